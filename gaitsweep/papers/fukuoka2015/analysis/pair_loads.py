"""The loads and the pitch of each diagonal pair of legs in its stance, beside its phase shift."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy
from jaxtyping import Float

from gaitsweep.analyses import axes_of, require
from gaitsweep.papers.fukuoka2015.analysis.gait_tables import gaits_in
from gaitsweep.papers.fukuoka2015.analysis.swing_onsets import FLEXORS, onsets_of
from gaitsweep.papers.fukuoka2015.planar_quadruped.cycle import LATE_STANCE
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import CHART, LEGS, PAIRS

_MAX_ONSET_LAG = 0.25  # cycles; largest distance of an onset from its expected time


class Measure(NamedTuple):
    """A measure of load or pitch in a pair's stance that the rule relates to its shift."""

    meaning: str
    unit: str


# By the rule each of them has the opposite sign of delta.
MEASURES = {
    "load_together": Measure("load, fore less hind, before the first of the two swings", "N"),
    "load_late": Measure("load, fore less hind, each in its own late stance", "N"),
    "load_stance": Measure("mean load in stance, fore less hind", "N"),
    "tilt_together": Measure("pitch before the first of the two swings, nose down", "rad"),
    "tilt_late": Measure("pitch in late stance, mean of the two legs', nose down", "rad"),
    "tilt_stance": Measure("mean pitch in stance, mean of the two legs', nose down", "rad"),
}


def pairs_in(table: pd.DataFrame) -> pd.DataFrame:
    """The shift, loads and pitch of each diagonal pair of each steady row.

    Args:
        table: a trace of `planar_quadruped` (u_f_LF, F_LF, ..., pitch) with every step, since a touchdown's
            load lasts for a few, or a settle table of it. Late stance is the last 15 % of a cycle before a
            leg begins to swing. Only a trace gives the loads of both legs of a pair before the first swing
            (`load_together`, `tilt_together`).

    Returns:
        One record for each pair of a row with one of the nine gaits: row, swept axes, gait, pair_number (1:
        RF and LH, 2: LF and RH), delta (cycles), and those `MEASURES` that the table gives (N, rad).

    Raises:
        AnalysisError: the table is of another kind.
    """
    gaits = gaits_in(table)
    gaits = gaits.loc[gaits["gait"].isin(CHART)]
    axes = [name for name in axes_of(table) if name in gaits.columns]
    rows = gaits[["row", *axes, "gait"]]
    parts = [rows.assign(pair_number=pair, delta=gaits[f"delta_{pair}"]) for pair in (1, 2)]
    pairs = pd.concat(parts, ignore_index=True)
    settled = "late_load_LF_end" in table.columns
    measured = _loads_of_settled(table) if settled else _loads_of_trace(table, pairs)
    pairs = pairs.merge(measured, on=["row", "pair_number"], how="left")
    pairs = pairs.sort_values(["row", "pair_number"], ignore_index=True)
    pairs.attrs["quantities"] = gaits.attrs.get("quantities", {})
    return pairs


def _loads_of_settled(table: pd.DataFrame) -> pd.DataFrame:
    """Loads (N) and pitch (rad) of each row and pair of a settle table, in each leg's own stance."""
    parts = []
    for number, (fore, hind) in enumerate(PAIRS, start=1):
        part = pd.DataFrame({"row": table["row"], "pair_number": number})
        for when in ("late", "stance"):
            load = [f"{when}_load_{leg}_end" for leg in (fore, hind)]
            tilt = [f"{when}_pitch_{leg}_end" for leg in (fore, hind)]
            require(table, *load, *tilt)
            part[f"load_{when}"] = table[load[0]] - table[load[1]]
            part[f"tilt_{when}"] = 0.5 * (table[tilt[0]] + table[tilt[1]])
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


def _loads_of_trace(trace: pd.DataFrame, pairs: pd.DataFrame) -> pd.DataFrame:
    """Loads (N) and pitch (rad) of each row and pair, averaged over the complete cycles of a trace."""
    require(trace, "row", "t", "pitch", *FLEXORS.values(), *(f"F_{leg}" for leg in LEGS))
    onsets = {
        key: onsets_of_leg["t"].to_numpy(float)
        for key, onsets_of_leg in onsets_of(trace).groupby(["row", "leg"])
    }
    shift = pairs.set_index(["row", "pair_number"])["delta"]
    records = []
    for row, samples in trace.groupby("row", sort=True):
        if (row, 1) not in shift.index:
            continue
        stances = _Stances(samples.sort_values("t", kind="stable"))
        for number, (fore, hind) in enumerate(PAIRS, start=1):
            begins = onsets.get((row, fore), np.zeros(0)), onsets.get((row, hind), np.zeros(0))
            loads = stances.of_pair((fore, hind), begins, float(shift.loc[row, number]))
            records.append({"row": row, "pair_number": number} | loads)
    return pd.DataFrame(records, columns=["row", "pair_number", *MEASURES])


