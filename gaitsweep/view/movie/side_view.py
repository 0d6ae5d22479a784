"""A drawing of a body from its right side, slightly from above, on a ground with marks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from scipy import spatial

from gaitsweep.mathtext import escape_unparsable
from gaitsweep.plot.limbs import limb_colours
from gaitsweep.skeleton import Skeleton

# The drawn offset (m) of a metre to the left: to the right and up.
_ASIDE = np.array([0.28, 0.22])
_BODY, _NEAR_SIDE, _EDGE = "#DDE0E4", "#BFC4CC", "#4A4F57"  # of a body
_STRIP, _MARK, _INK = "#F1EEE8", "#CFC9BE", "#8A8478"  # of the ground, its marks and their labels
SWING = "#D55E00"  # of limbs off the ground, where limbs have no colours of their own
_MARKS = 7  # approximate number of marks across the frame
# The top of the axes and the space below the ground, as shares of the body's height.
_NAMED = (1.22, 0.24)
_PLAIN = (1.12, 0.1)  # without names
_TURNS = 5  # turns of a spring
_MOST_NAMES = 16  # with more limbs none is named
_BELOW = 21  # places below a body at which its ground is averaged
_USUAL_HEIGHT = 110.0  # points: drawn height of a body for which line widths are meant


def heading(skeleton: Skeleton) -> float:
    """The heading of a body, by default the mean from its tail to its head, rad from the x axis."""
    if skeleton.heading is not None:
        return skeleton.heading
    if len(skeleton.bodies) < 2:
        return 0.0
    ahead = skeleton.bodies[0].mean(axis=(0, 1)) - skeleton.bodies[-1].mean(axis=(0, 1))
    return float(np.arctan2(ahead[1], ahead[0]))


def with_points(
    skeleton: Skeleton,
    change: Callable[[Float[np.ndarray, "frames points 3"]], Float[np.ndarray, "frames points 3"]],
) -> Skeleton:
    """A body with a function applied to the points of each limb, body and spring."""
    return dataclasses.replace(
        skeleton,
        limbs=tuple(dataclasses.replace(limb, points=change(limb.points)) for limb in skeleton.limbs),
        bodies=tuple(map(change, skeleton.bodies)),
        springs=tuple(map(change, skeleton.springs)),
    )


def turned(skeleton: Skeleton, angle: float) -> Skeleton:
    """A body rotated about the z axis by minus an angle (rad); with its heading, it faces to the right."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return with_points(skeleton, lambda points: points @ turn)


def lifted(skeleton: Skeleton, factor: float) -> Skeleton:
    """A body with its feet a factor as high over its ground, and the joints above in proportion."""
    limbs = []
    for limb in skeleton.limbs:
        feet = limb.points[:, -1:]
        ground = 0.0 if skeleton.ground is None else np.interp(feet[..., 0], *skeleton.ground.T)
        height = (factor - 1.0) * np.maximum(feet[..., 2] - ground, 0.0)
        points = limb.points.copy()
        points[..., 2] += height * np.linspace(0.0, 1.0, points.shape[1])
        limbs.append(dataclasses.replace(limb, points=points))
    return dataclasses.replace(skeleton, limbs=tuple(limbs))


