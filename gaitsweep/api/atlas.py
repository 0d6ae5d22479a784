"""Atlas of a model from keywords: its gaits, their branches, bifurcations, and curves in two parameters."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from gaitsweep.analysis.atlas.atlas_tables import atlas_tables
from gaitsweep.api.keywords import AnyModel
from gaitsweep.api.result import Result
from gaitsweep.api.run import run, run_in_memory
from gaitsweep.api.sweep import sweep
from gaitsweep.errors import ArgumentError
from gaitsweep.job.load import wider_job
from gaitsweep.kinds import Atlas as AtlasRun

if TYPE_CHECKING:
    from gaitsweep.api.figures_of_table import FiguresOfTable


class Atlas:
    """The atlas of a model, as tables.

    Example:
        A ball on a shaking table stays in flight for one period of it from G = pi (1 - e) / (1 + e) on, and
        bounces twice as high in turns from a flip on (Luck and Mehta 1993):

        >>> import numpy as np, gaitsweep as gs
        >>> from gaitsweep.examples.bouncing_ball import BouncingBall
        >>> ball = gs.atlas(
        ...     BouncingBall(), parameter="G", path=(0.9, 1.6), at=1.2, depth=0, periods=1, budget=64,
        ...     ranges={"phase_0": (0.0, 2.0 * np.pi), "speed_0": (0.0, 6.0)},
        ... )
        >>> ball.gaits["stable"].tolist()
        [False, True]
        >>> ball.points[["special", "G"]].round(6).values.tolist()
        [['fold', 1.047198], ['flip', 1.526824]]
        >>> fold = np.pi / 3.0
        >>> [round(float(G), 6) for G in (fold, np.hypot(fold, 10.0 / 9.0))]
        [1.047198, 1.526824]
    """

    def __init__(self, result: Result | pd.DataFrame) -> None:
        """Keep the result of a run of the kind `atlas`, or its table, such as `gs.load(DIR)`.

        Raises:
            ArgumentError: it is another kind's, neither a result nor a table, or a table without its job, as
                from a file that another program has written.
        """
        self.result = Result(table=result) if isinstance(result, pd.DataFrame) else result
        if not isinstance(self.result, Result):
            raise ArgumentError(
                f"An atlas is made of a result or its table, not of {type(result).__name__}: give "
                "gs.load(DIR)."
            )
        self._table = self.result.table
        job = self._table.attrs.get("job")
        if missing := [name for name in ("part", "found", "special") if name not in self._table]:
            kind = "no run" if job is None else job.get("run", {}).get("kind", "no run")
            raise ArgumentError(
                f"The table lacks {', '.join(missing)} of a run of kind atlas: it is one of {kind}."
            )
        if job is None:
            raise ArgumentError(
                "The table has no job in its .attrs: read it from its directory by gs.load(DIR)."
            )

    def __repr__(self) -> str:
        return f"Atlas({len(self.gaits)} gaits, {len(self.points)} bifurcations)"

    @property
    def table(self) -> pd.DataFrame:
        """Everything in one table, as a job stores it."""
        return self._table

    @property
    def gaits(self) -> pd.DataFrame:
        """All gaits at the value of the parameter where they were searched, a record each."""
        return self._tables["gaits"]

    @property
    def branches(self) -> pd.DataFrame:
        """The branches, a record for each point; `number` is the branch."""
        return self._tables["branches"]

    @property
    def points(self) -> pd.DataFrame:
        """The bifurcations on the branches, a record each; `special` is the kind."""
        return self._tables["points"]

    @property
    def curves(self) -> pd.DataFrame:
        """The curves of bifurcations in both parameters, a record for each point; `number` is the curve."""
        return self._tables["curves"]

    @property
    def missing(self) -> float:
        """An estimate of the number of gaits that were not found, of the row where it is largest."""
        return float(np.nanmax(self._table["missing"].to_numpy(float), initial=0.0))

    def more(self, out: str | Path | None = None) -> Atlas:
        """Make the atlas again with twice the starts, patience and branches, one bifurcation deeper.

        Args:
            out: its result directory; without it its tables are in memory.
        """
        job = wider_job(self._table.attrs)
        return Atlas(run_in_memory(job) if out is None else run(job, out))

    @property
    def plot(self) -> FiguresOfTable:
        """Figures of the atlas: `road_map()`, `atlas()`, `orbit_family()`, each a method of it."""
        return self.result.plot

    @functools.cached_property
    def _tables(self) -> dict[str, pd.DataFrame]:
        """The four tables by name."""
        return atlas_tables(self._table, self._table.attrs["job"]["run"]["parameter"])


def atlas(
    model: AnyModel,
    *,
    parameter: str,
    path: Sequence[float],
    ranges: Mapping[str, Sequence[float]],
    at: float | None = None,
    second: Mapping[str, Sequence[float]] | None = None,
    **keywords: Any,
) -> Atlas:
    """Find all periodic gaits of a model and follow them, and what they meet, along a parameter.

    Args:
        model: an instance, a class, a registered name, or "package.module:attribute".
        parameter: the parameter along which gaits are followed.
        path: its range, two numbers.
        ranges: the ranges from which starts are drawn, of start values or of coordinates of the section.
        at: the value of the parameter at which gaits are searched; by default the first of `path`.
        second: a second parameter and its range, {name: (lowest, highest)}: bifurcations are followed in the
            plane of both.
        keywords: as for `sweep`: parameters and start values by name, `out`, `params`, `start`, `numerics`,
            `engine`, `verify`, `client`; and the other fields of the run kind: periods, depth, budget, batch,
            patience, seed, branches, settle, fix, step, longest, shortest, most.

    Raises:
        ArgumentError: a name that the model does not have, or a field that is not allowed.
        JobError: all other errors.
    """
    fields = {"parameter": parameter, "path": path, "ranges": ranges, "at": at, "second": second}
    options = {name: keywords.pop(name) for name in list(keywords) if name in AtlasRun.model_fields}
    kind = AtlasRun(**{name: value for name, value in fields.items() if value is not None}, **options)
    return Atlas(sweep(model, run=kind, **keywords))
