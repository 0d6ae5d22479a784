"""One row of a trace table, with the model and the parameters that it was run with."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd

from gaitsweep.contract import Model
from gaitsweep.job import Job
from gaitsweep.plot import PlotError
from gaitsweep.plot.columns import rows_where, written
from gaitsweep.table import load

_NAMED = 4  # quantities in a title


@dataclasses.dataclass(frozen=True)
class Motion:
    """What a row recorded: signals (n,) by name at the times `t` (n,) s.

    `values` are the row's parameters by name; `period` s is its model's nominal cycle; `title` names the row.
    """

    model: Model
    values: Mapping[str, float]
    t: np.ndarray
    signals: Mapping[str, np.ndarray]
    period: float
    title: str

    def at(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """The signals at times (k,) s: linear between samples; angles and contacts of the nearest sample."""
        edges = 0.5 * (self.t[1:] + self.t[:-1])
        nearest = np.searchsorted(edges, times)
        circular = {quantity.name for quantity in self.model.signals if quantity.circular}
        return {
            name: signal[nearest]
            if name in circular or name.startswith("contact_")
            else np.interp(times, self.t, signal)
            for name, signal in self.signals.items()
        }

    def contact(self, limbs: int) -> np.ndarray:
        """1 where a limb is on the ground, (n, limbs).

        Raises:
            PlotError: the model has no such signal for one of them.
        """
        names = [f"contact_{i + 1}" for i in range(limbs)]
        for name in names:
            if name not in self.signals:
                raise PlotError(f"{self.model.name} has no signal {name}, which says when a foot is down.")
        return np.stack([self.signals[name] for name in names], axis=1)


def read_motion(directory: str | Path, row: int) -> Motion:
    """Read a row of a result directory.

    Raises:
        PlotError: the table is not a trace's, lacks signals, or has no such row or nothing recorded for it.
        TableError, JobError: the directory cannot be read, or its job.
    """
    directory = Path(directory)
    table = load(directory)
    kind = table.attrs["job"].get("run", {}).get("kind", "another kind")
    if kind != "trace":
        raise PlotError(f"{directory} holds {kind} rows, which have no motion: use a run of kind trace.")
    part = _samples(table, directory, row)
    # the job that was run, whatever `job.yaml` says by now
    rows = Job.model_validate(table.attrs["job"], context={"folder": directory}).plan
    missing = [quantity.name for quantity in rows.model.signals if quantity.name not in part.columns]
    if missing:
        names = ", ".join(missing[:_NAMED]) + (", ..." if len(missing) > _NAMED else "")
        raise PlotError(
            f"The table of {directory} lacks the signals {names}: run its job again, into another directory."
        )
    names = [quantity.name for quantity in rows.model.signals]
    finite = np.isfinite(part[["t", *names]].to_numpy(float)).all(axis=1)
    part = rows_where(part, finite).sort_values("t")
    if len(part) < 2:
        status = str(table.loc[table["row"] == row, "status"].iloc[0])
        raise PlotError(f"Row {row} of {directory} recorded no motion: it ended as {status}.")
    parameters, _ = rows.values(row, row + 1)
    values = {name: float(value[0]) for name, value in parameters.items()}
    params = {name: jnp.asarray(value[0]) for name, value in rows.model.on_host(parameters).items()}
    set_to = [written(table, name, part[name].iloc[0]) for name in rows.names if name in part.columns]
    return Motion(
        model=rows.model,
        values=values,
        t=part["t"].to_numpy(float),
        signals={name: part[name].to_numpy(float) for name in names},
        period=float(rows.model.period(rows.model.params(params))),
        title=f"{rows.model.name}, row {row}{': ' if set_to else ''}{', '.join(set_to[:_NAMED])}",
    )


def _samples(table: pd.DataFrame, directory: Path, row: int) -> pd.DataFrame:
    rows = int(table.attrs["manifest"]["rows"])
    if not 0 <= row < rows:
        allowed = f"rows 0 to {rows - 1}" if rows > 1 else "row 0 alone"
        raise PlotError(f"There is no row {row}: {directory} has {allowed}.")
    part = rows_where(table, table["row"] == row)
    if part.empty:
        raise PlotError(f"Row {row} of {directory} has not been run yet: run the job again to continue it.")
    return part
