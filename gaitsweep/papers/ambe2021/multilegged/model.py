"""Multi-legged chain with phase resetting at touchdown (Ambe, Aoi, Tsuchiya and Matsuno 2021).

N + 1 point masses move vertically, with springs and dampers between neighbours. Each mass stands on a
massless leg whose length is a function of the phase of its own oscillator. The oscillators are not coupled: a
phase is reset when its leg touches the ground in the landing segment, and the legs interact only by this.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Bool, Float, Real

from gaitsweep import Limb, Skeleton
from gaitsweep.analyses import AnalysisError
from gaitsweep.contract import Chart, HybridModel, Quantity, Rates, Recommended, Simultaneous
from gaitsweep.dynamics import TWO_PI, wrapped
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import chain_of, largest_distance, relative_phases
from gaitsweep.papers.ambe2021.multilegged.forces import (
    fastest_motions,
    ground_force,
    neighbour_force,
    obstacle_problem,
)
from gaitsweep.papers.ambe2021.multilegged.parameters import SPRINGS, chain_parameters
from gaitsweep.papers.ambe2021.multilegged.state import (
    CONTACT_DEPTH,
    LANDING,
    STANCE,
    MultileggedChart,
    Params,
    State,
    corner_of,
    first_touchdown,
    lagged_reset,
    leg_lengths,
    segment_of,
    without_touchdown,
)
from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.papers.ambe2021.theory.gaits import GAITS, classify, free_link, nearest_set

# Multiple of the machine epsilon, relative to the terms of x - l, that bounds the rounding error of a gap.
ROUNDING_FACTOR = 4.0
# Drawn distance of neighbours and half size of masses, in leg lengths; the model has neither.
_SPACING, _HALF_SIZE = 0.6, 0.075
# Corners of a mass's box in halves of its size, in the order in which the box is drawn.
_CORNERS = np.array([(x, y, z) for y in (-1.0, 1.0) for x in (-1.0, 1.0) for z in (-1.0, 1.0)])


class Transitions(NamedTuple):
    """Effects of events on each leg, (N+1,).

    `corner`: its segment ends; `segment`: the segment after that; `wraps`: its phase passes 2 pi; `resets`:
    it touches down in its landing segment, which resets its phase.
    """

    corner: jax.Array
    segment: jax.Array
    wraps: jax.Array
    resets: jax.Array


@dataclasses.dataclass(frozen=True)
class ChainModel(HybridModel):
    """Base of the full and the reduced chain of N + 1 legs: parameters, observables, gaits and labels."""

    N: int = dataclasses.field(
        default=SPRINGS, metadata={"meaning": "springs; the chain has N + 1 legs", "low": 3, "high": 64}
    )
    profile: bool = dataclasses.field(
        default=False,
        metadata={
            "meaning": "whether inner legs have a mass, spring and amplitude each: m_2, kappa_2, a_2, ...",
            "later": True,
        },
    )

    source: ClassVar[str] = "Ambe, Aoi, Tsuchiya, Matsuno 2021, Front. Neural Circuits 15:706064"
    bibtex: ClassVar[str] = Path(__file__).parents[1].joinpath("paper.bib").read_text(encoding="utf-8")
    gaits: ClassVar[tuple[str, ...]] = GAITS

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        phase = Quantity(
            "phi_1",
            "rad",
            "phase of leg 1 at the start; nan: leg 1 is just touching down, on section 1",
            default=float("nan"),
            circular=True,
            symbol=r"\phi_1",
        )
        return (*self._psi("at the start"), phase)

    @property
    def observables(self) -> tuple[Quantity, ...]:
        landed = Quantity("landed", "1", "1: leg 1 touched down; 0: its phase passed 2 pi without a landing")
        return (*self._psi("on section 1"), landed)

    def _observed(self, psi: jax.Array, landed: jax.Array) -> dict[str, jax.Array]:
        """The observables from the relative phases (N,) on the section."""
        return {f"psi_{i + 1}": psi[i] for i in range(self.N)} | {"landed": landed.astype(psi.dtype)}

    def _signalled(self, of_legs: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        """The signals from their values for all legs (N+1,)."""
        return {f"{name}_{i + 1}": values[i] for name, values in of_legs.items() for i in range(self.N + 1)}

    def _psi(self, where: str) -> tuple[Quantity, ...]:
        """The relative phases, eq. (7), at the start or on the section."""
        return tuple(
            Quantity(
                f"psi_{i}",
                "rad",
                f"phase of leg {i + 1} less that of leg {i}, {where}",
                circular=True,
                symbol=rf"\psi_{{{i}}}",
                source="eq. (7)",
            )
            for i in range(1, self.N + 1)
        )

    def _signals_of_legs(self) -> tuple[Quantity, ...]:
        """Phases, heights, lengths and contacts of the legs."""
        legs = range(1, self.N + 2)
        return (
            *(
                Quantity(f"phase_{i}", "rad", f"phase of leg {i}", circular=True, symbol=rf"\phi_{{{i}}}")
                for i in legs
            ),
            *(Quantity(f"x_{i}", "m", f"height of mass {i}") for i in legs),
            *(Quantity(f"l_{i}", "m", f"length of leg {i}") for i in legs),
            *(Quantity(f"contact_{i}", "1", f"1 while leg {i} is on the ground") for i in legs),
        )

    @property
    def label_fields(self) -> tuple[Quantity, ...]:
        return (
            Quantity("k", "1", "leg at the boundary of a source wave, 2..N; 0 for other gaits"),
            Quantity("distance", "rad", "distance to the nearest analytic solution on section 1"),
        )

    def params(self, values: Mapping[str, Float[Array, " ..."]]) -> Params:
        def along(name: str, first: str, last: str, n: int) -> jax.Array:
            """The values (n,) from head to tail: of both ends, and of all inner legs or springs."""
            names = [f"{name}_{i}" if self.profile else name for i in range(2, n)]
            inner = [values[inner_name] for inner_name in names]
            return jnp.stack([jnp.asarray(value) for value in (values[first], *inner, values[last])])

        arrays = {
            "masses": along("m", "m_1", "m_end", self.N + 1),
            "kappa": along("kappa", "kappa_1", "kappa_end", self.N),
            "a": along("a", "a_1", "a_end", self.N + 1),
        }
        scalars = [field.name for field in dataclasses.fields(Params) if field.name not in arrays]
        return Params(**arrays, **{name: jnp.asarray(values[name]) for name in scalars})

    @property
    def guard_names(self) -> tuple[str, ...]:
        legs = range(1, self.N + 2)
        ends = (f"phase of leg {i} reaches the end of its segment" for i in legs)
        return (*ends, *(f"leg {i} touches or lifts" for i in legs))

    def label(
        self, params: Params, observations: Mapping[str, Real[Array, ""]]
    ) -> dict[str, Real[Array, ""]]:
        p = params
        psi = jnp.stack([observations[f"psi_{i}"] for i in range(1, self.N + 1)])
        inner = slice(1, -1) if self.profile else 1
        m = p.masses[inner] if self.profile else p.m
        ends = {"m": p.masses, "kappa": p.kappa, "a": p.a}
        heads = {f"{name}_1": values[0] for name, values in ends.items()}
        tails = {f"{name}_end": values[-1] for name, values in ends.items()}
        chain = Chain(beta=p.beta, g=p.g, m=m, kappa=p.kappa[inner], a=p.a[inner], **heads, **tails)
        gait, k, distance = classify(self.N, psi, chain)
        return {"gait": gait, "k": k, "distance": distance}

    def period(self, params: Params) -> Float[Array, ""]:
        return TWO_PI / params.omega

    def skeleton(
        self, values: Mapping[str, float], signals: Mapping[str, Float[np.ndarray, " times"]]
    ) -> Skeleton:
        """The chain, its head to the right: a box for each mass, its leg, and springs between neighbours."""
        masses, limbs = [], []
        for i in range(self.N + 1):
            height = signals[f"x_{i + 1}"]
            along = np.full_like(height, -_SPACING * values["L"] * i)
            mass = np.stack([along, np.zeros_like(height), height], axis=1)
            foot = np.stack([along, np.zeros_like(height), height - signals[f"l_{i + 1}"]], axis=1)
            masses.append(mass)
            limbs.append(Limb(f"leg {i + 1}", np.stack([mass, foot], axis=1), pair=1))
        box = _HALF_SIZE * values["L"] * _CORNERS
        return Skeleton(
            limbs=tuple(limbs),
            bodies=tuple(mass[:, None, :] + box for mass in masses),
            springs=tuple(np.stack(ends, axis=1) for ends in itertools.pairwise(masses)),
            note="Leg 1 is the head's. Masses only move up and down; "
            "how far apart they are is not in the model.",
        )

    def free_link(self, trace: pd.DataFrame, legs: int) -> int | None:
        """The link whose lag is free by the theory, 1 .. N; None for traces that are too short."""
        if not {"phase_1", "x_1", "l_1", f"phase_{legs}"} <= set(trace.columns) or legs < 3:
            return None
        try:
            branch, _ = nearest_set(legs - 1, chain_of(trace), relative_phases(trace))
        except AnalysisError:
            return None
        return free_link(legs - 1, branch)

    def analytic_distance(self, table: pd.DataFrame) -> tuple[float, int] | None:
        """The largest distance (rad) of settled states from the theory's solutions, and its row."""
        return largest_distance(table)


