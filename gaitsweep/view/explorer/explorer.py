"""The explorer of a result directory: one page on which a click on a start shows the walking model."""

from __future__ import annotations

import html
import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float, Int

import gaitsweep
from gaitsweep.engine.sweep.blocks_of_rows import gait_codes
from gaitsweep.errors import ArgumentError
from gaitsweep.job import Job
from gaitsweep.job.load import job_fields, stored_job
from gaitsweep.kinds.columns import gaits
from gaitsweep.plot.bifurcations.passes import DOWN, UP
from gaitsweep.plot.columns import rows_where
from gaitsweep.plot.limbs import limb_colours
from gaitsweep.plot.provenance_marks import remarks
from gaitsweep.runs.prepare import RunContext, prepare
from gaitsweep.runs.progress import Progress
from gaitsweep.runs.sentences import status_sentence
from gaitsweep.status import Status
from gaitsweep.table import replace_file, writing
from gaitsweep.view.explorer.animated_records import AnimatedRecords
from gaitsweep.view.explorer.page_format import columns_of, compressed, html_symbol, json_bytes, plotly_source
from gaitsweep.view.explorer.start_map import StartMap, map_of, with_next

EXPLORE = "explore.html"
MAX_SIZE = 10.0  # MB
MOST_REPLAYS = 400
KINDS = ("settle", "fixed_time", "return_map", "ramp", "staircase", "continuation", "atlas")
_MB = 1_000_000
_LEAST_ROOM = 0.2 * _MB  # bytes of the records
_TEXTS_SIZE = 4000  # bytes of the texts about the table
# The share of the room beside plotly.js that the table may take.
_TABLE_SHARE = 0.6
# Records by which the size of a table's records is measured.
_MEASURED = 1000
_TEMPLATE = "explorer.html"  # names the other files of the page in the order in which it has them
_ROW_CHOOSING_FIELDS = ("refine", "over", "coarse")  # of a run: which of its rows are simulated


class ExplorerSizeError(ArgumentError):
    """The page does not fit into the allowed size."""


def write_explorer(
    table: pd.DataFrame,
    target: Path,
    *,
    x: str | None = None,
    y: str | None = None,
    replays: int | None = None,
    max_size: float | None = None,
    trust: bool = False,
    on_progress: Progress | None = None,
    on_message: Callable[[str], None] = lambda _: None,
) -> Path:
    """Write a self-contained page on which a click on a start of a table shows the walking model.

    Args:
        table: the table of a run of kind settle, fixed_time, return_map, ramp, staircase, continuation or
            atlas; of an atlas the branches are shown.
        target: the file.
        x, y: columns along the axes; by default those of the job's figures, or the longest axes.
        replays: largest number of starts (records of a ramp or a staircase) simulated again; 400 by default.
        max_size: the largest size of the page, MB; 10 by default.
        trust: whether to import a user's model from the directory or the folder named in its manifest.
        on_progress: called with the rows done, all rows, rows per second, the fraction done, and a remark.
        on_message: called with sentences about the contents that the page lacks.

    Returns:
        The file.

    Raises:
        ArgumentError: the table has no job, its run kind is not supported, or the size is too small.
        MissingPackageError: plotly is not installed.
        PlotError: a column is missing.
        JobError, RunError: the job cannot be read, or cannot run here.
        WriteError: the file cannot be written.
    """
    job = _job_of(table, trust=trust)
    most = MOST_REPLAYS if replays is None else replays
    limit = MAX_SIZE if max_size is None else max_size
    if most < 0:
        raise ArgumentError(f"replays is {most}, but must be 0 or more.")
    if not len(table):
        raise ArgumentError("No row has ended yet, so there is nothing to explore.")
    script = compressed(plotly_source().encode())
    room = _room(script, limit)
    context = prepare(job)
    table = _labelled(table, context)
    if not len(table):
        reason = "The atlas found no gait"
        if job.run.kind_name == "return_map":
            reason = f"No row has {_mapped_column(table, context)} at two successive crossings"
        raise ArgumentError(f"{reason}, so there is nothing to explore.")
    varied = context.design.names
    shown = map_of(table, job, x, y, _most_records(table, varied, _TABLE_SHARE * room))
    fields = _table_fields(shown, varied, table.attrs)
    room -= len(compressed(json_bytes(fields)))
    if room < 0:
        raise ExplorerSizeError(f"The table alone is larger than max_size, {limit:g} MB.")
    spent = table.attrs.get("manifest", {}).get("timings", {}).get("run_s", 0.0)
    animated = AnimatedRecords(shown, context, most, float(spent), on_progress)
    fields |= animated.fields(room)
    fields |= _python(table, context) | _passes(table, context) | _about(shown, table, context, animated)
    parts = {"title": html.escape(fields["name"]), "contents": html.escape(animated.sentence)}
    parts |= {"data": compressed(json_bytes(fields)), "plotly": script}
    size = f"{len(_filled({**parts, 'size': '0.0'}).encode()) / _MB:.1f}"
    on_message(f"{animated.sentence} The page is {size} MB.")
    page = _filled({**parts, "size": size}).encode()
    with writing(f"{target} could not be written"):
        replace_file(target, lambda file: file.write(page))
    return target


