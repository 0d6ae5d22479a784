"""YAML files as plain values, with the line of each field; numbers follow YAML 1.2, not 1.1.

`1e-3` is a number; `1:30`, dates and `010` stay text, which numeric fields refuse with an explanation. Only
true and false are booleans.
"""

from __future__ import annotations

import dataclasses
import itertools
import os
import re
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import yaml

from gaitsweep import near_miss
from gaitsweep.errors import JobError
from gaitsweep.schema.diagnostics import Diagnostic, clipped, quoted
from gaitsweep.schema.diagnostics import Path as FieldPath
from gaitsweep.schema.numbers import control_character
from gaitsweep.shipped import job_folders, shipped_as

_ByLibyaml: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_LARGEST = 2**21 if _ByLibyaml is not yaml.SafeLoader else 2**18  # bytes, which are parsed in seconds
_MAX_NODES = 100_000  # values of a file, with all that its aliases stand for
_DEEPEST = 60  # lists and mappings inside each other
_TOO_DEEP = f"is nested too deep: at most {_DEEPEST} levels of lists and mappings are allowed."
_MAX_LISTED = 200  # names of a folder that are looked through for a near miss
_MAX_DIGITS = 18  # of a whole number that is read as one; longer ones become floats
_CORE = "tag:yaml.org,2002:"  # begins the tags of YAML's own types
_TAGS = ("null", "bool", "int", "float", "str", "seq", "map")


class _LimitError(Exception):
    """A document exceeds a limit; the message follows the file's name."""

    def __init__(self, line: int | None, message: str) -> None:
        self.line = line
        super().__init__(message)


class _Loader(_ByLibyaml):  # pyright: ignore[reportGeneralTypeIssues] (libyaml is optional)
    """Safe loader of PyYAML, without its rules for plain words, that limits nodes and depth."""

    yaml_implicit_resolvers: ClassVar[dict] = {}
    _nodes = 0
    _depth = 0

    def descend_resolver(self, current_node: Any, current_index: Any) -> None:
        """Count a node; PyYAML calls this before it composes one, and `ascend_resolver` after it."""
        self._nodes += 1
        self._depth += 1
        line = current_node.start_mark.line + 1 if current_node is not None else None
        if self._nodes > _MAX_NODES:
            raise _LimitError(line, f"has more than {_MAX_NODES} values.")
        if self._depth > _DEEPEST:
            raise _LimitError(line, _TOO_DEEP)

    def ascend_resolver(self) -> None:
        """Leave a node."""
        self._depth -= 1


_INT = re.compile(r"^[-+]?(0|[1-9][0-9]*)\Z")
_FLOAT = re.compile(r"^[-+]?((0|[1-9][0-9]*)?\.[0-9]+|(0|[1-9][0-9]*)\.?)([eE][-+]?[0-9]+)?\Z")
# The plain words of each type, and the characters with which they begin; an earlier type takes precedence.
for _tag, _words, _first in (
    ("null", re.compile(r"^(~|null|Null|NULL|)\Z"), ["~", "n", "N", ""]),
    ("bool", re.compile(r"^([Tt]rue|TRUE|[Ff]alse|FALSE)\Z"), list("tTfF")),
    ("int", _INT, list("-+0123456789")),
    ("float", _FLOAT, list("-+.0123456789")),
    ("merge", re.compile(r"^<<\Z"), ["<"]),
):
    _Loader.add_implicit_resolver(_CORE + _tag, _words, _first)

# Sentences for the problems that PyYAML or libyaml reports, by a part of their texts.
_YAML_SENTENCES = {
    "mapping values are not allowed": "a colon is not allowed here: indent, or add quotes",
    "could not find expected ':'": "a colon is missing after a key",
    "expected ',' or ']'": "a list [ is not closed, or a comma is missing",
    "expected ',' or '}'": "a mapping { is not closed, or a comma is missing",
    "unexpected end of stream": "a closing quote is missing",
    "found undefined alias": "an alias (*name) has no anchor (&name)",
    "expected <block end>": "the indentation fits neither the lines above nor those below",
    "did not find expected key": "the indentation fits neither the lines above nor those below",
    "did not find expected '-'": "the indentation fits neither the lines above nor those below",
    "another document": "a second document (---) begins, but only one is allowed",
    "cannot start any token": "a value cannot begin with this character: put the text in quotes",
    "special characters are not allowed": "control characters are not allowed",
    "control characters are not allowed": "control characters are not allowed",
    "expected node content": "there is a comma or bracket too many, or a value is missing",
    "expected the node content": "there is a comma or bracket too many, or a value is missing",
}


