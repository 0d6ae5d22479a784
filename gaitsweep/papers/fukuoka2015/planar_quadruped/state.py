"""The parameters and the state of the planar quadruped."""

from __future__ import annotations

import dataclasses

import jax
from jaxtyping import Array, Float

from gaitsweep.papers.fukuoka2015.planar_quadruped.cycle import Cycle
from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import (
    PlanarMechanics,
)
from gaitsweep.papers.fukuoka2015.planar_quadruped.rhythm import Motors, Network


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Params:
    """The parameters of one trajectory.

    Attributes:
        network, motors, mechanics: parameters of the rhythm, of its motors and of the body.
        threshold: largest phase shift of a pair of legs that counts as zero, cycles.
        memory: number of cycles over which phase shifts are averaged.
    """

    network: Network
    motors: Motors
    mechanics: PlanarMechanics
    threshold: Float[Array, ""]
    memory: Float[Array, ""]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class State:
    """The state along a trajectory.

    Attributes:
        q, v: MuJoCo's qpos (m, rad) and qvel (m/s, rad/s).
        warm: the last acceleration, from which MuJoCo's solver begins; empty if `body` is `tree`.
        u, f: potentials and fatigue of the extensors (row 0) and the flexors (row 1) of the legs.
        load: loads on the feet in the last step, N.
        cycle: running measurements of the gait cycles.
    """

    q: Float[Array, " coordinates"]
    v: Float[Array, " coordinates"]
    warm: Float[Array, " accelerations"]
    u: Float[Array, "halves legs"]
    f: Float[Array, "halves legs"]
    load: Float[Array, " legs"]
    cycle: Cycle