def _room(script: str, max_size: float) -> int:
    """The bytes for the table and the replays on a page of `max_size` MB with plotly.js, compressed.

    Raises:
        ArgumentError: the size is too small.
    """
    if not 0.0 < max_size < math.inf:
        raise ArgumentError(f"max_size is {max_size:g} MB, but must be a finite number above 0.")
    without_data = dict.fromkeys(("title", "contents", "data", "size"), "") | {"plotly": script}
    frame = len(_filled(without_data)) + _TEXTS_SIZE
    room = int(max_size * _MB) - frame
    if room < _LEAST_ROOM:
        least = (frame + _LEAST_ROOM) / _MB
        raise ExplorerSizeError(
            f"The page needs {least:.1f} MB even without replays, but max_size is {max_size:g} MB."
        )
    return room


def _job_of(table: pd.DataFrame, *, trust: bool) -> Job:
    """The job that made a table, even if `job.yaml` was edited since."""
    fields = job_fields(table.attrs)
    where = table.attrs.get("path", "This result")
    for other in ("search", "sensitivity"):
        if other in fields:
            raise ArgumentError(
                f"{where} contains sets of constants (a job with `{other}:`), which the explorer does "
                "not show. Use `gaitsweep report`."
            )
    kind = fields.get("run", {}).get("kind", "another kind")
    if kind not in KINDS:
        instead = " Use `gaitsweep animate` for the rows of a trace." if kind == "trace" else ""
        raise ArgumentError(
            f"{where} contains {kind} rows, which the explorer does not show. "
            f"Allowed: {', '.join(KINDS)}.{instead}"
        )
    return stored_job(table.attrs, trust=trust)


def _labelled(table: pd.DataFrame, context: RunContext) -> pd.DataFrame:
    """A table with a gait for each record; crossings have the label of their observables."""
    run = context.job.run
    # the last records of a row tell its gait, or belong to its fall
    if run.kind_name in ("return_map", "ramp"):
        table = table.sort_values(["row", "crossing"], kind="stable")
    if "gait" not in table.columns:
        table = _with_gaits(table, gaits(context.model, _gait_codes(table, context)))
    if run.kind_name == "atlas":
        table = rows_where(table, (table["part"] == "branch") & (table["end"].astype(str) != "no_gait"))
        gait = table["gait"].astype(str)
        table = _with_gaits(table, gait.mask(gait == "none", "period " + table["period"].astype(str)))
    if run.kind_name == "return_map":
        table = with_next(table, _mapped_column(table, context))
    return table


def _with_gaits(table: pd.DataFrame, names: Any) -> pd.DataFrame:
    """A table with a column of gaits, and its attributes."""
    labelled = table.assign(gait=names)
    labelled.attrs = table.attrs
    return labelled


def _mapped_column(table: pd.DataFrame, context: RunContext) -> str:
    """The column of the observable that the job's first figure draws, else of the first observable."""
    drawn = [dict(figure).get("y") for figure in context.job.figures]
    names = [name for name in drawn if name][:1]
    names += [quantity.name for quantity in context.model.observables]
    return next(f"{name}_n" for name in names if f"{name}_n" in table.columns)


def _gait_codes(table: pd.DataFrame, context: RunContext) -> Int[np.ndarray, " records"]:
    """The number of the gait of each record, (n,), from its observables; -1 of a record without numbers.

    All records of a row whose parameter does not move have the gait of its last record.
    """
    names = [quantity.name for quantity in context.model.observables]
    observed = table[[f"{name}_n" for name in names]].to_numpy(float)
    rows = table["row"].to_numpy(np.int64)
    of_records = dict(zip(names, observed.T, strict=True))
    t = table["t"].to_numpy(float)
    codes = np.where(np.isfinite(t), _labelled_gaits(context, rows, t, of_records), -1)
    if context.job.run.moved:
        return codes
    return np.asarray(pd.Series(codes).groupby(rows).transform("last").to_numpy(), np.int64)


def _labelled_gaits(
    context: RunContext,
    rows: Int[np.ndarray, " records"],
    t: Float[np.ndarray, " records"],
    observed: Mapping[str, Float[np.ndarray, " records"]],
) -> Int[np.ndarray, " records"]:
    """The number of the gait that the model reads from the observables of records, (n,) each.

    Args:
        context: the job.
        rows: the row of each record.
        t: their times, s.
        observed: their observables by name.
    """
    model, drive = context.model, context.spec.drive
    distinct_rows, place = np.unique(rows, return_inverse=True)
    of_rows, _ = context.design.values_in(distinct_rows)
    parameters = {name: jnp.asarray(values)[place] for name, values in model.on_host(of_rows).items()}

    def gait_of(values: Any, time: jax.Array, observed: Any) -> jax.Array:
        params = model.params(values) if drive is None else drive(values, time)
        return model.label(params, observed)["gait"]

    return gait_codes(np.asarray(jax.jit(jax.vmap(gait_of))(parameters, np.nan_to_num(t), observed)))


