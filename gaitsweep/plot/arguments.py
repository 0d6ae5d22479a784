"""The arguments of drawing functions: types that several kinds share, and their fields in a job."""

from __future__ import annotations

import enum
import functools
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import SimpleNamespace, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args, get_origin, get_type_hints

import pandas as pd
from pydantic import BeforeValidator, Field

from gaitsweep.column_meanings import COLUMNS
from gaitsweep.schema.numbers import Flag, Positive, Real, Stem, Text, checked, read_text


class Role(enum.Enum):
    """Kind of quantity that an argument names, as a mark of its type; a value is its list in `FigureKind`."""

    COLUMN = "column_fields"
    ALONG_AXIS = "axis_fields"
    OBSERVABLE = "observable_fields"


# Types of arguments that name a column of the table, a numeric column along an axis, or an observable.
Column = Annotated[Text, Role.COLUMN]
AlongAxis = Annotated[Text, Role.COLUMN, Role.ALONG_AXIS]
Observable = Annotated[Text, Role.OBSERVABLE]


def read_title(value: Any) -> str | None:
    """Return a figure's title in a job: None is the default, and "" no title, which "" and `none` ask for.

    Raises:
        InvalidValue: it is no text.
    """
    if value is None:
        return None
    return "" if value in ("", "none") else read_text(value)


# Arguments that several figures have.
Horizontal = Annotated[AlongAxis, "column along the horizontal axis"]
Vertical = Annotated[AlongAxis, "column along the vertical axis"]
Observed = Annotated[Observable, "observable of the model"]
GaitColumn = Annotated[Column, "column of the gait"]
Hue = Annotated[Column, "column that colours the points"]
Panels = Annotated[Column | None, "column whose values have a panel each"]
Name = Annotated[
    Stem | None, Field(description="name of the figure's file without ending; by default its kind")
]
Shares = Annotated[Flag, "whether to write the share of each outcome, above panels or in the legend"]
Title = Annotated[
    str | None, BeforeValidator(checked(read_title)), 'text above the figure; "" or none: no text there'
]
Bandwidth = Annotated[
    Positive | None,
    "half-width of the smoothing window, in the unit of y; by default 0.05 rad for an angle, and a twentieth "
    "of the range of other values",
]

# A table, or its name, which is all that a job can write and so the type where jobs are read.
if TYPE_CHECKING:
    TableOrName = Text | pd.DataFrame
else:
    TableOrName = Text

Window = Annotated[
    Sequence[Real] | None,
    Field(min_length=2, max_length=2),
    "beginning and end of the time that is shown, in s; by default all",
]

TEXT_COLUMNS = frozenset(name for name, (unit, _) in COLUMNS.items() if unit == "")


def fields_of(draw: Callable[..., Any]) -> dict[str, Any]:
    """The arguments after the table as fields of a job, if text at the end of their types describes them."""
    fields = {}
    # without the types of the table and of the figure, for which pandas and Matplotlib would be imported
    _, *arguments = inspect.signature(draw).parameters.values()
    annotations = {argument.name: argument.annotation for argument in arguments}
    hints = get_type_hints(
        SimpleNamespace(__annotations__=annotations), draw.__globals__, include_extras=True
    )
    for argument in arguments:
        name = argument.name
        annotation = hints[name]
        description = getattr(annotation, "__metadata__", (None,))[-1]
        if isinstance(description, str):
            # pydantic's mark of a required field is `...`; mappings are not shared between figures
            default: Any = ... if argument.default is argument.empty else argument.default
            mapping = isinstance(default, Mapping)
            copy = functools.partial(dict, default) if mapping else None
            value: dict[str, Any] = {"default_factory": copy} if mapping else {"default": default}
            fields[name] = (_in_job(annotation), Field(**value, description=description))
    return fields


def _in_job(annotation: Any) -> Any:
    """Type of a figure's argument in a job, which has lists and dicts."""
    origin, (first, *rest) = get_origin(annotation), get_args(annotation) or (None,)
    if origin is Annotated:
        return Annotated[_in_job(first), *rest]
    if origin in (Union, UnionType):
        return Union[tuple(_in_job(part) for part in (first, *rest))]  # noqa: UP007 - of a tuple of types
    if origin in (Sequence, Mapping):
        plain = list if origin is Sequence else dict
        return plain[*(_in_job(part) for part in (first, *rest))]  # pyright: ignore[reportInvalidTypeArguments]
    return annotation


def parts_of(annotations: Sequence[Any]) -> Iterator[Any]:
    """Annotations and all their parts."""
    for annotation in annotations:
        yield annotation
        yield from parts_of(get_args(annotation))
