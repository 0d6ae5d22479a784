"""Planar quadruped with leg-loading feedback (Fukuoka, Habu and Fukui 2015).

A torso and four telescopic legs in the sagittal plane. Each leg has a half-centre oscillator and swings while
its flexor is active. Fore and hind, left and right legs inhibit each other, which by itself results in a
trot. The load on a foot inhibits its flexor: if fore and hind leg of a diagonal pair have different loads,
their swings begin at different times, and other gaits result. Legs: LF, LH, RF, RH.

Body and network take fixed steps, the network by Euler's method. Contacts are MuJoCo's (`body: mjx`), or
compliant feet under gaitsweep's articulated tree (`body: tree`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

from gaitsweep.contract import Quantity, SteppedModel
from gaitsweep.dynamics import Ground, check_ground, ground_field, ground_quantities
from gaitsweep.near_miss import suggestion
from gaitsweep.papers.fukuoka2015.planar_quadruped import cycle
from gaitsweep.papers.fukuoka2015.planar_quadruped.bodies import PlanarBody, PlanarMjxBody, PlanarTreeBody
from gaitsweep.papers.fukuoka2015.planar_quadruped.drawing import PlanarDrawing
from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import (
    HIP,
    KNEE,
    NQ,
    PITCH,
    PlanarMechanics,
    X,
    Z,
    forces_on_joints,
    joint_powers,
)
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import (
    CHART,
    LEGS,
    MAX_ANTIPHASE_ERROR,
    MAX_VARIATION,
    MIN_LENGTH,
    PAIRS,
    margin,
    place,
)
from gaitsweep.papers.fukuoka2015.planar_quadruped.observables import (
    LABEL_FIELDS,
    OBSERVABLES,
    SIGNALS,
    observed,
    signalled,
)
from gaitsweep.papers.fukuoka2015.planar_quadruped.parameters import PARAMETERS, STARTS
from gaitsweep.papers.fukuoka2015.planar_quadruped.rhythm import Motors, Network, swinging
from gaitsweep.papers.fukuoka2015.planar_quadruped.state import Params, State

BODIES = ("tree", "mjx")
# Limits of a fall: height as a share of the standing height, and pitch (rad).
FALL_HEIGHT, FALL_TILT = 0.45, 1.0
FALL_CLEARANCES = (0.2, FALL_HEIGHT, 0.2)  # of hind hips, centre and fore hips above uneven ground
DEFINED_STEP = 1.0e-3  # s
UNSTEADY = len(CHART)
START_CLEARANCE = 0.005  # m, between the lowest foot and the ground
START_LEAN = 0.2  # rad, by which the hips of standing legs point forward and those of swinging legs backward
START_ACTIVE, START_SILENT, START_FATIGUE = 1.0, -0.5, 0.1  # potentials of half-centres, and fatigue
# Multipliers of the seed for each potential: the fractional parts are uniform in a cube.
_WEYL_ROOTS = np.sqrt([[2.0, 3.0, 5.0, 7.0], [11.0, 13.0, 17.0, 19.0]])


@dataclasses.dataclass(frozen=True)
class PlanarQuadruped(PlanarDrawing, SteppedModel):
    """The quadruped of a torso and four telescopic legs, in the plane."""

    body: str = dataclasses.field(
        default="tree",
        metadata={
            "meaning": "rigid-body dynamics: gaitsweep's own on compliant feet, or MJX",
            "allowed": BODIES,
        },
    )

    ground: str = ground_field()

    name: ClassVar[str] = "planar_quadruped"
    source: ClassVar[str] = "Fukuoka, Habu, Fukui 2015, Sci. Rep. 5:8169"
    bibtex: ClassVar[str] = Path(__file__).parents[1].joinpath("paper.bib").read_text(encoding="utf-8")
    gaits: ClassVar[tuple[str, ...]] = (*CHART, "unsteady")

    def __post_init__(self) -> None:
        if self.body not in BODIES:
            raise ValueError(f"body is '{self.body}'{suggestion(self.body, BODIES)}")
        if check_ground(self.ground) != "even" and self.body != "tree":
            raise ValueError(
                f"ground is {self.ground.split(' ', 1)[0]}, but the plane that MuJoCo compiles is even. "
                "Use body: tree."
            )

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return (*PARAMETERS, *ground_quantities(self.ground))

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return STARTS

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return OBSERVABLES

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return SIGNALS

    @property
    def label_fields(self) -> tuple[Quantity, ...]:
        return LABEL_FIELDS

    @property
    def _rigid_body(self) -> PlanarBody:
        return PlanarTreeBody() if self.body == "tree" else PlanarMjxBody()

    @property
    def host_parameters(self) -> tuple[str, ...]:
        return self._rigid_body.compiled_of

    def on_host(
        self, values: Mapping[str, Float[np.ndarray, " rows"]]
    ) -> dict[str, Float[np.ndarray, "rows ..."]]:
        variants = self._rigid_body.variants
        return dict(values) if variants is None else variants.on_host(values)

    def params(self, values: Mapping[str, Float[Array, " ..."]]) -> Params:
        v = {name: jnp.asarray(value) for name, value in values.items()}
        variants = self._rigid_body.variants
        numbers = {} if variants is None else variants.of_row(v)
        ground = None if self.ground == "even" else Ground.of(self.ground, v)

        def of(kind: type) -> dict[str, jax.Array]:
            return {field.name: v[field.name] for field in dataclasses.fields(kind) if field.name in v}

        return Params(
            network=Network(**of(Network)),
            motors=Motors(**of(Motors)),
            mechanics=PlanarMechanics(**of(PlanarMechanics), numbers=numbers, ground=ground),
            threshold=v["threshold"],
            memory=v["memory"],
        )

    def init(self, params: Params, start: Mapping[str, Float[Array, ""]]) -> State:
        """One diagonal pair is about to swing; potentials are perturbed."""
        m = params.mechanics
        first = np.array([leg in PAIRS[0] for leg in LEGS])
        swings = jnp.where(start["pair"] < 0.5, first, ~first)
        u = jnp.stack(
            [jnp.where(swings, START_SILENT, START_ACTIVE), jnp.where(swings, START_ACTIVE, START_SILENT)]
        )
        f = jnp.stack([jnp.where(swings, 0.0, START_FATIGUE), jnp.where(swings, START_FATIGUE, 0.0)])
        hip = jnp.where(swings, -START_LEAN, START_LEAN)
        leg = m.l_0 + params.motors.l_st - m.foot_radius
        height = leg * math.cos(START_LEAN) + m.foot_radius + START_CLEARANCE
        q = jnp.zeros((NQ,), hip.dtype).at[Z].set(height).at[HIP].set(hip)
        q = q.at[KNEE].set(params.motors.l_st)
        if m.ground is not None:  # all feet begin where the ground is even
            q = q.at[X].set(-(m.hip_x + m.l_0 + params.motors.l_st))
        u = u + start["scatter"] * perturbation(start["seed"])
        zero = jnp.zeros_like(q)
        warm = zero[: self._rigid_body.warm]
        load = zero[:4]
        measured = cycle.initial_cycle(q[X], q[PITCH])
        return State(q=q, v=zero, warm=warm, u=u, f=f, load=load, cycle=measured)

    def step(self, params: Params, state: State, dt: Float[Array, ""]) -> State:
        """The state after a step of `dt` (s); network, motors and body all use the state before it."""
        p, s = params, state
        theta, length = s.q[HIP], s.q[KNEE]
        swings = swinging(s.u)
        tau = forces_on_joints(*p.motors.forces(swings, theta, length))
        q, v, warm, load = self._rigid_body.stepped(p.mechanics, s, tau, dt)
        u, f = p.network.stepped(s.u, s.f, theta, s.load, dt)
        # semi-implicit steps: q moves by dt v, with the damping at the end of the step
        powers = joint_powers(tau, p.mechanics.damping(swings), v)
        work = dt * jnp.stack([jnp.sum(jnp.maximum(power, 0.0)) for power in powers])
        measured = cycle.after_step(s.cycle, (s.u, u), load, q[X], s.q[PITCH], work, p.memory, dt)
        return State(q=q, v=v, warm=warm, u=u, f=f, load=load, cycle=measured)

    def longest_step(self, params: Params) -> Float[Array, ""]:
        """1 ms, the step that is part of the model's definition, or less for stiffer contacts."""
        return jnp.minimum(DEFINED_STEP, self._rigid_body.longest_step(params.mechanics))

    def events(self, params: Params, before: State, after: State) -> Bool[Array, " events"]:
        """Whether LF has begun to swing; the step itself has applied the jump."""
        return after.cycle.closed[None]

    def jump(self, params: Params, state: State, fired: Bool[Array, " events"]) -> State:
        return state

    def section(self, params: Params, before: State, fired: Bool[Array, " events"]) -> Bool[Array, ""]:
        return fired[0]

    def observe(self, params: Params, state: State) -> dict[str, Real[Array, ""]]:
        return observed(params, state)

    def signal(self, params: Params, state: State) -> dict[str, Real[Array, ""]]:
        return signalled(params, state)

    def label(
        self, params: Params, observations: Mapping[str, Real[Array, ""]]
    ) -> dict[str, Real[Array, ""]]:
        """One of the nine gaits, by swing onsets and by touchdowns; unsteady if shifts or period vary."""
        o = observations
        steady = (o["variation"] <= MAX_VARIATION) & (jnp.abs(o["antiphase"] - 0.5) <= MAX_ANTIPHASE_ERROR)

        def gait(by: str, length: jax.Array) -> jax.Array:
            named = place(o[f"delta_1_{by}"], o[f"delta_2_{by}"], params.threshold)
            return jnp.where(steady & (length >= MIN_LENGTH), named, UNSTEADY)

        return {
            "gait": gait("mean", o["length"]),
            "margin": margin(o["delta_1_mean"], o["delta_2_mean"], params.threshold, jnp),
            "gait_by_touchdowns": gait("touchdown", o["length_touchdown"]),
        }

    def failed(self, params: Params, state: State) -> Bool[Array, ""]:
        """Whether the torso is too low or tilted, or on uneven ground a hip is almost on it."""
        m = params.mechanics
        standing = m.l_0 + params.motors.l_st
        x, height, pitch = state.q[X], state.q[Z], state.q[PITCH]
        tilted = jnp.abs(pitch) > FALL_TILT
        if m.ground is None:
            return (height < FALL_HEIGHT * standing) | tilted
        # a torso that lies on a slope need not tilt, and its legs would tremble on
        ahead = jnp.stack([-m.hip_x, 0.0 * m.hip_x, m.hip_x])
        clearance = height - ahead * jnp.sin(pitch) - m.ground(x + ahead * jnp.cos(pitch))
        return jnp.any(clearance < jnp.array(FALL_CLEARANCES) * standing) | tilted

    def period(self, params: Params) -> Float[Array, ""]:
        """The approximate period: ten times the rise time of a half-centre, 0.85 to 0.2 s."""
        return 10.0 * params.network.Tr


def perturbation(seed: jax.Array) -> jax.Array:
    """Pseudo-random numbers (2, 4) in [-1, 1) from an integer seed, equal for all engines.

    A Weyl sequence: the fractional parts of (seed + 1) times roots of primes.
    """
    turns = (seed + 1.0) * _WEYL_ROOTS
    return 2.0 * (turns - jnp.floor(turns)) - 1.0
