"""What the two legs of a diagonal pair bear in stance, and how the body is tilted meanwhile."""

from __future__ import annotations

import numpy as np
import pandas as pd

from gaitsweep.analysis.gaits.gait_tables import FLEXORS, onsets_of
from gaitsweep.analysis.records import require
from gaitsweep.models.planar_quadruped.nine_gaits import LEGS, PAIRS

LATE = 0.15  # of a cycle
_NEAR = 0.25  # of a cycle: an onset farther from where it is due does not belong to this cycle


def loads_of_settled(table: pd.DataFrame) -> pd.DataFrame:
    """The loads and tilts that the rows of a settle table end with, each leg's in its own stance.

    Args:
        table: row, and for each leg late_load_LF_end, stance_load_LF_end (N), late_pitch_LF_end and
            stance_pitch_LF_end (rad).

    Returns:
        One record for each pair of a row: row, pair_number, load_late, load_stance, tilt_late, tilt_stance.

    Raises:
        AnalysisError: a column is not there.
    """
    parts = []
    for number, (fore, hind) in enumerate(PAIRS, start=1):
        part = pd.DataFrame({"row": table["row"], "pair_number": number})
        for when in ("late", "stance"):
            load, tilt = ([f"{when}_{what}_{leg}_end" for leg in (fore, hind)] for what in ("load", "pitch"))
            require(table, *load, *tilt)
            part[f"load_{when}"] = table[load[0]] - table[load[1]]
            part[f"tilt_{when}"] = 0.5 * (table[tilt[0]] + table[tilt[1]])
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


def loads_of_trace(trace: pd.DataFrame, pairs: pd.DataFrame) -> pd.DataFrame:
    """The loads and tilts of each pair, averaged over the cycles that a trace holds whole.

    A leg's stance is where its flexor is silent; its late stance the last `LATE` of the cycle before it
    begins to swing. `together`: the same time for both legs of a pair, before the first of them does.

    Args:
        trace: row, t (s) and for each leg u_f_LF and F_LF (N), pitch (rad, nose down positive).
        pairs: row, pair_number and delta (cycles).

    Returns:
        One record for each pair of a row: row, pair_number, and load_ and tilt_ of together, late and stance.

    Raises:
        AnalysisError: a column is not there.
    """
    require(trace, "row", "t", "pitch", *FLEXORS.values(), *(f"F_{leg}" for leg in LEGS))
    onsets = {key: each["t"].to_numpy(float) for key, each in onsets_of(trace).groupby(["row", "leg"])}
    shift = pairs.set_index(["row", "pair_number"])["delta"]
    records = []
    for row, samples in trace.groupby("row", sort=True):
        if (row, 1) not in shift.index:
            continue
        stances = _Stances(samples.sort_values("t", kind="stable"))
        for number, (fore, hind) in enumerate(PAIRS, start=1):
            begins = onsets.get((row, fore), np.zeros(0)), onsets.get((row, hind), np.zeros(0))
            found = stances.of_pair((fore, hind), begins, float(shift.loc[row, number]))
            records.append({"row": row, "pair_number": number} | found)
    return pd.DataFrame(records)


class _Stances:
    """The samples of one row, summed up over time so that means over any stretch are differences."""

    def __init__(self, samples: pd.DataFrame) -> None:
        self._t = samples["t"].to_numpy(float)
        pitch = samples["pitch"].to_numpy(float)
        sums = {"pitch": pitch}
        for leg in LEGS:
            load = samples[f"F_{leg}"].to_numpy(float)
            stands = (samples[FLEXORS[leg]].to_numpy(float) <= 0.0).astype(float)
            sums |= {f"F_{leg}": load, f"time_{leg}": stands}
            sums |= {f"F_{leg}_standing": load * stands, f"pitch_{leg}": pitch * stands}
        step = np.diff(self._t)
        self._sums = {
            name: np.concatenate([[0.0], np.cumsum(0.5 * step * (value[1:] + value[:-1]))])
            for name, value in sums.items()
        }

    def over(self, name: str, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """The integral of a signal from `begin` to `end` (n,) s."""
        sums = self._sums[name]
        return np.interp(end, self._t, sums) - np.interp(begin, self._t, sums)

    def of_pair(
        self, legs: tuple[str, str], begins: tuple[np.ndarray, np.ndarray], delta: float
    ) -> dict[str, float]:
        """The measures of a pair whose legs begin to swing at these times, and which is shifted by delta."""
        fore, hind, period = _paired(*begins, delta)
        whole = np.minimum(fore, hind) - period >= self._t[0]
        fore, hind, period = fore[whole], hind[whole], period[whole]
        if not len(fore):
            return {}
        first, late = np.minimum(fore, hind), LATE * period
        found: dict[str, np.ndarray] = {}
        found["load_together"] = self._difference(legs, (first, first), late)
        found["tilt_together"] = self.over("pitch", first - late, first) / late
        found["load_late"] = self._difference(legs, (fore, hind), late)
        found["tilt_late"] = sum(self.over("pitch", at - late, at) for at in (fore, hind)) / (2.0 * late)
        load, tilt = [], []
        for leg, at in zip(legs, (fore, hind), strict=True):
            time = self.over(f"time_{leg}", at - period, at)
            load.append(self.over(f"F_{leg}_standing", at - period, at) / time)
            tilt.append(self.over(f"pitch_{leg}", at - period, at) / time)
        found["load_stance"], found["tilt_stance"] = load[0] - load[1], 0.5 * (tilt[0] + tilt[1])
        return {name: float(np.mean(value)) for name, value in found.items()}

    def _difference(
        self, legs: tuple[str, str], at: tuple[np.ndarray, np.ndarray], late: np.ndarray
    ) -> np.ndarray:
        """Load on the fore leg less that on the hind leg, before each begins to swing, (n,) N."""
        fore, hind = (
            self.over(f"F_{leg}", end - late, end) / late for leg, end in zip(legs, at, strict=True)
        )
        return fore - hind


def _paired(fore: np.ndarray, hind: np.ndarray, delta: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Onsets of a fore leg, those of the hind leg that belong to them, and how long the cycle before was."""
    none = np.zeros(0)
    if len(fore) < 2 or not len(hind):
        return none, none, none
    period, fore = np.diff(fore), fore[1:]
    due = fore + delta * period
    nearest = hind[np.abs(hind[None, :] - due[:, None]).argmin(axis=1)]
    belongs = np.abs(nearest - due) < _NEAR * period
    return fore[belongs], nearest[belongs], period[belongs]
