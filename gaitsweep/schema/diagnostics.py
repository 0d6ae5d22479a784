"""Error messages of jobs: the field and its line, the value found, what is allowed, the near miss."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from gaitsweep import near_miss
from gaitsweep.errors import JobError

Path = tuple[str | int, ...]  # of a field in a job: ("vary", "psi_1", "linspace", 0)

_TEXT_LIMIT = 60  # characters of a quoted value
_LONGEST_WORD = 150  # characters
_LONGEST_SENTENCE = 1500  # characters
_DEEPEST = 4  # lists inside lists that are quoted
_MOST_BITS = 1000  # of a whole number that is quoted, since Python refuses to write longer ones


@dataclasses.dataclass(frozen=True)
class Diagnostic:
    """An error in a field of a job.

    `text` follows the name of the field at `path`, after a space unless it begins with a colon. `file` and
    `line` are its place if known; `place` is "--set key=value" if the field was set there. `is_cause` is true
    of a section that does not exist: its typo is the cause of others, such as a start that is missing.
    """

    path: Path
    text: str
    file: str = ""
    line: int | None = None
    place: str = ""
    is_cause: bool = False

    def __str__(self) -> str:
        line = self.place
        if not line and self.line is not None:
            line = f"line {self.line}"
        location = printable(", ".join(part for part in (self.file, line) if part))
        field = dotted(self.path)
        space = " " if field and not self.text.startswith(":") else ""
        sentence = printable(clipped_words(f"{field}{space}{self.text}"))
        return f"{location}: {sentence}" if location else sentence


def printable(text: str) -> str:
    """Return a text on one line: line feeds and tabs become spaces, and control characters are escaped."""
    text = re.sub(r"[\n\t]", " ", text)
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def clipped(text: str) -> str:
    """Shorten a text so that it can be quoted."""
    return text if len(text) <= _TEXT_LIMIT else f"{text[: _TEXT_LIMIT - 3]}..."


def clipped_words(text: str) -> str:
    """Shorten a long sentence, and its overlong words, such as a key of a thousand letters."""
    if len(text) > _LONGEST_SENTENCE:
        text = f"{text[:_LONGEST_SENTENCE]}..."
    return re.sub(rf"\S{{{_LONGEST_WORD + 1},}}", lambda word: f"{word[0][: _LONGEST_WORD - 3]}...", text)


def dotted(path: Path) -> str:
    """Write a path in dotted notation: vary.psi_1.linspace[0]."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += f".{part}" if text else part
    return text


def quoted(value: object) -> str:
    """Write a value as in a job, shortened to be quoted; only the beginning of a long one is read."""
    return clipped(_written(value, 0))


def _written(value: object, depth: int) -> str:
    """Write a value as in a job; `depth` is the number of lists around it."""
    if value is None:
        return "empty"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value[:_TEXT_LIMIT]}"'
    if isinstance(value, (list, tuple, dict)) and depth > _DEEPEST:
        return "..."
    if isinstance(value, dict):
        return f"a mapping ({', '.join(_some(map(str, value)))})" if value else "an empty mapping"
    if isinstance(value, (list, tuple)):
        items = _some(_written(item, depth + 1) for item in value)
        return f"a list ({', '.join(items)})" if value else "an empty list"
    if isinstance(value, int) and value.bit_length() > _MOST_BITS:
        return f"a number of {math.floor(value.bit_length() * math.log10(2.0)) + 1} digits"
    return str(value)


def _some(texts: Iterator[str]) -> Iterator[str]:
    """Yield the first texts, as far as a quoted value reaches."""
    length = 0
    for text in texts:
        yield text
        length += len(text) + 2
        if length > _TEXT_LIMIT:
            return


def refuse(wrong: Sequence[Diagnostic]) -> None:
    """Refuse a job that has errors.

    Raises:
        JobError: there are diagnostics.
    """
    if wrong:
        raise JobError(wrong)


def unknown_field(path: Path, section: str, allowed: Iterable[str], place: str = "") -> Diagnostic:
    """Return the diagnostic of a field that its section does not have.

    Args:
        path: the field's path.
        section: the name of its section in messages; empty for the job itself.
        allowed: the fields that the section has.
        place: the part of the job that has such a field, if another one does.
    """
    of_section = f" of {section}" if section else ""
    near = near_miss.suggestion(str(path[-1]), allowed)
    end = f": it belongs {place}. {near_miss.allowing(allowed)}" if place else near
    return Diagnostic(path, f"is not a field{of_section}{end}", is_cause=len(path) == 1)


def unknown_name(path: Path, name: str, kind: str, allowed: Iterable[str]) -> Diagnostic:
    """Return the diagnostic of a field whose value is no name of its kind.

    Args:
        path: the field's path.
        name: its value.
        kind: the kind in words, such as "a measure".
        allowed: the names of the kind.
    """
    return Diagnostic(path, f"is {name}, which is not {kind}{near_miss.suggestion(name, allowed)}")


def wrong_kind(
    path: Path, value: object, kinds: Collection[str], noun: str = "an allowed kind"
) -> Diagnostic | None:
    """Return the diagnostic of a mapping whose field `kind` is missing or unknown, or None.

    Args:
        path: the mapping's path.
        value: the mapping, or another value, which is refused.
        kinds: the known kinds.
        noun: a kind in words, such as "a run kind".
    """
    if not isinstance(value, Mapping):
        text = f"is {quoted(value)}, but must be a mapping with the field kind. {near_miss.allowing(kinds)}"
        return Diagnostic(path, text)
    if "kind" not in value:
        return Diagnostic((*path, "kind"), f"is missing. {near_miss.allowing(kinds)}")
    kind = value["kind"]
    if isinstance(kind, str) and kind in kinds:
        return None
    text = f": {quoted(kind)} is not {noun}{near_miss.suggestion(str(kind), kinds)}"
    return Diagnostic((*path, "kind"), text)
