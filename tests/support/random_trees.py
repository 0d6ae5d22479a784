"""Random MJCF trees and states, to set the articulated dynamics against MuJoCo."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

COORDINATES = np.eye(3)


def _words(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def unit(rng: np.random.Generator, n: int) -> np.ndarray:
    vector = rng.normal(size=n)
    return vector / np.linalg.norm(vector)


def _inertial(rng: np.random.Generator) -> str:
    # principal moments of three point masses' squares, so that the triangle inequalities hold
    squares = rng.uniform(0.01, 0.1, 3)
    return (
        f'<inertial pos="{_words(rng.uniform(-0.2, 0.2, 3))}" quat="{_words(unit(rng, 4))}" '
        f'mass="{rng.uniform(0.5, 2.0)}" diaginertia="{_words(squares.sum() - squares)}"/>'
    )


def _joint(rng: np.random.Generator, name: str, kind: str, axis: np.ndarray, plain: bool) -> str:
    """A hinge or slide; a plain one has no armature, damping, spring or reference."""
    extra = (
        ""
        if plain
        else f'armature="{rng.uniform(0.0, 0.3)}" damping="{rng.uniform(0.0, 0.5)}" '
        f'stiffness="{rng.uniform(0.0, 5.0)}" springref="{rng.normal()}" ref="{rng.normal()}"'
    )
    where = _words(rng.uniform(-0.2, 0.2, 3))
    return f'<joint name="{name}" type="{kind}" axis="{_words(axis)}" pos="{where}" {extra}/>'


def _joints(rng: np.random.Generator, number: int, axis: np.ndarray) -> str:
    """None, one, or two joints of a body; two of them along different coordinates."""
    count = rng.choice([0, 1, 2], p=[0.1, 0.7, 0.2])
    kinds = rng.choice(["hinge", "slide"], p=[0.75, 0.25], size=2)
    axes = [axis] if count < 2 else COORDINATES[rng.permutation(3)[:2]]
    plain = bool(rng.integers(2))
    return "".join(_joint(rng, f"j{number}_{k}", kinds[k], axes[k], plain) for k in range(count))


_PLANAR = (
    '<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>'
    '<joint name="y" type="hinge" axis="0 1 0"/>'
)


def tree_xml(rng: np.random.Generator) -> str:
    """An MJCF of one to seven bodies on a free, planar or fixed root, some limbs with all hinges parallel."""
    count = int(rng.integers(1, 8))
    parents = [-1, *(int(rng.integers(-1 if rng.random() < 0.1 else 0, i)) for i in range(1, count))]
    root = rng.choice(["free", "planar", "fixed"])
    axes = [COORDINATES[1]]
    bodies = []
    for i, parent in enumerate(parents):
        # an axis is the parent's, so that limbs move in planes, a coordinate's, or any
        way = rng.integers(3)
        axis = [axes[max(parent, 0)], COORDINATES[rng.integers(3)], unit(rng, 3)][way]
        axes.append(axis)
        turned = "" if way == 0 or rng.random() < 0.5 else f'quat="{_words(unit(rng, 4))}"'
        if i == 0 and root == "free":
            armature = "" if rng.integers(2) else 'armature="0.2"'
            joints = f'<joint name="root" type="free" {armature} damping="{rng.uniform(0.0, 0.1)}"/>'
        elif i == 0 and root == "planar":
            joints, turned = _PLANAR, ""
        else:
            joints = _joints(rng, i, axis)
        bodies.append(
            f'<body name="b{i}" pos="{_words(rng.normal(size=3) * 0.3)}" {turned}>{joints}{_inertial(rng)}'
        )

    def nested(parent: int) -> str:
        return "".join(f"{body}{nested(i)}</body>" for i, body in enumerate(bodies) if parents[i] == parent)

    return (
        '<mujoco><compiler angle="radian"/><option gravity="0.3 -0.2 -9.81">'
        '<flag contact="disable"/></option>'
        f"<worldbody>{nested(-1)}</worldbody></mujoco>"
    )


@dataclasses.dataclass(frozen=True)
class Moment:
    """A random state of a model and what acts on it; `data` after mj_forward."""

    model: mujoco.MjModel
    data: mujoco.MjData

    @property
    def q(self) -> np.ndarray:
        return self.data.qpos

    @property
    def v(self) -> np.ndarray:
        return self.data.qvel

    @property
    def tau(self) -> np.ndarray:
        return self.data.qfrc_applied


def moment(rng: np.random.Generator, model: mujoco.MjModel, *, pushed: bool = True) -> Moment:
    """A state at random, pushed at the joints and, in the world's axes, at each body's centre of mass."""
    data = mujoco.MjData(model)
    data.qpos[:] = rng.normal(size=model.nq)
    for j in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        at = model.jnt_qposadr[j]
        data.qpos[at + 3 : at + 7] = unit(rng, 4)
    data.qvel[:] = rng.normal(size=model.nv) * 2.0
    if pushed:
        data.qfrc_applied[:] = rng.normal(size=model.nv)
        data.xfrc_applied[1:] = rng.normal(size=(model.nbody - 1, 6))
    mujoco.mj_forward(model, data)
    return Moment(model, data)


def waist_quadruped_xml(mass: float = 1.0, size: float = 1.0) -> str:
    """The quadruped with a waist joint of Aoi et al. 2011, without ground.

    Args:
        mass: of the rear body, kg.
        size: the factor of the rear body's lengths, and of the fore body's along x.
    """

    def rod(name: str, joint: str, place: str, rest: str) -> str:
        across = 0.1 * 0.08**2 / 12.0
        return (
            f'<body name="{name}_{joint}" pos="{place}"><joint name="{name}_{joint}" axis="0 1 0"/>'
            f'<inertial pos="0 0 -0.04" mass="0.1" diaginertia="{across} {across} 1e-5"/>{rest}</body>'
        )

    def limb(name: str, x: float, y: float) -> str:
        return rod(name, "upper", f"{x} {y} 0", rod(name, "lower", "0 0 -0.08", ""))

    def box(m: float, x: float, y: float, z: float) -> str:
        squares = _words(np.array([y * y + z * z, x * x + z * z, x * x + y * y]) * m / 12.0)
        return f'<inertial pos="0 0 0" mass="{m}" diaginertia="{squares}"/>'

    s = size
    return (
        '<mujoco><compiler angle="radian"/><option gravity="0 0 -9.8"/><worldbody>'
        f'<body name="fore"><freejoint/>{box(1.0, 0.1 * s, 0.1, 0.05)}'
        f"{limb('right_fore', 0.048 * s, -0.05)}{limb('left_fore', 0.048 * s, 0.05)}"
        f'<body name="rear" pos="{-0.1 * s} 0 0"><joint name="waist" axis="1 0 0" pos="{0.05 * s} 0 0"/>'
        f"{box(mass, 0.1 * s, 0.1 * s, 0.05 * s)}"
        f"{limb('right_hind', -0.048 * s, -0.05 * s)}{limb('left_hind', -0.048 * s, 0.05 * s)}"
        "</body></body></worldbody></mujoco>"
    )
