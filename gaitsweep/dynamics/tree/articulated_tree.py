"""A tree of rigid bodies with free, hinge and slide joints: its structure, geometry and link axes.

A link is one joint and the body that it moves: a body with several joints is a chain of links, of which only
the last has mass. `Tree` is the structure, fixed and hashable; `Geometry` holds the numbers, which may be JAX
scalars that vary between rows. Positions q and velocities v are MuJoCo's qpos and qvel, in its order: a free
joint has the world position and the quaternion (w, x, y, z), the velocity in the world and the angular
velocity in the body.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import Literal, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaitsweep.dynamics.tree.spatial import EYE, ZERO, Array, Scalar
from gaitsweep.near_miss import suggestion

Kind: TypeAlias = Literal["free", "hinge", "slide", "fixed"]
Row: TypeAlias = tuple[float, float, float]

WORLD = -1  # the parent of a link that is attached to the world
_NQ: dict[Kind, int] = {"free": 7, "hinge": 1, "slide": 1, "fixed": 0}
_NV: dict[Kind, int] = {"free": 6, "hinge": 1, "slide": 1, "fixed": 0}


@dataclasses.dataclass(frozen=True)
class Link:
    """One joint, and the body or massless intermediate link that it moves.

    `parent` is an earlier link or WORLD; `kind` the kind of joint; `axis` the unit axis of a hinge or slide
    in the link's body frame; `orientation` the rows of the rotation from the link's frame to its parent's at
    the joint's reference position.
    """

    name: str
    parent: int
    kind: Kind
    axis: Row = (0.0, 0.0, 0.0)
    orientation: tuple[Row, Row, Row] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Geometry:
    """The numbers of a tree of n links and nv degrees of freedom; NumPy constants or JAX arrays.

    `mass` (n,) kg; `com` (n, 3) m, centre of mass in the body's frame; `inertia` (n, 3, 3) kg m2, about the
    centre of mass in the body's axes; `position` (n, 3) m of the body's frame in its parent's; `anchor`
    (n, 3) m, a point of the joint's axis in the body's frame; `reference` (n,) rad or m, the joint's q at
    `position` and the link's orientation; `armature` (nv,) kg m2 or kg; `damping` (nv,) N m s/rad or N s/m;
    `stiffness` (n,) N m/rad or N/m of the joint's spring; `rest` (n,) rad or m, its neutral position.
    """

    mass: Float[Array, " links"]
    com: Float[Array, "links 3"]
    inertia: Float[Array, "links 3 3"]
    position: Float[Array, "links 3"]
    anchor: Float[Array, "links 3"]
    reference: Float[Array, " links"]
    armature: Float[Array, " nv"]
    damping: Float[Array, " nv"]
    stiffness: Float[Array, " links"]
    rest: Float[Array, " links"]


@dataclasses.dataclass(frozen=True)
class LinkAxes:
    """The axes in which a link's vectors are expressed, chosen so that constants keep their zeros.

    The links of a limb whose hinges are all parallel are expressed in the axes of its first link before that
    one rotates. Every other link is expressed in its own axes.

    `across` is the constant part of the rotation from the link's axes to its parent's, None where they are
    equal. `own`: the link is expressed in its own axes, and the rotation of its joint is part of the rotation
    across. Else the body's orientation in these axes is the constant orientation `still` (3, 3), rotated
    about `normal` (3,) by the sum of `sign` times q over the limb's links up to this one.
    """

    across: Float[np.ndarray, "3 3"] | None
    own: bool
    normal: Float[np.ndarray, " 3"]
    sign: float
    still: Float[np.ndarray, "3 3"]


@dataclasses.dataclass(frozen=True)
class Tree:
    """The structure of a tree: its links, each after its parent."""

    links: tuple[Link, ...]

    def __post_init__(self) -> None:
        for i, link in enumerate(self.links):
            if not WORLD <= link.parent < i:
                raise ValueError(f"Link '{link.name}' must come after its parent, link {link.parent}.")
            if link.kind == "free" and link.parent != WORLD:
                raise ValueError(f"Link '{link.name}' is free, so its parent must be the world.")
            if link.kind in ("hinge", "slide") and abs(np.linalg.norm(link.axis) - 1.0) > 1e-9:
                raise ValueError(f"The axis {link.axis} of link '{link.name}' must have length 1.")

    @property
    def nv(self) -> int:
        return sum(_NV[link.kind] for link in self.links)

    @cached_property
    def q_of(self) -> tuple[slice, ...]:
        """The slice of q of each link's joint."""
        return _slices([_NQ[link.kind] for link in self.links])

    @cached_property
    def v_of(self) -> tuple[slice, ...]:
        """The slice of v of each link's joint."""
        return _slices([_NV[link.kind] for link in self.links])

    def index(self, name: str) -> int:
        """The number of the link of this name.

        Raises:
            ValueError: there is no such link; the message lists the names.
        """
        names = [link.name for link in self.links]
        if name not in names:
            raise ValueError(f"The tree has no link '{name}'{suggestion(name, names)}")
        return names.index(name)

    @cached_property
    def link_axes(self) -> tuple[LinkAxes, ...]:
        """The axes of each link."""
        planes = self._planes()
        axes: list[LinkAxes] = []
        for link, plane in zip(self.links, planes, strict=True):
            across = np.array(link.orientation)
            if plane is None:
                axes.append(LinkAxes(_unless_same(across), True, ZERO, 0.0, EYE))
                continue
            if link.parent == WORLD or planes[link.parent] is None:
                normal = plane
                still = EYE
            else:
                carrier = axes[link.parent]
                normal, still, across = carrier.normal, carrier.still @ across, EYE
            sign = float(np.round(normal @ still @ np.array(link.axis))) if link.kind == "hinge" else 0.0
            axes.append(LinkAxes(_unless_same(across), False, normal, sign, still))
        return tuple(axes)

    def _planes(self) -> list[np.ndarray | None]:
        """The common axis of the hinges from each link outwards; None without one, zero without hinges."""
        planes: list[np.ndarray | None] = [
            None if link.kind == "free" else np.array(link.axis) * (link.kind == "hinge")
            for link in self.links
        ]
        for i in range(len(self.links) - 1, -1, -1):
            parent = self.links[i].parent
            plane = planes[i]
            normal = None if parent == WORLD else planes[parent]
            if normal is None:
                continue
            if plane is None:
                planes[parent] = None
                continue
            beyond = np.array(self.links[i].orientation) @ plane
            if not normal.any():
                planes[parent] = beyond
            elif beyond.any() and np.abs(np.cross(normal, beyond)).max() > 1e-12:
                planes[parent] = None
        return planes


