"""Analyses of the paper's tables: functions, and commands of `gaitsweep analyse`."""

import pandas as pd
import typer

import gaitsweep as gs
from gaitsweep.cli import Directory, print_table

app = typer.Typer()


def launches(table: pd.DataFrame) -> pd.DataFrame:
    """Compute the number of rows and the median launch speed (m/s) of each gait.

    Raises:
        gaitsweep.analyses.AnalysisError: the table does not have a column.
    """
    gs.analyses.require(table, "status", "gait", "launch_end")
    settled = table.loc[table["status"] == "settled"]
    groups = settled.groupby("gait", observed=True)["launch_end"]
    return groups.agg(rows="size", launch="median").reset_index()


@app.command()
def hopper_launches(directory: Directory) -> None:
    """Print the speed of the launch in each gait."""
    print_table(launches(gs.load(directory)))
