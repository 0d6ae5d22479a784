"""A family of random hybrid models, and the solutions that gaitsweep's runs are compared with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import brentq

from gaitsweep.dynamics.declared_model import DeclaredModel

Values = dict[str, float]  # parameters and start values by name
State = np.ndarray  # the variables of a system (n,)

# Guards within this of zero, in units of the system's variables, count as on their surface.
ON_SURFACE = 1e-10
# Events within this share of a system's `look` happen at one instant.
ONE_INSTANT = 1e-10


@dataclass(frozen=True)
class Case:
    """One random model: its parameters and starts, and the run in which it is compared.

    `differentiable` says whether the return map has a derivative there.
    """

    values: Values
    run: Any  # a run kind
    differentiable: bool = True


@dataclass(frozen=True)
class Solution:
    """Correct values of a case.

    Args:
        statuses: the statuses that are right; empty where no result is right without a warning.
        columns: numbers of the result's table by column; (n,) are those of crossing 1 to n.
        period: the model's period (s), the unit of errors in time.
        scales: the units of errors in the other columns, 1 where not given.
        after: each variable just after the first crossing, from whose differences the Jacobian follows.
    """

    statuses: frozenset[str]
    columns: Mapping[str, float | np.ndarray] = field(default_factory=dict)
    period: float = 1.0
    scales: Mapping[str, float] = field(default_factory=dict)
    after: Mapping[str, float] = field(default_factory=dict)


COMPLETE = frozenset({"complete"})
TOLERANCE = 1e-6  # of a time in periods, of a state in its scale, of a Jacobian's largest element


@dataclass(frozen=True)
class Family:
    """Random models of one class.

    `draw` makes one case; `exact` solves a case independently of gaitsweep; `share` is the number of models
    of this family among 300. `jacobian` says whether the return map's derivative is compared, too, with
    central differences of the exact map in steps of `step`, in units of `scales` (by coordinate, else 1).
    """

    name: str
    about: str
    model: type[DeclaredModel]
    draw: Callable[[np.random.Generator], Case]
    exact: Callable[[Case], Solution]
    share: int
    jacobian: bool = False
    step: float = 1e-4


@dataclass(frozen=True)
class System:
    """A hybrid system whose flow is known between its events.

    Args:
        names: of the variables, modes included.
        flow: from a state to a function of times (m,) that gives the states (m, n) after these times.
        guards: of states (m, n), the functions (m, k) that rise through zero at the events.
        jumps: of each event in the order of declaration, from a state to the state after it.
        sections: the events that close a cycle.
        look: the time (s) within which events are looked for at once, by `samples` samples.
    """

    names: Sequence[str]
    flow: Callable[[State], Callable[[np.ndarray], np.ndarray]]
    guards: Callable[[np.ndarray], np.ndarray]
    jumps: Sequence[Callable[[State], State]]
    sections: frozenset[int]
    look: float
    samples: int = 200

    def crossings(self, start: State, most: int, limit: int = 100000) -> tuple[np.ndarray, np.ndarray]:
        """The times (n,) and the states (n, size) just after so many crossings of the section."""
        t, state = 0.0, np.asarray(start, float)
        times: list[float] = []
        states: list[State] = []
        # a start on a surface that moves through it fires at once
        state, closed, resting = self._instant(state, self._entering(state))
        for _ in range(limit):
            times += [t] * closed
            states += [state] * closed
            if len(times) >= most:
                break
            passed, state, fired = self._next(state, resting)
            t += passed
            state, closed, resting = self._instant(state, fired)
        return np.array(times[:most]), np.array(states[:most])

    def _entering(self, state: State) -> np.ndarray:
        """The guards on whose surface the state is, and through which it moves."""
        soon = self.flow(state)(np.array([1e-6 * self.look]))
        now = self.guards(state[None])[0]
        return (np.abs(now) <= ON_SURFACE) & (self.guards(soon)[0] > np.abs(now))

    def _next(self, state: State, resting: np.ndarray) -> tuple[float, State, np.ndarray]:
        """The time to the next event, the state before it and the guards that fire there."""
        way = self.flow(state)
        moments = np.linspace(0.0, self.look, self.samples + 1)
        heights = self.guards(way(moments))
        heights[0, resting] = 0.0
        below, above = heights[:-1] < 0.0, heights[1:] >= 0.0
        below[0] &= heights[0] < -ON_SURFACE
        rising = below & above
        if not rising.any():
            return self.look, way(moments[-1:])[0], np.zeros(heights.shape[1], bool)
        result = np.full(heights.shape[1], np.inf)
        for guard in np.flatnonzero(rising.any(axis=0)):
            first = int(np.argmax(rising[:, guard]))

            def height(t: float, guard: int = int(guard)) -> float:
                return float(self.guards(way(np.array([t])))[0, guard])

            ends, rtol = (moments[first], moments[first + 1]), np.float64(1e-15)
            result[guard] = (
                ends[1] if height(ends[1]) == 0.0 else brentq(height, *ends, xtol=1e-300, rtol=rtol)
            )
        t = result.min()
        return float(t), way(np.array([t]))[0], result <= t + ONE_INSTANT * self.look

    def _instant(self, state: State, fired: np.ndarray) -> tuple[State, int, np.ndarray]:
        """The state after the jumps of one instant, its crossings, and the guards that fired.

        Jumps are applied in the order of declaration; one whose guard an earlier jump has put below its
        surface is left out. A jump that lifts another guard over its surface fires it at the same instant.
        """
        closed = 0
        ever = np.zeros_like(fired)
        while fired.any():
            before = self.guards(state[None])[0]
            for guard in np.flatnonzero(fired).tolist():
                if self.guards(state[None])[0, guard] < -ON_SURFACE:
                    continue
                state = self.jumps[guard](state)
                ever[guard] = True
                closed += guard in self.sections
            fired = (before < -ON_SURFACE) & (self.guards(state[None])[0] > ON_SURFACE)
        return state, closed, ever


def solved(
    system: System, start: State, crossings: int, period: float, scales: Mapping[str, float]
) -> Solution:
    """The solution of a system over some crossings; columns are t and NAME_n of each variable."""
    times, states = system.crossings(start, crossings)
    columns = {f"{name}_n": states[:, i] for i, name in enumerate(system.names)}
    after = {name: float(states[0, i]) for i, name in enumerate(system.names)}
    widths = {f"{name}_n": scale for name, scale in scales.items()}
    return Solution(COMPLETE, {"t": times, **columns}, period, {**scales, **widths}, after)


def differences(
    family: Family, case: Case, coordinates: Sequence[str], scales: Mapping[str, float]
) -> np.ndarray:
    """The Jacobian (n, n) of the exact map in units of `scales`: differences, extrapolated to steps of 0."""

    def image(name: str, moved: float) -> np.ndarray:
        at = case.values[f"{name}_0"] + moved * scales.get(name, 1.0)
        after = family.exact(Case({**case.values, f"{name}_0": at}, case.run)).after
        return np.array([after[coordinate] / scales.get(coordinate, 1.0) for coordinate in coordinates])

    def slope(name: str, step: float) -> np.ndarray:
        return (image(name, step) - image(name, -step)) / (2.0 * step)

    def limit(name: str) -> np.ndarray:
        whole, half, quarter = (slope(name, family.step / parts) for parts in (1.0, 2.0, 4.0))
        # the second derivative jumps where events meet, so there is an error of first order, too
        return (4.0 * (2.0 * quarter - half) - (2.0 * half - whole)) / 3.0

    columns = [limit(name) for name in coordinates]
    return np.stack(columns, axis=1)


def any_of(random: np.random.Generator, *choices: Any) -> Any:
    """One of the choices."""
    return choices[int(random.integers(len(choices)))]
