"""Traces, crossings and tables of walks whose shifts, loads and tilts are known, for analyses and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, LEGS, PAIRS, signs

SWING = 0.35  # of a cycle
QUANTITIES = {"x": {"unit": "m"}, "sigma": {"unit": "1", "symbol": r"\sigma", "circular": False}}


def ideal_phases(gait: str, shift: float = 0.25) -> dict[str, float]:
    """The phases in [0, 1) of the legs' swing onsets relative to LF, cycles.

    The legs of a pair are shifted by equal amounts in opposite directions, so that the mean phases of the
    pairs stay in antiphase (Fig. 5a).

    Args:
        gait: one of `CHART`.
        shift: size of a nonzero shift, cycles; 0.25 spaces the legs of a walk evenly.
    """
    phases = {}
    for middle, sign, (fore, hind) in zip((0.0, 0.5), signs(gait), PAIRS, strict=True):
        phases[fore], phases[hind] = middle - 0.5 * sign * shift, middle + 0.5 * sign * shift
    return {leg: (phases[leg] - phases["LF"]) % 1.0 for leg in LEGS}


def onset_table(onsets: np.ndarray) -> pd.DataFrame:
    """Records (row, leg, t) of the onsets (rows, 4, k), s, of the legs in their order; NaN is left out."""
    row, leg, k = np.nonzero(np.isfinite(onsets))
    return pd.DataFrame({"row": row, "leg": np.array(LEGS)[leg], "t": onsets[row, leg, k]})


def trace_of(
    gait: str,
    shift: float = 0.2,
    *,
    row: int = 0,
    period: float = 0.5,
    duration: float = 6.0,
    speed: float = 1.0,
    loads: Mapping[str, float] | None = None,
    pitch: float = 0.0,
    phases: np.ndarray | None = None,
    every: float = 2e-3,
) -> pd.DataFrame:
    """A trace of one row: each leg swings for `SWING` of its cycle, and bears its load (N) otherwise.

    Args:
        gait, shift: as of `ideal_phases`.
        phases: cycles that LF has gone through at each sample; by default at a constant period (s).
        loads: on each leg in stance, 10 N if not given.
    """
    t = np.arange(0.0, duration, every)
    phases = t / period if phases is None else phases
    columns: dict[str, Any] = {"row": row, "t": t}
    for number, leg in enumerate(LEGS):
        place = (phases - ideal_phases(gait, shift)[leg] - 0.123) % 1.0
        swings = place < SWING
        # a straight line through 0 where the swing begins, so that onsets between samples are exact
        up = np.minimum(np.where(place < 0.5, place, place - 1.0) * 20.0, 1.0)
        columns[f"u_f_{leg}"] = np.where(swings | (place > 0.95), up, -1.0)
        columns[f"contact_{number + 1}"] = (~swings).astype(float)
        columns[f"F_{leg}"] = np.where(swings, 0.0, (loads or {}).get(leg, 10.0))
    columns |= {"pitch": pitch, "x": speed * t, "status": "complete"}
    return pd.DataFrame(columns)


def traces(gaits: Sequence[str] = CHART, **options: Any) -> pd.DataFrame:
    """A row for each gait, sigma rising with the row."""
    parts = [trace_of(gait, row=row, **options) for row, gait in enumerate(gaits)]
    for row, part in enumerate(parts):
        part.insert(1, "sigma", 0.1 * row)
    table = pd.concat(parts, ignore_index=True)
    table.attrs["quantities"] = QUANTITIES
    return table


def crossings_of(
    gait: str, shift: float = 0.2, *, row: int = 0, period: float = 0.5, n: int = 20
) -> pd.DataFrame:
    """The records of a return map: LF's onsets, and the time since each other leg's last one."""
    t = period * (1.0 + np.arange(n)) + 1e-4
    since = {leg: np.full(n, (-ideal_phases(gait, shift)[leg] % 1.0) * period + 1e-4) for leg in LEGS}
    columns = {f"since_{leg}_n": value for leg, value in since.items()}
    return pd.DataFrame({"row": row, "crossing": np.arange(1, n + 1), "t": t, "status": "complete"} | columns)


def ends(
    delta: np.ndarray,
    load: np.ndarray,
    tilt: np.ndarray,
    *,
    k2: float = 0.08,
    axes: Mapping[str, Any] | None = None,
) -> pd.DataFrame:
    """Ends of rows: both pairs shifted by delta (n,), fore less hind load (N) and pitch (rad) in stance."""
    n = len(delta)
    signs = np.where(np.abs(delta) > 0.07, np.sign(delta), 0).astype(int)
    gaits = [CHART[4 * (1 + sign)] for sign in signs]
    columns: dict[str, Any] = {
        "row": np.arange(n),
        "k2": k2,
        **(axes or {}),
        "status": "complete",
        "cycles": 40,
    }
    columns |= {f"delta_{i}_mean_end": delta for i in (1, 2)}
    columns |= {"antiphase_end": 0.5, "length_end": 1.0, "variation_end": 0.0, "period_end": 0.4}
    columns |= {"speed_end": 1.0 + delta}
    for fore, hind in PAIRS:
        for when in ("late", "stance"):
            columns |= {f"{when}_load_{fore}_end": 20.0 + load, f"{when}_load_{hind}_end": np.full(n, 20.0)}
            columns |= {f"{when}_pitch_{leg}_end": tilt for leg in (fore, hind)}
    return pd.DataFrame(columns).assign(gait=pd.Categorical(gaits, [*CHART, "unsteady"]))
