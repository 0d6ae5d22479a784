"""An articulated tree from an MJCF, read from MuJoCo's compiled model.

Only the masses of geoms count; contacts and actuators are ignored: the caller adds their forces as `external`
and `tau`. Everything else that would act in MuJoCo but not here is refused.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from gaitsweep.dynamics.mjcf import DUST, cleaned, compiled, element_name, named
from gaitsweep.dynamics.tree.articulated_tree import WORLD, Geometry, Kind, Link, Row, Tree

_KINDS: dict[int, Kind] = {
    mujoco.mjtJoint.mjJNT_FREE: "free",
    mujoco.mjtJoint.mjJNT_HINGE: "hinge",
    mujoco.mjtJoint.mjJNT_SLIDE: "slide",
}
_OFF = mujoco.mjtDisableBit
_UNSUPPORTED = "which an articulated tree does not support"


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
    name = element_name(m, "body", body)
    if j is not None and not ends:
        name = f"{name}/{element_name(m, 'joint', j)}"
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
    inertia[np.abs(inertia) < DUST * np.abs(inertia).max()] = 0.0
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
            quoted = f" '{name}'" if name else ""
            yield f"The model has {element}{quoted}, {_UNSUPPORTED}: remove it."
    if m.opt.density or m.opt.viscosity:
        yield f"The model moves in a fluid (option density or viscosity), {_UNSUPPORTED}."
    for body in range(1, m.nbody):
        if m.body_mocapid[body] >= 0:
            yield f"{named(m, 'body', body)} is a mocap body, {_UNSUPPORTED}: remove mocap."
        if m.body_gravcomp[body]:
            yield f"{named(m, 'body', body)} has gravcomp, {_UNSUPPORTED}: apply its force instead."
        if m.body_plugin[body] >= 0:
            yield f"{named(m, 'body', body)} has a plugin, {_UNSUPPORTED}."
    for j in range(m.njnt):
        yield from _of_joint(m, j)
    for k in range(m.nu):
        if m.actuator_armature[k] or m.actuator_damping[k] or m.actuator_dampingpoly[k].any():
            own = "has armature or damping of its own: give them to the joint instead"
            yield f"{named(m, 'actuator', k)} {own}."


def _of_joint(m: mujoco.MjModel, j: int) -> Iterator[str]:
    """A sentence for each feature of joint `j` that the tree does not support."""
    joint = named(m, "joint", j)
    kind = m.jnt_type[j]
    dof = m.jnt_dofadr[j]
    unconstrained = m.opt.disableflags & _OFF.mjDSBL_CONSTRAINT
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        yield f"{joint} is a ball joint, {_UNSUPPORTED}: use three hinges."
    if m.jnt_limited[j] and not (unconstrained or m.opt.disableflags & _OFF.mjDSBL_LIMIT):
        yield f"{joint} has a limit, {_UNSUPPORTED}: remove its range."
    if m.dof_frictionloss[dof] and not (unconstrained or m.opt.disableflags & _OFF.mjDSBL_FRICTIONLOSS):
        yield f"{joint} has frictionloss, {_UNSUPPORTED}: use damping."
    if m.jnt_stiffnesspoly[j].any() or m.dof_dampingpoly[dof].any() or m.jnt_plasticadr[j] >= 0:
        yield f"{joint} has a spring or damper that is not linear: apply its force instead."
    if kind == mujoco.mjtJoint.mjJNT_FREE and m.jnt_stiffness[j]:
        yield f"{joint} is free and has a spring, {_UNSUPPORTED}: apply its force instead."


def _rotation(quaternion: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "3 3"]:
    """The rotation matrix of a quaternion (w, x, y, z)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return cleaned(matrix.reshape(3, 3))


def _row(vector: np.ndarray) -> Row:
    """The three numbers of a vector, without rounding errors of whole numbers."""
    x, y, z = cleaned(vector).tolist()
    return x, y, z
