"""Angles of period 2 pi: which columns hold them, their differences, means, and where to cut their circle."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd

TURN = 2.0 * np.pi


def is_circular(table: pd.DataFrame, name: str) -> bool:
    """Whether a column holds an angle: as `table.attrs["quantities"]` says, else as psi, phi and delta do.

    A column is looked up by its own name first, then without the _n or _end of section observables.
    """
    known = table.attrs.get("quantities", {})
    entry = known.get(name) or known.get(re.sub(r"_(n|end)$", "", name)) or {}
    circular = entry.get("circular")
    return bool(circular) if circular is not None else re.match(r"(psi|phi|delta)(_|$)", name) is not None


def wrapped(difference: np.ndarray) -> np.ndarray:
    """Differences of angles by the shorter way, rad, in (-pi, pi]."""
    return np.pi - np.mod(np.pi - np.asarray(difference, float), TURN)


def unwrapped(angles: np.ndarray) -> np.ndarray:
    """Successive angles (rad) without jumps at 2 pi, each within pi of the one before; none may be NaN."""
    angles = np.asarray(angles, float)
    return np.concatenate([angles[:1], angles[:1] + np.cumsum(wrapped(np.diff(angles)))])


def mean_direction(angles: np.ndarray) -> float:
    """The mean of angles, rad, in [0, 2 pi): the direction of the sum of their unit vectors; NaN of none."""
    if not len(angles):
        return float("nan")
    return float(np.mod(np.angle(np.exp(1j * np.asarray(angles, float)).sum()), TURN))


def cut(angles: np.ndarray) -> float:
    """Where to cut the circle so that angles (rad) that lie together stay together, in (-2 pi, 0].

    It is 0 where the widest gap between them reaches over 0, so that angles keep their usual range; else the
    middle of that gap, less a turn.
    """
    places = np.unique(np.mod(np.asarray(angles, float)[np.isfinite(angles)], TURN))
    if not len(places):
        return 0.0
    gaps = np.diff(np.append(places, places[0] + TURN))
    widest = int(np.argmax(gaps))
    if widest == len(places) - 1:
        return 0.0
    return float(places[widest] + 0.5 * gaps[widest] - TURN)


def on_line(angles: np.ndarray, origin: float) -> np.ndarray:
    """Angles (rad) on the turn that begins at `origin`."""
    return origin + np.mod(np.asarray(angles, float) - origin, TURN)
