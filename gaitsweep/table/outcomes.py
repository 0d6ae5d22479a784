"""The column `outcome`: the gait of each row, or the reason why it has none."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from gaitsweep.contract import Outcome, Status


def outcomes(gait: pd.Categorical, status: ArrayLike) -> pd.Categorical:
    """The outcomes of rows (n,) from their gaits and statuses."""
    names = list(dict.fromkeys([*gait.categories, *map(str, Outcome)]))
    codes = np.where(gait.codes < 0, names.index(Outcome.NO_GAIT), gait.codes.astype(np.int32))
    codes[~Status.SOUND.among(status)] = names.index(Outcome.FAILED)
    codes[Status.UNDECIDED.among(status)] = names.index(Outcome.NOT_SETTLED)
    return pd.Categorical.from_codes(codes, categories=names)
