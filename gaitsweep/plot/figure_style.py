"""The style that a figure, a job or `gs.plot.style` asks for, and the looks of gaits and other outcomes."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import numpy as np
from matplotlib.colors import to_hex, to_rgb
from pydantic import BeforeValidator, Field, ValidationError

from gaitsweep.errors import UserError
from gaitsweep.extension import gait_styles
from gaitsweep.schema.diagnostics import quoted
from gaitsweep.schema.numbers import (
    Count,
    Flag,
    InvalidValue,
    Positive,
    Text,
    Word,
    checked,
    read_flag,
    read_real,
    read_text,
)
from gaitsweep.schema.pydantic_errors import SchemaSection, from_pydantic
from gaitsweep.schema.strict_model import StrictModel
from gaitsweep.status import Outcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_FormatName = Literal["png", "pdf", "svg"]
FORMATS: tuple[str, ...] = get_args(_FormatName)
MILLIMETRES = {"column": 85.0, "page": 180.0}  # of one column of a paper, and of its full width
_HEX = re.compile(r"#[0-9A-Fa-f]{6}")


class StyleError(UserError, ValueError):
    """A style has a field that does not exist, or a value that is not allowed."""


def _read_width(value: Any) -> str | float:
    """Read a width: column, page or mm."""
    if value in MILLIMETRES:
        return value
    try:
        return read_real(value, low=50.0, high=500.0)
    except InvalidValue:
        text = "but must be column, page, or a number of mm from 50 to 500."
        raise InvalidValue(f"is {quoted(value)}, {text}") from None


def _read_colour(value: Any) -> str:
    """Read a colour as its hexadecimal text."""
    if isinstance(value, str) and _HEX.fullmatch(value):
        return value
    from matplotlib.colors import is_color_like, to_hex  # only for colours that are given by name

    if not isinstance(value, str) or not is_color_like(value):
        text = "but must be a colour such as '#0072B2' (in quotes) or a name that Matplotlib knows."
        raise InvalidValue(f"is {quoted(value)}, {text}")
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
_Colour = Annotated[str, BeforeValidator(checked(_read_colour))]
_Letters = Annotated[bool | list[str], BeforeValidator(checked(_read_letters))]
_Format = Annotated[_FormatName, Word()]


class FigureStyle(StrictModel):
    """Fields of every figure, and of `style` for all figures of a job; those left out keep the default."""

    width: _Width | None = Field(
        default=None, description="width of the figure: column (85 mm), page (180 mm), or a number of mm"
    )
    height: Positive | None = Field(default=None, description="height of the figure, in mm")
    panel_columns: Count | None = Field(
        default=None, description="number of panels beside each other; by default as many as have room"
    )
    format: Annotated[list[_Format], Field(min_length=1), BeforeValidator(_as_list)] | None = Field(
        default=None, description="file format, png, pdf or svg, or a list of these; by default png"
    )
    dpi: Count | None = Field(default=None, description="pixels per inch of png files; by default 150")
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
        default=None, description="whether panels have the letters a, b, c, ..., or a list of their letters"
    )
    caption: Flag | None = Field(
        default=None, description="whether a line above the legend explains it; by default true"
    )
    marks: Flag | None = Field(
        default=None,
        description="whether a figure of an incomplete or doubtful table says so; by default true",
    )

    def over(self, other: FigureStyle) -> FigureStyle:
        """This style, with the fields of another where this one has none; colours and labels are joined."""
        fields, defaults = dict(self), dict(other)
        for name in FigureStyle.model_fields:
            if isinstance(fields[name], dict) and defaults[name]:
                fields[name] = {**defaults[name], **fields[name]}
            elif fields[name] is None:
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


HATCH = "/////"

# Of outcomes that no model names; gaits have those of their extensions.
COLOURS = MappingProxyType(
    {"none": "#BBBBBB", Outcome.NOT_SETTLED: "#E4E4E4", Outcome.FAILED: "#3B3B3B", "fell": "#3B3B3B"}
)
MARKERS = MappingProxyType({"none": "x"})
HATCHES = MappingProxyType({"none": "xxx", Outcome.NOT_SETTLED: HATCH, Outcome.FAILED: HATCH, "fell": "...."})
# Okabe and Ito's colours, distinct for colour-blind readers.
SPARE_COLOURS = ("#E69F00", "#0072B2", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#F0E442", "#000000")
SPARE_MARKERS = ("o", "^", "s", "D", "v", "P", "X", "*")
LINE_COLOURS = SPARE_COLOURS[:6]  # the others are too pale or too dark for lines
DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (5, 1, 1, 1)))
MOST_NAMED_LINES = 8  # in a legend
_SPARE_HATCHES = ("", "....", "\\\\\\\\", "----", "++++", "oo", "||||", "xxxx", "**")
CONTRAST = 1.8  # the least ratio of luminances at which grey print tells two colours apart
_DARK = 0.28  # luminance of a colour below which white text on it is more legible than black


def named(name: str) -> str:
    """The label of a gait in legends: its style's, else its name."""
    return (current().labels or {}).get(name, name)


