"""How each row of a settle table came out: its label where it settled, else why it has none."""

from __future__ import annotations

import numpy as np
import pandas as pd

from gaitsweep.analysis.gaits.records import require
from gaitsweep.contract import Status, Verdict

SETTLED, UNSETTLED = Status.of(Verdict.sound), Status.of(Verdict.undecided)
NOT_SETTLED, FAILED = "not settled", "failed"


def outcomes(table: pd.DataFrame, label: str) -> pd.Series:
    """What each row came to: its label if it settled, else `not settled` or `failed`; NaN labels are `none`.

    Raises:
        AnalysisError: the column is not there.
    """
    require(table, label)
    came_to = np.where(table[label].notna(), table[label].astype(str), "none").astype(object)
    if "status" in table.columns:
        status = table["status"].astype(str)
        came_to[status.isin(list(UNSETTLED))] = NOT_SETTLED
        came_to[~status.isin(list(SETTLED | UNSETTLED))] = FAILED
    return pd.Series(came_to, index=table.index, dtype=object)


def in_order(table: pd.DataFrame, label: str, came_to: pd.Series) -> list[str]:
    """The outcomes that occur: in the label's own order where it is a category, rows without one last."""
    kind = table[label].dtype
    known = [str(each) for each in kind.categories] if isinstance(kind, pd.CategoricalDtype) else []
    present = set(came_to.unique())
    others = sorted(present - set(known) - {NOT_SETTLED, FAILED, "none"})
    order = [*(name for name in known if name != "none"), *others, "none", NOT_SETTLED, FAILED]
    return [name for name in order if name in present]
