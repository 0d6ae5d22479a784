"""The waves of swing legs in traces of the multi-legged chain: lags of neighbours, wavelength and speed.

The phase of a leg advances at omega except for some time constants after its touchdown. So linear
interpolation between samples gives the exact time at which it passes pi, in the middle of stance. The lag of
two legs is the difference of two such times.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from gaitsweep.analyses import AnalysisError, require, wrapped_difference
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import (
    chain_of,
    constants_of,
    of_legs,
    psi_columns,
    relative_phases,
    set_columns,
    springs_of,
)
from gaitsweep.papers.ambe2021.theory.chain import Chain, wave_speed, wavelength
from gaitsweep.papers.ambe2021.theory.gaits import GAITS, free_link, gait_of, nearest_set
from gaitsweep.papers.ambe2021.theory.solution_sets import drift, drift_on_ground
from gaitsweep.status import Status

MID_STANCE = np.pi  # rad, the phase whose passage is timed: far from the phase reset


class Passages(NamedTuple):
    """Times between the legs' passages of mid-stance in one row: `period` (s) and `leads`, s.

    `leads[i]` is the time from the passage of leg i + 2 to the next one of leg i + 1, in [0, period): short
    in a direct wave, nearly a period in a retrograde one.
    """

    period: float
    leads: Float[np.ndarray, " springs"]


def waves(table: pd.DataFrame) -> pd.DataFrame:
    """The wave of each row of a trace, with the wavelength and speed that the theory gives.

    Args:
        table: a trace table of the multi-legged chain, full or reduced, settled (`after_cycles`).

    Returns:
        A record for each row: its parameters that vary; `gait`, the boundary leg `k` and the `distance` (rad)
        of the nearest analytic solution on section 1, however far; `free_link`, the link i between legs i and
        i + 1 whose lag is free; `period` (s); `lag` (s), the mean over the links of the wave, and `spread`,
        the largest minus the smallest of these; `wavelength` (legs) and `speed` (legs/s); the theory's
        `wavelength_27`, `speed_28` (as printed) and `speed_exact`, NaN for a chain with a profile.

    Raises:
        AnalysisError: the table has no phases, or a row has fewer than two cycles.

    Source: eqs. (27), (28).
    """
    N = springs_of(table)
    if not {"t", "phase_3"} <= set(table.columns):
        raise AnalysisError("Waves need a trace of the multi-legged chain with the columns t, phase_1, ...")
    varied = set_columns(table)
    records = []
    for row, part in table.groupby("row", sort=True):
        part = part.sort_values("t")
        omega = constants_of(table, ["omega"], part)["omega"]
        parameters = {name: part[name].iloc[0] for name in varied}
        records.append({"row": int(str(row)), **parameters, **_wave(part, N, chain_of(table, part), omega)})
    return pd.DataFrame(records)


def _wave(part: pd.DataFrame, N: int, chain: Chain, omega: float) -> dict[str, object]:
    """The measured wave of one row, and the theory's wavelength and speeds, as `waves` returns them."""
    swings = passages(part)
    branch, distance = nearest_set(N, chain, relative_phases(part))
    # link k of set A moves with the free one
    not_of_wave = [free_link(N, branch), *([branch.k] if branch.kind == "A" else [])]
    lags = np.delete(np.minimum(swings.leads, swings.period - swings.leads), np.array(not_of_wave) - 1)
    # eqs. (27), (28) are of equal inner legs; with a profile each pair has a lag of its own
    theory = (np.nan,) * 3 if chain.has_profile else (wavelength(chain), *wave_speed(omega, chain))
    return {
        "gait": GAITS[gait_of(branch)],
        "k": 0 if branch.kind == "direct" else branch.k,
        "distance": distance,
        "free_link": free_link(N, branch),
        "period": swings.period,
        "lag": lags.mean(),
        "spread": np.ptp(lags),
        "wavelength": swings.period / lags.mean(),
        "speed": 1.0 / lags.mean(),
        **dict(zip(("wavelength_27", "speed_28", "speed_exact"), map(float, theory), strict=True)),
    }


def passages(part: pd.DataFrame) -> Passages:
    """The period, and by how much each leg leads the one in front of it, in the last cycles of one row.

    Args:
        part: the records of one row of a trace, in order of time.

    Raises:
        AnalysisError: a leg passes the middle of stance fewer than three times, or samples are too few.
    """
    t = part["t"].to_numpy(float)
    passed = [_times_of_mid_stance(t, phase) for phase in of_legs(part, "phase").T]
    if min(map(len, passed)) < 3:
        raise AnalysisError(
            "A wave needs at least two cycles, of seven samples or more each: use a longer duration of the "
            "trace, or a smaller interval between samples."
        )
    period = float(np.mean([times[-1] - times[-3] for times in passed])) / 2.0
    last = np.array([times[-1] for times in passed])
    return Passages(period, np.mod(last[:-1] - last[1:], period))


