"""Small synthetic tables of runs, and readers of legends, for the tests of figures."""

from __future__ import annotations

import io

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitsweep.papers.ambe2021.theory.gaits import GAITS

TURN = 2 * np.pi
POINTS = {"a": [1.13, 0.98, 1.50], "b": [3.97, 5.29, 5.29], "c": [1.13, 1.10, 5.28]}
AXES = ["psi_1", "psi_2", "psi_3"]


def settle_table(n: int = 4) -> pd.DataFrame:
    """A settle job of n x n starts for each of three psi_3; the gait follows from psi_1 alone."""
    cell = (np.arange(n) + 0.5) / n * TURN
    starts = pd.MultiIndex.from_product([[0.4 * np.pi, np.pi, 1.6 * np.pi], cell, cell])
    table = starts.to_frame(index=False, name=["psi_3", "psi_2", "psi_1"])
    table.insert(0, "row", np.arange(len(table)))
    ends = np.array(list(POINTS.values()))
    which = np.digitize(table["psi_1"], [TURN / 4, 3 * TURN / 4])  # a quarter, a half and a quarter
    table["status"] = pd.Categorical(["settled"] * len(table), ["settled", "cycle_limit", "fell"])
    table["cycles"] = 50
    for i in range(3):
        table[f"psi_{i + 1}_end"] = ends[which, i]
    # not in ascending order, so that a figure that orders gaits by their occurrence fails
    table["gait"] = pd.Categorical.from_codes(np.array([0, 2, 1])[which].tolist(), list(GAITS))
    return table


def crossing_table() -> pd.DataFrame:
    """A return_map job of three rows, whose psi_1 grows by 0.4 rad from one crossing to the next."""
    rows = [
        {"row": row, "psi_1": start, "crossing": n, "status": "complete", "psi_1_n": (start + 0.4 * n) % TURN}
        for row, start in enumerate([0.5, 3.0, 5.9])
        for n in range(6)
    ]
    return pd.DataFrame(rows)


def trace_table(legs: int = 4, rows: int = 2) -> pd.DataFrame:
    """A trace job: contacts of legs that swing one after another, the same in all rows."""
    t = np.arange(0.0, 50.0, 0.05)
    parts = []
    for row in range(rows):
        contact = {f"contact_{i + 1}": (((t - 2.5 * i) % 15.0) < 12.0).astype(float) for i in range(legs)}
        parts.append(pd.DataFrame({"row": row, "t": t, **contact, "status": "complete"}))
    return pd.concat(parts, ignore_index=True)


def rendered(figure: Figure) -> None:
    """Render a small image: some mistakes raise only then."""
    figure.savefig(io.BytesIO(), format="png", dpi=40)


def legend_texts(part: Figure | Axes) -> list[str]:
    """The texts of the legends of a figure, or of the legend of axes."""
    legends = part.legends if isinstance(part, Figure) else [part.get_legend()]
    return [text.get_text() for legend in legends if legend is not None for text in legend.get_texts()]
