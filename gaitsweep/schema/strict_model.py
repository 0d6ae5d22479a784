"""Strict pydantic models, and registries of models of which a field `kind` selects one.

The errors of pydantic become diagnostics: the field as written, and a sentence for each type of error.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import operator
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar, cast, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails, SchemaValidator, core_schema

from gaitsweep import near_miss
from gaitsweep.expression import VARY_GROUPS
from gaitsweep.schema.diagnostics import Diagnostic, Path, quoted, unknown_field, wrong_kind


class _OwnMembers(type(BaseModel)):
    """Metaclass of strict models, whose `help` shows their own members, without those of bases."""

    def __dir__(cls) -> list[str]:
        return [name for name in vars(cls) if not name.startswith("_")]

    @property
    def __signature__(cls) -> inspect.Signature:
        """Signature of the fields and their defaults, without types; required fields come first."""
        fields = cast(type[BaseModel], cls).model_fields.items()
        init_fields = {field.alias or name: field for name, field in fields if field.init is not False}
        in_order = sorted(init_fields.items(), key=lambda item: not item[1].is_required())
        keyword = inspect.Parameter.KEYWORD_ONLY
        return inspect.Signature(
            [inspect.Parameter(name, keyword, default=_default(field)) for name, field in in_order]
        )

    @__signature__.setter
    def __signature__(cls, signature: object) -> None:
        """Ignore the signature that pydantic sets, which has the types of validators."""


def _default(field: FieldInfo) -> Any:
    """Return the default of a field in a signature; an ellipsis for one that is a model."""
    if field.is_required():
        return inspect.Parameter.empty
    default = field.get_default(call_default_factory=True)
    return ... if isinstance(default, BaseModel) else default


if TYPE_CHECKING:  # pydantic's own metaclass tells type checkers the fields of a model
    _Base = BaseModel
else:

    class _Base(BaseModel, metaclass=_OwnMembers):
        pass


class StrictModel(_Base):
    """A frozen model that refuses unknown fields; its numbers may be expressions."""

    # validators are built for the first value: a job has one run kind and few kinds of figures
    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    __about: ClassVar[str]  # the docstring as the class has it, without the list of fields

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        super().__pydantic_init_subclass__(**options)
        cls.__about = inspect.cleandoc(cls.__doc__ or "")
        described = []
        for name, field in cls.model_fields.items():
            if field.description and field.init is not False:
                text = f"{name}: {field.description}"
                described.append(textwrap.fill(text, 106, initial_indent=" " * 4, subsequent_indent=" " * 8))
        if described:
            cls.__doc__ = "\n".join([cls.__about, "", "Fields:", *described])

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        json_schema = handler(schema)
        of_class = handler.resolve_ref_schema(json_schema)
        if "description" in of_class:
            of_class["description"] = cls.__about
        return json_schema


def kind_of(model: type[StrictModel]) -> str:
    """Return the value of the field `kind` that selects a model.

    Args:
        model: the class of the model.

    Raises:
        TypeError: the model has no field `kind: Literal["..."]`.
    """
    field = model.model_fields.get("kind")
    values = () if field is None else get_args(field.annotation)
    if len(values) != 1 or not isinstance(values[0], str):
        raise TypeError(f'{model.__name__} needs a field kind: Literal["its_name"].')
    return values[0]


ModelT = TypeVar("ModelT", bound=StrictModel)


class Registry(Mapping[str, type[ModelT]]):
    """Models by their kind, in the order in which they were registered.

    Args:
        noun: the name of a member in messages, such as "run".
        models: the built-in members.
        module: a module that registers further members; it is imported when one is first looked for.
    """

    def __init__(self, noun: str, models: Iterable[type[ModelT]] = (), module: str | None = None) -> None:
        self.noun = noun
        self._module = module
        self._models: dict[str, type[ModelT]] = {}
        for model in models:
            self.register(model)

    def register(self, model: type[ModelT]) -> type[ModelT]:
        """Add a model; usable as a decorator.

        Raises:
            TypeError: the model has no field `kind: Literal["its_name"]`.
            ValueError: the registry has another model of this kind.
        """
        kind = kind_of(model)
        if self._models.setdefault(kind, model) is not model:
            raise ValueError(f"A kind of {self.noun} named {kind} exists already: choose another name.")
        return model

    def unregister(self, kind: str) -> None:
        """Remove a model by its kind.

        Raises:
            KeyError: the registry has no such model.
        """
        del self._members[kind]

    @property
    def _members(self) -> dict[str, type[ModelT]]:
        """All members, including those of the module."""
        if self._module is not None:
            importlib.import_module(self._module)
        return self._models

    def __getitem__(self, kind: str) -> type[ModelT]:
        return self._members[kind]

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self) -> int:
        return len(self._members)


@dataclasses.dataclass(frozen=True)
class OneOf:
    """Annotation of a field for any model of a registry, including models registered later."""

    registry: Registry[Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        # pydantic would fix the members of a discriminated union when the class of the job is made
        return core_schema.no_info_plain_validator_function(self._read)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return handler(self._adapter.core_schema)

    def _read(self, value: Any) -> Any:
        """Validate a value by the member of its kind; without such a member the union reports the error."""
        kind = value.get("kind") if isinstance(value, Mapping) else getattr(value, "kind", None)
        if isinstance(kind, str) and kind in self.registry:
            return _member(kind, self.registry[kind]).validate_python(value)
        return self._adapter.validator.validate_python(value)

    @property
    def _adapter(self) -> TypeAdapter[Any]:
        """Validator of the union of all members."""
        return _union(tuple(self.registry.values()))


@functools.lru_cache(maxsize=64)
def _member(kind: str, model: type[StrictModel]) -> SchemaValidator:
    """Return the validator of a union's member, whose errors have the same places as those of the union."""
    member = core_schema.no_info_plain_validator_function(model.model_validate)
    return SchemaValidator(core_schema.tagged_union_schema({kind: member}, "kind", from_attributes=True))


