"""The theme of figures: sizes, fonts, legends, colours and markers of gaits, axes of angles."""

from __future__ import annotations

import contextlib
import re
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from types import MappingProxyType
from typing import Any, TypeVar, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend import Legend
from matplotlib.legend_handler import HandlerTuple
from matplotlib.ticker import FixedLocator, FuncFormatter, Locator, MultipleLocator
from matplotlib.transforms import ScaledTranslation

from gaitsweep.contract import Outcome
from gaitsweep.extension import gait_styles
from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.figure_style import MILLIMETRES, current, given_axes

_INCH = 25.4  # mm
COLUMN, PAGE = (MILLIMETRES[name] / _INCH for name in ("column", "page"))  # inches
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
_SPARE_HATCHES = ("", "....", "\\\\\\\\", "----", "++++", "oo", "||||", "xxxx", "**")
CONTRAST = 1.8  # of luminance, least, by which grey print tells two colours apart
_DARK = 0.28  # luminance of a colour below which white is read better on it than black

_POINTS = 8.0  # of text, unless the user's rcParams differ from Matplotlib's defaults
_SIZES = {
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "legend.title_fontsize": 7.5,
}
_RC: dict[str, Any] = {
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.0,
    "figure.dpi": 150.0,
    "savefig.dpi": 200.0,
    "hatch.linewidth": 0.5,
    "legend.handleheight": 1.0,  # of which a hatch shows its pattern
}
_EMBEDDED = {"pdf.fonttype": 42, "ps.fonttype": 42}  # TrueType, which publishers ask for
# Dark ink on a white page in every notebook: the colours and black lines of figures are made for it.
_INK = (
    "text.color", "lines.color", "patch.edgecolor", "axes.edgecolor", "axes.labelcolor", "axes.facecolor",
    "xtick.color", "ytick.color", "xtick.labelcolor", "ytick.labelcolor", "grid.color", "figure.facecolor",
    "figure.edgecolor", "savefig.facecolor", "savefig.edgecolor", "legend.labelcolor",
    "axes3d.xaxis.panecolor", "axes3d.yaxis.panecolor", "axes3d.zaxis.panecolor",
)  # fmt: skip
_PAPER: dict[Any, Any] = {key: mpl.rcParamsDefault[key] for key in _INK}
_STEPS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0)  # of ticks, in pi
# The least span of values along an axis, below which rounding would look like a change.
_LEAST_ANGLE, _LEAST_SHARE, _LEAST_VALUE = 0.01, 1e-3, 1e-9  # rad, of the largest magnitude, in any unit
_LEAST_PANEL, _LEAST_SHARE_OF_NATURAL = 12.0, 0.6  # height in mm, or if less, share of the natural one
_BELOW, _LINE = 0.4, 0.13  # inches: heights of a legend below panels, and of another line in it
_HIGHEST, _HIGHER = 1000, 5  # mm, of a figure: the heights that are tried
_SHORT = 4  # labels of three letters along an axis of a turn
_LETTER = 0.53  # mean width of a letter, as a share of the size of its font
_COLLAPSED = "constrained_layout not applied"  # a warning of Matplotlib
_FORMULA = re.compile(r"\$[^$]*\$")
# In a formula, what has no width, and commands, which are a letter wide.
_MARKUP = re.compile(r"\\(?:mathrm|mathit|mathbf|bar|hat|tilde|dot|vec|left|right|,)(?![a-z])|[{}_^$]")
_COMMAND = re.compile(r"\\[A-Za-z]+")
Panel = TypeVar("Panel")


class _Figure(Figure):
    """A figure whose files embed their fonts as Type 42, and whose page is white in dark notebooks too."""

    def savefig(self, fname: Any, **options: Any) -> None:
        with mpl.rc_context({**_unchanged(_EMBEDDED), **_PAPER}):
            super().savefig(fname, **options)

    def draw(self, renderer: Any) -> None:
        with mpl.rc_context(_PAPER):  # ticks are made as they are drawn
            super().draw(renderer)


