"""The neural network of the rhythm, and the motors that it controls."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from gaitsweep.dynamics.matsuoka import FLEXOR, Coupling, leg_feedback, links, rates
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS

ACROSS = links(4, [(LEGS.index("LF"), LEGS.index("RF")), (LEGS.index("LH"), LEGS.index("RH"))])
BESIDE = links(4, [(LEGS.index("LF"), LEGS.index("LH")), (LEGS.index("RF"), LEGS.index("RH"))])


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Network:
    """The network: an extensor and a flexor half-centre for each leg; units as in `PARAMETERS`."""

    s: jax.Array
    Tr: jax.Array
    Ta: jax.Array
    b: jax.Array
    alpha: jax.Array
    beta_w: jax.Array
    gamma: jax.Array
    theta0: jax.Array
    k1: jax.Array
    k2: jax.Array

    def stepped(
        self, u: jax.Array, f: jax.Array, theta: jax.Array, load: jax.Array, dt: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Potentials and fatigue (2, 4) after a step of `dt` (s), by Euler's method.

        Args:
            u, f: potentials and fatigue, (2, 4).
            theta: angles of the hips, (4,) rad.
            load: loads on the feet, (4,) N.
        """
        du, df = rates(
            u, f, s=self.s, Tr=self.Tr, Ta=self.Ta, b=self.b, gamma=self.gamma,
            couplings=[Coupling(self.alpha, ACROSS), Coupling(self.beta_w, BESIDE)],
            feedback=leg_feedback(theta, load, theta0=self.theta0, k1=self.k1, k2=self.k2),
        )  # fmt: skip
        return u + dt * du, f + dt * df


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Motors:
    """Target positions and stiffness of hips and knees in swing and in stance; units as in `PARAMETERS`.

    Their damping belongs to the joints.
    """

    theta_sw: jax.Array
    theta_st: jax.Array
    Kp_hip_sw: jax.Array
    Kp_hip_st: jax.Array
    l_sw: jax.Array
    l_st: jax.Array
    Kp_knee_sw: jax.Array
    Kp_knee_st: jax.Array

    def forces(self, swings: jax.Array, theta: jax.Array, length: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Torques of the hips (4,) N m and forces of the knees (4,) N.

        Args:
            swings: whether each leg swings, (4,).
            theta, length: angles of the hips, (4,) rad, and lengths of the knees, (4,) m.
        """
        hip_sw, hip_st = self.Kp_hip_sw * (self.theta_sw - theta), self.Kp_hip_st * (self.theta_st - theta)
        knee_sw, knee_st = self.Kp_knee_sw * (self.l_sw - length), self.Kp_knee_st * (self.l_st - length)
        return jnp.where(swings, hip_sw, hip_st), jnp.where(swings, knee_sw, knee_st)


def swinging(u: jax.Array) -> jax.Array:
    """Whether each leg swings, (4,), that is, whether its flexor is active."""
    return u[FLEXOR] > 0.0
