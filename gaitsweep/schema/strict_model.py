"""Strict pydantic models, and registries of models of which a field `kind` selects one."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import operator
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar, cast, get_args

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, SchemaValidator, core_schema


class _OwnMembers(type(BaseModel)):
    """Metaclass of strict models, whose `help` shows their own members, without those of bases."""

    def __dir__(cls) -> list[str]:
        return [name for name in vars(cls) if not name.startswith("_")]

    @property
    def __signature__(cls) -> inspect.Signature:
        """Signature of the fields and their defaults, without types; required fields come first."""
        fields = cast("type[BaseModel]", cls).model_fields.items()
        init_fields = {field.alias or name: field for name, field in fields if field.init is not False}
        in_order = sorted(init_fields.items(), key=lambda item: not item[1].is_required())
        return inspect.Signature(
            [
                inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=_default(field))
                for name, field in in_order
            ]
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
    """Replace arrays, series and NumPy numbers by lists and Python numbers, also inside mappings."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | range):
        return [plain(item) for item in value]
    return value.tolist() if hasattr(value, "tolist") else value