_Figure.__name__ = Figure.__name__  # what notebooks show


class _OnePanel:
    """Axes of the user in the place of a figure of one panel."""

    def __init__(self, axes: Axes) -> None:
        self.axes = axes

    def subplots(self, rows: int = 1, columns: int = 1, *, squeeze: bool = True, **_: Any) -> Any:
        if rows * columns != 1:
            raise PlotError(f"This figure has {rows * columns} panels, but ax is one: leave ax out.")
        return self.axes if squeeze else np.array([[self.axes]], object)

    def add_subplot(self, *_: Any, projection: str | None = None) -> Axes:
        if projection is not None:
            raise PlotError("This figure has panels of its own, but ax is one: leave ax out.")
        return self.axes

    def add_gridspec(self, *_: Any, **__: Any) -> Any:
        raise PlotError("This figure has several panels, but ax is one: leave ax out.")

    subfigures = add_gridspec

    def legend(self, *, loc: str, **look: Any) -> Legend:
        return self.axes.legend(**look)

    def colorbar(self, image: Any, *, ax: Any, **look: Any) -> Any:
        return cast(Figure, self.axes.get_figure(root=True)).colorbar(image, ax=self.axes, **look)

    def set_figheight(self, height: float) -> None:
        """Keep the user's height."""


def _unchanged(defaults: dict[Any, Any]) -> dict[Any, Any]:
    """Those of some rcParams that the user has not changed."""
    return {key: value for key, value in defaults.items() if mpl.rcParams[key] == mpl.rcParamsDefault[key]}


