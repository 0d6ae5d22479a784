"""A YAML file as plain values, with the line of each field, and nothing of YAML 1.1's readings of numbers.

Numbers are read as in YAML 1.2: `1e-3` is one, `1:30`, dates and `010` stay text, which the fields that
take numbers refuse with a sentence. Only true and false are booleans.
"""

from __future__ import annotations

import dataclasses
import difflib
import re
from pathlib import Path
from typing import Any, ClassVar

import yaml

from gaitsweep.job import complaints
from gaitsweep.job.complaints import Complaint, JobError

_LARGEST = 16 * 1024 * 1024  # bytes
_MOST_NODES = 300_000  # aliases of aliases grow past any file's size; PyYAML needs seconds for so many
_CORE = "tag:yaml.org,2002:"
_TAGS = ("null", "bool", "int", "float", "str", "seq", "map")


class _Loader(yaml.SafeLoader):
    """The safe loader, without its rules of what a plain word means."""

    yaml_implicit_resolvers: ClassVar[dict] = {}  # pyright: ignore[reportIncompatibleVariableOverride]


_INT = re.compile(r"^[-+]?(0|[1-9][0-9]*)$")
_FLOAT = re.compile(r"^[-+]?((0|[1-9][0-9]*)?\.[0-9]+|(0|[1-9][0-9]*)\.?)([eE][-+]?[0-9]+)?$")
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:null", re.compile(r"^(~|null|Null|NULL|)$"), ["~", "n", "N", ""]
)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^([Tt]rue|TRUE|[Ff]alse|FALSE)$"), list("tTfF")
)
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", _INT, list("-+0123456789"))
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+.0123456789"))
_Loader.add_implicit_resolver("tag:yaml.org,2002:merge", re.compile(r"^<<$"), ["<"])

_YAML_SENTENCES = {
    "mapping values are not allowed here": "a colon where none may stand: indent, or add quotes",
    "could not find expected ':'": "a key without its colon",
    "expected ',' or ']'": "a list [ that is not closed, or a comma that is missing",
    "expected ',' or '}'": "a mapping { that is not closed, or a comma that is missing",
    "unexpected end of stream": "text in quotes that is not closed",
    "found undefined alias": "an alias (*name) without its anchor (&name)",
    "expected <block end>": "an indentation that fits neither the lines above nor below",
    "another document": "a second document (---); a job is one document",
    "cannot start any token": "a character that no value may start with: put the text in quotes",
    "special characters are not allowed": "a control character",
    "expected the node content": "a comma or bracket too many, or a value that is missing",
}


@dataclasses.dataclass
class Document:
    """What a file says: `data`, and by path the line or the `--set` that said it."""

    file: str
    data: dict[str, Any]
    places: dict[complaints.Path, int | str]

    def locate(self, complaint: Complaint) -> Complaint:
        """The complaint with the file and the line (or `--set`) of the nearest field that is written here."""
        if complaint.file:
            return complaint
        place = self._place(complaint.path)
        if isinstance(place, str):
            return dataclasses.replace(complaint, file=self.file, place=place)
        return dataclasses.replace(complaint, file=self.file, line=place)

    def _place(self, path: complaints.Path) -> int | str | None:
        # Where the file wrote a field and an override changed it inside, what is wrong is the override's.
        for inner, place in self.places.items():
            if isinstance(place, str) and len(inner) > len(path) > 1 and inner[: len(path)] == path:
                return place
        for length in range(len(path), 0, -1):
            if path[:length] in self.places:
                return self.places[path[:length]]
        return None

    def located(self, error: JobError) -> JobError:
        """The error with every complaint located, in the order of the lines."""
        found = [self.locate(complaint) for complaint in error.complaints]
        return JobError(sorted(found, key=lambda complaint: complaint.line or 0))


def read_document(path: Path) -> Document:
    """The YAML mapping in a file.

    Raises:
        JobError: a file that is missing, a directory, not text, not YAML, empty, or not a mapping; a key
            that is written twice; a tag that asks for more than plain values.
    """
    name = str(path)
    text = _read_text(path, name)
    reading = _Reading(name)
    node = _compose(text, name)
    if node is None:
        raise _refused(name, None, "is empty: a job is a mapping (name: ..., model: ..., run: ...).")
    data = reading.value(node, ())
    if not isinstance(data, dict):
        raise _refused(name, 1, f"holds {complaints.found(data)}, but a job is a mapping (key: value).")
    return Document(name, data, reading.places)


def read_value(text: str, origin: str) -> Any:
    """The plain value of YAML text that was given on the command line, `origin` being how it was given."""
    node = _compose(text, origin)
    return None if node is None else _Reading(origin).value(node, ())