def _most_records(table: pd.DataFrame, exact: Sequence[str], room: float) -> int:
    """The number of a table's records that fit into `room` bytes of the page.

    Columns that are `exact` have all digits.
    """
    sample = table.iloc[np.linspace(0, len(table) - 1, min(_MEASURED, len(table))).astype(int)]
    size = len(compressed(json_bytes({"columns": columns_of(sample, exact)}))) / len(sample)
    return max(int(room / size), 100)


def _table_fields(shown: StartMap, exact: Sequence[str], attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """The map and the records in the format of the page, and the sentences of their statuses."""
    fields: dict[str, Any] = {
        "kind": shown.kind,
        "x": shown.axis("x"),
        "y": shown.axis("y"),
        "noChange": shown.no_change,
        "outcomes": shown.outcomes,
        "outcome": shown.outcome.tolist(),
        "columns": columns_of(shown.table, exact),
        "slices": [
            {"name": html_symbol(shown.table, axis.name), "texts": axis.texts, "of": axis.of_record.tolist()}
            for axis in shown.slices
        ],
        "statuses": {
            status.name: status_sentence(
                status.name, attrs["job"], {"quantities": attrs["manifest"].get("quantities")}
            )
            for status in Status
        },
    }
    if shown.edges is not None and shown.at is not None:
        fields |= {
            "edges": [[float(f"{edge:.9g}") for edge in edges] for edges in shown.edges],
            "at": [shown.at[:, 0].tolist(), shown.at[:, 1].tolist()],
            "closed": list(shown.closed),
        }
    return fields


def _python(table: pd.DataFrame, context: RunContext) -> dict[str, Any]:
    """A job of one row in Python, with marks for the row's number and its values of the varied quantities."""
    fields = table.attrs["job"]
    arguments: dict[str, Any] = {"name": f"{context.job.name}_row_@row@"}
    arguments |= {name: fields[name] for name in ("model", "structure", "params", "start", "numerics")}
    arguments["run"] = {
        field: value
        for field, value in fields["run"].items()
        if value is not None and field not in _ROW_CHOOSING_FIELDS
    }
    lines = [f"{name}={value!r}" for name, value in arguments.items() if value]
    text = "".join(f"    {line},\n" for line in [*lines, "vary={@vary@}"])
    python = f"import gaitsweep as gs\n\njob = gs.Job(\n{text})\nprint(gs.run(job).table)\n"
    return {"python": python, "varied": [name for name in context.design.names if name in table.columns]}


def _passes(table: pd.DataFrame, context: RunContext) -> dict[str, Any]:
    """The direction, colour and marker of each pass of a parameter that rises and falls; none for others."""
    run = context.job.run
    turns = run.turns if "pass" in table.columns else ()
    rising = [after > before for before, after in itertools.pairwise(turns)]
    if len(set(rising)) < 2:
        return {"moved": run.moved, "passes": []}
    up = {"rises": True, "colour": UP, "marker": "^"}
    down = {"rises": False, "colour": DOWN, "marker": "v"}
    return {"moved": run.moved, "passes": [up if rises else down for rises in rising]}


def _about(
    shown: StartMap, table: pd.DataFrame, context: RunContext, animated: AnimatedRecords
) -> dict[str, Any]:
    """Header of the page: name, model, limbs, remarks and provenance."""
    job, model = context.job, context.model
    manifest = table.attrs.get("manifest", {})
    colours = limb_colours(animated.limbs)
    thinned = [f"shown: {shown.thinned}"] if shown.thinned else []
    return {
        "name": job.name,
        "model": model.name,
        "source": model.source,
        "what": (type(model).__doc__ or "").strip().split("\n")[0],
        "run": job.run.kind_name,
        "rows": int(manifest.get("rows", table["row"].nunique())),
        "remarks": [*remarks(table), *thinned],
        "limbs": [
            {"name": look.name, "colour": colour, "far": look.far}
            for look, colour in zip(animated.limbs, colours, strict=True)
        ],
        "provenance": {
            "gaitsweep": gaitsweep.__version__,
            "job": str(manifest.get("job_hash", ""))[:12],
            "commit": str(manifest.get("git_commit", "") or "")[:12],
            "engine": str(manifest.get("engine", "")),
            "device": str(manifest.get("device", "")),
        },
    }


def _filled(parts: Mapping[str, str]) -> str:
    """The template with its marks {{...}} replaced by escaped parts, and by the files that they name."""
    files = resources.files("gaitsweep.view.explorer").joinpath("page")

    def part(mark: re.Match[str]) -> str:
        return parts[mark[1]] if mark[1] in parts else files.joinpath(mark[1]).read_text("utf-8")

    # all at once, so that no text is searched for marks
    return re.sub(r"\{\{([\w.]+)\}\}", part, files.joinpath(_TEMPLATE).read_text("utf-8"))
