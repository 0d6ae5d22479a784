"""The figures of the paper; a job asks for one by its function's name."""

from typing import Annotated

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from gaitsweep.plot import Column, Observed, Title, column, described, figure_kind, theme


@figure_kind("return_map")
def goswami1998_bifurcations(
    table: pd.DataFrame,
    *,
    y: Observed,
    x: Annotated[Column, "column of the parameter"] = "phi",
    title: Title = None,
) -> Figure:
    """The values of an observable at successive steps, over a parameter."""
    name = column(table, y, ("_n", ""))
    complete = table.loc[np.asarray(table["status"] == "complete")]
    with theme.canvas(theme.COLUMN + 1.6, 3.2, title) as figure:
        axes = figure.subplots()
        axes.plot(complete[x], complete[name], ".", ms=1.2, mew=0, color="#0072B2")
        axes.set_xlabel(described(table, x))
        axes.set_ylabel(described(table, name, 36))
    return figure
