"""The figures of the paper; a job asks for one by its function's name."""

import pandas as pd
from matplotlib.figure import Figure

from gaitsweep.plot import Title, figure_kind, theme


@figure_kind("settle")
def hopper_launches(table: pd.DataFrame, *, title: Title | None = None) -> Figure:
    """Draw how often each speed of launch is settled at."""
    with theme.canvas(theme.COLUMN, 2.4, title) as figure:
        axes = figure.subplots()
        axes.hist(table["launch_end"], bins=40, range=(0.0, 10.0), color="#0072B2")
        axes.set_xlabel("speed of the launch (m/s)")
        axes.set_ylabel("starts")
    return figure
