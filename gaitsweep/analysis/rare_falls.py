"""Mean steps to a rare fall, by importance sampling: noise is enlarged, and falls are weighted.

A row that has forgotten its start falls in each step with the same chance p, and the mean number of steps is
1 / p. From states that plain simulation reaches, some steps are made with normal numbers that are larger by a
factor; a fall counts with the quotient of the densities of all numbers drawn on the way, so the estimate of p
has no bias. Where plain simulation meets enough falls, it counts these. Source: Bucklew 2004, Introduction to
Rare Event Simulation, ch. 4; Byl and Tedrake 2009, Int. J. Robotics Research 28:1040, of the chance of a fall
in a step; Del Moral and Doucet 2004, Ann. Inst. Henri Poincare B 40:491, of rows that go on from others.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import scipy
from jaxtyping import Array, Bool, Float, Int

from gaitsweep import near_miss
from gaitsweep.analysis.basins.fractions import check_level
from gaitsweep.analysis.records import AnalysisError
from gaitsweep.contract import Params, State
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.poincare.model_map import ModelMap
from gaitsweep.engine.poincare.poincare_return import ReturnStatus

# The numbers (k,) that the last jump drew, as standard normal ones, from parameters and the state after it.
Draws = Callable[[Params, State], Float[Array, " numbers"]]

ROWS = 2048  # rows that are simulated together
SCALES = (1.0, 1.5, 2.0, 2.5, 3.0)
FORGOTTEN = 20  # steps after which rows have forgotten their common start
_PILOT = 4  # rounds for each factor, before the best one is chosen
_SLOW = 8  # times four nominal periods that a step may last
_FEW = 20  # falls below which an estimate's own error is not known
_ROUNDING = 1e-9  # a number that differs less from that of the step before was not drawn again
_COMMON = 400  # falls in the plain steps of the pilots from which no noise is enlarged: an error of 5 %


class TooFewFallsError(AnalysisError):
    """Error of an estimate that met too few falls, or rows that all fell at once."""


@dataclasses.dataclass(frozen=True)
class RareFalls:
    """The chance of a fall in a step, and the most likely way to it.

    Args:
        chance, low, high: the chance of a fall in a step, and its confidence interval; steps that end neither
            at a crossing nor by a fall count as falls in `high`.
        falls: the number of falls behind it.
        scale: the factor by which the noise was enlarged; 1 where plain steps met enough falls.
        simulated: steps that were simulated.
        way_out: one record for each of the last steps up to a fall: step (0 is that of the fall, left out
            where no fall came after a number of its own step), and the weighted means over all falls of the
            numbers drawn there, `draw_1`, ..., in standard deviations of the noise itself; NaN where no fall
            came at the end of its window.
    """

    chance: float
    low: float
    high: float
    falls: int
    scale: float
    simulated: int
    way_out: pd.DataFrame

    @property
    def steps(self) -> float:
        """The mean number of steps to a fall."""
        return 1.0 / self.chance if self.chance > 0.0 else np.inf

    @property
    def steps_interval(self) -> tuple[float, float]:
        """The confidence interval of `steps`."""
        return 1.0 / self.high if self.high > 0.0 else np.inf, 1.0 / self.low if self.low > 0.0 else np.inf


@dataclasses.dataclass(frozen=True)
class _Windows:
    """Windows of enlarged noise: `chances` (rounds,) of a fall in a step, and the weighted falls.

    `weights` (falls,) are those of falls at the last step of a window, `draws` (falls, steps, k) the numbers
    drawn before them, NaN where none was drawn; `falls` counts those that `chances` are made of. `undecided`
    is the chance that a step ends neither at a crossing nor by a fall.
    """

    chances: Float[np.ndarray, " rounds"]
    weights: Float[np.ndarray, " falls"]
    draws: Float[np.ndarray, "falls steps numbers"]
    falls: int
    undecided: float

    @classmethod
    def joined(cls, windows: Sequence[_Windows]) -> _Windows:
        """Windows of several rounds as one."""
        return cls(
            chances=np.concatenate([window.chances for window in windows]),
            weights=np.concatenate([window.weights for window in windows]),
            draws=np.concatenate([window.draws for window in windows]),
            falls=sum(window.falls for window in windows),
            undecided=sum(window.undecided for window in windows) / len(windows),
        )

    @property
    def error(self) -> float:
        """The relative standard error of the mean chance; infinite where falls are too few to know it."""
        mean = self.chances.mean()
        if self.falls < _FEW or not mean > 0.0:
            return np.inf
        return float(self.chances.std(ddof=1) / np.sqrt(self.chances.size) / mean)


def rare_falls(
    mapping: ModelMap,
    values: Mapping[str, float],
    starts: Mapping[str, Any],
    noise: str,
    draws: Draws,
    *,
    seed: str,
    steps: int,
    rounds: int,
    scales: Sequence[float],
    level: float,
) -> RareFalls:
    """Estimate the chance of a fall in a step.

    Args:
        mapping: the return map.
        values: parameters by name, beside those of the map's settings.
        starts: initial conditions by name.
        noise: the parameter that is proportional to the noise.
        draws: function of parameters and the state after a step that returns the numbers drawn in it.
        seed: the parameter that is the seed of the noise.
        steps: steps of a window of enlarged noise; falls in its second half count.
        rounds: rounds of windows with the best factor.
        scales: factors by which the noise is enlarged, of which the best is chosen. Those are left out with
            which the noise is beyond its allowed range.
        level: confidence level of the interval.

    Raises:
        TooFewFallsError: too few falls were met with every factor, or all rows fell at once.
        AnalysisError: an argument is not allowed, or a step ended neither at a crossing, nor by a fall, nor
            at the limit of time.
    """
    parameters = {quantity.name: quantity for quantity in mapping.model.parameters}
    for name in (noise, seed):
        if name not in parameters:
            near = near_miss.suggestion(name, parameters)
            raise AnalysisError(f"{name} is not a parameter of {mapping.model.name}{near}")
    if steps < 2 or rounds < 2:
        raise AnalysisError(f"steps and rounds are {steps} and {rounds}, but must be 2 or more.")
    if not scales or min(scales) < 1.0:
        raise AnalysisError("scales must be numbers of 1 or more.")
    check_level(level)
    itself, most = float(mapping.complete(values, 1)[noise][0]), parameters[noise].high
    scales = [scale for scale in scales if scale * itself <= most]
    if not scales:
        raise AnalysisError(
            f"{noise} is at most {most:g}, which each of the scales exceeds: give smaller ones."
        )
    walk = _Walk(mapping, values, starts, noise, draws, seed, steps)
    half = 0.5 + 0.5 * level
    pilots: dict[float, _Windows] = {}
    for scale in scales:
        pilots[scale] = walk.windows(scale, _PILOT)
        if walk.plain.fell >= _COMMON:
            return _of_plain_steps(walk, rounds, half)
    best = min(pilots, key=lambda scale: pilots[scale].error)
    if not np.isfinite(pilots[best].error):
        raise TooFewFallsError(
            f"fewer than {_FEW} falls were met with each of the factors {', '.join(map(str, scales))}: "
            "give larger ones as scales, or more steps."
        )
    windows = walk.windows(best, rounds)
    chance = float(windows.chances.mean())
    width = scipy.stats.t.ppf(half, rounds - 1) * windows.error
    # steps without an end may be falls
    chances = (chance, chance * np.exp(-width), chance * np.exp(width) + windows.undecided)
    hazard, low, high = (_hazard(float(of_fall), steps) for of_fall in chances)
    return RareFalls(hazard, low, high, windows.falls, best, walk.simulated, _way_out(windows, steps))


def _of_plain_steps(walk: _Walk, rounds: int, half: float) -> RareFalls:
    """The estimate from falls in the steps between windows, which are made with the noise itself.

    Args:
        walk: the rows.
        rounds: rounds of windows.
        half: the share of the distribution of the mean below the upper end of its interval.
    """
    windows, totals = [], [walk.plain]
    for _ in range(rounds):
        windows.append(walk.windows(1.0, 1))
        totals.append(walk.plain)
    tried, fell, undecided = np.diff(totals, axis=0).T
    chances = fell / tried
    chance = float(chances.mean())
    error = float(chances.std(ddof=1)) / np.sqrt(rounds)
    width = scipy.stats.t.ppf(half, rounds - 1) * error / chance
    return RareFalls(
        chance=chance,
        low=chance * np.exp(-width),
        high=min(1.0, chance * np.exp(width) + undecided.sum() / tried.sum()),
        falls=int(fell.sum()),
        scale=1.0,
        simulated=walk.simulated,
        way_out=_way_out(_Windows.joined(windows), walk.steps),
    )


def _way_out(windows: _Windows, steps: int) -> pd.DataFrame:
    """The weighted means of the numbers drawn before falls, as `RareFalls.way_out`."""
    _, length, draws = windows.draws.shape
    weights = np.where(np.isnan(windows.draws), 0.0, windows.weights[:, None, None])
    total = weights.sum(axis=0)
    sums = np.sum(weights * np.nan_to_num(windows.draws), axis=0)
    means = np.divide(sums, total, out=np.full((length, draws), np.nan), where=total > 0.0)
    columns = {f"draw_{k + 1}": means[:, k] for k in range(draws)}
    way_out = pd.DataFrame({"step": np.arange(1 - steps, 1), **columns})
    # a number that is drawn at the end of a step comes after a fall within it
    return way_out if total[-1].any() else way_out.iloc[:-1]


def _counted_steps(steps: int) -> range:
    """The steps of a window whose falls count: before them the noise was enlarged for a while."""
    return range(steps // 2, steps)


def _hazard(chance: float, steps: int) -> float:
    """The chance p of a fall in a step, from the mean chance p (1 - p)^k to fall after k steps.

    It is 1 where no p gives so large a mean chance.
    """
    hazard = chance
    for _ in range(100):  # a contraction where falls within a window are few
        if hazard >= 1.0:
            return 1.0
        hazard = chance / float(np.mean((1.0 - hazard) ** np.array(_counted_steps(steps))))
    return hazard


class _PlainSteps(NamedTuple):
    """Steps with the noise itself: how many were tried, ended by a fall, and had no end in time."""

    tried: int = 0
    fell: int = 0
    undecided: int = 0


class _Walk:
    """Rows that walk with the noise itself, and windows of enlarged noise that begin at their states.

    Attributes:
        steps: steps of a window.
        simulated: steps that were simulated.
        plain: the steps with the noise itself, without those in which rows forgot their start.
    """

    def __init__(
        self,
        mapping: ModelMap,
        values: Mapping[str, float],
        starts: Mapping[str, Any],
        noise: str,
        draws: Draws,
        seed: str,
        steps: int,
    ) -> None:
        self._noise, self._seed, self.steps = noise, seed, steps
        self._values = mapping.complete(values, ROWS)
        self._step = _stepper(mapping, draws)
        self._next_seed = 1
        self.simulated = 0
        self.plain = _PlainSteps()
        self._states = mapping.settled(starts, {**self._values, seed: self._seeds()}, 0)[0].modes
        for _ in range(FORGOTTEN):
            self._walk_on()
        self.plain = _PlainSteps()

    def _seeds(self) -> Float[np.ndarray, " rows"]:
        """Seeds that no other step has."""
        first = self._next_seed
        self._next_seed += ROWS
        return np.arange(first, first + ROWS, dtype=np.float64)

    def _moved(
        self, states: State, scale: float, walks: Bool[np.ndarray, " rows"] | bool = True
    ) -> tuple[State, Int[np.ndarray, " rows"], Float[np.ndarray, "rows numbers"]]:
        """The states after a step, each row's `ReturnStatus`, and the numbers that were drawn; else NaN.

        Rows that do not walk any more have no meaning.
        """
        noise = scale * self._values[self._noise]
        values = {**self._values, self._seed: self._seeds(), self._noise: noise}
        self.simulated += ROWS
        moved, status, drawn = jax.tree.map(np.asarray, self._step(values, states, states))
        for _ in range(_SLOW):
            if not (late := walks & (status == ReturnStatus.late)).any():
                break
            # a row that is slow near its barrier goes on within the same step
            later = jax.tree.map(np.asarray, self._step(values, moved, states))
            moved, status, drawn = jax.tree.map(
                lambda old, new, late=late: np.where(late.reshape(-1, *(1,) * (old.ndim - 1)), new, old),
                (moved, status, drawn),
                later,
            )
        return moved, status, drawn

    def _walk_on(self) -> None:
        """Make a step with the noise itself; rows that fall go on from the states of others."""
        moved, status, _ = self._moved(self._states, 1.0)
        _refuse_stuck(status)
        ended = status != ReturnStatus.crossed
        if ended.all():
            raise TooFewFallsError(
                "all rows fell within a few steps: count them in a run of kind fixed_time."
            )
        fell, late = (int((status == code).sum()) for code in (ReturnStatus.fell, ReturnStatus.late))
        before = self.plain
        self.plain = _PlainSteps(before.tried + ROWS, before.fell + fell, before.undecided + late)
        alive = np.flatnonzero(~ended)
        sources = np.where(ended, alive[np.arange(ROWS) % alive.size], np.arange(ROWS))
        self._states = jax.tree.map(lambda leaf: np.asarray(leaf)[sources], moved)

    def windows(self, scale: float, rounds: int) -> _Windows:
        """Windows of so many rounds, each from the states of rows that have walked on."""
        windows = []
        for _ in range(rounds):
            for _ in range(self.steps):
                self._walk_on()
            windows.append(self._window(scale))
        return _Windows.joined(windows)

    def _window(self, scale: float) -> _Windows:
        """One window of each row, from its present state."""
        counted = _counted_steps(self.steps)
        states, walks, falling = self._states, np.ones(ROWS, bool), np.zeros(ROWS, bool)
        log_weights = np.zeros(ROWS)  # of the density of the noise itself over that of the larger noise
        draws = []
        falls, chance, undecided = 0, 0.0, 0.0
        for step in range(self.steps):
            states, status, numbers = self._moved(states, scale, walks)
            falling, lost = (walks & (status == code) for code in (ReturnStatus.fell, ReturnStatus.late))
            _refuse_stuck(status[walks])
            # a fall may come after numbers of its own step
            log_weights += np.where(lost | ~walks, 0.0, _log_quotient(numbers, scale))
            if step in counted:
                chance += float(np.exp(log_weights[falling]).sum())
                falls += int(falling.sum())
            undecided += float(np.exp(log_weights[lost]).sum())
            draws.append(scale * numbers)
            walks &= status == ReturnStatus.crossed
        return _Windows(
            chances=np.array([chance / (ROWS * len(counted))]),
            weights=np.exp(log_weights[falling]),
            draws=np.stack(draws, axis=1)[falling],
            falls=falls,
            undecided=undecided / (ROWS * self.steps),
        )


def _refuse_stuck(status: Int[np.ndarray, " rows"]) -> None:
    """Refuse steps that ended neither at a crossing, nor by a fall, nor at the limit of time."""
    stuck = status[~np.isin(status, [ReturnStatus.crossed, ReturnStatus.fell, ReturnStatus.late])]
    if stuck.size:
        reason = ReturnStatus(int(stuck[0])).sentence
        raise AnalysisError(f"{stuck.size} rows ended neither by a step nor by a fall: {reason}")


def _log_quotient(numbers: Float[np.ndarray, "rows numbers"], scale: float) -> Float[np.ndarray, " rows"]:
    """The logarithm of the density of scale * numbers over that of the numbers, both standard normal.

    Numbers that are NaN were not drawn, and have no share.
    """
    drawn = np.sum(~np.isnan(numbers), axis=1)
    return drawn * np.log(scale) - 0.5 * (scale**2 - 1.0) * np.nansum(numbers**2, axis=1)


@cached_by_content(maxsize=16)
def _stepper(mapping: ModelMap, draws: Draws) -> Callable[..., Any]:
    """The function `(values, states, begun) -> (states, status, draws)` of many rows, after one step.

    `begun` are the states at the begin of the step; numbers as before it were not drawn in it, and are NaN.
    """

    def one(values: Any, state: State, begun: State) -> tuple[State, Any, Float[Array, " numbers"]]:
        params = mapping.params(values)
        _, moved, status = mapping.state(params, state)
        fell = (status == ReturnStatus.crossed) & mapping.model.failed(params, moved)
        status = jnp.where(fell, ReturnStatus.fell, status)
        numbers, before = (jnp.atleast_1d(draws(params, each)) for each in (moved, begun))
        return moved, status, jnp.where(jnp.abs(numbers - before) > _ROUNDING, numbers, jnp.nan)

    return jax.jit(jax.vmap(one))
