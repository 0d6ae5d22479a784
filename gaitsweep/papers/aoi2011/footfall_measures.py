"""Measures of the feet: their slip in a stance, and the lags and order of their touchdowns."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.analyses import TURN, AnalysisError, mean_direction, require, unwrap_from
from gaitsweep.claims import measure, row_params, stances, stored_job
from gaitsweep.papers.aoi2011.waist_quadruped.sizes import LIMBS

# Largest deviation of the times between touchdowns from one cycle, where a foot lands once a cycle
_ONCE = 0.2


@measure
def foot_slip(table: pd.DataFrame, *, take: str = "median") -> float:
    """Distance (m) that a foot moves along the ground in a stance: `median` or `max` of all stances.

    A foot that bounces is still in its stance; the time off the ground does not count.
    """
    require(table, "row", "t", *(f"q_{i}" for i in range(16)))
    design = stored_job(table.attrs).design
    feet = jax.jit(jax.vmap(lambda m, q: m.feet(q, jnp.zeros(15))[0], in_axes=(None, 0)))
    moved = []
    for row, part in table.groupby("row"):
        part = part.sort_values("t")
        t, mechanics = part["t"].to_numpy(float), row_params(design, int(str(row))).mechanics
        at = np.asarray(feet(mechanics, jnp.asarray(part[[f"q_{i}" for i in range(16)]].to_numpy(float))))
        for i in LIMBS:
            down = part[f"contact_{i + 1}"].to_numpy(float) > 0.5
            for first, last in stances(t, down):
                ground = at[first:last, i, :2][down[first:last]]
                moved.append(float(np.max(np.linalg.norm(ground - ground[0], axis=1))))
    return float(np.max(moved) if take == "max" else np.median(moved))


@measure
def touchdown_lags(
    table: pd.DataFrame,
    *,
    row: int,
    pairs: Sequence[Sequence[int]],
    window: Sequence[float] | None = None,
    near: Sequence[float] | None = None,
) -> list[float]:
    """Phase (rad) by which foot i of each pair [i, j] touches down before foot j.

    Args:
        table: a trace.
        row: its row.
        pairs: numbers of feet.
        window: begin and end of the time that is used, s.
        near: for each pair, the middle of the turn in which its phase is given, rad; pi without it.

    Raises:
        AnalysisError: a foot touches down less or more than once a cycle.
    """
    if window is not None:
        t = table["t"].to_numpy(float)
        table = table.loc[(t >= window[0]) & (t <= window[1])]
    lags = []
    for (i, j), middle in zip(pairs, near or [math.pi] * len(pairs), strict=True):
        first, second = _touchdowns(table, row, i), _touchdowns(table, row, j)
        cycle = float(np.median(np.diff(first)))
        for foot, times in ((i, first), (j, second)):
            if np.max(np.abs(np.diff(times) / cycle - 1.0)) > _ONCE:
                raise AnalysisError(f"Foot {foot} of row {row} does not touch down once a cycle.")
        after = second[:, None] - first[None, :]
        lag = np.asarray(mean_direction(TURN * (after / cycle).ravel()))
        lags.append(float(unwrap_from(lag, middle - math.pi)))
    return lags


@measure
def order_of_footfalls(table: pd.DataFrame, *, row: int, apart: float = 0.2) -> str:
    """Limbs in their order of touchdown from limb 1 on; those within `apart` (rad) joined by +."""
    lags = touchdown_lags(table, row=row, pairs=[[1, 2], [1, 3], [1, 4]], near=[math.pi - apart] * 3)
    order = sorted(zip([0.0, *lags], "1234", strict=True))
    groups = [[order[0][1]]]
    for (before, _), (after, limb) in itertools.pairwise(order):
        if after - before > apart:
            groups.append([])
        groups[-1].append(limb)
    return "-".join("+".join(sorted(limbs)) for limbs in groups)


def _touchdowns(table: pd.DataFrame, row: int, foot: int) -> Float[np.ndarray, " touchdowns"]:
    """Times (s) at which a swing of a foot ends; breaks of a stance do not count as swings."""
    require(table, "row", "t", f"contact_{foot}")
    part = table.loc[table["row"].to_numpy() == row].sort_values("t")
    t, down = part["t"].to_numpy(float), part[f"contact_{foot}"].to_numpy(float) > 0.5
    # without its lift-off before it, the first stance is not known to begin with a touchdown
    lands = stances(t, down)[1:, 0]
    if len(lands) < 2:
        raise AnalysisError(f"Foot {foot} of row {row} has fewer than two touchdowns.")
    return t[lands]
