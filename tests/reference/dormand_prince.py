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
LONGEST = 1e-3  # s: guards are looked at no more seldom


class Fallen(Exception):
    """The trajectory failed by the model's own test."""


class LateEvent(Exception):
    """An event that was due did not come, or events come without end."""


class Taken(NamedTuple):
    """The end of a step: time (s), state, guards there, and the length (s) to try next."""

    t: float
    y: np.ndarray
    guards: np.ndarray
    h: float


def step(rates: Rates, t: float, y: np.ndarray, first: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """The state a time h (s) later, and the rates (7, n) at all stages but the last."""
    slopes = np.empty((6, y.size))
    slopes[0] = first
    for k in range(1, 6):
        slopes[k] = rates(t + NODES[k] * h, y + h * (np.array(STAGES[k]) @ slopes[:k]))
    return y + h * (np.array(FIFTH) @ slopes), slopes


def advanced(
    rates: Rates, guards: Guards, t: float, y: np.ndarray, h: float, before: np.ndarray, rtol: float
) -> Taken:
    """One accepted step, which ends at the first event inside it: there a guard is at or just above zero.

    Args:
        rates, guards: of time (s) and state.
        t, y, before: where the step begins, and the guards there, all below zero.
        h: the length to try, s.
        rtol: the largest error of a step, relative to 1 and to each number's size.
    """
    first = rates(t, y)
    while True:
        h = min(h, LONGEST)
        end, slopes = step(rates, t, y, first, h)
        last = rates(t + h, end)
        error = h * (np.array(ERROR[:6]) @ slopes + ERROR[6] * last)
        size = float(np.max(np.abs(error) / (1.0 + np.maximum(np.abs(y), np.abs(end)))) / rtol)
        if not np.isfinite(size):
            raise LateEvent(f"no number at t = {t} s")
        if size <= 1.0:
            break
        h *= max(0.2, 0.9 * size**-0.2)
    following = h * min(4.0, 0.9 * max(size, 1e-8) ** -0.2)
    after = guards(t + h, end)
    if not np.any(after >= 0.0):
        return Taken(t + h, end, after, following)
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
) -> Taken:
    """The step taken again, as long as it goes before the first guard rises, by secants and halves."""
    low, high, below, above = 0.0, h, before, after
    for k in range(200):
        if high - low <= TOLERANCE:
            return Taken(t + high, end, above, following)
        rising = above >= 0.0
        share = float(np.min(below[rising] / (below[rising] - above[rising])))
        guess = low + share * (high - low) + (0.4 * TOLERANCE if k % 2 else -0.4 * TOLERANCE)
        if k % 4 == 3 or not low < guess < high:
            guess = 0.5 * (low + high)
        trial, _ = step(rates, t, y, first, guess)
        seen = guards(t + guess, trial)
        if np.any(seen >= 0.0):
            high, end, above = guess, trial, seen
        else:
            low, below = guess, seen
    raise LateEvent(f"an event at t = {t + high} s is not located")
