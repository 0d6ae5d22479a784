"""Quadruped with a passive waist joint (Aoi, Yamashita and Tsuchiya 2011).

Two rigid bodies joined by a roll joint with a spring, and four limbs of two links. Each limb has a phase
oscillator whose phase determines the desired position of its foot. Left and right oscillators are coupled in
antiphase; fore and hind ones are not, unless their gains K_ij are given. A landing resets the phase of its
limb. So the gait, the phase difference between fore and hind limbs, results from the mechanics only. Limbs:
1 right fore, 2 left fore, 3 right hind, 4 left hind.

There are two integration methods: an ODE with located events (`numerics.method: rk4`) for transition points
and Jacobians, and semi-implicit Euler (`method: semi_implicit`) for scans, with landing times interpolated
inside a step. The body is gaitsweep's articulated tree, or MJX's (`body: mjx`), which has fixed steps only.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

from gaitsweep.contract import Chart, HybridModel, Quantity, Rates, Recommended
from gaitsweep.dynamics import TWO_PI, Ground, check_ground, ground_field, ground_quantities, wrapped
from gaitsweep.dynamics.tree import rates
from gaitsweep.near_miss import suggestion
from gaitsweep.papers.aoi2011.waist_quadruped.bodies import WaistBody, WaistMjxBody, WaistTreeBody
from gaitsweep.papers.aoi2011.waist_quadruped.chart import LandingChart
from gaitsweep.papers.aoi2011.waist_quadruped.drawing import WaistDrawing
from gaitsweep.papers.aoi2011.waist_quadruped.kinematics import SWINGS, Swing, has_fallen
from gaitsweep.papers.aoi2011.waist_quadruped.mechanics import RELEASE_HEIGHT, WaistMechanics
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import FRICTION, HEIGHTS, PARAMETERS, body
from gaitsweep.papers.aoi2011.waist_quadruped.rhythm import (
    STRIDE_LIMB,
    after_events,
    anchors,
    corner,
    desired_velocities,
    landing_points,
    phase_rates,
    transitions,
)
from gaitsweep.papers.aoi2011.waist_quadruped.semi_implicit import SemiImplicit
from gaitsweep.papers.aoi2011.waist_quadruped.state import (
    DAMPINGS,
    OBSERVABLES,
    SIGNALS,
    Damping,
    Params,
    State,
    initial_state,
    observed,
    signalled,
)

BODIES = ("tree", "mjx")
SLIPS = ("none", "coulomb")
HEIGHT_CHOICES = ("level", "given")


def _word(default: str, meaning: str, allowed: tuple[str, ...]) -> Any:
    """A field of the structure that older jobs do not have."""
    return dataclasses.field(
        default=default, metadata={"meaning": meaning, "allowed": allowed, "later": True}
    )


@dataclasses.dataclass(frozen=True)
class WaistQuadruped(WaistDrawing, HybridModel):
    """The quadruped of two bodies, a waist and four limbs."""

    body: str = dataclasses.field(
        default="tree",
        metadata={
            "meaning": "rigid-body dynamics: gaitsweep's own, or MJX with fixed steps",
            "allowed": BODIES,
        },
    )
    swing: str = _word("cycloid", "curve of the desired foot in swing", SWINGS)
    damping: str = _word("joint_rate", "rate that joints are damped by: their own, or its error", DAMPINGS)
    slip: str = _word("none", "feet slip by Coulomb friction mu, or never", SLIPS)
    heights: str = _word(
        "level", "hips and the waist's axis: level with the centres of mass, or given", HEIGHT_CHOICES
    )
    ground: str = ground_field()

    name: ClassVar[str] = "waist_quadruped"
    source: ClassVar[str] = "Aoi, Yamashita, Tsuchiya 2011, Phys. Rev. E 83:061909"
    bibtex: ClassVar[str] = Path(__file__).parents[1].joinpath("paper.bib").read_text(encoding="utf-8")
    gaits: ClassVar[tuple[str, ...]] = ("walk", "trot", "pace", "none")

    def __post_init__(self) -> None:
        check_ground(self.ground)
        for field in dataclasses.fields(self):
            word = getattr(self, field.name)
            allowed = field.metadata.get("allowed", (word,))
            if word not in allowed:
                raise ValueError(f"{field.name} is '{word}'{suggestion(word, allowed)}")

    @property
    def precisions(self) -> tuple[str, ...]:
        return ("float64", "mixed") if self.body == "tree" else ("float64",)

    @property
    def _rigid_body(self) -> WaistBody:
        return WaistTreeBody() if self.body == "tree" else WaistMjxBody(level=self.heights == "level")

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        heights = () if self.heights == "level" else HEIGHTS
        friction = () if self.slip == "none" else FRICTION
        return (*PARAMETERS, *heights, *friction, *ground_quantities(self.ground))

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return (
            Quantity(
                "delta_13", "rad", "lead of limb 1 over limb 3",
                default=math.pi, circular=True, symbol=r"\Delta_{13}", source="eq. (5)",
            ),
        )  # fmt: skip

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return OBSERVABLES

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return SIGNALS

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
        omega_w = TWO_PI * v["f"]
        mechanics = WaistMechanics(
            kappa_w=v["kappa_0"] * omega_w * omega_w,  # eq. (8)
            sigma_w=2.0 * v["kappa_0"] * v["zeta_0"] * omega_w,
            **{f.name: v[f.name] for f in dataclasses.fields(WaistMechanics) if f.name in v},
            numbers={} if variants is None else variants.of_row(v),
            ground=None if self.ground == "even" else Ground.of(self.ground, v),
        )
        cycle = v["T_sw"] / (1.0 - v["beta"])  # eq. (3)
        return Params(
            **{f.name: v[f.name] for f in dataclasses.fields(Params) if f.name in v},
            K={i + j: v[f"K_{i}{j}"] for i, j in itertools.permutations("1234", 2)},
            delta_star={i + j: v[f"delta_star_{i}{j}"] for i, j in itertools.combinations("1234", 2)},
            gait_centres=jnp.stack([v[f"{gait}_centre"] for gait in self.gaits[:-1]]),
            gait_widths=jnp.stack([v[f"{gait}_width"] for gait in self.gaits[:-1]]),
            omega=TWO_PI / cycle,
            phi_AEP=TWO_PI * (1.0 - v["beta"]),
            mechanics=mechanics,
            # words of a structure are `str`, of which those `allowed` alone are accepted
            swing=cast(Swing, self.swing),
            damping=cast(Damping, self.damping),
        )

    def init(self, params: Params, start: Mapping[str, Float[Array, ""]]) -> State:
        """Standing, all feet on the ground below their hips, limb 3 at its AEP."""
        return initial_state(params, start["delta_13"])

    @property
    def locates_events(self) -> bool:
        return self.body == "tree"

    def flow(self, params: Params, state: State) -> Rates:
        p, s, m = params, state, params.mechanics
        q_rate = jnp.asarray(rates(body()[0], s.q, s.v))
        x, z = p.path(s.clock, s.growing).target(s.phi, s.segment, (s.landing_x, s.landing_z))
        feet = (*m.feet(s.q, s.v), s.anchor, s.contact)
        coupling = jnp.where(s.held, p.K_hold, 0.0)
        desired = desired_velocities(p, s, coupling) if p.damping == "rate_error" else None
        slip = {} if m.mu is None else {"anchor": m.creep(*feet)}
        return {
            "q": q_rate,
            "v": m.accelerations(s.q, s.v, m.torques(s.q, s.v, x, z, desired), m.ground_forces(*feet)),
            "phi": phase_rates(p, s, coupling),
            "clock": jnp.ones_like(s.clock),
            **slip,
        }

    @property
    def recommended(self) -> Recommended:
        return Recommended("rk4") if self.locates_events else Recommended("semi_implicit")

    def fast_modes(self, params: Params) -> tuple[Float[Array, " motions"], Float[Array, " motions"]]:
        rate, damping = params.mechanics.fastest_motion(params.farthest_foot)
        slip = params.mechanics.T_slip
        if slip is None:
            return rate[None], damping[None]
        return jnp.stack([rate, 1.0 / slip]), jnp.stack([damping, jnp.ones_like(damping)])

    def fixed_step_scheme(self) -> SemiImplicit:
        return SemiImplicit(self._rigid_body)

    def guards(self, params: Params, state: State) -> Float[Array, " guards"]:
        """Phases relative to the ends of their segments, foot contacts, ends of growth and hold, (10,)."""
        p, s = params, state
        height = p.mechanics.heights(p.mechanics.feet(s.q, s.v)[0])
        foot = jnp.where(s.contact, height - RELEASE_HEIGHT, -height)
        grown = jnp.where(s.growing, s.clock - p.T_grow, -1.0)
        free = jnp.where(s.held, s.clock - p.T_hold, -1.0)
        return jnp.concatenate([s.phi - corner(p, s.segment), foot, jnp.stack([grown, free])])

    @property
    def guard_names(self) -> tuple[str, ...]:
        ends = (f"phase of limb {i} reaches the end of its segment" for i in range(1, 5))
        feet = (f"foot {i} touches or lifts" for i in range(1, 5))
        return (*ends, *feet, "the stride has grown (T_grow)", "delta_13 is released (T_hold)")

    def jump(self, params: Params, state: State, fired: Bool[Array, " events"]) -> State:
        p, s = params, state
        now = transitions(s, fired[:4], fired[4:8])
        at, _ = p.mechanics.feet(s.q, s.v)
        touches = now.contact & ~s.contact
        anchor = anchors(p, s, touches, at[:, :2])
        desired = p.path(s.clock, s.growing).target(s.phi, s.segment, (s.landing_x, s.landing_z))
        landing = landing_points(p, s, now.late, desired, p.mechanics.from_hips(s.q, p.landing_actual))
        s = dataclasses.replace(s, anchor=anchor, growing=s.growing & ~fired[8], held=s.held & ~fired[9])
        return after_events(p, s, now, landing)

    def section(self, params: Params, before: State, fired: Bool[Array, " events"]) -> Bool[Array, ""]:
        """Whether limb 3 lands."""
        return transitions(before, fired[:4], fired[4:8]).lands[STRIDE_LIMB]

    def observe(self, params: Params, state: State) -> dict[str, Real[Array, ""]]:
        return observed(state)

    def signal(self, params: Params, state: State) -> dict[str, Real[Array, ""]]:
        return signalled(state)

    def label(
        self, params: Params, observations: Mapping[str, Real[Array, ""]]
    ) -> dict[str, Real[Array, ""]]:
        """The gait with the nearest centre, among the gaits within whose width delta_13 is."""
        distance = jnp.abs(wrapped(observations["delta_13"] - params.gait_centres + jnp.pi) - jnp.pi)
        distance = jnp.where(distance < params.gait_widths, distance, jnp.inf)
        gait = jnp.where(jnp.min(distance) < jnp.inf, jnp.argmin(distance), len(self.gaits) - 1)
        return {"gait": gait}

    def failed(self, params: Params, state: State) -> Bool[Array, ""]:
        """Whether the body is too low, tilted or twisted."""
        ground = params.mechanics.ground
        return has_fallen(state.q, params.depths()[0], None if ground is None else ground(state.q[0]))

    def period(self, params: Params) -> Float[Array, ""]:
        return TWO_PI / params.omega

    def free_after(self, params: Params) -> Float[Array, ""]:
        return params.T_hold

    def chart(self) -> Chart | None:
        return LandingChart() if self.locates_events else None