def rescaled(
    tree: Tree,
    geometry: Geometry,
    mass: Mapping[str, Scalar] | None = None,
    size: Mapping[str, Scalar | Float[Array, " 3"]] | None = None,
) -> Geometry:
    """The geometry with the masses and lengths of some links scaled; mass distributions keep their shape.

    Args:
        tree, geometry: the links.
        mass: by link, the factor of its mass and inertia.
        size: by link, the factor of its lengths, a scalar or one for each axis (3,) of its frame: centre of
            mass, inertia, and joint positions of its child links.

    Raises:
        ValueError: the tree has no link of that name.
    """
    heavier = {tree.index(name): factor for name, factor in (mass or {}).items()}
    larger = {tree.index(name): factor * np.ones(3) for name, factor in (size or {}).items()}

    def inertia(i: int) -> Array:
        tensor = geometry.inertia[i]
        if i in larger:
            # the second moments of mass, of which the inertia is trace less moment, scale by axis
            moment = 0.5 * _trace(tensor) * EYE - tensor
            moment = moment * (larger[i][:, None] * larger[i][None, :])
            tensor = _trace(moment) * EYE - moment
        return heavier.get(i, 1.0) * tensor

    def position(i: int) -> Array:
        return larger.get(tree.links[i].parent, 1.0) * geometry.position[i]

    n = range(len(tree.links))
    return dataclasses.replace(
        geometry,
        mass=jnp.stack([jnp.asarray(heavier.get(i, 1.0) * geometry.mass[i]) for i in n]),
        com=jnp.stack([larger.get(i, 1.0) * geometry.com[i] for i in n]),
        inertia=jnp.stack([inertia(i) for i in n]),
        position=jnp.stack([position(i) for i in n]),
        anchor=jnp.stack([larger.get(i, 1.0) * geometry.anchor[i] for i in n]),
    )


def _unless_same(across: np.ndarray) -> np.ndarray | None:
    """A rotation; None if it is the identity."""
    return None if np.array_equal(across, EYE) else across


def _trace(A: Array) -> Scalar:
    return A[0, 0] + A[1, 1] + A[2, 2]


def _slices(lengths: list[int]) -> tuple[slice, ...]:
    """Slices of these lengths, one after the other."""
    ends = np.cumsum(lengths).tolist()
    return tuple(slice(end - length, end) for end, length in zip(ends, lengths, strict=True))