@dataclasses.dataclass(frozen=True)
class Multilegged(ChainModel):
    """The chain of N + 1 legs, with equal inner legs or with a profile of them."""

    name: ClassVar[str] = "multilegged"
    linear: ClassVar[bool] = True  # except the kink of `clamp`, an error of 1e-5 rad if it is above zero
    simultaneous: ClassVar[Simultaneous] = "independent"  # a guard's jump changes its own leg alone

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return chain_parameters(self.N, profile=self.profile)

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return self._signals_of_legs()

    def init(self, params: Params, start: Mapping[str, Float[Array, ""]]) -> State:
        p = params
        touching = jnp.isnan(start["phi_1"])
        phi_1 = jnp.where(touching, first_touchdown(p), start["phi_1"])
        steps = jnp.stack([phi_1, *(start[f"psi_{i}"] for i in range(1, self.N + 1))])
        phi = wrapped(jnp.cumsum(steps))
        segment = segment_of(p, phi)
        length, _ = leg_lengths(p, phi, segment)
        x, load = obstacle_problem(length, p.masses, p.kappa, p.g)
        leg_1 = touching & (jnp.arange(self.N + 1) == 0)
        contact = (load > p.K * CONTACT_DEPTH) | leg_1
        x = jnp.where(contact, length - load / p.K - jnp.where(leg_1, CONTACT_DEPTH, 0.0), x)
        return State(
            x=x,
            v=jnp.zeros_like(x),
            phi=phi,
            y=jnp.where(leg_1, lagged_reset(phi, p.tau), 0.0),
            contact=contact,
            segment=segment,
            landed=touching,
        )

    def without_start(self, params: Params, state: State) -> dict[str, jax.Array]:
        return without_touchdown(state.phi)

    def flow(self, params: Params, state: State) -> Rates:
        p, s = params, state
        phi_rate = p.omega + s.y  # eq. (4)
        length, slope = leg_lengths(p, s.phi, s.segment)
        force = neighbour_force(s.x, s.v, p.kappa, p.sigma)  # eq. (1)
        force += ground_force(s.x - length, s.v - slope * phi_rate, s.contact, p.K, p.D, p.clamp)
        return {"x": s.v, "v": force / p.masses - p.g, "phi": phi_rate, "y": -s.y / p.tau}  # eq. (5)

    @property
    def recommended(self) -> Recommended:
        return Recommended("propagator6")

    def fast_modes(self, params: Params) -> tuple[Float[Array, " motions"], Float[Array, " motions"]]:
        """The modes of the masses on springs and ground, and the lag's, 1 / tau; phases have none."""
        p = params
        rates, damping = fastest_motions(p.masses, p.kappa, p.sigma, p.K, p.D)
        return jnp.append(rates, 1.0 / p.tau), jnp.append(damping, 1.0)

    def guards(self, params: Params, state: State) -> Float[Array, " guards"]:
        """Each leg's phase relative to the end of its segment, then each leg's contact, shape (2N + 2,)."""
        p, s = params, state
        end = corner_of(p, s.segment)
        length, _ = leg_lengths(p, s.phi, s.segment)
        gap = s.x - length
        # without this, two legs that lift off at one instant touch again by rounding, and so without end
        error = ROUNDING_FACTOR * jnp.finfo(gap.dtype).eps * (p.L + 2.0 * p.a / (1.0 - p.beta))
        return jnp.concatenate([s.phi - end, jnp.where(s.contact, gap, -gap) - error])  # eq. (2)

    def jump(self, params: Params, state: State, fired: Bool[Array, " events"]) -> State:
        p, s = params, state
        after = self._transitions(s, fired)
        return dataclasses.replace(
            s,
            phi=jnp.where(after.wraps, s.phi - TWO_PI, s.phi),
            y=jnp.where(after.resets, s.y + lagged_reset(s.phi, p.tau), s.y),  # eq. (5), (6)
            contact=s.contact ^ fired[self.N + 1 :],
            segment=jnp.where(after.corner, after.segment, s.segment),
            landed=(s.landed | after.resets[0]) & ~after.wraps[0],
        )

    def section(self, params: Params, before: State, fired: Bool[Array, " events"]) -> Bool[Array, ""]:
        """Leg 1's first landing contact of a cycle, or the wrap of its phase if there was none."""
        after = self._transitions(before, fired)
        return ~before.landed & (after.resets[0] | after.wraps[0])

    def _transitions(self, s: State, fired: jax.Array) -> Transitions:
        """The transitions of the legs whose guards have fired, (2N + 2,)."""
        corner, touched = fired[: self.N + 1], fired[self.N + 1 :]
        following = jnp.where(s.segment == LANDING, STANCE, s.segment + 1)
        segment = jnp.where(corner, following, s.segment)
        wraps = corner & (s.segment == LANDING)
        resets = touched & ~s.contact & (segment == LANDING)  # eq. (6), from the segment's beginning on
        return Transitions(corner, segment, wraps, resets)

    def observe(self, params: Params, state: State) -> dict[str, Real[Array, ""]]:
        return self._observed(wrapped(state.phi[1:] - state.phi[:-1]), state.landed)  # eq. (7)

    def signal(self, params: Params, state: State) -> dict[str, Real[Array, ""]]:
        length, _ = leg_lengths(params, state.phi, state.segment)
        contact = state.contact.astype(length.dtype)
        return self._signalled({"phase": state.phi, "x": state.x, "l": length, "contact": contact})

    def failed(self, params: Params, state: State) -> Bool[Array, ""]:
        """Whether a mass has reached the ground."""
        return jnp.any(state.x <= 0.0)

    def chart(self) -> Chart | None:
        return MultileggedChart(self.N)
