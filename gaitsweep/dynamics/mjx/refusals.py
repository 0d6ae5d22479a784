"""Features of a model that MJX silently ignores, found by comparison with MuJoCo.

MJX raises an error for most features that it does not support. It ignores the others, and then simulates a
body that differs from the MJCF.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

# Fields of MjModel with an effect where they are not zero: the field, the kind of its owner, the name in
# MJCF. Some versions of MuJoCo do not have all of them.
_ACTING = (
    ("geom_adhesion", "geom", "adhesion"),
    ("pair_adhesion", "pair", "adhesion"),
    ("geom_surfacevel", "geom", "surfacevel"),
    ("geom_fluid", "geom", "fluidshape ellipsoid"),
    ("jnt_springyield", "jnt", "springyield"),
    ("jnt_stiffnesspoly", "jnt", "a stiffness that is a polynomial"),
    ("dof_dampingpoly", "dof", "a damping that is a polynomial"),
    ("tendon_springyield", "tendon", "springyield"),
    ("tendon_stiffnesspoly", "tendon", "a stiffness that is a polynomial"),
    ("tendon_dampingpoly", "tendon", "a damping that is a polynomial"),
    ("actuator_delay", "actuator", "a delay"),
    ("actuator_actearly", "actuator", "actearly"),
    ("actuator_armature", "actuator", "an armature of its own"),
    ("actuator_damping", "actuator", "a damping of its own"),
    ("actuator_dampingpoly", "actuator", "a damping of its own that is a polynomial"),
)
_WORDS = {"jnt": "joint", "dof": "joint", "eq": "equality"}
_OFF = mujoco.mjtDisableBit


def refusals(model: mujoco.MjModel) -> list[str]:
    """A sentence for each feature of a compiled model that MJX would ignore."""
    return [*_of_parts(model), *_of_options(model)]


def _of_parts(m: mujoco.MjModel) -> Iterator[str]:
    for field, kind, what in _ACTING:
        values = np.asarray(getattr(m, field, ()))
        for i in np.flatnonzero(values.reshape(len(values), -1).any(axis=1) if values.size else values):
            yield f"{_named(m, kind, int(i))} has {what}, which MJX ignores."
    for kind in ("body", "geom", "actuator"):
        for i in np.flatnonzero(np.asarray(getattr(m, f"{kind}_plugin", ())) >= 0):
            yield f"{_named(m, kind, int(i))} has a plugin, which MJX ignores."
    for i in np.flatnonzero(m.actuator_trntype == mujoco.mjtTrn.mjTRN_BODY):
        yield f"{_named(m, 'actuator', int(i))} is an adhesion, which MJX does not have."
    for i in np.flatnonzero(np.isin(m.eq_type, (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD))):
        yield f"{_named(m, 'eq', int(i))} is a connect or weld, of whose acceleration MJX ignores a term."


def _of_options(m: mujoco.MjModel) -> Iterator[str]:
    if m.opt.noslip_iterations:
        yield "The option noslip_iterations is set, which MJX ignores."
    groups = [g for g in range(31) if m.opt.disableactuator >> g & 1]
    for i in np.flatnonzero(np.isin(m.actuator_group, groups)):
        yield f"{_named(m, 'actuator', int(i))} is disabled by its group, which MJX ignores: remove it."
    if m.opt.enableflags & getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0):
        yield "The flag sleep is enabled, which MJX ignores."
    springs, dampers = (bool(m.opt.disableflags & bit) for bit in (_OFF.mjDSBL_SPRING, _OFF.mjDSBL_DAMPER))
    if springs != dampers:
        yield "The flag spring or damper is disabled, and MJX then leaves out both: set zeros instead."
    if m.opt.integrator not in (
        mujoco.mjtIntegrator.mjINT_EULER,
        mujoco.mjtIntegrator.mjINT_RK4,
        mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    ):
        yield "The integrator is one that MJX does not have. Allowed: Euler, RK4, implicitfast."


def _named(m: mujoco.MjModel, kind: str, number: int) -> str:
    if kind == "dof":
        number = int(m.dof_jntid[number])
    word = _WORDS.get(kind, kind)
    name = getattr(m, word)(number).name or f"{word} {number}"
    return f"{word.capitalize()} '{name}'"
