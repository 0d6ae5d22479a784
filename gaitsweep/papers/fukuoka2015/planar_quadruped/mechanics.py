"""The planar quadruped's rigid-body mechanics: indices of joints, and the tree with a row's values."""

from __future__ import annotations

import dataclasses
from functools import cache
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.dynamics import Ground
from gaitsweep.dynamics.tree import Array, Geometry, Scalar, Tree
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS

# Indices in q and in v.
X, Z, PITCH = 0, 1, 2
HIP, KNEE = np.array([3, 5, 7, 9]), np.array([4, 6, 8, 10])
NQ = 11
# Positions of the hips relative to their midpoint, in units of hip_x.
HIP_SIGNS = tuple(1.0 if leg.endswith("F") else -1.0 for leg in LEGS)
# Radii of the legs' capsules, m, for their moments of inertia only.
UPPER_RADIUS, LOWER_RADIUS = 0.015, 0.008


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PlanarMechanics:
    """Masses, lengths, damping and ground; units as in `PARAMETERS`.

    `numbers` has the fields of an mjx.Model that MuJoCo computes from masses and lengths, for the body in
    MJX; it is empty for the tree. `ground` is None where the ground is even.
    """

    com_x: jax.Array
    com_z: jax.Array
    torso_mass: jax.Array
    torso_inertia: jax.Array
    upper_mass: jax.Array
    lower_mass: jax.Array
    foot_mass: jax.Array
    hip_x: jax.Array
    l_0: jax.Array
    upper_length: jax.Array
    lower_length: jax.Array
    foot_radius: jax.Array
    Kv_hip: jax.Array
    Kv_knee_sw: jax.Array
    Kv_knee_st: jax.Array
    g: jax.Array
    mu: jax.Array
    K_foot: jax.Array
    D_foot: jax.Array
    v_slip: jax.Array
    numbers: dict[str, jax.Array]
    ground: Ground | None = None

    def damping(self, swings: jax.Array) -> jax.Array:
        """Damping of the degrees of freedom (11,), N m s/rad and N s/m; `swings` (4,): which legs do."""
        return _placed(self.g, [self.Kv_hip] * 4, list(jnp.where(swings, self.Kv_knee_sw, self.Kv_knee_st)))

    def geometry(self, swings: jax.Array, dt: Scalar) -> Geometry:
        """The tree's geometry, with implicit joint damping for a step of `dt` (s); `swings` as in `damping`.

        With the damping force at the end of the step, the accelerations follow from (M + dt D) a = forces at
        its beginning, as in MuJoCo's Euler integrator: an armature of dt D.
        """
        tree, of_mjcf = body()
        fields = ("mass", "com", "inertia", "position")
        rows: dict[str, list[Array]] = {name: list(getattr(of_mjcf, name)) for name in fields}
        rows["mass"][tree.index("torso")] = self.torso_mass
        rows["com"][tree.index("torso")] = jnp.stack([self.com_x, 0.0 * self.com_x, self.com_z])
        rows["inertia"][tree.index("torso")] = _about_y(self.torso_inertia)
        upper = capsule_inertia(self.upper_mass, self.upper_length, UPPER_RADIUS)
        lower_mass, lower_com, lower = self._lower()
        for leg, side in zip(LEGS, HIP_SIGNS, strict=True):
            i = tree.index(f"upper_{leg}")
            rows["mass"][i] = self.upper_mass
            rows["com"][i] = _along(2, -0.5 * self.upper_length)
            rows["inertia"][i] = _about_y(upper)
            rows["position"][i] = _along(0, side * self.hip_x)
            i = tree.index(f"lower_{leg}")
            rows["mass"][i] = jnp.asarray(lower_mass)
            rows["com"][i] = _along(2, lower_com)
            rows["inertia"][i] = _about_y(lower)
            rows["position"][i] = _along(2, -self.l_0)
        damping = self.damping(swings)
        stacked = {name: jnp.stack([jnp.asarray(row) for row in rows[name]]) for name in rows}
        return dataclasses.replace(of_mjcf, **stacked, damping=damping, armature=dt * damping)

    def _lower(self) -> tuple[Scalar, Scalar, Scalar]:
        """Mass (kg) of a lower leg with its foot, centre of mass above the sole (m), inertia (kg m2)."""
        shin, foot = self.lower_mass, self.foot_mass
        mass = shin + foot
        d = 0.5 * self.lower_length  # between the centres of the shin and of the foot
        inertia = capsule_inertia(shin, self.lower_length, LOWER_RADIUS)
        inertia = inertia + 0.4 * foot * self.foot_radius * self.foot_radius
        com = self.foot_radius + shin / mass * d
        return mass, com, inertia + shin * foot / mass * d * d

    def total_mass(self) -> jax.Array:
        """The mass of the torso and four legs, kg."""
        return self.torso_mass + 4.0 * (self.upper_mass + self.lower_mass + self.foot_mass)

    def gravity(self) -> jax.Array:
        """The acceleration of gravity in the world (3,), m/s2."""
        return _along(2, -self.g)


def capsule_inertia(mass: Scalar, length: Scalar, radius: float) -> Scalar:
    """The inertia (kg m2) of a capsule about a transverse axis through its centre.

    Args:
        mass: mass, kg.
        length: length of its cylinder, m.
        radius: radius, m.
    """
    ends = mass * 4.0 * radius / (4.0 * radius + 3.0 * length)
    cylinder = (mass - ends) * (3.0 * radius**2 + length * length) / 12.0
    return cylinder + ends * (0.4 * radius**2 + 0.375 * length * radius + 0.25 * length * length)


def forces_on_joints(hip: jax.Array, knee: jax.Array) -> jax.Array:
    """Generalised forces (11,) from torques (4,) of the hips, N m, and forces (4,) of the knees, N."""
    return _placed(hip[0], list(hip), list(knee))


def joint_powers(tau: jax.Array, damping: jax.Array, v: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The mechanical powers (4,) W of the hips and (4,) W of the knees: of each motor's spring and damper.

    Args:
        tau: generalised forces (11,) of the motors without damping, N m and N.
        damping: damping (11,), N m s/rad and N s/m.
        v: velocities (11,), rad/s and m/s.
    """
    power = (tau - damping * v) * v
    return power[HIP], power[KNEE]


def _placed(like: jax.Array, hips: list[jax.Array], knees: list[jax.Array]) -> jax.Array:
    """Values of the joints in the order of v (11,), zeros for the root."""
    joints = [joint for pair in zip(hips, knees, strict=True) for joint in pair]
    return jnp.stack([jnp.zeros_like(like)] * 3 + joints)


def _along(axis: int, value: Scalar) -> jax.Array:
    """A vector (3,) along one axis."""
    return jnp.stack([jnp.asarray(value if i == axis else 0.0 * value) for i in range(3)])


def _about_y(inertia: Scalar) -> jax.Array:
    """An inertia (3, 3) about y, the only axis of rotation."""
    zero = _along(1, 0.0 * inertia)
    return jnp.stack([zero, _along(1, inertia), zero])


def mjcf() -> str:
    """The body as an MJCF."""
    return resources.files("gaitsweep.papers.fukuoka2015.planar_quadruped").joinpath("body.xml").read_text()


@cache
def body() -> tuple[Tree, Geometry]:
    """The tree, and its geometry with the values of the MJCF."""
    from gaitsweep.dynamics.tree import tree_of  # MuJoCo, only for a job of this body

    return tree_of(mjcf())