@dataclasses.dataclass
class Document:
    """Content of a file: `data`, and in `places` the line or the `--set` of each path.

    `overridden` are the paths that `--set` changed.
    """

    file: str
    data: dict[str, Any]
    places: dict[FieldPath, int | str]
    overridden: list[FieldPath] = dataclasses.field(default_factory=list)

    def locate(self, diagnostic: Diagnostic) -> Diagnostic:
        """Return the diagnostic with the file and line (or `--set`) of the nearest field in this document."""
        if diagnostic.file:
            return diagnostic
        place = self._place(diagnostic.path)
        if not isinstance(place, str):
            return dataclasses.replace(diagnostic, file=self.file, line=place)
        text = diagnostic.text
        if place.endswith("="):
            text += " Write a value after =; to go without the field, remove it from the file."
        return dataclasses.replace(diagnostic, file=self.file, place=place, text=text)

    def _place(self, path: FieldPath) -> int | str | None:
        """Return the line or the `--set` of the nearest field that contains a path, or None."""
        # an error in a field of the file that an override changed inside is located at the override
        for inner in self.overridden:  # few, where `places` may be many
            if inner in self.places and len(inner) > len(path) > 1 and inner[: len(path)] == path:
                return self.places[inner]
        for length in range(len(path), 0, -1):
            if path[:length] in self.places:
                return self.places[path[:length]]
        return None

    def located(self, error: JobError) -> JobError:
        """Return the error with the location of each diagnostic, in the order of the lines."""
        diagnostics = [self.locate(diagnostic) for diagnostic in error.diagnostics]
        return JobError(sorted(diagnostics, key=lambda diagnostic: diagnostic.line or 0))


def read_document(
    path: Path, *, noun: str = "a job", fields: Sequence[str] = ("name", "model", "run")
) -> Document:
    """Read the YAML mapping in a file.

    Args:
        path: the file.
        noun: what the file describes, for messages.
        fields: its first fields, for the message about an empty file.

    Raises:
        JobError: the file is missing, a directory, not text, not YAML, empty, or not a mapping; or it has a
            duplicate key or an unsupported tag.
    """
    name = str(path)
    text = _read_text(path, noun)
    reading = _Reading(name)
    node = _compose(text, name)
    if node is None:
        example = ", ".join(f"{field}: ..." for field in fields)
        raise _refused(name, None, f"is empty: {noun} is a mapping ({example}).")
    data = reading.value(node, ())
    if not isinstance(data, dict):
        text = f"holds {quoted(data)}, but {noun} must be a mapping (key: value)."
        raise _refused(name, 1, text)
    return Document(name, data, reading.places)


def read_value(text: str, origin: str) -> Any:
    """Read the plain value of YAML text from the command line.

    Args:
        text: the YAML text; None is read of an empty one.
        origin: the option that holds it, for messages.

    Raises:
        JobError: it is not YAML, exceeds a limit, or has a duplicate key or an unsupported tag.
    """
    node = _compose(text, origin)
    return None if node is None else _Reading(origin).value(node, ())


def _refused(file: str, line: int | None, text: str, path: FieldPath = ()) -> JobError:
    """Return the error of one field of a file, or of the file itself."""
    return JobError([Diagnostic(path, text, file=file, line=line)])


def _read_text(path: Path, noun: str) -> str:
    """Read the text of a file that describes `noun`; raises JobError where it is not readable text."""
    name = str(path)
    try:
        _require_regular(path, os.stat(path).st_mode, noun)
        # without blocking, since it may have been replaced by a named pipe that has no writer
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            _require_regular(path, os.fstat(descriptor).st_mode, noun)
            raw = file.read(_LARGEST + 1)  # a file of /proc has no size before it is read
    except FileNotFoundError:
        raise _refused(name, None, f"does not exist{_suggestion(path)}") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise _refused(name, None, f"cannot be read: {reason}.") from None
    if raw is None:
        raise _refused(name, None, "cannot be read: it is empty so far.")
    if len(raw) > _LARGEST:
        raise _refused(name, None, f"is larger than {_LARGEST / 2**20:g} MiB, the largest size of {noun}.")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise _refused(name, None, "is not text in UTF-8.") from None


def _suggestion(path: Path) -> str:
    """Return the end of the message about a missing file."""
    # `sweeps/quick_basins.yaml` of the documentation, in a folder that is not a checkout
    if job := shipped_as(path, near_miss.nearest):
        return f"; did you mean {job}?"
    if path.parent in job_folders():
        return "; `gaitsweep examples` lists the jobs that come with gaitsweep and its extensions."
    if file := near_miss.nearest(path.name, _yaml_files(path.parent)):
        return f"; did you mean {file}?"
    return "." if path.parent.is_dir() else f", nor does its folder {path.parent}."


