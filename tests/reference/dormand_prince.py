"""Dormand and Prince's pair 5(4) with step control, and the location of the first event inside a step."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Rates = Callable[[float, np.ndarray], np.ndarray]
Guards = Callable[[float, np.ndarray], np.ndarray]

NODES = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0)
STAGES = (
    (),
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
)
FIFTH = (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)
ERROR = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
TOLERANCE = 1e-12  # s, of an event's time
LONGEST = 1e-3  # s, of a step: guards are evaluated at least this often


class Fallen(Exception):
    """The trajectory failed by the model's own test."""


class LateEvent(Exception):
    """An event that was due did not occur, or events follow each other without end."""


class Accepted(NamedTuple):
    """The end of an accepted step: time (s), state, guards there, and the length (s) to try next."""

    t: float
    y: np.ndarray
    guards: np.ndarray
    h: float


def step(rates: Rates, t: float, y: np.ndarray, first: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """The state a time h (s) later, and the rates (6, n) at all stages but the last, which is at the end."""
    slopes = np.empty((6, y.size))
    slopes[0] = first
    for k in range(1, 6):
        slopes[k] = rates(t + NODES[k] * h, y + h * (np.array(STAGES[k]) @ slopes[:k]))
    return y + h * (np.array(FIFTH) @ slopes), slopes


def advanced(
    rates: Rates, guards: Guards, t: float, y: np.ndarray, h: float, before: np.ndarray, rtol: float
) -> Accepted:
    """Take one step, which ends at the first event inside it, where a guard is at or just above zero.

    Args:
        rates, guards: of time (s) and state.
        t, y, before: time (s) and state at the step's beginning, and the guards there, all below zero.
        h: the length to try, s.
        rtol: the largest error of each number, relative to 1 plus its size.

    Raises:
        LateEvent: the error is not a number, or the event is not located.
    """
    first = rates(t, y)
    while True:
        h = min(h, LONGEST)
        end, slopes = step(rates, t, y, first, h)
        last = rates(t + h, end)
        error = h * (np.array(ERROR[:6]) @ slopes + ERROR[6] * last)
        error_ratio = float(np.max(np.abs(error) / (1.0 + np.maximum(np.abs(y), np.abs(end)))) / rtol)
        if not np.isfinite(error_ratio):
            raise LateEvent(f"the error at t = {t} s is not a number")
        if error_ratio <= 1.0:
            break
        h *= max(0.2, 0.9 * error_ratio**-0.2)
    following = h * min(4.0, 0.9 * max(error_ratio, 1e-8) ** -0.2)
    after = guards(t + h, end)
    if not np.any(after >= 0.0):
        return Accepted(t + h, end, after, following)
    return _at_event(rates, guards, t, y, first, h, before, end, after, following)


def _at_event(
    rates: Rates,
    guards: Guards,
    t: float,
    y: np.ndarray,
    first: np.ndarray,
    h: float,
    before: np.ndarray,
    end: np.ndarray,
    after: np.ndarray,
    following: float,
) -> Accepted:
    """Shorten a step to the first event inside it, by secants and bisections of the bracket of its length.

    Args:
        rates, guards, t, y, before: as in `advanced`.
        first: the rates at the step's beginning.
        h, end, after: length, end and guards of the step, in which a guard has risen to zero or above.
        following: the length to try next.
    """
    low, high, below, above = 0.0, h, before, after
    for k in range(200):
        if high - low <= TOLERANCE:
            return Accepted(t + high, end, above, following)
        rising = above >= 0.0
        share = float(np.min(below[rising] / (below[rising] - above[rising])))
        # alternately before and after the secant's root, so that both ends of the bracket move
        guess = low + share * (high - low) + (0.4 * TOLERANCE if k % 2 else -0.4 * TOLERANCE)
        if k % 4 == 3 or not low < guess < high:
            guess = 0.5 * (low + high)
        trial, _ = step(rates, t, y, first, guess)
        reached = guards(t + guess, trial)
        if np.any(reached >= 0.0):
            high, end, above = guess, trial, reached
        else:
            low, below = guess, reached
    raise LateEvent(f"an event at t = {t + high} s is not located")
