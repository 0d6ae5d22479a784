"""Parts of a job: pydantic models, and registries of them whose members a field `kind` selects."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import operator
from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema


class Part(BaseModel):
    """A part of a job: it has no field but its own and is frozen; its numbers may be expressions."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def kind_of(part: type[Part]) -> str:
    """The value of the field `kind` that selects a part.

    Raises:
        TypeError: the part has no field `kind: Literal["..."]`.
    """
    field = part.model_fields.get("kind")
    values = getattr(field and field.annotation, "__args__", ())
    if len(values) != 1 or not isinstance(values[0], str):
        raise TypeError(f'{part.__name__} needs a field kind: Literal["its_name"].')
    return values[0]


PartT = TypeVar("PartT", bound=Part)


class Registry(Mapping[str, type[PartT]]):
    """Parts by their kind, in the order in which they were registered.

    Args:
        noun: what a sentence calls a member, such as "run".
        parts: the members that are always there.
        module: a module that registers further members; it is imported when one is first looked for.
    """

    def __init__(self, noun: str, parts: Iterable[type[PartT]] = (), module: str | None = None) -> None:
        self.noun = noun
        self._module = module
        self._parts: dict[str, type[PartT]] = {}
        for part in parts:
            self.register(part)

    def register(self, part: type[PartT]) -> type[PartT]:
        """Add a part; usable as a decorator.

        Raises:
            TypeError: the part has no field `kind: Literal["its_name"]`.
            ValueError: the registry has another part of this kind.
        """
        kind = kind_of(part)
        if self._parts.setdefault(kind, part) is not part:
            raise ValueError(f"There is a kind of {self.noun} named {kind}: give this one another name.")
        return part

    def unregister(self, kind: str) -> None:
        """Remove a part by its kind.

        Raises:
            KeyError: the registry has no such part.
        """
        del self._members[kind]

    @property
    def _members(self) -> dict[str, type[PartT]]:
        if self._module is not None:
            importlib.import_module(self._module)
        return self._parts

    def __getitem__(self, kind: str) -> type[PartT]:
        return self._members[kind]

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self) -> int:
        return len(self._members)


@dataclasses.dataclass(frozen=True)
class OneOf:
    """The annotation of a field that takes any part of a registry, those registered later too."""

    registry: Registry[Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        # pydantic would fix the members of a discriminated union when the class of the job is made
        return core_schema.no_info_plain_validator_function(self._read)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return handler(self._adapter.core_schema)

    def _read(self, value: Any) -> Any:
        return self._adapter.validate_python(value)

    @property
    def _adapter(self) -> TypeAdapter[Any]:
        return _union(tuple(self.registry.values()))


@functools.lru_cache(maxsize=8)
def _union(parts: tuple[type[Part], ...]) -> TypeAdapter[Any]:
    union: Any = Annotated[functools.reduce(operator.or_, parts), Field(discriminator="kind")]
    return TypeAdapter(union)


def plain(value: Any) -> Any:
    """Lists and Python's numbers for arrays, series and NumPy's numbers, in mappings too."""
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | range):
        return [plain(each) for each in value]
    return value.tolist() if hasattr(value, "tolist") else value