def _times_of_mid_stance(
    t: Float[np.ndarray, " times"], phase: Float[np.ndarray, " times"]
) -> Float[np.ndarray, " passages"]:
    """The times at which a phase (rad, any turns) passes `MID_STANCE`."""
    # the phase wraps far from MID_STANCE
    passes = (phase[:-1] < MID_STANCE) & (phase[1:] >= MID_STANCE) & (np.diff(phase) < 1.0)
    before = np.flatnonzero(passes)  # the last samples before the passages
    share = (MID_STANCE - phase[before]) / (phase[before + 1] - phase[before])
    return t[before] + share * (t[before + 1] - t[before])


CYCLES = 20  # the last cycles of a row over which its drift is averaged


def source_place(table: pd.DataFrame) -> pd.DataFrame:
    """The share of starts that settle with the source at each leg, for each set of parameters.

    A source at leg k is the boundary leg of a source wave: legs in front of it swing in a direct wave, k and
    those behind it in a retrograde one. Waves meet at leg p if they are retrograde in front of it and direct
    behind it, without a free lag.

    Args:
        table: a settle table of the multi-legged chain, several starts for each set.

    Returns:
        A row for each set and each leg: the parameters that vary, `leg`, `source`, `meeting`, and `neither`,
        the share of starts of the set without a source or a meeting place at any leg; `starts` of the set.

    Raises:
        AnalysisError: the table is not of the chain, has no rows, or has inferred rows.
    """
    phases = _phases(table, "_end")
    require(table, "status", "gait", "k")
    if np.any(table["status"].astype(str) == Status.inferred.name):
        raise AnalysisError("This table has inferred rows, which have no k: run the job without run.refine.")
    if table.empty:
        raise AnalysisError("The table has no rows.")
    names = set_columns(table)
    settled = Status.SOUND.among(table["status"])
    gait = np.asarray(table["gait"], str)
    # the legs of source and meeting, 0 where there is none
    ends = table[names].assign(
        source=np.where(settled & (gait == "source"), table["k"], 0),
        meeting=np.where(settled & (gait == "none"), _meetings(phases), 0),
    )
    rows = []
    for _, starts in ends.groupby(names, sort=True) if names else [((), ends)]:
        parameters = {name: starts[name].iloc[0] for name in names}
        source, meeting = starts["source"].to_numpy(), starts["meeting"].to_numpy()
        of_set = {"neither": np.mean((source == 0) & (meeting == 0)), "starts": len(starts)}
        for leg in range(1, phases.shape[1] + 2):
            shares = {"source": np.mean(source == leg), "meeting": np.mean(meeting == leg)}
            rows.append({**parameters, "leg": leg, **shares, **of_set})
    return pd.DataFrame(rows)


def source_drift(table: pd.DataFrame) -> pd.DataFrame:
    """Measure how fast E, the sum of the relative phases, drifts in each row, beside the law for its ends.

    The source moves with E: by one leg while E changes by about 4 rad.

    Args:
        table: a return_map table of the multi-legged chain.

    Returns:
        A record for each row: the parameters that vary, `place`, the link whose lag is farthest from the
        wave's at the end, `drift` (rad a cycle) over the last `CYCLES`, `law` for rigid legs (eqs. 30 to
        32), and `law_on_ground` with the ground's stiffness, rad a cycle; above 0 the source moves to the
        head.

    Raises:
        AnalysisError: the table is not of the chain, or a row has fewer than two crossings.
    """
    _phases(table, "_n")
    names = set_columns(table)
    records = []
    for row, part in table.groupby("row", sort=True):
        part = part.sort_values(by="crossing").tail(CYCLES + 1)
        psi = _phases(part, "_n")
        if len(psi) < 2:
            raise AnalysisError(f"Row {row} has fewer than two crossings.")
        N = psi.shape[1]
        chain = chain_of(table, part)
        K = constants_of(table, ["K"], part)["K"]
        drifts = {
            "place": int(np.abs(wrapped_difference(psi[-1])).argmax()) + 1,
            "drift": float(np.mean(wrapped_difference(np.diff(psi.sum(axis=1))))),
            "law": float(drift(chain)),
            "law_on_ground": float(drift_on_ground(N, chain, K)),
        }
        records.append({"row": row, **{name: part[name].iloc[0] for name in names}, **drifts})
    return pd.DataFrame(records)


def _phases(table: pd.DataFrame, suffix: str) -> Float[np.ndarray, "records springs"]:
    """The relative phases of each record, rad."""
    names = psi_columns(table, suffix)
    if not names:
        raise AnalysisError(f"A source needs psi_1{suffix}, ..., the columns of the multi-legged chain.")
    return table[names].to_numpy(float)


def _meetings(psi: Float[np.ndarray, "states springs"]) -> Int[np.ndarray, " states"]:
    """The leg, 2 .. N, at which the waves of each state meet; 0 if they do not."""
    lags = wrapped_difference(psi)
    near, behind = np.abs(lags) < 0.5 * np.pi, lags > 0.0
    retrograde = np.count_nonzero(~behind, axis=1)  # links in front of the meeting leg
    ordered = np.all(behind == (np.arange(psi.shape[1]) >= retrograde[:, None]), axis=1)
    inside = (retrograde > 0) & (retrograde < psi.shape[1])
    return np.where(near.all(axis=1) & ordered & inside, retrograde + 1, 0)