def _refused(file: str, line: int | None, text: str, path: complaints.Path = ()) -> JobError:
    return JobError([Complaint(path, text, file=file, line=line)])


def _read_text(path: Path, name: str) -> str:
    try:
        if path.is_dir():
            jobs = sorted(found.name for found in path.glob("*.y*ml"))
            listed = f" It holds {', '.join(jobs[:8])}." if jobs else ""
            raise _refused(name, None, f"is a directory, not a file.{listed}")
        if path.stat().st_size > _LARGEST:
            raise _refused(name, None, f"is larger than {_LARGEST // 2**20} MiB, which no job is.")
        raw = path.read_bytes()
    except FileNotFoundError:
        near = [found.name for found in path.parent.glob("*.y*ml")] if path.parent.is_dir() else []
        close = difflib.get_close_matches(path.name, near, n=1)
        raise _refused(
            name, None, f"does not exist{f'; did you mean {close[0]}?' if close else '.'}"
        ) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise _refused(name, None, f"cannot be read: {reason}.") from None
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise _refused(name, None, "is not text in UTF-8.") from None


def _compose(text: str, name: str) -> yaml.Node | None:
    try:
        return yaml.compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark is not None else None
        raise _refused(name, line, f"is not YAML: {_sentence(text, error.problem or '', line)}.") from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise _refused(name, line, "is not text: it has a control character.") from None
    except RecursionError:
        raise _refused(name, None, "is nested too deep to be read.") from None


def _sentence(text: str, problem: str, line: int | None) -> str:
    lines = text.split("\n")
    if line is not None and line <= len(lines) and re.match(r"^\s*\t", lines[line - 1]):
        return "a tab stands where YAML wants spaces"
    for start, sentence in _YAML_SENTENCES.items():
        if start in problem:
            return sentence
    return problem or "it cannot be read"


class _Reading:
    """Plain values from YAML's nodes, keeping the line of each."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.places: dict[complaints.Path, int | str] = {}
        self._open: set[int] = set()
        self._nodes = 0

    def value(self, node: yaml.Node, path: complaints.Path) -> Any:
        line = node.start_mark.line + 1
        self.places.setdefault(path, line)
        self._nodes += 1
        if self._nodes > _MOST_NODES:
            raise _refused(self.file, line, f"has more than {_MOST_NODES} values.", path)
        if id(node) in self._open:
            raise _refused(self.file, line, "contains itself through an alias.", path)
        tag = node.tag.removeprefix(_CORE)
        if tag not in _TAGS:
            shown = node.tag.replace(_CORE, "!!")
            text = f"has the tag {shown}, which is not read: write plain numbers, text, lists, mappings."
            raise _refused(self.file, line, text, path)
        self._open.add(id(node))
        try:
            if isinstance(node, yaml.MappingNode):
                return self._mapping(node, path)
            if isinstance(node, yaml.SequenceNode):
                return [self.value(item, (*path, index)) for index, item in enumerate(node.value)]
            return self._scalar(tag, node.value, line, path)
        except RecursionError:
            raise _refused(self.file, line, "is nested too deep to be read.") from None
        finally:
            self._open.discard(id(node))

    def _mapping(self, node: yaml.MappingNode, path: complaints.Path) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if key_node.tag == "tag:yaml.org,2002:merge":
                raise _refused(
                    self.file, line, "uses a merge key (<<), which is not read: write the fields out.", path
                )
            key = self._key(key_node, line, path)
            if key in result:
                first = self.places[(*path, key)]
                raise _refused(self.file, line, f"is written twice, first in line {first}.", (*path, key))
            self.places[(*path, key)] = line
            result[key] = self.value(value_node, (*path, key))
        return result

    def _key(self, node: yaml.Node, line: int, path: complaints.Path) -> str:
        if not isinstance(node, yaml.ScalarNode) or node.tag != "tag:yaml.org,2002:str":
            shown = node.value if isinstance(node, yaml.ScalarNode) else "a list or mapping"
            raise _refused(self.file, line, f"has the key {shown or '(empty)'}, but a key is text.", path)
        return node.value

    def _scalar(self, tag: str, text: str, line: int, path: complaints.Path) -> Any:
        if tag == "null":
            return None
        if tag == "bool" and text.lower() in ("true", "false"):
            return text.lower() == "true"
        if tag == "int" and _INT.match(text) and len(text) < 19:
            return int(text)
        if tag in ("int", "float") and (_INT.match(text) or _FLOAT.match(text)):
            return float(text)
        if tag == "str":
            return text
        raise _refused(self.file, line, f"is tagged !!{tag}, but {complaints.found(text)} is not one.", path)
