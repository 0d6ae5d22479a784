"""The parameters and the state of the planar quadruped."""

from __future__ import annotations

import dataclasses

import jax

from gaitsweep.papers.fukuoka2015.planar_quadruped.cycle import Cycle
from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import PlanarMechanics
from gaitsweep.papers.fukuoka2015.planar_quadruped.rhythm import Motors, Network


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Params:
    """The network, the motors and the body; `threshold` and `memory` as in `PARAMETERS`."""

    network: Network
    motors: Motors
    mechanics: PlanarMechanics
    threshold: jax.Array
    memory: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class State:
    """The state along a trajectory.

    `q`, `v` (11,) are MuJoCo's qpos and qvel; `warm` (11,) the last acceleration, the initial guess of
    MuJoCo's solver, (0,) for the tree; `u`, `f` (2, 4) potentials and fatigue; `load` (4,) N on the feet in
    the last step; `cycle` the measurements of gait cycles.
    """

    q: jax.Array
    v: jax.Array
    warm: jax.Array
    u: jax.Array
    f: jax.Array
    load: jax.Array
    cycle: Cycle
