"""Surfaces of the ground in an MJCF, planes, boxes and height fields: distance and normal of a point."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import itertools
from typing import Any, ClassVar, TypeAlias

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

from gaitsweep.dynamics.ground import MOST_POINTS, ROUNDING, Ground, Profile
from gaitsweep.dynamics.mjcf import DUST, cleaned, named
from gaitsweep.dynamics.tree import Array, Scalar


@dataclasses.dataclass(frozen=True)
class Plane:
    """A plane of the world, with its `normal` (3,), and a point `origin` (3,) m that is `margin` m above."""

    description: ClassVar[str] = "a plane"

    normal: Float[np.ndarray, " 3"]
    origin: Float[np.ndarray, " 3"]
    margin: float

    @property
    def is_level(self) -> bool:
        """Whether the plane is level, so that uneven ground lies on it."""
        return bool(self.normal[2] == 1.0)

    @property
    def is_along_y(self) -> bool:
        """Whether the surface is the same along y."""
        return bool(self.normal[1] == 0.0)

    def below(self, point: Array, ground: Ground) -> tuple[Array, Scalar]:
        """The normal (3,) that a point (3,) m meets, and the height (m) of the point above the surface.

        On uneven `ground`, which lies on level planes, they are those of its tangent plane below the point.
        """
        if ground.kind == "even" or not self.is_level:
            return self.normal, self.normal @ (point - self.origin)
        height, slope = ground.height_and_slope(point[0])
        normal, above = _above_tangent(point[2] - (self.origin[2] - self.margin) - height, slope)
        return normal, above - self.margin

    def top(self, x: Array, y: Array) -> Array:
        """The height (m) of a level plane at places x, y (m); NaN of an inclined one."""
        return jnp.full_like(x + y, self.origin[2] - self.margin if self.is_level else jnp.nan)


@dataclasses.dataclass(frozen=True)
class Box:
    """A box of the world: `centre` (3,) m, `axes` (3, 3) in columns, `half` (3,) m lengths, `margin` m."""

    description: ClassVar[str] = "a box"

    centre: Float[np.ndarray, " 3"]
    axes: Float[np.ndarray, "3 3"]
    half: Float[np.ndarray, " 3"]
    margin: float

    @property
    def is_along_y(self) -> bool:
        """Whether the faces are along y or across it."""
        return bool((np.abs(self.axes[1]) == 1.0).any())

    def below(self, point: Array, _ground: Ground) -> tuple[Array, Scalar]:
        """The normal (3,) from the box to a point (3,) m, and the signed distance (m) of both.

        Outside, the normal is continuous; inside, it is that of the nearest face.
        """
        local = self.axes.T @ (point - self.centre)
        beyond = jnp.abs(local) - self.half
        side = jnp.where(local < 0.0, -1.0, 1.0)
        outside = jnp.maximum(beyond, 0.0)
        square = outside @ outside
        is_outside = square > 0.0
        # the root of 0 has no derivative
        distance = jnp.sqrt(jnp.where(is_outside, square, 1.0))
        along_x = (beyond[0] >= beyond[1]) & (beyond[0] >= beyond[2])
        along_y = ~along_x & (beyond[1] >= beyond[2])
        nearest = jnp.stack([along_x, along_y, ~(along_x | along_y)])
        normal = side * jnp.where(is_outside, outside / distance, jnp.where(nearest, 1.0, 0.0))
        depth = jnp.maximum(jnp.maximum(beyond[0], beyond[1]), beyond[2])
        return self.axes @ normal, jnp.where(is_outside, distance, depth) - self.margin

    def edges(self, along_y: bool, level: float) -> list[Edge]:
        """The edges, without those that are nowhere above a plane at the height `level` (m).

        Args:
            along_y: whether to take the edges along y alone, which a planar body meets.
            level: the plane's height, m; minus infinity without one.
        """
        result = []
        for k in range(3):
            along = self.axes[:, k]
            if along_y and abs(along[1]) != 1.0:
                continue
            for signs in itertools.product((-1.0, 1.0), repeat=2):
                aside = self.axes @ (self.half * np.insert(signs, k, 0.0))
                half = float(self.half[k])
                if self.centre[2] + aside[2] + half * abs(along[2]) > level + DUST:
                    result.append(Edge(self.centre + aside, along, half, self.margin))
        return result

    def top(self, x: Array, y: Array) -> Array:
        """The height (m) of the upper side of the box at places x, y (m); NaN beside it."""
        low = jnp.full_like(x + y, -jnp.inf)
        high = jnp.full_like(x + y, jnp.inf)
        for axis, half in zip(self.axes.T, self.half, strict=True):
            # the vertical line is between both faces of this axis from `low` to `high`
            offset = axis[0] * (x - self.centre[0]) + axis[1] * (y - self.centre[1])
            if axis[2] == 0.0:
                low = jnp.where(jnp.abs(offset) > half, jnp.inf, low)
                continue
            ends = [(sign * half - offset) / axis[2] for sign in (-1.0, 1.0)]
            low = jnp.maximum(low, jnp.minimum(*ends))
            high = jnp.minimum(high, jnp.maximum(*ends))
        return jnp.where(low <= high, self.centre[2] + high, jnp.nan)


@dataclasses.dataclass(frozen=True)
class Edge:
    """An edge of a box: `middle` (3,) m, direction `along` (3,), `half` its length, `margin`, both m."""

    middle: Float[np.ndarray, " 3"]
    along: Float[np.ndarray, " 3"]
    half: float
    margin: float

    def below(self, point: Array, _ground: Ground) -> tuple[Array, Scalar]:
        """The normal (3,) from the edge to a point (3,) m, and the distance (m) of both."""
        away = point - self._nearest_to(point)
        distance = jnp.sqrt(away @ away)
        return away / distance, distance - self.margin

    def nearest_of_segment(self, begin: Array, end: Array) -> Array:
        """The point (3,) m of a segment from `begin` to `end`, (3,) m, that is nearest to the edge.

        It is that nearest to the edge's line, and then that nearest to the edge's point next to it (Ericson
        2005, Real-Time Collision Detection, 5.1.9).
        """
        along = end - begin
        across = along - self.along * (self.along @ along)
        on_line = begin + _share(across, self.middle - begin) * along
        return begin + _share(along, self._nearest_to(on_line) - begin) * along

    def beyond(self, point: Array) -> Scalar:
        """The distance (m) of a point (3,) m beyond the nearer end of the edge; negative between both."""
        return jnp.abs(self.along @ (point - self.middle)) - self.half

    def _nearest_to(self, point: Array) -> Array:
        """The point (3,) m of the edge that is nearest to a point (3,) m."""
        return self.middle + self.along * jnp.clip(self.along @ (point - self.middle), -self.half, self.half)


def _share(along: Array, to: Array) -> Scalar:
    """The place, from 0 to 1, of the foot of `to` (3,) on a segment `along` (3,), both m from its begin."""
    square = along @ along
    return jnp.clip(along @ to / jnp.where(square > 0.0, square, 1.0), 0.0, 1.0)


@dataclasses.dataclass(frozen=True)
class Relief:
    """A height field of the world, whose cells are two triangles each, with rounded bends.

    `centre` (3,) m is its place, `half` (2,) m are half its lengths along x and y, `first` (m) is the height
    of its first point above the centre, `profile` that of its first row along x, `across` that of its first
    column along y; `twists` (rows - 1, columns - 1) m are the heights of each cell's last point above the
    plane of its three others; `margin` (m) is that of the contact.
    """

    description: ClassVar[str] = "a height field"

    centre: Float[np.ndarray, " 3"]
    half: Float[np.ndarray, " 2"]
    first: float
    profile: Profile
    across: Profile
    twists: Float[np.ndarray, "rows columns"]
    margin: float

    @property
    def is_along_y(self) -> bool:
        """Whether the heights vary along x alone."""
        return not (np.any(np.diff(self.across.heights)) or self.twists.any())

    def below(self, point: Array, _ground: Ground) -> tuple[Array, Scalar]:
        """The normal (3,) of the tangent plane below a point (3,) m, and the point's height (m) over it."""
        x, y = point[0] - self.centre[0], point[1] - self.centre[1]
        slopes = (0,) if self.is_along_y else (0, 1)
        height, along = jax.value_and_grad(self._height, slopes)(x, y)
        normal, above = _above_tangent(point[2] - height, *along)
        return normal, above - self.margin

    def beyond(self, point: Array) -> Scalar:
        """The distance (m) of a point (3,) m beyond the nearest end of the field; negative within it."""
        past = jnp.abs(point[:2] - self.centre[:2]) - self.half
        return jnp.maximum(past[0], past[1])

    def top(self, x: Array, y: Array) -> Array:
        """The height (m) of the field at places x, y (m); NaN beside it."""
        inside = (jnp.abs(x - self.centre[0]) <= self.half[0]) & (jnp.abs(y - self.centre[1]) <= self.half[1])
        return jnp.where(inside, self._height(x - self.centre[0], y - self.centre[1]), jnp.nan)

    def _height(self, x: Array, y: Array) -> Array:
        height = self.centre[2] + self.first + self.profile.height(jnp.asarray(x), ROUNDING)
        if self.is_along_y:
            return height
        u = self.profile.shares(jnp.asarray(x), ROUNDING)
        v = self.across.shares(jnp.asarray(y), ROUNDING)
        height = height + self.across.height(jnp.asarray(y), ROUNDING)
        cell = 2.0 * self.half / np.array([len(u), len(v)])
        bend = min(0.5, ROUNDING * float(np.linalg.norm(1.0 / cell)))
        for j, i in np.argwhere(self.twists).tolist():
            height = height + self.twists[j, i] * _lower(u[i], v[j], bend)
        return height


