"""Place along the multi-legged chain at which the source of a wave settles, and its drift."""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from gaitsweep.analyses import AnalysisError, wrapped_difference
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import (
    chain_of,
    parameters_of,
    psi_columns,
    set_columns,
)
from gaitsweep.papers.ambe2021.theory.solution_sets import drift, drift_on_ground
from gaitsweep.status import Status

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
        AnalysisError: the table is not of the chain.
    """
    phases = _phases(table, "_end")
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
        first = pd.DataFrame(part.head(1))
        chain = chain_of(table, first)
        K = np.ravel(parameters_of(table, first)["K"])[0]
        rate = float(np.mean(wrapped_difference(np.diff(psi.sum(axis=1)))))
        drifts = {
            "place": int(np.abs(wrapped_difference(psi[-1])).argmax()) + 1,
            "drift": rate,
            "law": float(drift(chain)),
            "law_on_ground": float(drift_on_ground(N, chain, float(K))),
        }
        records.append({"row": row, **{name: first[name].iloc[0] for name in names}, **drifts})
    return pd.DataFrame(records)


def _phases(table: pd.DataFrame, suffix: str) -> Float[np.ndarray, "records springs"]:
    """The relative phases of each record, rad."""
    names = psi_columns(table, suffix)
    if not names:
        columns = f"the columns psi_1{suffix}, ..."
        raise AnalysisError(f"A source needs a table of the multi-legged chain with {columns}")
    return table[names].to_numpy(float)


def _meetings(psi: Float[np.ndarray, "states springs"]) -> Int[np.ndarray, " states"]:
    """The leg, 2 .. N, at which the waves of each state meet; 0 if they do not."""
    lags = wrapped_difference(psi)
    near, behind = np.abs(lags) < 0.5 * np.pi, lags > 0.0
    retrograde = np.count_nonzero(~behind, axis=1)  # links in front of the meeting leg
    ordered = np.all(behind == (np.arange(psi.shape[1]) >= retrograde[:, None]), axis=1)
    inside = (retrograde > 0) & (retrograde < psi.shape[1])
    return np.where(near.all(axis=1) & ordered & inside, retrograde + 1, 0)