class _Stances:
    """The cumulative integrals of one row's samples, so that means over any interval are differences."""

    def __init__(self, samples: pd.DataFrame) -> None:
        self._t = samples["t"].to_numpy(float)
        pitch = samples["pitch"].to_numpy(float)
        sums = {"pitch": pitch}
        for leg in LEGS:
            load = samples[f"F_{leg}"].to_numpy(float)
            stands = (samples[FLEXORS[leg]].to_numpy(float) <= 0.0).astype(float)
            sums |= {f"F_{leg}": load, f"time_{leg}": stands}
            sums |= {f"F_{leg}_standing": load * stands, f"pitch_{leg}": pitch * stands}
        integral = scipy.integrate.cumulative_trapezoid
        self._sums = {name: integral(value, self._t, initial=0) for name, value in sums.items()}

    def over(
        self, name: str, begin: Float[np.ndarray, " cycles"], end: Float[np.ndarray, " cycles"]
    ) -> Float[np.ndarray, " cycles"]:
        """The integral of a signal from `begin` to `end`, s."""
        sums = self._sums[name]
        return np.interp(end, self._t, sums) - np.interp(begin, self._t, sums)

    def of_pair(
        self,
        legs: tuple[str, str],
        begins: tuple[Float[np.ndarray, " fore_onsets"], Float[np.ndarray, " hind_onsets"]],
        delta: float,
    ) -> dict[str, float]:
        """The measures of a pair with the shift delta, from the swing onsets of its fore and hind leg."""
        cycles = _cycles_of_pair(*begins, delta)
        recorded = np.minimum(cycles.fore, cycles.hind) - cycles.period >= self._t[0]
        fore, hind, period = (values[recorded] for values in cycles)
        if not len(fore):
            return {}
        first = np.minimum(fore, hind)
        late = LATE_STANCE * period
        measures: dict[str, Float[np.ndarray, " cycles"]] = {}
        measures["load_together"] = self._difference(legs, (first, first), late)
        measures["tilt_together"] = self.over("pitch", first - late, first) / late
        measures["load_late"] = self._difference(legs, (fore, hind), late)
        measures["tilt_late"] = sum(self.over("pitch", at - late, at) for at in (fore, hind)) / (2.0 * late)
        load, tilt = [], []
        for leg, at in zip(legs, (fore, hind), strict=True):
            time = self.over(f"time_{leg}", at - period, at)
            load.append(self.over(f"F_{leg}_standing", at - period, at) / time)
            tilt.append(self.over(f"pitch_{leg}", at - period, at) / time)
        measures["load_stance"], measures["tilt_stance"] = load[0] - load[1], 0.5 * (tilt[0] + tilt[1])
        return {name: float(np.mean(value)) for name, value in measures.items()}

    def _difference(
        self,
        legs: tuple[str, str],
        at: tuple[Float[np.ndarray, " cycles"], Float[np.ndarray, " cycles"]],
        late: Float[np.ndarray, " cycles"],
    ) -> Float[np.ndarray, " cycles"]:
        """The load on the fore leg less that on the hind leg, before each begins to swing, N."""
        ends = zip(legs, at, strict=True)
        fore, hind = (self.over(f"F_{leg}", end - late, end) / late for leg, end in ends)
        return fore - hind


class _PairCycles(NamedTuple):
    """Onsets of a fore leg, the hind leg's in the same cycles, and the durations of the cycles before, s."""

    fore: Float[np.ndarray, " cycles"]
    hind: Float[np.ndarray, " cycles"]
    period: Float[np.ndarray, " cycles"]


def _cycles_of_pair(
    fore: Float[np.ndarray, " fore_onsets"], hind: Float[np.ndarray, " hind_onsets"], delta: float
) -> _PairCycles:
    """The cycles of a pair with the shift delta (cycles), from all onsets of its legs (s)."""
    none = np.zeros(0)
    if len(fore) < 2 or not len(hind):
        return _PairCycles(none, none, none)
    period = np.diff(fore)
    fore = fore[1:]
    due = fore + delta * period
    nearest = hind[np.abs(hind[None, :] - due[:, None]).argmin(axis=1)]
    belongs = np.abs(nearest - due) < _MAX_ONSET_LAG * period
    return _PairCycles(fore[belongs], nearest[belongs], period[belongs])
