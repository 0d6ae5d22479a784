"""Result of a run: its table, its figures, and the job that reproduces it."""

from __future__ import annotations

import html
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import yaml

from gaitsweep.errors import ArgumentError
from gaitsweep.models import importable
from gaitsweep.runs.sentences import self_check_sentence
from gaitsweep.table import load
from gaitsweep.table.manifest import read_manifest
from gaitsweep.table.reading import figure_files

if TYPE_CHECKING:
    import xarray  # pyright: ignore[reportMissingImports]

    from gaitsweep.api.figures_of_table import FiguresOfTable

_SHOWN_ROWS = 5


class Result:
    """A run's table, in a result directory or in memory.

    Example:
        >>> import gaitsweep as gs
        >>> from gaitsweep.examples.hopper import Hopper
        >>> result = gs.sweep(Hopper(), launch_0=[2.5, 5.0, 7.0], phase_0=2.0)
        >>> result.manifest["counts"]
        {'settled': 3}
        >>> result.table["gait"].tolist()
        ['1:1', '2:1', '3:1']
        >>> result.table.attrs["quantities"]["launch"]["unit"]
        'm/s'
    """

    def __init__(self, path: str | Path | None = None, table: pd.DataFrame | None = None) -> None:
        """Keep the directory, or the table of a result in memory.

        Raises:
            ArgumentError: neither is given.
        """
        if path is None and table is None:
            raise ArgumentError("A Result has a directory or a table: give path or table.")
        self._path = None if path is None else Path(path)
        self._table = table

    if not TYPE_CHECKING:  # a type checker knows what a result has

        def __getattr__(self, name: str) -> Any:
            """Refuse what a table has and a result has not; Python calls this for no other name."""
            of_table = not name.startswith("_") and hasattr(pd.DataFrame, name)
            hint = "; its table has: give .table" if of_table else ""
            raise AttributeError(f"A Result has no {name}{hint}.", name=name, obj=self)

        def __getitem__(self, name: Any) -> Any:
            raise TypeError("A Result has no columns; its table has: give .table.")

    @property
    def path(self) -> Path:
        """The result directory.

        Raises:
            ArgumentError: the result is in memory.
        """
        if self._path is None:
            raise ArgumentError("This result is in memory, without a directory: give out= to keep one.")
        return self._path

    @property
    def table(self) -> pd.DataFrame:
        """Table with units and provenance in `.attrs`; read anew each time from a directory."""
        return load(self.path) if self._table is None else self._table

    @property
    def manifest(self) -> dict[str, Any]:
        """Job, hash, versions, device, timings, counts by status, self-check.

        Raises:
            ArgumentError: the table in memory has none in its `.attrs`.
        """
        if self._table is None:
            return read_manifest(self.path)
        if "manifest" not in self._table.attrs:
            raise ArgumentError(
                "The table has no manifest in its .attrs, which pandas.concat and merge drop: join results "
                "by gs.concat, or give the table of a run."
            )
        return self._table.attrs["manifest"]

    @property
    def figures(self) -> list[Path]:
        """Files of the job's figures."""
        return [] if self._path is None else figure_files(self._path)

    @property
    def plot(self) -> FiguresOfTable:
        """Figures of `gaitsweep.plot` for this table: `result.plot.basin(x="psi_1", y="psi_2")`."""
        from gaitsweep.api.figures_of_table import FiguresOfTable  # which imports Matplotlib

        return FiguresOfTable(self.table)

    def to_xarray(self) -> xarray.Dataset:
        """Convert the table to a dataset whose dimensions are the axes; see `runs.dataset.dataset_of`."""
        from gaitsweep.runs.dataset import dataset_of

        return dataset_of(self.table)

    def job(self) -> str:
        """Return the job file, as YAML text, whose run gives the same table.

        Raises:
            ArgumentError: the model's class belongs to this session, and no file can name it; or as of
                `manifest`.
        """
        job = self.manifest["job"]
        if not importable(job["model"]):
            raise ArgumentError(
                f"{job['model'].partition(':')[2]} is a class of this session, which a job file cannot name: "
                "write the class into a module (hopper.py) and import it from there."
            )
        return yaml.safe_dump(job, sort_keys=False, allow_unicode=True, width=100)

    def explore(
        self,
        out: str | Path | None = None,
        *,
        x: str | None = None,
        y: str | None = None,
        replays: int | None = None,
        max_size: float | None = None,
        trust: bool = False,
    ) -> Path:
        """Write a page on which a click on a start makes it walk.

        Args:
            out: the file; `explore.html` in the result directory by default.
            x, y: columns along the axes; by default those of the job's figures, or the longest axes.
            replays: largest number of starts that are simulated again; 400 by default.
            max_size: the largest size of the page, MB; 10 by default.
            trust: import a user's model from the directory, or from the folder that its manifest names.

        Returns:
            The file.

        Raises:
            ArgumentError: the result is in memory, without `out`; its kind cannot be explored.
            MissingPackageError: plotly is not installed.
            PlotError: a column is not there.
            WriteError: the file cannot be written.
        """
        from gaitsweep.view.explorer.explorer import EXPLORE, write_explorer

        target = self.path / EXPLORE if out is None else Path(out)
        return write_explorer(self.table, target, x=x, y=y, replays=replays, max_size=max_size, trust=trust)

    def __repr__(self) -> str:
        where = "in memory" if self._path is None else f"in {self._path}"
        return f"Result({'; '.join(self._summary())}; {where})"

    def _repr_html_(self) -> str:
        """Format counts, self-check and the first records for a notebook."""
        lines = "<br>".join(html.escape(line) for line in self._summary())
        return f"<p>{lines}</p>{self.table.head(_SHOWN_ROWS).to_html()}"

    def _summary(self) -> list[str]:
        """Lines with the counts of rows, statuses and gaits, and the self-check."""
        if self._table is not None and "manifest" not in self._table.attrs:
            return [f"records: {len(self._table)}"]
        manifest = self.manifest
        lines = [f"rows: {manifest['rows']}"]
        for title, key in (("status", "counts"), ("gait", "gaits")):
            if counts := manifest.get(key):
                left_out = manifest["rows"] - sum(counts.values())
                others = f", {left_out} failed or not settled" if key == "gaits" and left_out else ""
                names = ", ".join(f"{name} {count}" for name, count in counts.items())
                lines.append(f"{title}: {names}{others}")
        if isinstance(check := manifest.get("self_check"), dict):
            lines.append(self_check_sentence(check))
        return lines
