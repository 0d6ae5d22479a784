"""Figures of a search (score, profiles of constants, misses of targets) and of a sensitivity analysis."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.free_parameters import FreeParameter, number_of_sets
from gaitsweep.fitting.identifiability import PARTS, Constant, Identifiability
from gaitsweep.fitting.search_job import Search
from gaitsweep.fitting.targets import FAILED_MISS, MISS
from gaitsweep.near_miss import suggestion
from gaitsweep.plot import theme
from gaitsweep.plot.column_labels import axis_label, described, symbol
from gaitsweep.status import SetStatus
from gaitsweep.table import own_folder, replace_file, writing
from gaitsweep.table.manifest import FIGURES as FOLDER

# The figures, in their order.
FIGURES = ("convergence", "constants", "misses")

_ORANGE, _BLUE, _GREEN = theme.SPARE_COLOURS[:3]
_GREY = "#BBBBBB"
_DARK_GREY = "#555555"
_LIGHT_GREY = "#EDEDED"
# Sets whose misses are drawn, at most.
_MAX_LINES = 200
# The score below which an axis is linear, where scores are 0.
_LINEAR_BELOW = 1e-2
# Labels along an axis are written aslant if they have more letters in all.
_MAX_CHOICE_LETTERS = 14
_MAX_TARGET_LETTERS = 60
_ASLANT: dict[str, Any] = {"rotation": 30, "ha": "right"}


def draw_search(path: Path, search: Search, table: pd.DataFrame, near: Identifiability) -> list[Path]:
    """Draw the figures of a search into its directory; return their files.

    Args:
        path: the result directory.
        search: the search.
        table: its sets.
        near: identifiability of the constants.

    Raises:
        TableError: a file could not be written.
    """
    return [write_figure(path, f"{name}.png", search_figure(name, search, table, near)) for name in FIGURES]


def write_figure(path: Path, name: str, figure: Figure, **options: Any) -> Path:
    """Write a figure into the folder of figures of a result directory; return its file.

    Args:
        path: the result directory.
        name: the name of the file, a PNG.
        figure: the figure.
        options: further arguments of `savefig`.

    Raises:
        TableError: the file could not be written.
    """
    file = path / FOLDER / name
    with writing(f"{file} could not be written"):
        own_folder(file.parent)
        replace_file(file, lambda handle: figure.savefig(handle, format="png", **options))
    return file


def search_figure(name: str, search: Search, table: pd.DataFrame, near: Identifiability) -> Figure:
    """Draw one of the figures of a search.

    Args:
        name: one of FIGURES.
        search, table, near: as for `draw_search`.

    Raises:
        ArgumentError: there is no figure of this name.
    """
    if name not in FIGURES:
        raise ArgumentError(f"{name} is not a figure of a search{suggestion(name, FIGURES)}")
    if name == "convergence":
        return _convergence(table)
    if name == "constants":
        return _constants(search.free, table, near)
    return _misses(search, table, near)


def _convergence(table: pd.DataFrame) -> Figure:
    """Draw the score of each set, and the least so far; failed sets are marked on top."""
    numbers = table["row"].to_numpy() + 1
    failed = SetStatus.FAILED.among(table)
    scores = np.where(failed, np.nan, table["score"].to_numpy())
    with theme.canvas(theme.PAGE / 2, 2.6) as figure:
        axes = figure.add_subplot()
        axes.plot(numbers, scores, ".", color=_GREY, ms=2.0, label="a set", rasterized=True)
        best = np.fmin.accumulate(scores)
        axes.plot(numbers, best, color=_BLUE, lw=1.4, label="best so far")
        axes.axhline(1.0, color="black", lw=0.6, ls=":", label="reading error")
        _score_axis(axes, scores)
        if failed.any():
            above_the_axes = np.full(int(failed.sum()), 1.02)  # as a share of their height
            style: dict[str, Any] = {"color": "black", "ms": 3.0, "mew": 0.4, "clip_on": False}
            style |= {"transform": axes.get_xaxis_transform(), "label": f"{failed.sum()} failed sets"}
            axes.plot(numbers[failed], above_the_axes, "|", **style)
        axes.set_xlim(0.5, numbers.max() + 0.5)
        axes.set_xlabel("sets measured")
        axes.set_ylabel("score: root mean square miss,\nin reading errors")
        theme.legend(figure, ncols=4)
    return figure


def _score_axis(axes: Axes, scores: Float[np.ndarray, " scores"]) -> None:
    """Set a logarithmic axis of scores, with a linear part if some are 0, as misses of ranges are."""
    finite = scores[np.isfinite(scores)]
    if finite.size and finite.min() > 0.0:
        axes.set_yscale("log")
    else:
        axes.set_yscale("symlog", linthresh=_LINEAR_BELOW)


def _constants(free: Mapping[str, FreeParameter], table: pd.DataFrame, near: Identifiability) -> Figure:
    """Draw the least score over each constant's range, and the values of the near-best sets."""
    rows, columns = theme.shape(len(free), theme.PAGE, 1.5, 4)
    fitting = f"{number_of_sets(near.fitting)} that fit{'s' * (near.fitting == 1)} all targets"
    fits = fitting if near.fitting else number_of_sets(len(near.best), "near-best set")
    title = f"Blue: least score in each twentieth of a range. Orange: {fits}."
    with theme.canvas(theme.PAGE, 0.6 + 1.6 * rows, title) as figure:
        panels = theme.panels(figure, (rows, columns), len(free), sharey=True)
        for axes, constant in zip(panels, near.constants, strict=True):
            _profile(axes, free[constant.name].ordered, constant, near.best)
            width = theme.width_of(theme.PAGE) / columns - 0.3
            axes.set_xlabel(theme.wrapped(described(table, constant.name), width, 8.5))
        for axes in panels[::columns]:
            axes.set_ylabel("least score")
    return figure


