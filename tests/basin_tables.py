"""Settle tables with basins that are known, made without simulating."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

TURN = 2 * np.pi


def grid_table(
    lengths: Sequence[int],
    label: Callable[..., np.ndarray],
    *,
    circular: bool = True,
    panels: Sequence[float] = (),
) -> pd.DataFrame:
    """Starts psi_1, psi_2, ... in the middles of cells of a turn each; `label(psi_1, ...)` gives the gait.

    With `circular` false the axes are open and called x_1, x_2, ..., from 0 to 1. `panels` are values of p,
    which `label` gets last.
    """
    side, stem = (TURN, "psi") if circular else (1.0, "x")
    axes = {f"{stem}_{i + 1}": (np.arange(n) + 0.5) / n * side for i, n in enumerate(lengths)}
    if len(panels):
        axes = {"p": np.asarray(panels, float), **axes}
    starts = pd.MultiIndex.from_product(list(axes.values()), names=list(axes)).to_frame(index=False)
    table = pd.concat([pd.Series(np.arange(len(starts)), name="row"), starts], axis=1)
    table["status"] = "settled"
    given = [starts[name].to_numpy() for name in axes if name != "p"]
    gait = label(*given, *([starts["p"].to_numpy()] if len(panels) else []))
    return table.assign(gait=pd.Categorical(np.asarray(gait).astype(str)))


def cantor_labels(depth: int) -> np.ndarray:
    """The parity of the step at which Cantor's construction takes out each of 3^depth cells; 0 if never.

    The boundary of the two sets is the Cantor set, of dimension ln 2 / ln 3.
    """
    cells = np.arange(3**depth)
    step = np.zeros(cells.size, int)
    for k in range(depth, 0, -1):
        step[cells // 3 ** (depth - k) % 3 == 1] = k
    return step % 2
