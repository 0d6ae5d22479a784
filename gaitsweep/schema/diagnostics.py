"""Error messages of jobs: the field and its line, the value found, what is allowed, the near miss."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from gaitsweep import near_miss
from gaitsweep.errors import UserError
from gaitsweep.expression import VARY_GROUPS
from gaitsweep.schema import former_names
from gaitsweep.schema.strict_model import ModelT, StrictModel

Path = tuple[str | int, ...]  # of a field in a job: ("vary", "psi_1", "linspace", 0)

_MAX_ERRORS = 5  # in a message
_TEXT_LIMIT = 60  # characters of a quoted value
_LONGEST_WORD = 150  # characters
_LONGEST_SENTENCE = 1500  # characters
_DEEPEST = 4  # lists inside lists that are quoted
_MOST_BITS = 1000  # of a whole number that is quoted, since Python refuses to write longer ones


@dataclasses.dataclass(frozen=True)
class Diagnostic:
    """An error in a field of a job.

    `text` follows the name of the field at `path`, after a space unless it begins with a colon. `file` and
    `line` are its place if known; `place` is "--set key=value" if the field was set there.
    """

    path: Path
    text: str
    file: str = ""
    line: int | None = None
    place: str = ""

    def __str__(self) -> str:
        line = self.place
        if not line and self.line is not None:
            line = f"line {self.line}"
        location = printable(", ".join(part for part in (self.file, line) if part))
        field = dotted(self.path)
        space = " " if field and not self.text.startswith(":") else ""
        sentence = printable(clipped_words(f"{field}{space}{self.text}"))
        return f"{location}: {sentence}" if location else sentence


class JobError(UserError):
    """A job that cannot be run: `diagnostics` has all errors, the message the first few."""

    def __init__(self, diagnostics: Sequence[Diagnostic]) -> None:
        self.diagnostics = tuple(dict.fromkeys(diagnostics))
        lines = [str(diagnostic) for diagnostic in self.diagnostics[:_MAX_ERRORS]]
        if len(self.diagnostics) > _MAX_ERRORS:
            lines.append(f"... and {len(self.diagnostics) - _MAX_ERRORS} more.")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[type[JobError], tuple[tuple[Diagnostic, ...]]]:
        return JobError, (self.diagnostics,)


def printable(text: str) -> str:
    """Return a text on one line: line ends become spaces, and control characters are escaped."""
    if text.isprintable():
        return text
    return "".join(map(_printable_character, text))


def _printable_character(character: str) -> str:
    """Return a character, or what stands for it in a printable text."""
    if character in "\n\t":
        return " "
    return character if character.isprintable() else character.encode("unicode_escape").decode()


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


def unknown_field(
    path: Path,
    section: str,
    allowed: Iterable[str],
    former: Mapping[str, str] | None = None,
    place: str = "",
) -> Diagnostic:
    """Return the diagnostic of a field that its section does not have.

    Args:
        path: the field's path.
        section: the name of its section in messages; empty for the job itself.
        allowed: the fields that the section has.
        former: new names by older ones.
        place: the part of the job that has such a field, if another one does.
    """
    field = str(path[-1])
    of_section = f" of {section}" if section else ""
    if former and field in former:
        return Diagnostic(path, f"is not a field{of_section} any more: it is called {former[field]} now.")
    if place:
        return Diagnostic(
            path, f"is not a field{of_section}: it belongs {place}. {near_miss.allowing(allowed)}"
        )
    return Diagnostic(path, f"is not a field{of_section}{near_miss.suggestion(field, allowed)}")


def unknown_name(path: Path, name: str, kind: str, allowed: Iterable[str]) -> Diagnostic:
    """Return the diagnostic of a field whose value is no name of its kind.

    Args:
        path: the field's path.
        name: its value.
        kind: the kind in words, such as "a measure".
        allowed: the names of the kind.
    """
    return Diagnostic(path, f"is {name}, which is not {kind}{near_miss.suggestion(name, allowed)}")


@dataclasses.dataclass(frozen=True)
class SchemaSection:
    """A section of a job: its name in messages, its class, and the field whose union it belongs to."""

    words: str
    model: type[StrictModel]
    union: str = ""

    @property
    def fields(self) -> dict[str, FieldInfo]:
        """Fields by their names in a job, which may not be those in Python."""
        return {field.alias or name: field for name, field in self.model.model_fields.items()}


def from_pydantic(
    error: ValidationError, sections: dict[str, SchemaSection], top: str, prefix: Path = ()
) -> list[Diagnostic]:
    """Return a diagnostic for each error of pydantic.

    Args:
        error: what pydantic raised.
        sections: the sections by the field, or the union's tag, under which pydantic reports them.
        top: the key in `sections` of what was validated.
        prefix: the path of what was validated inside the job.
    """
    return [_from_details(details, sections, top, prefix) for details in error.errors(include_url=False)]


def read_model(
    model: type[ModelT], value: Any, path: Path, wrong: list[Diagnostic], words: str = ""
) -> ModelT | None:
    """Read the value at a path as a strict model; return None if it has errors.

    Args:
        model: the class of the model.
        value: the value.
        path: its path in the job.
        wrong: the list to which its diagnostics are added.
        words: its name in a sentence, by default the last step of its path.
    """
    words = words or str(path[-1])
    try:
        return model.model_validate(value)
    except ValidationError as error:
        wrong.extend(from_pydantic(error, {words: SchemaSection(words, model)}, words, path))
        return None


def _from_details(
    details: ErrorDetails, sections: dict[str, SchemaSection], top: str, prefix: Path
) -> Diagnostic:
    """Return the diagnostic of one error of pydantic; arguments as of `from_pydantic`."""
    loc = tuple(details["loc"])
    path: Path = (*prefix, *_without_tags(loc, sections))
    error = details["type"]
    value = details["input"]
    context = details.get("ctx", {})
    enclosing = [_key(loc, place) for place in reversed(range(len(loc) - 1))]
    key = next((key for key in enclosing if key in sections), top)
    section = sections[key]
    if error == "gaitsweep":
        return Diagnostic(path, context["text"])
    if error == "extra_forbidden":
        former = former_names.RUN_FIELDS.get(key)
        place = _place_of(str(path[-1]), section, sections)
        return unknown_field(path, section.words, section.fields, former, place)
    if error == "missing":
        return Diagnostic(path, f"is missing: {section.fields[str(path[-1])].description}.")
    if error in ("union_tag_invalid", "union_tag_not_found"):
        return _about_kind(path, value, sections)
    if error in ("too_short", "too_long"):
        end, limit = ("at least", "min_length") if error == "too_short" else ("at most", "max_length")
        return Diagnostic(
            path, f"has {context['actual_length']} items, but must have {end} {context[limit]}."
        )
    if error == "list_type":
        return Diagnostic(path, f"is {quoted(value)}, but must be a list in brackets.")
    if error == "model_attributes_type" and (loc == ("run",) or loc[:1] == ("figures",)):
        return _about_kind(path, value, sections)
    if error in ("model_type", "dict_type", "model_attributes_type"):
        inner = sections.get(_key(loc, -1) if loc else "")
        fields = f" {near_miss.allowing(inner.fields)}" if inner else ""
        return Diagnostic(path, f"is {quoted(value)}, but must be a mapping (key: value).{fields}")
    return Diagnostic(path, f"is {quoted(value)}, which is not allowed here.")


def _place_of(field: str, section: SchemaSection, sections: Mapping[str, SchemaSection]) -> str:
    """Words for the part of a job that has a field which `section` lacks; empty if there is none."""
    homes = {
        key: other
        for key, other in sections.items()
        if field not in ("kind", "name") and other is not section and field in other.fields
    }
    if field in VARY_GROUPS:
        return "under vary"
    if "" in homes:
        return "at the top of the job"
    for other in homes.values():
        if not other.union:
            return f"under {other.words.rpartition(' ')[2]}"
    kinds = [key.rpartition(".")[2] for key in homes]
    if len(kinds) > 1 and kinds == [key.rpartition(".")[2] for key in sections if key.startswith("figures.")]:
        return "in an entry of figures (of any kind)"
    named = f"{', '.join(kinds[:4])}{', ...' if len(kinds) > 4 else ''}"
    if any(other.union == "figures" for other in homes.values()):
        return f"in an entry of figures ({named})"
    return f"under run ({named})" if kinds else ""


def _about_kind(path: Path, value: object, sections: dict[str, SchemaSection]) -> Diagnostic:
    """Return the diagnostic of a run or a figure whose `kind` is missing or unknown."""
    kinds = [tag.rpartition(".")[2] for tag, section in sections.items() if section.union == path[0]]
    if path[0] == "run":
        wrong = wrong_kind(path, value, kinds, former_names.RUN_KINDS, "a run kind")
    else:
        wrong = wrong_kind(path, value, kinds, noun="a figure kind")
    return wrong or Diagnostic(path, f"is {quoted(value)}.")


def wrong_kind(
    path: Path,
    value: object,
    kinds: Collection[str],
    former: Mapping[str, str] | None = None,
    noun: str = "an allowed kind",
) -> Diagnostic | None:
    """Return the diagnostic of a mapping whose field `kind` is missing or unknown, or None.

    Args:
        path: the mapping's path.
        value: the mapping, or another value, which is refused.
        kinds: the known kinds.
        former: new names by older ones.
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
    if former and isinstance(kind, str) and kind in former:
        text = f": {kind} is now called {former[kind]}; write {former[kind]}."
    else:
        text = f": {quoted(kind)} is not {noun}{near_miss.suggestion(str(kind), kinds)}"
    return Diagnostic((*path, "kind"), text)


def _without_tags(loc: Path, sections: dict[str, SchemaSection]) -> Path:
    """Return the path as written; pydantic adds tags after run, figures[i] and a wrong key of a mapping."""
    if loc[-1:] == ("[key]",):
        return loc[:-1]
    if len(loc) > 1 and loc[0] == "run" and loc[1] in sections:
        return (loc[0], *loc[2:])
    if len(loc) > 2 and loc[0] == "figures" and _key(loc, 2) in sections:
        return (*loc[:2], *loc[3:])
    return loc


def _key(loc: Path, place: int) -> str:
    """Return the key among the sections of one step of a pydantic path: figures.basin, but settle."""
    return f"figures.{loc[place]}" if loc[0] == "figures" else str(loc[place])
