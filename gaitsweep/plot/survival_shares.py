"""Survival: the share of seeded rows that walk for some steps, over roughness or another parameter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pydantic import Field

from gaitsweep.analysis.falls import survival as share_that_walks
from gaitsweep.plot import theme
from gaitsweep.plot.arguments import AlongAxis, Title
from gaitsweep.plot.column_labels import described
from gaitsweep.plot.columns import require_columns, require_one_system
from gaitsweep.plot.kind import check_one_system, figure_kind
from gaitsweep.schema.numbers import Count


@figure_kind("fixed_time", check=check_one_system, coloured="none")
def survival(
    table: pd.DataFrame,
    *,
    x: Annotated[AlongAxis, "column of the varying parameter, such as ground_roughness"],
    steps: Annotated[
        Sequence[Count], Field(min_length=1, max_length=8), "section crossings, one line for each number"
    ] = (10, 100),
    title: Title = None,
) -> Figure:
    """The share of rows that make some steps before they fall, with its 95 % interval, over a parameter.

    Rows at one value of the parameter differ in their seed.

    Args:
        table: a table of kind fixed_time, complete or partial.

    Raises:
        PlotError: the table lacks a column, more than a twentieth of the rows at one value ended before so
            many steps without a fall, or rows ended in another way.
    """
    require_columns(table, x)
    require_one_system(table, x)
    with theme.canvas(theme.COLUMN, 2.6, title) as figure:
        axes = figure.subplots()
        axes.set_xlabel(described(table, x, 40))
        axes.set_ylabel("share of rows that still walk")
        axes.set_ylim(-0.02, 1.02)
        if not len(table):
            theme.message(axes, "no rows yet")
            return figure
        for number, count in enumerate(sorted(set(steps))):
            shares = share_that_walks(table, x, steps=count).sort_values(x)
            share = shares["share"].to_numpy(float)
            ends = np.abs(shares[["low", "high"]].to_numpy(float).T - share)
            look: dict[str, Any] = {"lw": 0.9, "ms": 3.5, "capsize": 2.0}
            look["color"] = theme.SPARE_COLOURS[number % len(theme.SPARE_COLOURS)]
            look["marker"] = theme.SPARE_MARKERS[number % len(theme.SPARE_MARKERS)]
            look["label"] = f"{count} step" + "s" * (count != 1)
            axes.errorbar(shares[x].to_numpy(float), share, ends, **look)
        theme.legend(figure, *axes.get_legend_handles_labels(), ncols=4)
    return figure