def _lower(u: Array, v: Array, bend: float) -> Array:
    """The lower one of u and v, both from 0 to 1, with a parabola in place of the bend at u = v.

    It begins and ends at u - v = -h and h, with h = `bend` (u + v) (2 - u - v), so that the edges of the
    square, and places beyond it, where u or v is 0 or 1, keep their heights.
    """
    both = u + v
    half = bend * both * (2.0 - both)
    inside = jnp.clip(u - v + half, 0.0, 2.0 * half)
    return u - inside * inside / (4.0 * jnp.where(half > 0.0, half, 1.0)) - jnp.maximum(u - v - half, 0.0)


Surface: TypeAlias = Plane | Box | Relief


def surface_of(m: Any, data: Any, geom: int, margin: float) -> Surface:
    """The surface of a plane, box or height field of the world.

    Args:
        m: the compiled MJCF.
        data: its data, with the places of geoms.
        geom: the geom's number.
        margin: the distance (m) from which on MuJoCo's contact is stretched.

    Raises:
        ValueError: the height field is turned, or has too many points.
    """
    centre = np.array(data.geom_xpos[geom])
    axes = cleaned(data.geom_xmat[geom].reshape(3, 3))
    if m.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
        return Plane(axes[:, 2], centre + margin * axes[:, 2], margin)
    if m.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        return Box(centre, axes, np.array(m.geom_size[geom]), margin)
    field = int(m.geom_dataid[geom])
    rows, columns = int(m.hfield_nrow[field]), int(m.hfield_ncol[field])
    begin = int(m.hfield_adr[field])
    elevations = np.asarray(m.hfield_data[begin : begin + rows * columns], float).reshape(rows, columns)
    name = f"{named(m, 'geom', geom)} is a height field"
    if not np.array_equal(axes, np.eye(3)):
        raise ValueError(f"{name} that is turned, but located contacts have it along x and y of the world.")
    varied = (elevations != elevations[0]).any()
    if (rows * columns if varied else columns) > MOST_POINTS:
        points = f"{rows} x {columns} points" if varied else f"{columns} columns"
        raise ValueError(f"{name} of {points}, but located contacts have at most {MOST_POINTS}.")
    half_x, half_y, tallest, _ = m.hfield_size[field].tolist()
    heights = tallest * elevations
    along_x, along_y = (
        Profile(tuple(np.linspace(-half, half, len(row)).tolist()), tuple(row.tolist()))
        for half, row in ((half_x, heights[0]), (half_y, heights[:, 0]))
    )
    twists = cleaned(np.diff(np.diff(heights, axis=0), axis=1))
    return Relief(centre, np.array([half_x, half_y]), float(heights[0, 0]), along_x, along_y, twists, margin)


def _above_tangent(above: Scalar, slope: Array, slope_y: Array | None = None) -> tuple[Array, Scalar]:
    """The normal (3,) of ground with slopes (1) along x and y, and the distance (m) of a point `above` it."""
    square = 1.0 + slope * slope
    cosine = 1.0 / jnp.sqrt(square if slope_y is None else square + slope_y * slope_y)
    aside = jnp.zeros_like(cosine) if slope_y is None else -slope_y * cosine
    return jnp.stack([-slope * cosine, aside, cosine]), cosine * above
