"""Shares of the gaits over sets of parameters, beside the conditions for the gaits to exist."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np
import pandas as pd

from gaitsweep.analysis.basin_fractions import fractions
from gaitsweep.analysis.multilegged.chain import Chain
from gaitsweep.analysis.multilegged.chain_of_table import chains_of, parameters_of
from gaitsweep.analysis.multilegged.conditions import wave_conditions
from gaitsweep.analysis.proportions import LEVEL, wilson
from gaitsweep.analysis.records import axes_of

GAITS = ("direct", "source", "retrograde")


def gait_shares(
    table: pd.DataFrame, parameters: Sequence[str] | None = None, *, level: float = LEVEL
) -> pd.DataFrame:
    """For each set of parameters the shares of the three gaits, with intervals, and whether they can exist.

    Args:
        table: a settle table of the multi-legged chain, several starts for each set.
        parameters: the columns that make a set; what varies but the start's phases if not given.
        level: of the intervals (Wilson's).

    Returns:
        A row for each set: the parameters; for each gait its share, NAME_low and NAME_high; `elsewhere`, the
        share of starts in none of them; `conditions`: whether the paper's m/2 < m_B < m (of the end that
        touches by more) and m g/kappa < a < L hold; `direct_hold`, `retrograde_hold`: whether all conditions
        of `wave_conditions` do.

    Raises:
        AnalysisError: a column is not there, or the job's parameters cannot be read.
    """
    names = set_columns(table) if parameters is None else list(parameters)
    counted = fractions(table, by=names, level=level, interval="wilson")
    wide = counted.pivot(index=names, columns="outcome", values=["fraction", "low", "high"])
    sets = pd.DataFrame(wide.index.to_frame(index=False))
    most_without = _none_of(int(counted["of"].to_numpy().min()), level)
    for gait in GAITS:
        for part, column, otherwise in (
            ("fraction", gait, 0.0),
            ("low", f"{gait}_low", 0.0),
            ("high", f"{gait}_high", most_without),
        ):
            there = (part, gait) in wide.columns
            sets[column] = wide[part, gait].fillna(otherwise).to_numpy() if there else otherwise
    sets["elsewhere"] = (1.0 - sets[list(GAITS)].sum(axis=1)).clip(lower=0.0).round(12)
    return sets.assign(**_conditions(table, pd.DataFrame(sets[names])))


def set_columns(table: pd.DataFrame) -> list[str]:
    """The columns of what varies but the start's phases."""
    return [name for name in axes_of(table) if not name.startswith(("psi_", "phi_"))]


def _none_of(starts: int, level: float) -> float:
    """The high end of the interval of a gait that no start came to."""
    return float(wilson(np.zeros(1), np.array([starts]), level)[1][0])


def _conditions(table: pd.DataFrame, sets: pd.DataFrame) -> dict[str, np.ndarray]:
    values, chains = parameters_of(table, sets), chains_of(table, sets)
    springs = sum(f"psi_{i}_end" in table for i in range(1, table.shape[1]))
    L = np.broadcast_to(values["L"], (len(sets),))

    def one(chain: Chain, longest: jax.Array) -> tuple[jax.Array, jax.Array]:
        direct, retrograde = wave_conditions(springs, chain, longest)
        return direct.hold, retrograde.hold

    direct, retrograde = jax.jit(jax.vmap(one))(chains, L)
    m_B = np.maximum(chains.m_1, chains.m_end)
    sag = np.asarray(chains.m) * chains.g / chains.kappa
    printed = (0.5 * np.asarray(chains.m) < m_B) & (m_B < chains.m) & (sag < chains.a) & (chains.a < L)
    return {
        "conditions": np.asarray(printed),
        "direct_hold": np.asarray(direct),
        "retrograde_hold": np.asarray(retrograde),
    }
