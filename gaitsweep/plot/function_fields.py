"""The arguments of a drawing function as fields of a kind of figure in a job."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import Field


def fields_of(draw: Callable[..., Any]) -> dict[str, Any]:
    """The described arguments of a function as fields of a job."""
    fields = {}
    _, *arguments = inspect.signature(draw).parameters.items()  # without the table, whose type is pandas'
    for name, argument in arguments:
        annotation = argument.annotation
        if isinstance(annotation, str):
            annotation = eval(annotation, draw.__globals__)
        description = getattr(annotation, "__metadata__", (None,))[-1]
        if isinstance(description, str):
            # pydantic's mark of a required field is `...`; mappings are not shared between figures
            default: Any = ... if argument.default is argument.empty else argument.default
            mapping = isinstance(default, Mapping)
            value: dict[str, Any] = {"default_factory": dict} if mapping else {"default": default}
            fields[name] = (_in_job(annotation), Field(**value, description=description))
    return fields


def _in_job(annotation: Any) -> Any:
    """Type of a figure's argument in a job: lists and dicts, and no table."""
    origin, (first, *rest) = get_origin(annotation), get_args(annotation) or (None,)
    if origin is Annotated:
        return Annotated[_in_job(first), *rest]
    if origin in (Union, UnionType):
        parts = (part for part in (first, *rest) if getattr(part, "__name__", "") != "DataFrame")
        return Union[tuple(_in_job(part) for part in parts)]  # noqa: UP007 - of a tuple of types
    if origin in (Sequence, Mapping):
        plain = list if origin is Sequence else dict
        return plain[*(_in_job(part) for part in (first, *rest))]  # pyright: ignore[reportInvalidTypeArguments]
    return annotation


def parts_of(annotations: Sequence[Any]) -> Iterator[Any]:
    """Annotations and all their parts."""
    for annotation in annotations:
        yield annotation
        yield from parts_of(get_args(annotation))
