"""Animations of one row: the frames of a movie, and a strip of poses over a cycle."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Generator, Iterator, Sequence
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Text

from gaitsweep.mathtext import escape_unparsable
from gaitsweep.plot import theme
from gaitsweep.plot.footprint_diagrams import contact_intervals, draw_stances
from gaitsweep.plot.limbs import name_limbs
from gaitsweep.skeleton import Limb, Skeleton
from gaitsweep.view.movie.side_view import SideView, bounds

_FRAME_WIDTH = 8.0  # inches; width of every frame, so that its text has the same relative size
_CYCLES_SHOWN = 2.0  # of footfalls
_TWO_LINES_FROM = 1.6  # half of the ratio of length to height above which the poses are in two lines
_MARGIN = 0.012  # of texts, as a share of the width
_BAR_HEIGHT = 0.66  # of a foot's bar, as a share of its row
_MAX_NAMES = 16  # with more limbs only some are named
_CHART_LEFT, _CHART_RIGHT = 0.115, 0.975  # sides of the charts, as shares of the width
_TITLE, _DETAILS = 10.0, 8.0  # points: font of the title, and the smallest before it takes two lines
_SECOND_LINE = 0.17  # inches
_INK = "#55595F"
_FORWARD = "forward \N{LONG RIGHTWARDS ARROW}"


@dataclasses.dataclass(frozen=True)
class Clip:
    """The data of an animation.

    `skeleton` is the body at the times `t` (n,) s of the frames; `contact` (m, limbs) is 1 on the ground at
    the times `contact_t` (m,) s of the whole trace; `period` (s) of a cycle; `title`, `pace` and `details`
    are texts. The first detail names the row, and the others its values.
    """

    t: Float[np.ndarray, " frames"]
    skeleton: Skeleton
    contact_t: Float[np.ndarray, " times"]
    contact: Float[np.ndarray, "times limbs"]
    period: float
    title: str
    pace: str = ""
    details: tuple[str, ...] = ()

    @property
    def down(self) -> Bool[np.ndarray, "frames limbs"]:
        """Whether each limb is on the ground at `t`."""
        edges = 0.5 * (self.contact_t[1:] + self.contact_t[:-1])
        return self.contact[np.searchsorted(edges, self.t)] > 0.5

    @property
    def camera(self) -> Float[np.ndarray, "frames 2"]:
        """The path of the camera, m: the centre of the body, averaged over a cycle."""
        path = middle(self.skeleton)
        if len(self.t) < 3:
            return path
        half_width = int(min(round(self.period / (self.t[1] - self.t[0])), len(self.t) - 1)) // 2
        padded = np.pad(path, ((half_width, half_width), (0, 0)), mode="reflect", reflect_type="odd")
        kernel = np.full(2 * half_width + 1, 1.0 / (2 * half_width + 1))
        return np.column_stack([np.convolve(column, kernel, mode="valid") for column in padded.T])


def middle(skeleton: Skeleton) -> Float[np.ndarray, "frames 2"]:
    """The centre of a body along the ground, m: the mean of the points of its parts, limbs or springs."""
    parts = skeleton.bodies or tuple(limb.points for limb in skeleton.limbs) or skeleton.springs
    return np.concatenate(parts, axis=1)[..., :2].mean(axis=1)


class Footfalls:
    """Footfall bars of each foot over time (s), the first limb on top."""

    def __init__(
        self,
        axes: Axes,
        limbs: Sequence[Limb],
        t: Float[np.ndarray, " times"],
        contact: Float[np.ndarray, "times limbs"],
    ) -> None:
        """Draw all bars.

        Args:
            axes: the panel.
            limbs: the limbs, one for each row of bars.
            t: the times of a trace, s.
            contact: 1 on the ground.
        """
        self._axes = axes
        stances = [contact_intervals(t, of_limb) for of_limb in contact.T]
        draw_stances(axes, stances, limbs, _BAR_HEIGHT)
        name_limbs(axes, limbs, _MAX_NAMES, "bold")
        axes.spines["left"].set_visible(False)
        axes.set_xlabel("time (s)", labelpad=1.5)
        self._veil = axes.axvspan(0.0, 0.0, facecolor="white", linewidth=0, zorder=3)
        self._now = axes.axvline(0.0, color="black", lw=1.1, zorder=4)

    def set_window(self, low: float, high: float) -> None:
        """Show only the time (s) from `low` to `high`."""
        self._axes.set_xlim(low, high)

    def set_time(self, t: float) -> None:
        """Set the current time `t` (s), and hide later footfalls."""
        self._now.set_xdata([t, t])
        self._veil.set_x(t)
        self._veil.set_width(max(self._axes.get_xlim()[1] - t, 0.0))

    def mark_times(self, times: Sequence[float]) -> None:
        """Mark several times (s), numbered from 1, instead of one."""
        self._now.set_visible(False)
        for number, t in enumerate(times):
            self._axes.axvline(t, color="black", lw=0.8, ls=(0, (4, 2)), zorder=4)
            self._axes.annotate(
                str(number + 1), (t, 1.0), (0, 1.5), xycoords=("data", "axes fraction"),
                textcoords="offset points", ha="center", va="bottom", fontsize=8, weight="bold",
            )  # fmt: skip


class Scene(Protocol):
    """A drawing of the body in axes."""

    def show(self, k: int) -> None:
        """Show sample k."""


class DrawBody(Protocol):
    """A function that draws the body of a clip in axes, with the names of its limbs or without."""

    def __call__(self, axes: Axes, clip: Clip, *, named: bool) -> Scene: ...


def side_view(axes: Axes, clip: Clip, *, named: bool) -> Scene:
    """The body as lines, drawn by Matplotlib."""
    return SideView(axes, clip.skeleton, clip.down, clip.camera, named=named)


def frames(
    clip: Clip, size: tuple[int, int], scene: DrawBody = side_view
) -> Generator[UInt8[np.ndarray, "height width 3"]]:
    """The frames of a movie, RGB bytes for each of the clip's times, valid until the next.

    Args:
        clip: the data of the animation.
        size: width and height, pixels.
        scene: the function that draws the body in its axes.
    """
    with _blank_figure(size) as (figure, canvas):
        view, chart, bar = _movie_axes(figure, clip)
        falls = Footfalls(chart, clip.skeleton.limbs, clip.contact_t, clip.contact)
        clock = figure.text(
            _CHART_RIGHT, 1.0 - 0.17 / figure.get_figheight(), "", ha="right", va="center", fontsize=10
        )
        progress = _time_bar(bar, clip)
        body = scene(view, clip, named=True)
        duration = _CYCLES_SHOWN * clip.period
        first = float(clip.t[0])
        for k, t in enumerate(clip.t):
            body.show(k)
            low = max(first, float(t) - duration)
            falls.set_window(low, low + duration)
            falls.set_time(float(t))
            clock.set_text(f"{t:.2f} s, {clip.pace}" if clip.pace else f"{t:.2f} s")
            progress.set_width(float(t) - first)
            canvas.draw()
            yield np.asarray(canvas.buffer_rgba())[..., :3]


def _movie_axes(figure: Figure, clip: Clip) -> tuple[Axes, Axes, Axes]:
    """The axes of the body, of the footfalls and of the time bar, from top to bottom."""
    tall = figure.get_figheight()
    chart = _chart_height(clip, tall)
    foot, gap = 0.62 / tall, 0.2 / tall
    # the time stands to the right of the title
    head = _add_title(figure, clip, 0.34 / tall, 0.75 - _MARGIN)
    view = figure.add_axes((0.0, foot + chart + gap, 1.0, 1.0 - head - gap - chart - foot))
    falls = figure.add_axes((_CHART_LEFT, foot, _CHART_RIGHT - _CHART_LEFT, chart))
    bar = figure.add_axes((_CHART_LEFT, 0.13 / tall, _CHART_RIGHT - _CHART_LEFT, 0.06 / tall))
    for x, text, side in (
        (_MARGIN, "feet on the ground", "left"),
        (_CHART_RIGHT, clip.skeleton.note, "right"),
    ):
        figure.text(x, foot + chart + 0.03 / tall, text, ha=side, va="bottom", fontsize=7.5, color=_INK)
    figure.text(
        _CHART_RIGHT, 1.0 - head - 0.02 / tall, _FORWARD, ha="right", va="top", fontsize=8, color=_INK
    )
    return view, falls, bar


def _time_bar(axes: Axes, clip: Clip) -> Rectangle:
    """The bar with the elapsed fraction of the clip."""
    axes.set_xlim(clip.t[0], clip.t[-1])
    axes.set_ylim(0.0, 1.0)
    axes.set_axis_off()
    axes.add_patch(Rectangle((clip.t[0], 0.0), clip.t[-1] - clip.t[0], 1.0, facecolor="#E4E6E9"))
    elapsed = Rectangle((clip.t[0], 0.0), 0.0, 1.0, facecolor=_INK)
    axes.add_patch(elapsed)
    return elapsed


@contextlib.contextmanager
def _blank_figure(size: tuple[int, int]) -> Iterator[tuple[Figure, FigureCanvasAgg]]:
    """An empty figure of a given size in pixels, always `_FRAME_WIDTH` inches wide."""
    width, height = size
    with theme.frame(_FRAME_WIDTH, _FRAME_WIDTH * height / width) as figure:
        figure.set_dpi(width / _FRAME_WIDTH)
        yield figure, FigureCanvasAgg(figure)


def still(clip: Clip, size: tuple[int, int], scene: DrawBody = side_view) -> Figure:
    """Numbered poses of a clip of a period or less, side by side, above the footfalls that mark their times.

    Args:
        clip: the data of the animation.
        size: width and height, pixels.
        scene: the function that draws a pose in its axes.
    """
    half, height, _ = bounds(clip.skeleton, clip.camera)
    lines = 2 if half > _TWO_LINES_FROM * height else 1
    columns = math.ceil(len(clip.t) / lines)
    with _blank_figure(size) as (figure, _):
        tall = figure.get_figheight()
        foot, gap = 0.38 / tall, 0.2 / tall
        chart = _chart_height(clip, tall)
        head = _add_title(figure, clip, 0.3 / tall, 1.0 - 2.0 * _MARGIN)
        figure.text(_CHART_RIGHT, 0.05 / tall, _FORWARD, ha="right", va="bottom", fontsize=8, color=_INK)
        pose_width = 1.0 / columns
        pose_height = (1.0 - head - (foot + chart + gap)) / lines
        for k in range(len(clip.t)):
            line, column = divmod(k, columns)
            low = 1.0 - head - (line + 1) * pose_height
            axes = figure.add_axes((column * pose_width, low, pose_width, pose_height))
            scene(axes, clip, named=False).show(k)
            axes.text(0.04, 0.98, str(k + 1), transform=axes.transAxes, va="top", fontsize=9, weight="bold")
        axes = figure.add_axes((_CHART_LEFT, foot, _CHART_RIGHT - _CHART_LEFT, chart))
        falls = Footfalls(axes, clip.skeleton.limbs, clip.contact_t, clip.contact)
        falls.set_window(float(clip.t[0]), float(clip.t[0]) + clip.period)
        falls.mark_times([float(t) for t in clip.t])
    return figure


def _add_title(figure: Figure, clip: Clip, line: float, widest: float) -> float:
    """Write the title of a figure, with the details in a second line if one line is too narrow for both.

    Args:
        figure: the figure.
        clip: the title, and its details.
        line: the height of the first line, a share of the figure's.
        widest: the largest width of that line, a share of the figure's.

    Returns:
        The height of both lines, a share of the figure's.
    """
    row, values = clip.details[:1], clip.details[1:]
    text = figure.text(_MARGIN, 1.0 - 0.5 * line, "", va="center", weight="bold")
    details = _joined([*row, ", ".join(values)], ": ")
    size = _fitted(text, _joined([clip.title, details], "; "), _TITLE, widest)
    if size >= _DETAILS or not details:
        return line
    _fitted(text, clip.title, _TITLE, widest)
    second = _SECOND_LINE / figure.get_figheight()
    text = figure.text(_MARGIN, 1.0 - line - 0.35 * second, "", va="center", color=_INK)
    for count in range(len(values), -1, -1):
        named = values if count == len(values) else (*values[:count], "...")
        details = _joined([*row, ", ".join(named)], ": ")
        if _fitted(text, details, _DETAILS, 1.0 - 2.0 * _MARGIN) == _DETAILS:
            break
    return line + second


def _joined(words: Sequence[str], by: str) -> str:
    return by.join(word for word in words if word)


def _fitted(text: Text, words: str, size: float, widest: float) -> float:
    """Set the words of a text, in a smaller font where they would be wider than a share of the figure.

    Args:
        text: the text.
        words: its words.
        size: the largest size of the font, points.
        widest: the largest width.

    Returns:
        The size of the font, points.
    """
    text.set_text(escape_unparsable(words))
    text.set_fontsize(size)
    figure = text.get_figure()
    assert figure is not None
    width = max(text.get_window_extent().width, 1.0)  # an empty text has none
    fitted = size * min(1.0, widest * figure.bbox.width / width)
    text.set_fontsize(fitted)
    return fitted


def _chart_height(clip: Clip, tall: float) -> float:
    """The fraction of the footfalls in the height of a figure `tall` inches high."""
    return min(0.25 + 0.17 * len(clip.skeleton.limbs), 0.4 * tall) / tall
