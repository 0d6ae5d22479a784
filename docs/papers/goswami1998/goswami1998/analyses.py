"""Analyses of the paper's tables: functions, and commands of `gaitsweep analyse`."""

import pandas as pd
import typer

import gaitsweep as gs
from gaitsweep.cli import Directory, print_table

app = typer.Typer()


def steps_over_slope(table: pd.DataFrame) -> pd.DataFrame:
    """The ranges of the slope (deg) in which the gait repeats after the same number of steps, in order.

    A number 0 stands for rows that do not repeat within 8 steps, or that fell (`status`).
    """
    rows = table.sort_values("phi")
    key = rows["attractor_period"].astype(str) + rows["status"].astype(str)
    groups = rows.groupby((key != key.shift()).cumsum(), sort=True)
    ranges = groups.agg(
        steps=("attractor_period", "first"),
        status=("status", "first"),
        first=("phi", "min"),
        last=("phi", "max"),
        rows=("phi", "size"),
    )
    return ranges.reset_index(drop=True)


@app.command()
def goswami1998_steps(directory: Directory) -> None:
    """Print after how many steps the compass gait repeats, over the slope."""
    print_table(steps_over_slope(gs.load(directory)))
