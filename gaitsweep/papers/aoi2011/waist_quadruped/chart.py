"""Coordinates on the quadruped's section, just after the landing of limb 3 by touchdown of its foot.

Level ground is invariant under translation and rotation, so position and heading of the quadruped are left
out: positions are relative to the front body, along and across its heading. A steady gait along a line or a
circle is a fixed point.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import Chart, Quantity
from gaitsweep.dynamics import wrapped
from gaitsweep.dynamics.tree import tilt_and_heading, tilted
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import LIMBS
from gaitsweep.papers.aoi2011.waist_quadruped.state import Params, State

# If foot 3 is farther than this (m) from the ground, its limb has landed by its phase, not by a touchdown.
SECTION_TOLERANCE = 1e-8
_JOINTS = ("hip_1", "knee_1", "hip_2", "knee_2", "waist", "hip_3", "knee_3", "hip_4", "knee_4")
# Lengths of the parts of the coordinates, in order.
_PARTS = (4, 2, 9, 3, 3, 9, 8, 4, 4)


@dataclasses.dataclass(frozen=True)
class LandingChart(Chart):
    """46 coordinates: phases, tilt, joints, velocities, and the touchdown point and LP of each limb.

    The height of the front body is not among them, since foot 3 is on the ground.
    """

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        limbs = [i + 1 for i in LIMBS]
        pairs = {"delta_13": (1, 3), "delta_12": (1, 2), "delta_34": (3, 4)}
        ahead, across = "along the heading", "to the left of the heading"
        return (
            *(Quantity(k, "rad", f"phi_{i} - phi_{j}", circular=True) for k, (i, j) in pairs.items()),
            Quantity("phi_3", "rad", "phase of limb 3", circular=True),
            Quantity("up_x", "1", "vertical component of the front body's x axis"),
            Quantity("up_y", "1", "vertical component of the front body's y axis"),
            *(Quantity(name, "rad", f"angle of {name}") for name in _JOINTS),
            Quantity("v_ahead", "m/s", f"velocity of the front body {ahead}"),
            Quantity("v_across", "m/s", f"velocity of the front body {across}"),
            Quantity("v_up", "m/s", "velocity of the front body upwards"),
            *(
                Quantity(f"w_{k}", "rad/s", f"angular velocity of the front body about its {k} axis")
                for k in "xyz"
            ),
            *(Quantity(f"{name}_rate", "rad/s", f"rate of {name}") for name in _JOINTS),
            *(
                Quantity(f"anchor_{i}_{k}", "m", f"touchdown of foot {i} from the front body, {words}")
                for i in limbs
                for k, words in (("ahead", ahead), ("across", across))
            ),
            *(Quantity(f"landing_x_{i}", "m", f"desired x of foot {i} at its landing") for i in limbs),
            *(Quantity(f"landing_z_{i}", "m", f"desired z of foot {i} at its landing") for i in limbs),
        )

    def to_coordinates(self, params: Params, state: State) -> Float[Array, " coordinates"]:
        s = state
        up, turn = tilt_and_heading(s.q[3:7])
        deltas = wrapped(jnp.stack([s.phi[0] - s.phi[2], s.phi[0] - s.phi[1], s.phi[2] - s.phi[3]]))
        anchors = (s.anchor - s.q[None, :2]) @ turn
        return jnp.concatenate(
            [
                deltas, s.phi[2:3], up, s.q[7:], s.v[:2] @ turn, s.v[2:], jnp.ravel(anchors),
                s.landing_x, s.landing_z,
            ]
        )  # fmt: skip

    def from_coordinates(self, params: Params, at: Float[Array, " coordinates"], modes: State) -> State:
        parts = jnp.split(at, np.cumsum(_PARTS)[:-1])
        phases, up, joints, linear, spin, rates, anchors, x, z = parts
        phi_1 = phases[3] + phases[0]
        phi = jnp.stack([phi_1, phi_1 - phases[1], phases[3], phases[3] - phases[2]])
        # multiples of 2 pi are those of the limb's segment
        phi = modes.phi + wrapped(phi - modes.phi + jnp.pi) - jnp.pi
        q = jnp.concatenate([jnp.zeros(3), tilted(up), joints])
        v = jnp.concatenate([linear, spin, rates])
        foot_3 = params.mechanics.feet(q, v)[0][2]
        return dataclasses.replace(
            modes,
            q=q.at[2].add(-foot_3[2]),
            v=v,
            phi=phi,
            anchor=anchors.reshape(4, 2),
            landing_x=x,
            landing_z=z,
            stride_x=0.0 * modes.stride_x,
            stride_t=modes.clock,
        )

    def covers(self, params: Params, state: State) -> Bool[Array, ""]:
        height = params.mechanics.feet(state.q, state.v)[0][2, 2]
        return state.contact[2] & (jnp.abs(height) < SECTION_TOLERANCE) & ~state.held & ~state.growing