def projected(points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 2"]:
    """The projection (m) of points (m)."""
    return points[..., [0, 2]] + points[..., 1:2] * _ASIDE


def nearest_first(points: Float[np.ndarray, "frames points 3"]) -> Float[np.ndarray, "frames points 3"]:
    """The points of a body in one order for all samples: first those nearest to the viewer.

    With an order of its own for each sample, corners at nearly the same distance would trade places, and
    pictures between two samples would mix different corners.
    """
    return points[:, np.argsort(points[..., 1].mean(axis=0), kind="stable")]


def points_of(skeleton: Skeleton) -> Float[np.ndarray, "frames points 3"]:
    """All points of a body: those of its limbs, bodies and springs."""
    parts = [*(limb.points for limb in skeleton.limbs), *skeleton.bodies, *skeleton.springs]
    return np.concatenate(parts, axis=1) if parts else np.zeros((0, 0, 3))


def above_ground(skeleton: Skeleton, camera: Float[np.ndarray, "frames 2"]) -> Float[np.ndarray, "frames 3"]:
    """The path of a camera (m) at the mean height of the ground below the body; at 0 on even ground."""
    if skeleton.ground is None:
        return np.column_stack([camera, np.zeros(len(camera))])
    ahead = camera[:, :1]
    reach = np.abs(points_of(skeleton)[..., 0] - ahead).max(initial=0.0)
    below = np.interp(ahead + reach * np.linspace(-1.0, 1.0, _BELOW), *skeleton.ground.T)
    return np.column_stack([camera, below.mean(axis=1)])


def bounds(skeleton: Skeleton, camera: Float[np.ndarray, "frames 2"]) -> tuple[float, float, float]:
    """Half the width, the height and half the ground's depth (m) that contain the body at all samples.

    The height is that above the ground at `above_ground`, or below it of a body that hangs deeper than it is
    high; 1 m of one that has neither.
    """
    across, up = _from_camera(skeleton, camera)
    height = float(np.abs(up).max(initial=0.0)) or float(up.size > 0)
    of_feet = [np.abs(limb.points[:, -1, 1] - camera[:, 1]).max(initial=0.0) for limb in skeleton.limbs]
    depth = max(1.5 * float(max(of_feet, default=0.0)), 0.3 * height)
    return float(np.abs(across).max(initial=0.0)), height, depth


def _from_camera(skeleton: Skeleton, camera: Float[np.ndarray, "frames 2"]) -> Float[np.ndarray, "2 points"]:
    """Drawn places (m) of all points at all samples: across from the camera, and above its ground."""
    middle = above_ground(skeleton, camera)[:, None, :]
    return projected((points_of(skeleton) - middle).reshape(-1, 3)).T


class Ground:
    """A strip of ground in axes, whose limits it sets."""

    def __init__(
        self,
        axes: Axes,
        half: float,
        height: float,
        depth: float,
        aside: Float[np.ndarray, 2],
        *,
        named: bool,
        lowest: float = 0.0,
    ) -> None:
        """Draw the ground.

        Args:
            axes: the panel, whose limits are set.
            half, height: half the width and the height of the body, m.
            depth: width of the ground to both sides, m.
            aside: the drawn offset of a metre to the left, m.
            named: whether marks show their position.
            lowest: the lowest place of the body above the ground, m; below 0 of one that hangs.
        """
        self._aside = aside * depth
        self.near = -float(self._aside[1])
        above, below = _NAMED if named else _PLAIN
        low, high = min(self.near, lowest) - below * height, above * height
        box = axes.get_window_extent()
        ratio = box.width / max(box.height, 1.0)
        width = max(2.3 * half, (high - low) * ratio)
        spare = max(0.0, width / ratio - (high - low))
        self._half = 0.5 * width
        axes.set_xlim(-self._half, self._half)
        axes.set_ylim(low - 0.5 * spare, high + 0.5 * spare)
        strip = Rectangle((-self._half, self.near), width, -2.0 * self.near, facecolor=_STRIP, zorder=0)
        axes.add_patch(strip)
        self._step = round_step(width / _MARKS)
        self._marks = LineCollection([], colors=_MARK, linewidths=0.9, zorder=1)
        axes.add_collection(self._marks, autolim=False)
        style = {"color": _INK, "fontsize": 6.5, "ha": "left", "va": "bottom", "zorder": 1.2, "clip_on": True}
        count = 2 * _MARKS + 4 if named else 0
        self._labels = [axes.text(0.0, self.near, "", **style) for _ in range(count)]

    def show(self, place: float) -> None:
        """Move the marks for a frame whose middle is at `place` (m) along the ground."""
        reach = self._half + abs(float(self._aside[0]))
        first, last = np.ceil((place - reach) / self._step), np.floor((place + reach) / self._step)
        marks = np.arange(first, last + 1.0) * self._step
        ahead = np.column_stack([marks - place, np.zeros_like(marks)])
        self._marks.set_segments(list(np.stack([ahead - self._aside, ahead + self._aside], axis=1)))
        digits = max(0, int(np.ceil(-np.log10(self._step) - 1e-9)))
        for label, x in zip(self._labels, marks, strict=False):
            label.set_position((x - place - self._aside[0] + 0.05 * self._step, self.near))
            label.set_text(f"{x + 0.0:.{digits}f} m")
        for label in self._labels[len(marks) :]:
            label.set_text("")


def round_step(length: float) -> float:
    """The next number from 1, 2, 5, 10 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    steps = (digit * power for digit in (1.0, 2.0, 5.0, 10.0))
    return float(next(step for step in steps if step >= length * (1.0 - 1e-9)))


class SideView:
    """The drawing of one sample in axes; `show` moves it to another sample."""

    def __init__(
        self,
        axes: Axes,
        skeleton: Skeleton,
        down: Bool[np.ndarray, "frames limbs"],
        camera: Float[np.ndarray, "frames 2"],
        *,
        named: bool = True,
    ) -> None:
        """Prepare the drawing of all samples.

        Args:
            axes: the panel.
            skeleton: the body.
            down: whether each limb is on the ground.
            camera: the middle of the axes along the ground, m.
            named: whether limbs and marks on the ground have names.
        """
        skeleton = dataclasses.replace(skeleton, bodies=tuple(map(nearest_first, skeleton.bodies)))
        self._axes = axes
        self._skeleton = skeleton
        self._down = down
        self._camera = above_ground(skeleton, camera)
        self._colours = limb_colours(skeleton.limbs)
        alike = len(self._colours) > 1 and len(set(self._colours)) == 1
        self._swing = [SWING if alike else colour for colour in self._colours]
        half, self._height, depth = bounds(skeleton, camera)
        self._moves = float(np.ptp(camera[:, 0])) > 1e-6 * half
        self._sole = 0.05 * self._height
        axes.set_axis_off()
        lowest = float(_from_camera(skeleton, camera)[1].min(initial=0.0))
        self._ground = Ground(axes, half, self._height, depth, _ASIDE, named=named, lowest=lowest)
        pixels = self._height * axes.get_window_extent().height / np.ptp(axes.get_ylim())
        self._thickness = float(np.clip(72.0 * pixels / axes.figure.dpi / _USUAL_HEIGHT, 0.4, 1.5))
        line = {"color": _INK, "lw": 1.2 * self._thickness, "zorder": 1.4}
        self._profile = None if skeleton.ground is None else axes.plot([], [], **line)[0]
        self._limbs = [
            self._add_limb(colour, far=limb.far)
            for limb, colour in zip(skeleton.limbs, self._colours, strict=True)
        ]
        self._bodies = [(self._add_patch(_BODY), self._add_patch(_NEAR_SIDE)) for _ in skeleton.bodies]
        self._springs = [
            axes.plot([], [], color=_EDGE, lw=0.9 * self._thickness, zorder=5)[0] for _ in skeleton.springs
        ]
        if named and len(skeleton.limbs) <= _MOST_NAMES:
            self._name_limbs()
        self.show(0)

    def show(self, k: int) -> None:
        """Show sample k."""
        middle = self._camera[k]
        for i, (line, foot, sole) in enumerate(self._limbs):
            at = projected(self._skeleton.limbs[i].points[k] - middle)
            stands = bool(self._down[k, i])
            colour = self._colours[i] if stands else self._swing[i]
            line.set(color=colour, markeredgecolor=colour)
            foot.set_markeredgecolor(colour)
            line.set_data(at[:, 0], at[:, 1])
            foot.set_data(at[-1:, 0], at[-1:, 1])
            foot.set_markerfacecolor(self._colours[i] if stands else "white")
            sole.set_visible(stands)
            sole.set_data(at[-1, 0] + np.array([-self._sole, self._sole]), at[[-1, -1], 1])
        for points, (outline, side) in zip(self._skeleton.bodies, self._bodies, strict=True):
            corners = projected(points[k] - middle)
            outline.set_xy(_hull(corners))
            side.set_xy(_hull(corners[: (len(corners) + 1) // 2]))
        for ends, line in zip(self._skeleton.springs, self._springs, strict=True):
            line.set_data(*_zigzag(projected(ends[k] - middle), self._sole))
        if self._moves:
            self._ground.show(float(middle[0]))
        if self._profile is not None and self._skeleton.ground is not None:
            places, heights = self._skeleton.ground.T
            self._profile.set_data(places - middle[0], heights - middle[2])

    def _add_limb(self, colour: str, *, far: bool) -> tuple[Line2D, Line2D, Line2D]:
        """Add the links of a limb with their joints, its foot, and the mark below it during stance."""
        width = self._thickness
        order = 2 if far else 7
        joints: dict[str, Any] = {"marker": "o", "mfc": "white", "mec": colour, "ms": 4.6 * width}
        (line,) = self._axes.plot(
            [], [], color=colour, lw=3.4 * width, mew=1.2 * width, zorder=order,
            solid_capstyle="round", solid_joinstyle="round", **joints,
        )  # fmt: skip
        (foot,) = self._axes.plot(
            [], [], ls="", marker="o", ms=6.0 * width, mec=colour, mew=1.4 * width, zorder=order + 0.1
        )
        (sole,) = self._axes.plot([], [], color=_EDGE, lw=2.2 * width, solid_capstyle="butt", zorder=1.5)
        return line, foot, sole

    def _add_patch(self, face: str) -> Polygon:
        """Add a part of a body, without its place."""
        width = 0.8 * self._thickness
        patch = Polygon(np.zeros((3, 2)), facecolor=face, edgecolor=_EDGE, lw=width, zorder=4)
        self._axes.add_patch(patch)
        return patch

    def _name_limbs(self) -> None:
        """Write names of near limbs below the ground, of far ones above the body, at their mean positions."""
        low, high = self._ground.near - 0.05 * self._height, 1.06 * self._height
        for limb, colour in zip(self._skeleton.limbs, self._colours, strict=True):
            place = float(projected(limb.points[:, 0] - self._camera)[:, 0].mean())
            y, alignment = (high, "bottom") if limb.far else (low, "top")
            style = {"color": colour, "ha": "center", "va": alignment, "weight": "bold", "fontsize": 8}
            self._axes.text(place, y, escape_unparsable(limb.name), **style)


def _hull(points: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "corners 2"]:
    """The corners of the convex hull of points."""
    try:
        return points[spatial.ConvexHull(points).vertices]
    except spatial.QhullError:  # all points on one line, as on the near side of a flat body
        return points


def _zigzag(
    ends: Float[np.ndarray, "2 2"], width: float
) -> tuple[Float[np.ndarray, " corners"], Float[np.ndarray, " corners"]]:
    """The corners of a spring of a `width` (m) between two points (m), straight at both ends."""
    share = np.concatenate([[0.0], np.linspace(0.2, 0.8, 2 * _TURNS + 1), [1.0]])
    aside = np.zeros_like(share)
    aside[2:-2] = 0.6 * width * np.where(np.arange(len(share) - 4) % 2, -1.0, 1.0)
    along = ends[1] - ends[0]
    length = float(np.hypot(*along))
    across = np.array([-along[1], along[0]]) / length if length > 0.0 else np.zeros(2)
    points = ends[0] + share[:, None] * along + aside[:, None] * across
    return points[:, 0], points[:, 1]
