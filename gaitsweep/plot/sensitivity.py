"""Sensitivity indices as bars with their intervals, a panel for each output."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitsweep.plot import theme
from gaitsweep.plot.column_labels import axis_label, symbol

_BLUE, _ORANGE, _GREEN = "#0072B2", "#E69F00", "#009E73"  # Okabe and Ito's
# Indices that are drawn, by method: the words of the legend and the colour.
_DRAWN = {
    "one_at_a_time": {"change_low": ("at the low end", _BLUE), "change_high": ("at the high end", _ORANGE)},
    "morris": {
        "mu_star": ("$\\mu^*$, mean size of the effects", _BLUE),
        "sigma": ("$\\sigma$, their spread", _ORANGE),
    },
    "sobol": {"ST": ("$S_T$, with interactions", _BLUE), "S1": ("$S_1$, alone", _ORANGE)},
    "rbd_fast": {"S1": ("$S_1$, alone (RBD-FAST)", _GREEN)},
}
_EFFECTS = {"one_at_a_time": "change", "morris": "effect of the whole range"}  # the others are shares
_ACROSS = 3  # panels beside each other
_ROW = 0.2  # inches: height of a parameter
_AROUND = 0.9  # inches: height of a panel's title and axis


def sensitivity_figure(indices: pd.DataFrame) -> Figure:
    """Bars of the indices of each output, the most important parameter on top.

    Args:
        indices: one record per index, with the columns `gaitsweep.fitting.sensitivity_methods.COLUMNS`;
            `.attrs` may have `quantities` with symbols and units.
    """
    outputs = list(dict.fromkeys(indices["output"]))
    parameters = len(set(indices["parameter"]))
    wide = theme.PAGE * max(0.5, min(len(outputs), _ACROSS) / _ACROSS)
    down, across = theme.shape(len(outputs), wide, 1.6, 2 if len(outputs) == 4 else _ACROSS)
    bars = max(len(_DRAWN[method]) for method in set(indices["method"]))
    height = down * (_AROUND + parameters * _ROW * max(1.0, 0.6 * bars)) + 0.35
    with theme.canvas(wide, height) as figure:
        panels = theme.panels(figure, (down, across), len(outputs))
        bars_of: dict[str, Any] = {}
        quantities: Mapping[str, Mapping[str, Any]] = indices.attrs.get("quantities", {})
        for axes, output in zip(panels, outputs, strict=True):
            bars_of |= _panel(axes, indices.loc[indices["output"] == output], indices)
            axes.set_title(axis_label(indices, output) if output in quantities else output)
        if bars_of:
            meanings = {name: quantities.get(name, {}).get("meaning") for name in indices["parameter"]}
            texts = [f"{symbol(indices, name)}: {meaning}" for name, meaning in meanings.items() if meaning]
            look: dict[str, Any] = {"ncols": len(bars_of), "title": "; ".join(texts) or None}
            theme.legend(figure, list(bars_of.values()), list(bars_of), **look)
    return figure


def _panel(axes: Axes, of_output: pd.DataFrame, indices: pd.DataFrame) -> dict[str, Any]:
    """Draw the indices of one output; returns the bars by the words of the legend."""
    method = of_output["method"].iloc[0]
    drawn = _DRAWN[method]
    names = list(dict.fromkeys(of_output["parameter"]))

    def column(field: str, index: str) -> Float[np.ndarray, " parameters"]:
        """A field of an index for each parameter; NaN if it is missing."""
        records = of_output.loc[of_output["index"] == index].set_index("parameter")
        return np.asarray(records[field].reindex(names), float)

    if not any(np.isfinite(column("value", index)).any() for index in drawn):
        axes.set_axis_off()
        theme.message(axes, of_output["note"].iloc[0])
        return {}
    levels = np.arange(len(names))
    thickness = 0.8 / len(drawn)
    bars = {}
    for number, (index, (text, colour)) in enumerate(drawn.items()):
        half_width = column("confidence", index)
        bars[text] = axes.barh(
            levels + (number - 0.5 * (len(drawn) - 1)) * thickness,
            column("value", index),
            thickness,
            xerr=None if np.isnan(half_width).all() else np.nan_to_num(half_width),
            color=colour,
            error_kw={"elinewidth": 0.8, "capsize": 1.5},
        )
    axes.axvline(0.0, color="black", linewidth=0.6)
    axes.set_yticks(levels, [symbol(indices, name) for name in names])
    axes.set_ylim(len(names) - 0.45, -0.55)
    unit = of_output["unit"].iloc[0]
    label = _EFFECTS.get(method, "share of the variance")
    axes.set_xlabel(f"{label} ({unit})" if method in _EFFECTS and unit != "1" else label)
    return bars
