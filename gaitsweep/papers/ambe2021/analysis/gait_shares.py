"""The fractions of the gaits over sets of parameters, and the conditions for the gaits to exist."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from gaitsweep.analyses import AnalysisError, fractions, proportion_interval, stored_function
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import (
    chains_of,
    parameters_of,
    set_columns,
    springs_of,
)
from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.papers.ambe2021.theory.conditions import existing_waves
from gaitsweep.papers.ambe2021.theory.gaits import WAVES


def gait_shares(table: pd.DataFrame, parameters: str | Sequence[str] | None = None) -> pd.DataFrame:
    """The fractions of the three gaits for each set of parameters, with intervals, and whether they exist.

    Args:
        table: a settle table of the multi-legged chain, several starts for each set.
        parameters: the columns of a set; by default the swept axes except the phases of the start.

    Returns:
        A row for each set: the parameters; for each gait its share, NAME_low and NAME_high (Wilson's
        interval); `elsewhere`, the share of starts in none of them; `conditions`: whether the paper's m/2 <
        m_B < m (of the end that touches by more) and m g/kappa < a < L hold, with a profile for all inner
        legs; `direct_hold`, `source_hold`, `retrograde_hold`: whether the wave is a motion of the chain
        (`existence`).

    Raises:
        AnalysisError: the table does not have a column, or the job's parameters cannot be read.
    """
    springs_of(table)  # refuses a table of another model
    if table.empty:
        raise AnalysisError("The table has no rows.")
    if parameters is None:
        parameters = set_columns(table)
    names = [parameters] if isinstance(parameters, str) else list(parameters)
    counted = fractions(table, by=names, interval="wilson")
    wide = counted.pivot(index=[*names, "of"], columns="outcome", values=["fraction", "low", "high"])
    sets = pd.DataFrame(wide.index.to_frame(index=False))
    high_of_none = [proportion_interval(0, starts)[1] for starts in sets.pop("of")]
    # of each column of `fractions`: its suffix here, and its values for a gait without starts in the table
    columns = {"fraction": ("", 0.0), "low": ("_low", 0.0), "high": ("_high", high_of_none)}
    for gait in WAVES:
        for part, (suffix, without_gait) in columns.items():
            sets[gait + suffix] = wide[part, gait].to_numpy() if (part, gait) in wide else without_gait
    sets["elsewhere"] = (1.0 - sets[list(WAVES)].sum(axis=1)).clip(lower=0.0).round(12)
    return sets.assign(**_conditions(table, pd.DataFrame(sets[names])))


def sets_by_conditions(table: pd.DataFrame) -> pd.DataFrame:
    """Count the sets of parameters with the three gaits, by whether the paper's conditions hold.

    Args:
        table: as for `gait_shares`.

    Returns:
        A row for each combination of `conditions`, `direct_hold`, `source_hold` and `retrograde_hold` that
        occurs: the number of `sets`, of those in which starts came to all three gaits and to any of them,
        `with_all` and `with_any`; the mean share of each gait.
    """
    shares = gait_shares(table)
    occurs = shares[list(WAVES)] > 0.0
    conditions = ["conditions", *(f"{gait}_hold" for gait in WAVES)]
    groups = shares.assign(with_all=occurs.all(axis=1), with_any=occurs.any(axis=1)).groupby(conditions)
    columns = {
        "sets": groups.size(),
        "with_all": groups["with_all"].sum(),
        "with_any": groups["with_any"].sum(),
        **{gait: groups[gait].mean() for gait in WAVES},
    }
    return pd.DataFrame(columns).iloc[::-1].reset_index()  # sets at which all conditions hold come first


def existence(table: pd.DataFrame, sets: pd.DataFrame) -> dict[str, Bool[np.ndarray, " sets"]]:
    """Whether each gait is a motion of the chain, by `existing_waves`.

    Args:
        table: a table of the multi-legged chain, whose job gives the parameters that do not vary.
        sets: the columns that vary, one row for each set of parameters.

    Returns:
        For each of WAVES whether each set has it; for the source wave, of any boundary leg.

    Raises:
        AnalysisError: the job's parameters cannot be read.
    """
    exists = _existing_waves(springs_of(table))(chains_of(table, sets).by_name)
    return {gait: exists[gait] for gait in WAVES}


@cache
def _existing_waves(N: int) -> Callable[[Any], dict[str, Bool[np.ndarray, " sets"]]]:
    """Make the function of the fields of n chains, whether each of WAVES is a motion of each."""

    def existing(chain: Any) -> dict[str, Any]:
        return existing_waves(N, Chain(**chain))

    return stored_function(existing)


def printed_margins(table: pd.DataFrame, sets: pd.DataFrame) -> Float[np.ndarray, "conditions sets"]:
    """By how much each of m/2 < m_B, m_B < m, m g < a kappa and a < L holds; those of all inner legs.

    Args:
        table, sets: as for `existence`.

    Raises:
        AnalysisError: the job's parameters cannot be read.
    """
    chains = chains_of(table, sets)
    m_B = np.maximum(chains.m_1, chains.m_end)  # of the end that touches by more
    # with a profile those of the extreme inner legs
    m, kappa, a = (np.asarray(field).reshape(len(sets), -1) for field in (chains.m, chains.kappa, chains.a))
    below_spring = a.min(axis=1) * kappa.min(axis=1) - m.max(axis=1) * chains.g
    below_leg = parameters_of(table, sets)["L"] - a.max(axis=1)
    return np.stack([m_B - 0.5 * m.max(axis=1), m.min(axis=1) - m_B, below_spring, below_leg])


def _conditions(table: pd.DataFrame, sets: pd.DataFrame) -> dict[str, Bool[np.ndarray, " sets"]]:
    """The columns `conditions` and NAME_hold of sets of parameters, as `gait_shares` returns them."""
    holds = {f"{gait}_hold": exists for gait, exists in existence(table, sets).items()}
    return {"conditions": np.all(printed_margins(table, sets) > 0.0, axis=0), **holds}