def _require_regular(path: Path, mode: int, noun: str) -> None:
    """Raise JobError if a file that describes `noun` is not a regular one, from its `st_mode`."""
    if stat.S_ISREG(mode):
        return
    if stat.S_ISDIR(mode):
        jobs = ", ".join(sorted(_yaml_files(path))[:8])
        content = f" It holds {jobs}." if jobs else ""
        raise _refused(str(path), None, f"is a directory, not a file.{content}")
    kinds = {stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket"}
    kind = kinds.get(stat.S_IFMT(mode), "a device")
    raise _refused(str(path), None, f"is {kind}; {noun} must be a regular file.")


def _yaml_files(folder: Path) -> list[str]:
    """Return the names of some YAML files of a folder; none if it cannot be read."""
    try:
        with os.scandir(folder) as entries:
            names = (entry.name for entry in entries if re.search(r"\.ya?ml\Z", entry.name))
            return list(itertools.islice(names, _MAX_LISTED))
    except OSError:
        return []


def _compose(text: str, name: str) -> yaml.Node | None:
    """Parse the tree of nodes of a YAML text; None if it is empty."""
    try:
        return yaml.compose(text, Loader=_Loader)
    except _LimitError as error:
        raise _refused(name, error.line, str(error)) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark is not None else None
        raise _refused(name, line, f"is not YAML: {_sentence(text, error.problem or '', line)}.") from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise _refused(name, line, "is not text: it contains a control character.") from None
    except RecursionError:
        raise _refused(name, None, "is nested too deep to be read.") from None
    except (ValueError, OverflowError):  # an escape past Unicode's last character
        raise _refused(name, None, "is not YAML.") from None


def _sentence(text: str, problem: str, line: int | None) -> str:
    """Return the sentence for a problem that the YAML parser reports in a line."""
    lines = text.split("\n", line or 0)
    if line is not None and line <= len(lines) and re.match(r"^\s*\t", lines[line - 1]):
        return "a tab is used for indentation; use spaces"
    for part, sentence in _YAML_SENTENCES.items():
        if part in problem:
            return sentence
    return problem or "it cannot be read"


class _Reading:
    """Converter of YAML nodes to plain values, which records the line of each.

    Args:
        file: the name of the file, for messages.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self.places: dict[FieldPath, int | str] = {}
        self._open: set[int] = set()
        self._nodes = 0

    def _refused(self, line: int, text: str, path: FieldPath) -> JobError:
        """Return the error of a field of the file."""
        return _refused(self.file, line, text, path)

    def value(self, node: yaml.Node, path: FieldPath) -> Any:
        """Return the plain value of a node at a path.

        Raises:
            JobError: the node is nested too deep, contains itself, or has an unsupported tag or key.
        """
        line = node.start_mark.line + 1
        if len(path) > _DEEPEST:
            raise self._refused(line, _TOO_DEEP, ())
        self.places.setdefault(path, line)
        self._nodes += 1
        if self._nodes > _MAX_NODES:
            raise self._refused(line, f"has more than {_MAX_NODES} values.", path)
        if id(node) in self._open:
            raise self._refused(line, "contains itself through an alias.", path)
        tag = node.tag.removeprefix(_CORE)
        if tag not in _TAGS:
            text = f"has the tag {node.tag.replace(_CORE, '!!')}, which is not supported: write plain "
            raise self._refused(line, f"{text}numbers, text, lists and mappings.", path)
        self._open.add(id(node))
        try:
            if isinstance(node, yaml.MappingNode):
                return self._mapping(node, path)
            if isinstance(node, yaml.SequenceNode):
                return [self.value(item, (*path, index)) for index, item in enumerate(node.value)]
            return self._scalar(tag, node.value, line, path)
        finally:
            self._open.discard(id(node))

    def _mapping(self, node: yaml.MappingNode, path: FieldPath) -> dict[str, Any]:
        """Return the values of a mapping by key; duplicate and merge keys are refused."""
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            if key_node.tag == f"{_CORE}merge":
                text = "uses a merge key (<<), which is not supported: write the fields out."
                raise self._refused(line, text, path)
            key = self._key(key_node, line, path)
            if key in result:
                first = self.places[(*path, key)]
                raise self._refused(line, f"is written twice, first in line {first}.", (*path, key))
            self.places[(*path, key)] = line
            result[key] = self.value(value_node, (*path, key))
        return result

    def _key(self, node: yaml.Node, line: int, path: FieldPath) -> str:
        """Return the key of a mapping, which must be text."""
        if not isinstance(node, yaml.ScalarNode) or node.tag != f"{_CORE}str":
            is_scalar = isinstance(node, yaml.ScalarNode)
            key = clipped(node.value) or "(empty)" if is_scalar else "a list or mapping"
            raise self._refused(line, f"has the key {key}, but a key must be text.", path)
        if (wrong := control_character(node.value)) is not None:
            raise self._refused(line, f"has a key that contains {wrong}, which is not allowed.", path)
        return node.value

    def _scalar(self, tag: str, text: str, line: int, path: FieldPath) -> Any:
        """Return the value of a scalar by its tag."""
        if tag == "null":
            return None
        if tag == "bool" and text.lower() in ("true", "false"):
            return text.lower() == "true"
        if tag == "int" and _INT.match(text) and len(text) <= _MAX_DIGITS:
            return int(text)
        if tag in ("int", "float") and (_INT.match(text) or _FLOAT.match(text)):
            return float(text)
        if tag == "str":
            if (wrong := control_character(text)) is not None:
                raise self._refused(line, f"contains {wrong}, which is not allowed in text.", path)
            return text
        message = f"is tagged !!{tag}, but {quoted(text)} is not of that type."
        raise self._refused(line, message, path)
