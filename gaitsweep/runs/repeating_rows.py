"""Rows that repeat at their limit of cycles, but do not settle, by errors of the integration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from gaitsweep.contract import Model
from gaitsweep.engine.poincare.maps import wrap_difference
from gaitsweep.engine.recorders.bounds import ROUNDING, SETTLE_WINDOW, bounds, unscaled
from gaitsweep.engine.recorders.orbit_period import NO_MOTION
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.kinds.settle import SettlesRows
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.runs.prepare import RunContext
from gaitsweep.runs.self_check_result import circular, finer_share

# Rows that are rerun, at most.
MOST_ROWS = 4
# Their last crossings that are recorded, at most; the observables' ranges are those of these crossings.
MOST_CROSSINGS = 1000
# The motion of a row is due to errors of the integration if finer tolerances make it so many times smaller;
# a row leaves an orbit if it moves so many times as much as half of its recorded crossings before.
SMALLER = 3.0

Crossings = Float[np.ndarray, "crossings observables"]


def most_reruns(context: RunContext) -> int:
    """The most rows that are rerun to describe those at their limit of cycles, of a job whose rows settle."""
    settles = isinstance(context.job.run, SettlesRows) and context.spec.numerics.adaptive
    return min(MOST_ROWS, context.spec.n_rows) if settles else 0


def repeating_rows(
    context: RunContext,
    settling: SettleRecorder,
    rows: Int[np.ndarray, " rows"],
    rerun: Callable[[CrossingRecorder, Int[np.ndarray, " rerun"], float], RowOutcome],
) -> dict[str, Any]:
    """Describe rows whose motion at the limit of cycles is due to errors of an integration with step control.

    Args:
        context: the job's context.
        settling: the recorder that settles the rows.
        rows: the rows (n,) that ended as `cycle_limit`; some of them are rerun.
        rerun: reruns rows with a recorder and a share of their step, to which finer tolerances belong.

    Returns:
        {} if there is no such row, else their number `rows` among `of` rerun ones, the longest `period` after
        which they repeat (crossings), and of the one that moves most over its period, the `observable` that
        moves most relative to its bound, and its motion as a share of its size with the run's tolerances
        (`motion`) and with finer ones (`finer_motion`).
    """
    model = settling.model
    chosen = rows[np.unique(np.linspace(0, rows.size - 1, min(MOST_ROWS, rows.size)).astype(np.int64))]
    count = min(settling.max_cycles, MOST_CROSSINGS)
    recorder = CrossingRecorder(model, count, settling.max_cycles - count)
    once = rerun(recorder, chosen, 1.0)
    orbits = [_orbit(context, settling, once, place) for place in range(chosen.size)]
    places = [place for place, orbit in enumerate(orbits) if orbit is not None]
    if not places:
        return {}
    finer = rerun(recorder, chosen[places], finer_share(context))
    of_rows: list[dict[str, Any]] = []
    for finer_place, (period, at) in enumerate(filter(None, orbits)):
        motion = float(_motion(model, _crossings(once, places[finer_place]), period)[at])
        finer_motion = float(_motion(model, _crossings(finer, finer_place), period)[at])
        if finer_motion * SMALLER <= motion:
            observable = model.observables[at].name
            numbers = {"motion": motion, "finer_motion": finer_motion}
            of_rows.append({"observable": observable, "period": period, **numbers})
    if not of_rows:
        return {}
    most = max(of_rows, key=lambda row: row["motion"])
    longest = max(row["period"] for row in of_rows)
    return {**most, "period": longest, "rows": len(of_rows), "of": int(chosen.size)}


def _crossings(outcome: RowOutcome, place: int) -> Crossings:
    """The observables at the recorded crossings of a row, without its start; those without a value are 0."""
    samples = outcome.samples[(outcome.place == place) & (outcome.samples[:, 0] > 0.0)]
    observed = samples[:, 2:]  # beside the number and the time of the crossing
    return np.where(np.isnan(observed), 0.0, observed)


def _orbit(
    context: RunContext, settling: SettleRecorder, outcome: RowOutcome, place: int
) -> tuple[int, int] | None:
    """The crossings after which a row repeats within the tolerances on its attempts, if that is too much.

    With them is the place of the observable that moves most in them, relative to its bound. There is no orbit
    if a row does not repeat, leaves it, or moves so little that it settles with more cycles.
    """
    model, numerics = settling.model, context.spec.numerics
    observed = _crossings(outcome, place)
    middle, latest = observed[: len(observed) // 2], observed[-1 - SETTLE_WINDOW :]
    if len(middle) <= SETTLE_WINDOW or not model.observables:
        return None
    attempts = outcome.attempts[place] / max(outcome.cycles[place], 1)
    error = attempts * (numerics.rtol * _sizes(model, latest) + numerics.atol)
    ranges = np.stack([observed.min(axis=0), observed.max(axis=0)])[:, unscaled(model)]
    bound = np.asarray(bounds(model, settling.tolerance, jnp.asarray(latest), jnp.asarray(ranges)))
    for period in range(1, min(settling.max_period, SETTLE_WINDOW) + 1):
        moves = _moves(model, latest, period)
        if np.all(moves <= period * error):
            before = np.max(_motion(model, middle, period))
            leaves = np.any(_motion(model, latest, period) > SMALLER * before)
            # a fixed point moves in a crossing, an orbit in all cycles of a row
            periods = settling.max_cycles / period if period > 1 else 1.0
            moved = np.maximum(moves - ROUNDING, 0.0) / bound
            if leaves or moved.max() * periods <= NO_MOTION:
                return None
            return period, int(np.argmax(moved))
    return None


def _sizes(model: Model, observed: Crossings) -> Float[np.ndarray, " observables"]:
    """The sizes of observables, to which their motion is relative: their scale, or magnitude if larger."""
    scales = np.array([1.0 if q.circular else q.scale or 0.0 for q in model.observables])
    return np.maximum(np.max(np.abs(observed), axis=0), scales)


def _moves(model: Model, observed: Crossings, period: int) -> Float[np.ndarray, " observables"]:
    """The largest change of each observable over a period, at the last crossings."""
    latest = observed[-1 - SETTLE_WINDOW :]
    difference = wrap_difference(latest[period:] - latest[:-period], circular(model))
    return np.max(np.abs(difference), axis=0)


def _motion(model: Model, observed: Crossings, period: int) -> Float[np.ndarray, " observables"]:
    """The largest change over a period as a share of each observable's size; inf with too few crossings."""
    if len(observed) <= SETTLE_WINDOW:
        return np.full(len(model.observables), np.inf)
    size = _sizes(model, observed[-1 - SETTLE_WINDOW :])
    return _moves(model, observed, period) / np.where(size > 0.0, size, 1.0)