def _profile(axes: Axes, free: FreeParameter, constant: Constant, best: pd.DataFrame) -> None:
    """Draw the least score in each part of a constant's range, and the constant in the near-best sets."""
    edges = np.linspace(0.0, 1.0, PARTS + 1)
    axes.stairs(constant.profile, edges, color=_BLUE, lw=1.2, baseline=None)
    shares = free.share(free.written(best[constant.name].tolist())) if len(best) else np.zeros(0)
    axes.plot(shares, best["score"], "o", color=_ORANGE, ms=2.5, rasterized=True)
    _score_axis(axes, constant.profile)
    axes.set_xlim(0.0, 1.0)
    if free.choices is not None:
        _choice_ticks(axes, [str(choice) for choice in free.choices])
    else:
        ticks = np.array([0.0, 0.5, 1.0])
        axes.set_xticks(ticks, [f"{value:.3g}" for value in free.at(ticks)])
        # inside the panel, so that they do not overlap labels of the next one
        for label, side in zip(axes.get_xticklabels(), ("left", "center", "right"), strict=True):
            label.set_horizontalalignment(side)
    axes.set_title(constant.verdict, fontsize=7.5)


def _choice_ticks(axes: Axes, choices: list[str]) -> None:
    """Label the equal parts of an axis from 0 to 1 with choices."""
    letters = sum(map(len, choices))
    centres = (np.arange(len(choices)) + 0.5) / len(choices)
    axes.set_xticks(centres, choices, **(_ASLANT if letters > _MAX_CHOICE_LETTERS else {}))


def _misses(search: Search, table: pd.DataFrame, near: Identifiability) -> Figure:
    """Draw the misses of the near-best sets, a line each, and of the sets that miss each target least."""
    names = list(search.targets)
    columns = [f"{MISS}{name}" for name in names]
    least = _least_of_each(search, table)[columns].to_numpy()
    others = near.best[columns].iloc[1:_MAX_LINES].to_numpy()
    best = near.best[columns].iloc[:1].to_numpy()
    drawn = np.concatenate([least, others, best])
    has_value = np.abs(drawn) < FAILED_MISS
    limit = 1.5 * max(2.0, float(np.max(np.abs(drawn), where=has_value, initial=0.0)))
    positions = np.arange(len(names))
    is_long = sum(map(len, names)) > _MAX_TARGET_LETTERS
    with theme.canvas(theme.PAGE, 3.4 if is_long else 2.8) as figure:
        axes = figure.add_subplot()
        axes.axhspan(-1.0, 1.0, color=_LIGHT_GREY, lw=0, label="within reading error")
        styles: dict[str, tuple[Float[np.ndarray, "sets targets"], dict[str, Any]]] = {
            "least miss of one target": (least, {"color": _DARK_GREY, "lw": 0.8, "ls": "--"}),
            "near-best sets": (others, {"color": _ORANGE, "lw": 0.6, "alpha": 0.5}),
            "best set": (best, {"color": _BLUE, "lw": 1.4, "marker": "o", "ms": 3.0}),
        }
        for label, (lines, style) in styles.items():
            for number, values in enumerate(np.clip(lines, -limit, limit)):
                entry = label if number == 0 else None  # one entry of the legend for all lines
                axes.plot(positions, values, label=entry, **style)
        lost = (~has_value).any(axis=0)
        if lost.any():
            marks: dict[str, Any] = {"color": "black", "ms": 4, "clip_on": False, "label": "no value"}
            axes.plot(positions[lost], np.full(int(lost.sum()), limit), "x", **marks)
        held_back = ", held back" if is_long else "\nheld back"
        labels = [f"{name}{held_back}" if name not in search.counted else name for name in names]
        axes.set_xticks(positions, labels, **(_ASLANT if is_long else {}))
        axes.set_yscale("symlog", linthresh=1.0)
        axes.yaxis.set_major_formatter("{x:g}")  # 1 and -1, the reading errors, are not written as powers
        axes.set_ylim(-limit, limit)
        axes.set_xlim(-0.3, len(names) - 0.7)
        axes.set_ylabel("miss, in reading errors")
        theme.legend(figure, ncols=5)
    return figure


def _least_of_each(search: Search, table: pd.DataFrame) -> pd.DataFrame:
    """Return the set that misses each counting target least, of equal ones that with the best score."""
    rows = []
    for name in search.counted:
        sorted_sets = table.assign(_miss=table[f"{MISS}{name}"].abs()).sort_values(["_miss", "score"])
        rows.append(sorted_sets.index[0])
    return table.loc[list(dict.fromkeys(rows))]


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
