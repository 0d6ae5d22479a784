"""The style that a figure, a job or `gs.plot.style` asks for: size, files, colours, names of gaits."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from contextvars import ContextVar
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field, PlainValidator, ValidationError, WithJsonSchema

from gaitsweep import near_miss
from gaitsweep.errors import UserError
from gaitsweep.schema.diagnostics import quoted
from gaitsweep.schema.numbers import (
    WHOLE,
    Count,
    Flag,
    InvalidValue,
    Text,
    Word,
    checked,
    read_flag,
    read_real,
    read_text,
    read_whole,
)
from gaitsweep.schema.strict_model import SchemaSection, StrictModel, from_pydantic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FormatName = Literal["png", "pdf", "svg"]
FORMATS: tuple[str, ...] = get_args(_FormatName)
MILLIMETRES = {"column": 85.0, "page": 180.0}  # of one column of a paper, and of its full width
_NUMBER = WithJsonSchema({"type": "number"})
_HEX = re.compile(r"#[0-9A-Fa-f]{6}")


class StyleError(UserError, ValueError):
    """A style has a field that does not exist, or a value that is not allowed."""


def _read_width(value: Any) -> str | float:
    """Read a width: column, page or mm."""
    if isinstance(value, str) and value in MILLIMETRES:
        return value
    try:
        return read_real(value, low=50.0, high=500.0)
    except InvalidValue:
        text = "but must be column, page, or a number of mm from 50 to 500."
        raise InvalidValue(f"is {quoted(value)}, {text}") from None


def _read_colour(value: Any) -> str:
    """Read an opaque colour as its hexadecimal text."""
    if isinstance(value, str) and _HEX.fullmatch(value):
        return value
    from matplotlib.colors import (  # only for colours that are given by name
        CSS4_COLORS,
        is_color_like,
        to_hex,
        to_rgba,
    )

    if not isinstance(value, str) or not is_color_like(value):
        near = near_miss.nearest(value, CSS4_COLORS) if isinstance(value, str) else None
        text = "but must be a colour such as '#0072B2' (in quotes) or a name that Matplotlib knows"
        raise InvalidValue(f"is {quoted(value)}, {text}{f'; did you mean {near}?' if near else '.'}")
    if to_rgba(value)[3] < 1.0:
        raise InvalidValue(f"is {quoted(value)}, but must be an opaque colour such as '#0072B2' (in quotes).")
    return to_hex(value)


def _read_letters(value: Any) -> bool | list[str]:
    """Read whether panels have letters, or their letters."""
    if isinstance(value, list) and value:
        return [read_text(letter) for letter in value]
    try:
        return read_flag(value)
    except InvalidValue:
        text = "but must be true, false, or a list of letters such as [b, c]."
        raise InvalidValue(f"is {quoted(value)}, {text}") from None


def _as_list(value: Any) -> Any:
    """A single name as a list of one."""
    return [value] if isinstance(value, str) else value


_Width = Annotated[float | Literal["column", "page"], BeforeValidator(checked(_read_width))]
# larger ones would fill the memory with pixels
_Height = Annotated[float, PlainValidator(checked(read_real, low=0.0, high=1000.0, open_ends=True)), _NUMBER]
_Resolution = Annotated[int, PlainValidator(checked(read_whole, low=1, high=1200)), WHOLE]
_Colour = Annotated[str, BeforeValidator(checked(_read_colour))]
_Letters = Annotated[bool | list[str], BeforeValidator(checked(_read_letters))]
_Format = Annotated[_FormatName, Word()]


class FigureStyle(StrictModel):
    """Fields of every figure, and of `style` for all figures of a job; those left out keep the default."""

    width: _Width | None = Field(
        default=None, description="width of the figure: column (85 mm), page (180 mm), or a number of mm"
    )
    height: _Height | None = Field(default=None, description="height of the figure, in mm, below 1000")
    panel_columns: Count | None = Field(
        default=None, description="number of panels beside each other; by default as many as have room"
    )
    format: Annotated[list[_Format], Field(min_length=1), BeforeValidator(_as_list)] | None = Field(
        default=None, description="file format, png, pdf or svg, or a list of these; by default png"
    )
    dpi: _Resolution | None = Field(
        default=None, description="pixels per inch of png files, at most 1200; by default 150"
    )
    colours: dict[Text, _Colour] | None = Field(default=None, description="colours of gaits, by name")
    order: list[Text] | None = Field(default=None, description="gaits in the order of legends; others follow")
    labels: dict[Text, Text] | None = Field(
        default=None, description="labels of columns along axes and of gaits in legends, by name"
    )
    hatches: Flag | None = Field(
        default=None,
        description="whether areas of gaits are hatched, which grey print needs; by default true",
    )
    panel_letters: _Letters | None = Field(
        default=None,
        description="whether panels have the letters a, b, c, ..., or a list of their letters; one letter is "
        "that of the whole figure",
    )
    caption: Flag | None = Field(
        default=None, description="whether a line above the legend explains it; by default true"
    )
    marks: Flag | None = Field(
        default=None,
        description="whether a figure of an incomplete or doubtful table says so; by default true",
    )

    def over(self, other: FigureStyle) -> FigureStyle:
        """This style, with the fields of another where this one has none; colours and labels are joined.

        `panel_letters: true` asks for letters, and a list of the other style says which.
        """
        fields, defaults = dict(self), dict(other)
        for name in FigureStyle.model_fields:
            if isinstance(fields[name], dict) and defaults[name]:
                fields[name] = {**defaults[name], **fields[name]}
            elif fields[name] is None or (fields[name] is True and isinstance(defaults[name], list)):
                fields[name] = defaults[name]
        return FigureStyle.model_construct(**{name: fields[name] for name in FigureStyle.model_fields})


STYLE_FIELDS = tuple(FigureStyle.model_fields)
_current: ContextVar[FigureStyle] = ContextVar("figure style", default=FigureStyle())  # noqa: B039 - frozen
_axes: ContextVar[Axes | None] = ContextVar("axes of a figure", default=None)


def current() -> FigureStyle:
    """The style of the figure that is being drawn."""
    return _current.get()


def given_axes() -> Axes | None:
    """The axes into which the figure that is being drawn goes, or None if it makes its own."""
    return _axes.get()


@contextlib.contextmanager
def styled(style: FigureStyle, axes: Axes | None = None) -> Iterator[None]:
    """A context in which figures have a style, over the styles around it, and go into `axes` if given."""
    style_before = _current.set(style.over(_current.get()))
    axes_before = _axes.set(_axes.get() if axes is None else axes)
    try:
        yield
    finally:
        _current.reset(style_before)
        _axes.reset(axes_before)


def read_style(**fields: Any) -> FigureStyle:
    """A style from its fields.

    Raises:
        StyleError: a field does not exist, or has a value that is not allowed.
    """
    try:
        return FigureStyle.model_validate(fields)
    except ValidationError as error:
        wrong = from_pydantic(error, {"": SchemaSection("a style", FigureStyle)}, "")
        raise StyleError("\n".join(map(str, wrong))) from None