def ordered(names: Iterable[str]) -> list[str]:
    """Gaits in the order of the style; others follow in their own order."""
    names = list(names)
    first = [name for name in current().order or () if name in names]
    return [*first, *(name for name in names if name not in first)]


def colours(names: Iterable[str]) -> dict[str, str]:
    """A colour for each name: that of the style or of the gait, else spare colours in order."""
    names = list(names)
    own = {name: colour for name, (colour, *_) in gait_styles().items()}
    own |= {**COLOURS, **(current().colours or {})}
    used = {own.get(name) for name in names}
    free = [colour for colour in SPARE_COLOURS if colour not in used]
    return _own_or_spare(names, own, free or SPARE_COLOURS)


def markers(names: Iterable[str]) -> dict[str, str]:
    """A marker for each name, as for `colours`."""
    own = {name: marker for name, (_, marker, *_) in gait_styles().items()} | dict(MARKERS)
    return _own_or_spare(list(names), own, SPARE_MARKERS)


def _own_or_spare(names: list[str], own: dict[str, str], spare: Sequence[str]) -> dict[str, str]:
    """Each name's own entry, or the spare ones in turn."""
    others = [name for name in names if name not in own]
    return {name: own[name] if name in own else spare[others.index(name) % len(spare)] for name in names}


def hatches(names: Iterable[str]) -> dict[str, str]:
    """A hatch for each name, by which grey print tells areas apart: that of the gait, else a spare one.

    Without `hatches` in the style, only what is no gait has one.
    """
    names = list(names)
    colour = colours(names)
    # an extension need not give a hatch
    own = {name: hatch for name, (_, _, *hatch_of) in gait_styles().items() for hatch in hatch_of}
    own |= HATCHES
    hatch_of = {name: own[name] for name in names if name in own}
    for name in names:
        confusable = {
            hatch_of[other] for other in hatch_of if contrast(colour[name], colour[other]) < CONTRAST
        }
        free = (hatch for hatch in _SPARE_HATCHES if hatch not in confusable)
        hatch_of.setdefault(name, next(free, _SPARE_HATCHES[-1]))
    if current().hatches is False:
        hatch_of |= {name: "" for name in names if name not in HATCHES}
    return hatch_of


def contrast(colour: str, other: str) -> float:
    """The contrast of two colours in grey print: the ratio of their luminances (WCAG 2), at least 1."""
    low, high = sorted(map(_luminance, (colour, other)))
    return (high + 0.05) / (low + 0.05)


def _luminance(colour: str) -> float:
    """The relative luminance of a colour (WCAG 2), from 0 to 1."""
    channels = np.array(to_rgb(colour))
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def mixed(colour: str, other: str) -> str:
    """The mean of two colours."""
    red, green, blue = 0.5 * (np.array(to_rgb(colour)) + np.array(to_rgb(other)))
    return to_hex((float(red), float(green), float(blue)))


def hatched(colour: str, hatch: str) -> dict[str, Any]:
    """The look of an area in a colour with a hatch."""
    return {"facecolor": colour, "hatch": hatch or None, "edgecolor": line_on(colour), "linewidth": 0.0}


def ink_on(colour: str) -> str:
    """Black or white, for a text over a colour."""
    return "white" if _luminance(colour) < _DARK else "black"


def line_on(colour: str) -> str:
    """The colour of a hatch: lighter on dark colours, darker on light ones."""
    return mixed(colour, ink_on(colour))
