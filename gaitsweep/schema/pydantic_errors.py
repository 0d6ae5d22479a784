"""Diagnostics from the errors of pydantic: the field as written, and a sentence for each type of error."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from gaitsweep import near_miss
from gaitsweep.expression import VARY_GROUPS
from gaitsweep.schema.diagnostics import (
    FORMER_RUN_FIELDS,
    FORMER_RUN_KINDS,
    Diagnostic,
    Path,
    quoted,
    unknown_field,
    wrong_kind,
)
from gaitsweep.schema.strict_model import ModelT, StrictModel


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
        former = FORMER_RUN_FIELDS.get(key)
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
        wrong = wrong_kind(path, value, kinds, FORMER_RUN_KINDS, "a run kind")
    else:
        wrong = wrong_kind(path, value, kinds, noun="a figure kind")
    return wrong or Diagnostic(path, f"is {quoted(value)}.")


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