class _TurnLocator(FixedLocator):
    """Ticks over a turn, at every half turn where an axis is short."""

    def __init__(self, steps: int) -> None:
        super().__init__(np.linspace(0.0, 2 * np.pi, steps + 1).tolist())

    def __call__(self) -> Any:
        ticks = super().__call__()
        short = self.axis is not None and self.axis.get_tick_space() < _SHORT
        return ticks[:: (len(ticks) - 1) // 2] if short else ticks


class _PiLocator(Locator):
    """Ticks at round multiples of pi, as many as an axis has room for, at most seven."""

    def __call__(self) -> Any:
        assert self.axis is not None
        return self.tick_values(*self.axis.get_view_interval())

    def step(self) -> float:
        """The distance of two ticks, in pi."""
        assert self.axis is not None
        span = abs(float(np.ptp(self.axis.get_view_interval()))) / np.pi
        most = max(2, min(6, self.axis.get_tick_space()))
        return next((step for step in _STEPS if span / step <= most), _STEPS[-1])

    def tick_values(self, vmin: float, vmax: float) -> Any:
        return MultipleLocator(self.step() * np.pi).tick_values(vmin, vmax)


@contextlib.contextmanager
def canvas(width: float, height: float, title: str | None = None) -> Iterator[Figure]:
    """A context with an empty figure, in which Matplotlib has this theme.

    The user's rcParams are obeyed, but for the colours of page and ink.

    Args:
        width, height: size in inches, unless the figure's style has another.
        title: text above the figure.
    """
    own_axes, requested = given_axes(), current()
    scale = _unchanged({"font.size": _POINTS}).get("font.size", mpl.rcParams["font.size"]) / _POINTS
    sizes = _unchanged({key: size * scale for key, size in _SIZES.items()})
    paper = _PAPER if own_axes is None else {}
    with mpl.rc_context({**_unchanged(_RC), **sizes, **paper, "font.size": _POINTS * scale}):
        if own_axes is not None:
            if title:
                own_axes.set_title(title)
            yield cast(Figure, _OnePanel(own_axes))
            return
        wide = width_of(width)
        lines = wrapped(title, wide, 9.5) if title else ""
        height += 0.16 * lines.count("\n")
        figure = _Figure(
            (wide, requested.height / _INCH if requested.height else height), layout="constrained"
        )
        FigureCanvasAgg(figure)
        # room for half of the label of a last tick, which the layout may miss
        if requested.width is not None:
            room = (0.0, 0.0, 1.0 - 0.07 / wide, 1.0)
            cast(ConstrainedLayoutEngine, figure.get_layout_engine()).set(rect=room)
        if lines:
            figure.suptitle(lines, fontsize=points(9.5))
        with warnings.catch_warnings():
            if requested.height is not None:  # which is refused, with the least that fits
                warnings.filterwarnings("ignore", _COLLAPSED)
            yield figure
            _centre_shared_label(figure)
            if requested.width is not None:
                _break_lines(figure)
                _break_lines(figure)  # broken labels may have made other panels narrower
            if requested.height is not None:
                _check_height(figure, height)


def _centre_shared_label(figure: Figure) -> None:
    """Move the label that rows of panels share to their middle, in lines no longer than they are high."""
    label = getattr(figure, "_supylabel")  # noqa: B009 - Matplotlib has no public name for it
    if label is None:
        return
    figure.draw_without_rendering()
    places = [axes.get_position() for axes in figure.axes]
    low, high = min(place.y0 for place in places), max(place.y1 for place in places)
    label.set_y(0.5 * (low + high))
    size = float(label.get_fontsize()) / points(1.0)
    label.set_text(wrapped(label.get_text(), (high - low) * figure.get_figheight(), size))


def _check_height(figure: Figure, natural: float) -> None:
    """Refuse the height of a figure at which a panel has no room.

    Args:
        figure: that of `canvas`, with the height of its style.
        natural: its height without a style, inches, at which all panels have room.
    """
    asked = least = figure.get_figheight() * _INCH
    figure.set_figheight(natural)
    enough = np.minimum(_LEAST_PANEL / _INCH, _LEAST_SHARE_OF_NATURAL * _panel_heights(figure))
    figure.set_figheight(asked / _INCH)
    while (_panel_heights(figure) < enough).any() and least < _HIGHEST:
        least = _HIGHER * (least // _HIGHER + 1.0)
        figure.set_figheight(least / _INCH)
    if least > asked:
        raise PlotError(f"height is {asked:g} mm, but this figure needs at least {least:g} mm.")


def _panel_heights(figure: Figure) -> np.ndarray:
    """The heights of panels in inches, (n,), of which all are 0 if the layout gives one of them no room."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        figure.draw_without_rendering()
    panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    heights = np.array([axes.get_position().height for axes in panels]) * figure.get_figheight()
    return heights * (not any(re.match(_COLLAPSED, str(each.message)) for each in caught))


def _break_lines(figure: Figure) -> None:
    """Break the lines of titles and labels that are longer than their panel, once the layout is known."""
    figure.draw_without_rendering()
    renderer = cast(FigureCanvasAgg, figure.canvas).get_renderer()
    panels = [axes.get_window_extent(renderer) for axes in figure.axes]
    for axes, panel in zip(figure.axes, panels, strict=True):
        if not axes.get_visible() or hasattr(axes, "zaxis"):
            continue
        gaps = [other.x0 - panel.x1 for other in panels] + [panel.x0 - other.x1 for other in panels]
        gap = min((each for each in gaps if each > 0.0), default=np.inf)
        titles = (axes.title, *(vars(axes)[f"_{side}_title"] for side in ("left", "right")))
        for text in (axes.xaxis.label, axes.yaxis.label, *titles):
            box = text.get_window_extent(renderer)
            long, room = (box.height, panel.height) if text is axes.yaxis.label else (box.width, panel.width)
            beside = min(0.15 * figure.dpi, panel.x0, figure.bbox.width - panel.x1, 0.45 * gap)
            room += 2.0 * max(beside, 0.0)
            if text.get_text() and long > room:
                lines = text.get_text() if text in titles else text.get_text().replace("\n", " ")
                text.set_text(wrapped(lines, room / figure.dpi, float(text.get_fontsize()) / points(1.0)))


def width_of(natural: float) -> float:
    """The width in inches of the figure that is being drawn: its style's, else its natural one."""
    width = current().width
    if width is None:
        return natural
    return (MILLIMETRES[width] if isinstance(width, str) else width) / _INCH


def shape(panels: int, natural: float, least: float, most: int | None = None) -> tuple[int, int]:
    """The rows and columns of a grid of panels, at least one of each.

    Args:
        panels: the number of panels.
        natural: natural width of the figure, inches.
        least: least width of a panel with its labels, inches, unless the style has `panel_columns`.
        most: the most panels in a row, likewise; by default all.
    """
    columns = current().panel_columns or min(most or panels, int(width_of(natural) / least))
    columns = max(1, min(panels, columns))
    return -(-max(panels, 1) // columns), columns


def first_of(
    panels: list[Panel], most: int, title: str | None, noun: str = "panels"
) -> tuple[list[Panel], str | None]:
    """The first panels of a figure, `most` at most, and its title, which says so if some are left out."""
    if len(panels) > most:
        title = f"{title or ''} (the first {most} of {len(panels)} {noun})".strip()
    return panels[:most], title


def panels(figure: Figure, grid: tuple[int, int], count: int, **look: Any) -> list[Axes]:
    """A grid of panels, of which the last row may have empty cells; the lowest of each column has numbers.

    Args:
        figure: that of `canvas`.
        grid: rows and columns, the result of `shape`.
        count: number of panels.
        look: options of `Figure.subplots`.
    """
    cells = figure.subplots(*grid, squeeze=False, **look).ravel()
    for axes in cells[count:]:
        axes.remove()
    for axes in cells[max(count - grid[1], 0) : count]:
        axes.tick_params(labelbottom=True)
    return list(cells[:count])


def interrupted(parted: np.ndarray, *lines: np.ndarray) -> list[np.ndarray]:
    """Lines (n,) with NaN between the neighbours that are `parted` (n - 1,), where nothing is to be drawn."""
    gaps = np.flatnonzero(parted) + 1
    return [np.insert(line, gaps, np.nan) for line in lines]


def points(size: float) -> float:
    """A font size in the theme, larger or smaller if the user's `font.size` is."""
    return size * mpl.rcParams["font.size"] / _POINTS


def wrapped(text: str, inches: float, size: float) -> str:
    """A text in lines that fit a width, at a font size of the theme."""
    letters = max(int(inches * 72 / (_LETTER * points(size))), 8)
    formulas = iter(_FORMULA.findall(text))
    # no break in a formula, which is as long as its letters, before its unit, nor beside a sign of equality
    unbroken = _FORMULA.sub(lambda formula: "\1" + "\2" * (_letters(formula[0]) - 1), text)
    unbroken = re.sub("(?<=[\1\2]) [(]", "\0(", unbroken.replace(" = ", "\0=\0"))
    lines = (textwrap.fill(line, letters, break_long_words=False) for line in unbroken.split("\n"))
    return re.sub("\1\2*", lambda _: next(formulas), "\n".join(lines).replace("\0", " "))


def _letters(formula: str) -> int:
    """The number of letters in a formula, at least one."""
    return max(len(_COMMAND.sub("x", _MARKUP.sub("", formula))), 1)


def label_panels(figure: Figure, panels: Sequence[Axes], across: int, *, x: str = "", y: str = "") -> None:
    """Label axes that panels share, once where there is a middle: of their columns, and of their rows.

    Args:
        figure: that of `canvas`.
        panels: those of `panels`, in rows of `across`.
        x, y: labels of the horizontal and the vertical axes.
    """
    for number, axes in enumerate(panels):
        lowest = number + across >= len(panels)
        if x and lowest and (across % 2 == 0 or number % across == across // 2):
            axes.set_xlabel(x)
    if len(panels) > across:
        figure.supylabel(y, fontsize=mpl.rcParams["axes.labelsize"])
    else:
        panels[0].set_ylabel(y)


def legend(
    figure: Figure,
    handles: Sequence[Any] | None = None,
    labels: Sequence[str] | None = None,
    *,
    ncols: int = 2,
    title: str | None = None,
    in_cell: bool = False,
) -> None:
    """The legend below a figure, in as many columns as its width allows.

    Args:
        figure: that of `canvas`.
        handles, labels: entries and their texts; by default those of all panels.
        ncols: the most columns.
        title: text above the entries, unless the style leaves out captions.
        in_cell: whether it may stand in the empty cell at the end of a grid of panels; the figure is then
            lower by its height.
    """
    title = None if current().caption is False else title
    if not title and handles is not None and not len(handles):
        return
    look: dict[str, Any] = {"loc": "outside lower center", "title": title}
    look["handler_map"] = {tuple: HandlerTuple(ndivide=1, pad=0.0)}  # several handles as one, over each other
    look |= {"handles": handles} if handles is not None else {}
    look |= {"labels": labels} if labels is not None else {}
    if isinstance(figure, _OnePanel):
        figure.legend(ncols=1, **look)
        return
    if handles:  # as many columns as fill the rows
        ncols = -(-len(handles) // -(-len(handles) // ncols))
    room = figure.get_figwidth() - 0.1
    if title:
        look["title"] = wrapped(title, room, 7.5)
    renderer = cast(FigureCanvasAgg, figure.canvas).get_renderer()
    if in_cell and _legend_in_cell(figure, {**look, "title": title}, renderer):
        return
    drawn, columns = figure.legend(ncols=ncols, **look), ncols
    count = len(drawn.get_texts())
    rows = -(-count // ncols)
    while columns > 1 and drawn.get_window_extent(renderer).width > room * figure.dpi:
        drawn.remove()
        columns = -(-count // -(-count // (columns - 1)))  # as many as fill the rows
        drawn = figure.legend(ncols=columns, **look)
    grow(figure, _LINE * (-(-count // columns) - rows))
    if drawn.get_window_extent(renderer).width > room * figure.dpi:
        for text in drawn.get_texts():
            text.set_text(wrapped(text.get_text(), room - 0.45, 7.5))
        breaks = np.array_split([text.get_text().count("\n") for text in drawn.get_texts()], columns)
        grow(figure, _LINE * max(int(column.sum()) for column in breaks))


def grow(figure: Figure, inches: float) -> None:
    """Make a figure higher, for what stands below its panels, unless its style has a height."""
    if current().height is None and not isinstance(figure, _OnePanel):
        figure.set_figheight(figure.get_figheight() + inches)


def _legend_in_cell(figure: Figure, look: dict[str, Any], renderer: Any) -> bool:
    """Put the legend into the empty cell beside the last panel; False if there is none, or no room."""
    place = figure.axes[-1].get_subplotspec()
    if place is None or place.colspan.stop == place.get_gridspec().ncols:
        return False
    grid = place.get_gridspec()
    width = figure.get_figwidth() * (1.0 - place.colspan.stop / grid.ncols) - 0.35
    if look["title"]:
        look["title"] = wrapped(look["title"], width, 7.5)
    at = figure.axes[-1].transAxes + ScaledTranslation(0.3, 0.0, figure.dpi_scale_trans)
    place_of = {
        "loc": "center left",
        "bbox_to_anchor": (1.0, 0.5),
        "bbox_transform": at,
        "borderaxespad": 0.0,
    }
    made = figure.legend(ncols=1, **{**look, **place_of})
    box = made.get_window_extent(renderer)
    if box.width <= width * figure.dpi and box.height <= figure.bbox.height / grid.nrows:
        grow(figure, -_BELOW)
        return True
    made.remove()
    return False


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
    names, own = list(names), {name: style[0] for name, style in gait_styles().items()} | dict(COLOURS)
    own |= current().colours or {}
    free = [colour for colour in SPARE_COLOURS if colour not in {own.get(name) for name in names}]
    return _own_or_spare(names, own, free or SPARE_COLOURS)


def markers(names: Iterable[str]) -> dict[str, str]:
    """A marker for each name, as for `colours`."""
    own = {name: style[1] for name, style in gait_styles().items()} | dict(MARKERS)
    return _own_or_spare(list(names), own, SPARE_MARKERS)


def _own_or_spare(names: list[str], own: dict[str, str], spare: Sequence[str]) -> dict[str, str]:
    others = [name for name in names if name not in own]
    return {name: own[name] if name in own else spare[others.index(name) % len(spare)] for name in names}


def hatches(names: Iterable[str]) -> dict[str, str]:
    """A hatch for each name, by which grey print tells areas apart: that of the gait, else a spare one.

    Without `hatches` in the style, only what is no gait has one.
    """
    names = list(names)
    colour = colours(names)
    own = {name: style[2] for name, style in gait_styles().items() if len(style) > 2} | dict(HATCHES)
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
    part = np.array(to_rgb(colour))
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
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


def angle_axis(axes: Axes, which: str, steps: int = 4) -> None:
    """Show an angle on axis x, y or z with ticks at multiples of pi, `steps` intervals per turn.

    The axis extends from 0 to 2 pi, or only over the data if they take less than half of that.
    """
    if which in "xy" and not _half_a_turn(axes, which):
        angle_ticks(axes, which)
        return
    getattr(axes, f"set_{which}lim")(0.0, 2 * np.pi)
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(_TurnLocator(steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: in_pi(value)))


def value_axis(axes: Axes, *, angle: bool) -> None:
    """Axis y of values over a parameter: ticks of angles in pi, and no span so small that rounding shows."""
    if angle:
        angle_ticks(axes, "y")
    spans = [each.dataLim.intervaly for each in axes.get_shared_y_axes().get_siblings(axes)]
    values = np.array([span for span in spans if np.isfinite(span).all()])
    if not len(values) or axes.get_yscale() != "linear":
        return
    low, high = float(values.min()), float(values.max())
    least = _LEAST_ANGLE if angle else max(_LEAST_SHARE * max(-low, high), _LEAST_VALUE)
    if high - low < least:
        axes.set_ylim(0.5 * (low + high - least), 0.5 * (low + high + least))


def _half_a_turn(axes: Axes, which: str) -> bool:
    """Whether the data of an axis and those that share it extend over half a turn, or there are no data."""
    shared = getattr(axes, f"get_shared_{which}_axes")().get_siblings(axes)
    spans = np.array([getattr(other.dataLim, f"interval{which}") for other in shared])
    spans = spans[np.isfinite(spans).all(axis=1)]
    return not len(spans) or float(np.ptp(spans)) >= np.pi


def percent(share: float) -> str:
    """Format a fraction in whole per cent, for a legend."""
    return "<1" if 0.0 < share < 0.005 else f"{100 * share:.0f}"


def angle_ticks(axes: Axes, which: str) -> None:
    """Ticks at round multiples of pi on a part of the circle that axis x or y already shows."""
    axis, locator = getattr(axes, f"{which}axis"), _PiLocator()
    axis.set_major_locator(locator)
    axis.set_major_formatter(FuncFormatter(lambda value, _: in_pi(value, fractions=locator.step() >= 0.25)))


def in_pi(angle: float, *, fractions: bool = True) -> str:
    """Format an angle (rad) as a multiple of pi: 3π/4, or 0.77π if it is not a simple fraction."""
    turns = round(angle / np.pi, 4)
    if turns == round(turns):
        return {0: "0", 1: "π", -1: "−π"}.get(round(turns), f"{round(turns)}π").replace("-", "−")
    if fractions and 4 * turns == round(4 * turns):
        bottom = 2 if 2 * turns == round(2 * turns) else 4
        top = round(turns * bottom)
        return f"{'−' if top < 0 else ''}{'' if abs(top) == 1 else abs(top)}π/{bottom}"
    return f"{turns:.4g}π".replace("-", "−")


def message(axes: Axes, text: str) -> None:
    """Write the reason, a sentence, into an empty panel."""
    width = axes.get_position().width * cast(Figure, axes.get_figure(root=True)).get_figwidth()
    lines = wrapped(text, 0.9 * width, 8.0)
    axes.text(0.5, 0.5, lines, transform=axes.transAxes, ha="center", va="center", color="#555555")
