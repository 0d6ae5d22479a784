"""Result of a run: its table, its figures, and the job that reproduces it."""

from __future__ import annotations

import html
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import yaml

from gaitsweep.errors import ArgumentError
from gaitsweep.job import Job, load_job
from gaitsweep.models import importable
from gaitsweep.runs.execute import run_job, table_in_memory
from gaitsweep.runs.progress import Progress, progress_lines
from gaitsweep.runs.sentences import remarks, self_check_sentence
from gaitsweep.table import load
from gaitsweep.table.manifest import read_manifest
from gaitsweep.table.reading import figure_files

if TYPE_CHECKING:
    import xarray  # pyright: ignore[reportMissingImports]
    from distributed import Client  # pyright: ignore[reportMissingImports]

    from gaitsweep.api.figures_of_table import FiguresOfTable
    from gaitsweep.runs.cluster.dispatch import Cluster

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
        """Keep the directory, or the table of a result in memory."""
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
        """Job, hash, versions, device, timings, counts by status, self-check."""
        if self._table is not None:
            return self._table.attrs["manifest"]
        return read_manifest(self.path)

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
            ArgumentError: the model's class belongs to this session, and no file can name it.
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
        manifest = self.manifest
        lines = [f"rows: {manifest['rows']}"]
        for title, key in (("status", "counts"), ("gait", "gaits")):
            if counts := manifest.get(key):
                lines.append(f"{title}: {', '.join(f'{name} {count}' for name, count in counts.items())}")
        if isinstance(check := manifest.get("self_check"), dict):
            lines.append(self_check_sentence(check))
        return lines


def run(
    job: Job | str | Path,
    out: str | Path | None = None,
    *,
    overrides: Sequence[str] = (),
    on_progress: Progress | None = None,
    strict: bool = False,
    client: Client | None = None,
) -> Result:
    """Run a job in its result directory, or the rest of it, and draw its figures.

    Args:
        job: a job, or the path of its YAML file.
        out: the result directory, `results/NAME` by default.
        overrides: settings for a job from a file, such as "run.max_cycles=50".
        on_progress: progress callback: rows done, rows in all, rows a second, the share done, a remark; by
            default it prints a line on standard error every half minute.
        strict: raise SelfCheckError if the self-check warns.
        client: a `distributed.Client`, whose workers compute the rows; they share the result directory.

    Raises:
        SelfCheckError: the self-check warns, with `strict`; the table is complete.
        JobError: the job is not valid, with a sentence for each error.
        ArgumentError: neither a job nor a path; overrides of a job that is not read from a file; a
            directory for a model whose class belongs to this session, which no later run could compare.
        TableError, RunError: the directory is another job's, the disk is full, a device is missing.
    """
    if isinstance(job, Job) and overrides:
        raise ArgumentError(
            "overrides are for a job that is read from a file: build the Job with them instead."
        )
    if not isinstance(job, (Job, str, Path)):
        raise ArgumentError(
            f"job is a {type(job).__name__}, but takes a Job or the path of its YAML file: of fields in a "
            "dictionary make one by Job(**fields)."
        )
    loaded = job if isinstance(job, Job) else load_job(job, overrides)
    refuse_of_session(loaded.model)
    cluster = None if client is None else cluster_of(client)
    on_progress = progress_lines() if on_progress is None else on_progress
    path = run_job(loaded, out, on_progress=on_progress, on_message=warn, strict=strict, cluster=cluster)
    return _remarked(Result(path))


def refuse_of_session(model: str) -> None:
    """Refuse a result directory for a model, by its name, whose class belongs to this session.

    Raises:
        ArgumentError: the class belongs to this session, so no later run could compare it.
    """
    if not importable(model):
        raise ArgumentError(
            f"{model.partition(':')[2]} is a class of this session, and a result directory needs a "
            "model that a file gives: leave out= away, or write the class into a module and import it."
        )


def cluster_of(client: Client, *, collect: bool = False) -> Cluster:
    """Return the workers of a `distributed.Client`.

    Args:
        client: the client, which stays open.
        collect: send rows here through the scheduler, without a directory that the workers share.
    """
    from gaitsweep.runs.cluster.connection import UserClient
    from gaitsweep.runs.cluster.dispatch import Cluster

    return Cluster(UserClient(client), collect=collect, on_message=warn)


def run_in_memory(job: Job, client: Client | None = None) -> Result:
    """Run a job and keep its table in memory.

    Args:
        job: the job.
        client: a `distributed.Client`, whose workers compute the rows and send them here.

    Raises:
        TableError, RunError: the temporary disk is full, a device is missing.
    """
    cluster = None if client is None else cluster_of(client, collect=True)
    table = table_in_memory(job, on_progress=progress_lines(), on_message=warn, cluster=cluster)
    return _remarked(Result(table=table))


def warn(sentence: str, level: int = 1) -> None:
    """Issue a sentence as a Python warning."""
    warnings.warn(sentence.removeprefix("Warning: "), stacklevel=level + 1)


def _remarked(result: Result) -> Result:
    """Issue the remarks on a result as warnings, and return it."""
    for remark in remarks(result.manifest):
        warn(remark, 4)
    return result
