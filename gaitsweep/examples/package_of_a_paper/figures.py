"""The figures of the paper; a job asks for one by its function's name."""

import pandas as pd
from matplotlib.figure import Figure

from gaitsweep.plot import Title, figure_kind, theme


@figure_kind("settle")
def hopper_launches(table: pd.DataFrame, *, title: Title | None = None) -> Figure:
    """Draw a histogram of the launch speeds at the ends of the rows that settled."""
    with theme.canvas(theme.COLUMN, 2.4, title) as figure:
        axes = figure.subplots()
        settled = table.loc[table["status"] == "settled", "launch_end"]
        axes.hist(settled, bins=40)
        axes.set_xlabel("launch speed at the end (m/s)")
        axes.set_ylabel("rows")
    return figure
