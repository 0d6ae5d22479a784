"""Sensitivity indices as bars with their intervals, a panel for each output."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitsweep.plot import theme
from gaitsweep.plot.columns import axis_label, symbol

# Indices that are drawn, by method: the words of the legend.
_DRAWN = {
    "one_at_a_time": {"change_low": "at the low end", "change_high": "at the high end"},
    "morris": {"mu_star": "$\\mu^*$, mean size of the effects", "sigma": "$\\sigma$, their spread"},
    "sobol": {"ST": "$S_T$, with interactions", "S1": "$S_1$, alone"},
    "rbd_fast": {"S1": "$S_1$, alone (RBD-FAST)"},
}
_ACROSS = 3  # panels beside each other
_ROW, _REST = 0.2, 0.9  # inches: of a parameter, and of a panel's title and axis


def sensitivity_figure(indices: pd.DataFrame) -> Figure:
    """Bars of the indices of each output, the most important parameter on top.

    Args:
        indices: one record per index, with the columns `gaitsweep.fitting.indices.COLUMNS`; `.attrs` may have
            `quantities` with symbols and units.
    """
    outputs = list(dict.fromkeys(indices["output"]))
    parameters = len(set(indices["parameter"]))
    wide = theme.PAGE * max(0.5, min(len(outputs), _ACROSS) / _ACROSS)
    down, across = theme.shape(len(outputs), wide, 1.6, 2 if len(outputs) == 4 else _ACROSS)
    bars = max(len(_DRAWN[method]) for method in set(indices["method"]))
    height = down * (_REST + parameters * _ROW * max(1.0, 0.6 * bars)) + 0.35
    with theme.canvas(wide, height) as figure:
        panels = theme.panels(figure, len(outputs), down, across)
        shown: dict[str, Any] = {}
        for axes, output in zip(panels, outputs, strict=True):
            here = indices.loc[indices["output"] == output]
            shown |= _panel(axes, here, indices)
            axes.set_title(axis_label(indices, output) if output in _quantities(indices) else output)
        if shown:
            look: dict[str, Any] = {"ncols": len(shown), "title": _meanings(indices)}
            theme.legend(figure, list(shown.values()), list(shown), **look)
    return figure


def _meanings(indices: pd.DataFrame) -> str | None:
    """The parameters' symbols with their meanings, for the legend."""
    known: Any = _quantities(indices)
    names = [name for name in dict.fromkeys(indices["parameter"]) if known.get(name, {}).get("meaning")]
    return "; ".join(f"{symbol(indices, name)}: {known[name]['meaning']}" for name in names) or None


def _quantities(indices: pd.DataFrame) -> dict[str, object]:
    return indices.attrs.get("quantities", {})


def _panel(axes: Axes, here: pd.DataFrame, indices: pd.DataFrame) -> dict[str, Any]:
    """One output; returns the bars by the words of the legend."""
    method = here["method"].iloc[0]
    drawn = _DRAWN[method]
    names = list(dict.fromkeys(here["parameter"]))
    of = {(row["parameter"], row["index"]): row for row in here.to_dict("records")}

    def column(index: str, field: str) -> np.ndarray:
        """A field of an index for each parameter; NaN if it is missing."""
        return np.array([of.get((name, index), {}).get(field, np.nan) for name in names], float)

    known = any(np.isfinite(column(index, "value")).any() for index in drawn)
    if not known:
        axes.set_axis_off()
        theme.message(axes, here["note"].iloc[0])
        return {}
    place, thick = np.arange(len(names)), 0.8 / len(drawn)
    shown = {}
    for number, (index, words) in enumerate(drawn.items()):
        values, half = column(index, "value"), column(index, "confidence")
        shown[words] = axes.barh(
            place + (number - 0.5 * (len(drawn) - 1)) * thick,
            values,
            thick,
            xerr=None if np.isnan(half).all() else np.nan_to_num(half),
            color=theme.SPARE_COLOURS[2 if method == "rbd_fast" else (1, 0)[number]],
            error_kw={"elinewidth": 0.8, "capsize": 1.5},
        )
    axes.axvline(0.0, color="black", linewidth=0.6)
    axes.set_yticks(place, [symbol(indices, name) for name in names])
    axes.set_ylim(len(names) - 0.45, -0.55)
    unit = here["unit"].iloc[0]
    what = {"one_at_a_time": "change", "morris": "effect of the whole range"}.get(method)
    if what is None:
        axes.set_xlabel("share of the variance")
    else:
        axes.set_xlabel(f"{what} ({unit})" if unit != "1" else what)
    return shown
