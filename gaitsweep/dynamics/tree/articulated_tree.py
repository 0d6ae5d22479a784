"""A tree of rigid bodies with free, hinge and slide joints, written or read from MuJoCo's compiled model.

A link is one joint and the body that it moves: a body with several joints is a chain of links, of which only
the last has mass. `Tree` is the structure, fixed and hashable; `Geometry` holds the numbers, which may be JAX
scalars that vary between rows. Positions q and velocities v are MuJoCo's qpos and qvel, in its order: a free
joint has the world position and the quaternion (w, x, y, z), the velocity in the world and the angular
velocity in the body.

Of an MJCF only the masses of geoms count; contacts and actuators are ignored: the caller adds their forces as
`external` and `tau`. Everything else that would act in MuJoCo but not here is refused.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Literal, TypeAlias

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

from gaitsweep.dynamics.mjcf import compiled
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


# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false


_KINDS: dict[int, Kind] = {
    mujoco.mjtJoint.mjJNT_FREE: "free",
    mujoco.mjtJoint.mjJNT_HINGE: "hinge",
    mujoco.mjtJoint.mjJNT_SLIDE: "slide",
}
_OFF = mujoco.mjtDisableBit
_UNSUPPORTED = "which an articulated tree does not support"
_DUST = 1e-15  # rounding error of the zeros and ones in the rotation matrix of a right angle


def tree_of(source: mujoco.MjModel | str | Path) -> tuple[Tree, Geometry]:
    """The tree of an MJCF, with q and v in the order of MuJoCo's qpos and qvel.

    The link of a body has its name. If the body has several joints, this is the link of the last one; the
    links of its earlier joints have no mass and are named `body/joint`. The option gravity is ignored.

    Args:
        source: a compiled model, a path, or the XML itself.

    Raises:
        ValueError: MuJoCo refuses the XML, or the model has a feature that the tree does not support; the
            message names it.
        FileNotFoundError: there is no file at the path.
    """
    m = compiled(source)
    complaint = next(_complaints(m), None)
    if complaint is not None:
        raise ValueError(complaint)
    links: list[Link] = []
    rows: list[dict[str, object]] = []
    link_of = {0: WORLD}  # the last link of each body
    for body in range(1, m.nbody):
        first = m.body_jntadr[body]
        count = m.body_jntnum[body]
        joints = [int(j) for j in range(first, first + count)]
        parent = link_of[int(m.body_parentid[body])]
        for j in joints or [None]:
            begins = not joints or j == joints[0]
            ends = not joints or j == joints[-1]
            links.append(_link(m, body, j, parent, begins, ends))
            rows.append(_numbers(m, body, j, begins, ends))
            parent = len(links) - 1
        link_of[body] = parent
    stacked = {name: np.array([row[name] for row in rows], float) for name in rows[0]}
    damping = m.dof_damping * (0.0 if m.opt.disableflags & _OFF.mjDSBL_DAMPER else 1.0)
    return Tree(tuple(links)), Geometry(**stacked, armature=m.dof_armature.copy(), damping=damping)


def _link(m: mujoco.MjModel, body: int, j: int | None, parent: int, begins: bool, ends: bool) -> Link:
    """The link of joint `j` of a body; `j` is None for a body without joints."""
    kind = "fixed" if j is None else _KINDS[int(m.jnt_type[j])]
    axis = _row(m.jnt_axis[j]) if kind in ("hinge", "slide") else (0.0, 0.0, 0.0)
    turn = _rotation(m.body_quat[body]) if begins and kind != "free" else np.eye(3)
    name = _name(m.body(body).name, "body", body)
    if j is not None and not ends:
        name = f"{name}/{_name(m.jnt(j).name, 'joint', j)}"
    return Link(name, parent, kind, axis, (_row(turn[0]), _row(turn[1]), _row(turn[2])))


def _numbers(m: mujoco.MjModel, body: int, j: int | None, begins: bool, ends: bool) -> dict[str, object]:
    """The values of a link, by name, for the fields of the geometry with one entry a link."""
    free = j is not None and m.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE
    jointed = j is not None and not free
    at = m.jnt_qposadr[j] if jointed else 0
    # a body welded to the world is part of the world
    heavy = ends and m.body_weldid[body] != 0
    principal = _rotation(m.body_iquat[body])
    inertia = principal @ np.diag(m.body_inertia[body]) @ principal.T
    inertia[np.abs(inertia) < _DUST * np.abs(inertia).max()] = 0.0
    return {
        "mass": m.body_mass[body] * heavy,
        "com": m.body_ipos[body] * heavy,
        "inertia": inertia * heavy,
        "position": m.body_pos[body] * (begins and not free),
        "anchor": m.jnt_pos[j] if jointed else np.zeros(3),
        "reference": m.qpos0[at] if jointed else 0.0,
        "stiffness": 0.0 if not jointed or m.opt.disableflags & _OFF.mjDSBL_SPRING else m.jnt_stiffness[j],
        "rest": m.qpos_spring[at] if jointed else 0.0,
    }


def _complaints(m: mujoco.MjModel) -> Iterator[str]:
    """A sentence for each feature of a model that the tree does not support."""
    if not m.nv:
        yield "The model has no joint, so nothing can move."
    kinds = mujoco.mjtObj
    for number, kind, element in (
        (m.neq, kinds.mjOBJ_EQUALITY, "an equality constraint"),
        (m.ntendon, kinds.mjOBJ_TENDON, "a tendon"),
        (m.nflex, kinds.mjOBJ_FLEX, "a flex"),
    ):
        if number:
            name = mujoco.mj_id2name(m, kind, 0)
            named = f" '{name}'" if name else ""
            yield f"The model has {element}{named}, {_UNSUPPORTED}: remove it."
    if m.opt.density or m.opt.viscosity:
        yield f"The model moves in a fluid (option density or viscosity), {_UNSUPPORTED}."
    for body in range(1, m.nbody):
        name = _name(m.body(body).name, "body", body)
        if m.body_mocapid[body] >= 0:
            yield f"Body '{name}' is a mocap body, {_UNSUPPORTED}: remove mocap."
        if m.body_gravcomp[body]:
            yield f"Body '{name}' has gravcomp, {_UNSUPPORTED}: apply its force instead."
        if m.body_plugin[body] >= 0:
            yield f"Body '{name}' has a plugin, {_UNSUPPORTED}."
    for j in range(m.njnt):
        yield from _of_joint(m, j)
    for k in range(m.nu):
        if m.actuator_armature[k] or m.actuator_damping[k] or m.actuator_dampingpoly[k].any():
            name = _name(m.actuator(k).name, "actuator", k)
            yield f"Actuator '{name}' has armature or damping of its own: give them to the joint instead."


def _of_joint(m: mujoco.MjModel, j: int) -> Iterator[str]:
    """A sentence for each feature of joint `j` that the tree does not support."""
    name = _name(m.jnt(j).name, "joint", j)
    kind = m.jnt_type[j]
    dof = m.jnt_dofadr[j]
    unconstrained = m.opt.disableflags & _OFF.mjDSBL_CONSTRAINT
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        yield f"Joint '{name}' is a ball joint, {_UNSUPPORTED}: use three hinges."
    if m.jnt_limited[j] and not (unconstrained or m.opt.disableflags & _OFF.mjDSBL_LIMIT):
        yield f"Joint '{name}' has a limit, {_UNSUPPORTED}: remove its range."
    if m.dof_frictionloss[dof] and not (unconstrained or m.opt.disableflags & _OFF.mjDSBL_FRICTIONLOSS):
        yield f"Joint '{name}' has frictionloss, {_UNSUPPORTED}: use damping."
    if m.jnt_stiffnesspoly[j].any() or m.dof_dampingpoly[dof].any() or m.jnt_plasticadr[j] >= 0:
        yield f"Joint '{name}' has a spring or damper that is not linear: apply its force instead."
    if kind == mujoco.mjtJoint.mjJNT_FREE and m.jnt_stiffness[j]:
        yield f"Joint '{name}' is free and has a spring, {_UNSUPPORTED}: apply its force instead."


def _rotation(quaternion: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "3 3"]:
    """The rotation matrix of a quaternion (w, x, y, z)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return _dusted(matrix.reshape(3, 3))


def _row(vector: np.ndarray) -> Row:
    """The three numbers of a vector, without rounding errors of whole numbers."""
    x, y, z = _dusted(vector).tolist()
    return x, y, z


def _dusted(values: np.ndarray) -> np.ndarray:
    """Values of which those within `_DUST` of a whole number are that number."""
    rounded = np.round(values)
    return np.where(np.abs(values - rounded) < _DUST, rounded, values)


def _name(name: str, kind: str, number: int) -> str:
    """The name of an element in messages and links; its kind and number if it has none."""
    return name or f"{kind} {number}"
