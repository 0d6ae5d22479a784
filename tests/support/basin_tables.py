"""Settle tables of which the basins or their boundaries are known, made without a model."""

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
    """The parity of the step at which Cantor's construction removes each of 3^depth cells; 0 for the rest.

    The boundary of the two sets is the Cantor set, of dimension ln 2 / ln 3.
    """
    cells = np.arange(3**depth)
    step = np.zeros(cells.size, int)
    for k in range(depth, 0, -1):
        step[cells // 3 ** (depth - k) % 3 == 1] = k
    return step % 2


def julia(x: np.ndarray, y: np.ndarray, c: complex) -> np.ndarray:
    """Whether z^2 + c, iterated from x + i y, stays bounded."""
    z, place = x + 1j * y, np.arange(x.size)
    for _ in range(1500):
        inside = np.abs(z := z * z + c) < 4.0
        z, place = z[inside], place[inside]
    return np.isin(np.arange(x.size), place)


def newton(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The cube root of 1 that Newton's method comes to from x + i y: its angle in thirds of a turn."""
    z = x + 1j * y
    for _ in range(60):
        z -= (z**3 - 1.0) / (3.0 * z**2)
    return np.rint(np.angle(z) * 3 / TURN) % 3


def final_state(theta: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The fixed point of the map of Grebogi et al. 1983 that a start comes to: true for (0, -0.3)."""
    for _ in range(500):
        turn = 1.32 * np.sin(2 * theta) - 0.9 * np.sin(4 * theta) - x * np.sin(theta)
        theta, x = theta + turn, -0.3 * np.cos(theta)
    return np.cos(theta) > 0.0


def weierstrass(theta: np.ndarray, x: np.ndarray, growth: float) -> np.ndarray:
    """Whether x goes to +infinity under theta -> 2 theta, x -> growth x + cos theta.

    The boundary is the graph of a Weierstrass function, of dimension 2 - log2(growth).
    """
    return x > -sum(growth ** -(n + 1.0) * np.cos(2.0**n * theta) for n in range(40))