@functools.lru_cache(maxsize=8)
def _union(models: tuple[type[StrictModel], ...]) -> TypeAdapter[Any]:
    """Return the validator of a union that the field `kind` discriminates."""
    union: Any = Annotated[functools.reduce(operator.or_, models), Field(discriminator="kind")]
    return TypeAdapter(union)


def plain(value: Any) -> Any:
    """Replace arrays, NumPy numbers and models by lists, numbers and mappings, also inside mappings."""
    if isinstance(value, BaseModel):
        return plain(value.model_dump(by_alias=True, exclude_none=True))
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | range):
        return [plain(item) for item in value]
    return value.tolist() if hasattr(value, "tolist") else value


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
        sections = {words: SchemaSection(words, model)}
        for name, field in model.model_fields.items():
            for part in (field.annotation, *get_args(field.annotation)):
                if isinstance(part, type) and issubclass(part, StrictModel):
                    sections[name] = SchemaSection(name, part)
        wrong.extend(from_pydantic(error, sections, words, path))
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
        place = _place_of(str(path[-1]), section, sections)
        return unknown_field(path, section.words, section.fields, place)
    if error == "missing":
        field = section.fields.get(str(path[-1]))  # None: an item of a list
        return Diagnostic(path, "is missing." if field is None else f"is missing: {field.description}.")
    of_union = error == "model_attributes_type" and (loc == ("run",) or loc[:1] == ("figures",))
    if of_union or error in ("union_tag_invalid", "union_tag_not_found"):
        return _about_kind(path, value, sections)
    if error in ("too_short", "too_long"):
        end, limit = ("at least", "min_length") if error == "too_short" else ("at most", "max_length")
        text = f"has {context['actual_length']} items, but must have {end} {context[limit]}."
        return Diagnostic(path, text)
    if error == "list_type":
        return Diagnostic(path, f"is {quoted(value)}, but must be a list in brackets.")
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
    return f"under {next(iter(homes.values())).union} ({named})" if kinds else ""


def _about_kind(path: Path, value: object, sections: dict[str, SchemaSection]) -> Diagnostic:
    """Return the diagnostic of a run or a figure whose `kind` is missing or unknown."""
    kinds = [tag.rpartition(".")[2] for tag, section in sections.items() if section.union == path[0]]
    noun = "a run kind" if path[0] == "run" else "a figure kind"
    return wrong_kind(path, value, kinds, noun) or Diagnostic(path, f"is {quoted(value)}.")


def _without_tags(loc: Path, sections: dict[str, SchemaSection]) -> Path:
    """Return the path as written; pydantic adds tags of unions, and one after a wrong key of a mapping."""
    if loc[-1:] == ("[key]",):
        return loc[:-1]
    for place in range(1, len(loc)):
        section = sections.get(_key(loc, place))
        # after the union's field, or its number in a list
        if section and section.union and section.union in loc[max(place - 2, 0) : place]:
            return (*loc[:place], *loc[place + 1 :])
    return loc


def _key(loc: Path, place: int) -> str:
    """Return the key among the sections of one step of a pydantic path: figures.basin, but settle."""
    return f"figures.{loc[place]}" if loc[0] == "figures" else str(loc[place])
