"""The explorer of a result directory: one page on which a click on a start shows the walking model."""

from __future__ import annotations

import html
import itertools
import json
import re
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from gaitsweep.contract import Status
from gaitsweep.engine.sweep.labels import gait_codes
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.errors import ArgumentError
from gaitsweep.job import Job
from gaitsweep.job.load import stored_job
from gaitsweep.kinds.columns import gaits
from gaitsweep.plot.bifurcations.passes import DOWN, UP
from gaitsweep.plot.limbs import limb_colours
from gaitsweep.plot.provenance_marks import remarks
from gaitsweep.runs.prepare import RunContext, prepare
from gaitsweep.runs.progress import Progress
from gaitsweep.runs.self_check import changes, circular
from gaitsweep.runs.sentences import status_sentence
from gaitsweep.skeleton import LimbLook
from gaitsweep.table import load, replace_file, writing
from gaitsweep.version import version
from gaitsweep.view.explorer.encoding import compressed, crossing_fields, motion_fields
from gaitsweep.view.explorer.plotly_source import plotly_source
from gaitsweep.view.explorer.replay_groups import ReplayGroup, replay_groups
from gaitsweep.view.explorer.replays import BodyParts, Crossings, ReplayedRow, Replayer
from gaitsweep.view.explorer.start_map import StartMap, columns_of, html_symbol, map_of, with_next

EXPLORE = "explore.html"
MAX_SIZE = 10.0  # MB
MOST_REPLAYS = 400
KINDS = ("settle", "fixed_time", "return_map", "ramp", "staircase", "continuation")
_MB = 1_000_000
# The share of the room beside plotly.js that the table may take.
_TABLE_SHARE = 0.6
# Records by which the size of a table's records is measured.
_MEASURED = 1000
# Lines of one figure beside the map, and symbols that name it.
_MOST_SERIES = 6
_NAMED = 3
# Differences in angles up to this value between a row simulated again and the table are not reported, rad.
_APART = 1e-2
# The page, and the parts that its marks stand for.
_TEMPLATE = "explorer.html"
_PARTS = {"style": "explorer.css", "script": "explorer.js", "gif": "gif.js"}
_OF_MANY_ROWS = ("refine", "over", "coarse")  # fields of a run that choose among its rows


class ExplorerSizeError(ArgumentError):
    """The page does not fit into the allowed size."""


def write_explorer(
    directory: str | Path,
    out: str | Path | None = None,
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
        directory: a result directory of a run of kind settle, fixed_time, return_map, ramp, staircase or
            continuation.
        out: the file; `explore.html` in the directory by default.
        x, y: columns along the axes; by default those of the job's figures, or the longest axes.
        replays: largest number of starts (records of a ramp or a staircase) simulated again; 400 by default.
        max_size: the largest size of the page, MB; 10 by default.
        trust: whether to import a user's model from the directory or the folder named in its manifest.
        on_progress: called with the rows done, all rows, rows per second, the fraction done, and a remark.
        on_message: called with sentences about the contents that the page lacks.

    Returns:
        The file.

    Raises:
        ArgumentError: the run kind of the table is not supported, or the size is too small.
        MissingPackageError: plotly is not installed.
        PlotError: a column is missing.
        TableError, JobError, RunError: the directory cannot be read, or its job cannot run here.
        WriteError: the file cannot be written.
    """
    directory = Path(directory)
    plotly_source()  # refuses before a large table is read
    table = load(directory)
    target = directory / EXPLORE if out is None else Path(out)
    return explorer_of(
        table,
        target,
        x=x,
        y=y,
        replays=replays,
        max_size=max_size,
        trust=trust,
        on_progress=on_progress,
        on_message=on_message,
    )


def explorer_of(
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
    """Write the page of a table, as `write_explorer` does."""
    plotly = plotly_source()
    most = MOST_REPLAYS if replays is None else replays
    megabytes = MAX_SIZE if max_size is None else max_size
    page = _page(table, _job_of(table, trust), plotly, (x, y), most, megabytes, on_progress, on_message)
    with writing(f"{target} could not be written"):
        replace_file(target, lambda file: file.write(page.encode()))
    return target


def _job_of(table: pd.DataFrame, trust: bool) -> Job:
    """The job that made a table, even if `job.yaml` was edited since."""
    fields, where = table.attrs["job"], table.attrs.get("path", "This result")
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
    return stored_job(table.attrs, trust)


def _page(
    table: pd.DataFrame,
    job: Job,
    plotly: str,
    axes: tuple[str | None, str | None],
    replays: int,
    max_size: float,
    on_progress: Progress | None,
    on_message: Callable[[str], None],
) -> str:
    """The HTML page of a table, with plotly.js (source `plotly`), the records and the replays embedded."""
    if replays < 0 or max_size <= 0.0:
        raise ArgumentError(
            f"replays is {replays} and max_size is {max_size:g} MB, but both must be at least 0."
        )
    if not len(table):
        raise ArgumentError("No row has ended yet, so there is nothing to explore.")
    script = compressed(plotly.encode())
    frame_size = len(script) + sum(len(_part(name)) for name in (_TEMPLATE, *_PARTS.values())) + 4000
    room = int(max_size * _MB) - frame_size
    least = f"The page needs {(frame_size + 0.2 * _MB) / _MB:.1f} MB even without walks"
    if room < 0.2 * _MB:
        raise ExplorerSizeError(f"{least}, but --max-size is {max_size:g} MB.")
    context = prepare(job)
    table = _labelled(table, context)
    shown = map_of(table, job, *axes, _most_records(table, context.design.names, _TABLE_SHARE * room))
    fields = _table_fields(shown, context.design.names, table.attrs["job"])
    room -= len(compressed(_json(fields)))
    if room < 0:
        raise ExplorerSizeError(f"The table alone is larger than --max-size, {max_size:g} MB.")
    spent = table.attrs.get("manifest", {}).get("timings", {}).get("run_s", 0.0)
    chosen = _Replays(shown, context, replays, float(spent), on_progress)
    fields |= chosen.fields(room)
    fields |= _python(table, context) | _passes(table, context) | _about(shown, table, context, chosen)
    data = compressed(_json(fields))
    sentence = chosen.sentence
    parts = {"title": fields["name"], "told": sentence}
    size = f"{len(_filled(parts, script, data, '0.0').encode()) / _MB:.1f}"
    on_message(f"{sentence} The page is {size} MB.")
    return _filled(parts, script, data, size)


def _labelled(table: pd.DataFrame, context: RunContext) -> pd.DataFrame:
    """A table with a gait for each record; crossings have the label of their observables."""
    run = context.job.run
    if "gait" not in table.columns:
        names = [q.name for q in context.model.observables]
        seen = table[[f"{name}_n" for name in names]].to_numpy(float)
        rows = table["row"].to_numpy(np.int64)
        codes = _gaits(context, rows, table["t"].to_numpy(float), dict(zip(names, seen.T, strict=True)))
        codes = np.where(np.isfinite(seen).all(axis=1), codes, -1)
        if not run.moved:  # all crossings of a start lead to one gait, that of the last
            last = pd.Series(codes).groupby(rows).transform("last").to_numpy()
            codes = np.asarray(last, np.int64)
        attrs = table.attrs
        table = table.assign(gait=gaits(context.model, codes))
        table.attrs = attrs
    if run.kind_name == "return_map":
        drawn = next((f.y for f in context.job.figures if getattr(f, "y", None)), None)  # pyright: ignore[reportAttributeAccessIssue]
        names = [f"{drawn}_n"] if drawn else []
        names += [f"{q.name}_n" for q in context.model.observables]
        table = with_next(table, next(name for name in names if name in table.columns))
    return table


def _gaits(
    context: RunContext, rows: np.ndarray, t: np.ndarray, seen: Mapping[str, np.ndarray]
) -> np.ndarray:
    """The number of the gait (n,) from the observables of n records at times `t` (n,) s."""
    model, drive = context.model, context.spec.drive
    some, place = np.unique(rows, return_inverse=True)
    parameters, _ = context.design.values_in(some)
    held = {name: jnp.asarray(each)[place] for name, each in model.on_host(parameters).items()}

    def one(values: Any, time: jax.Array, observed: Any) -> jax.Array:
        params = model.params(values) if drive is None else drive(values, time)
        return model.label(params, observed)["gait"]

    finite = {name: np.nan_to_num(each) for name, each in seen.items()}
    return gait_codes(np.asarray(jax.jit(jax.vmap(one))(held, np.nan_to_num(t), finite)))


def _most_records(table: pd.DataFrame, exact: Sequence[str], room: float) -> int:
    """The number of a table's records that fit into a number of bytes of the page."""
    some = table.iloc[np.linspace(0, len(table) - 1, min(_MEASURED, len(table))).astype(int)]
    size = len(compressed(_json({"columns": columns_of(some, exact)}))) / len(some)
    return max(int(room / size), 100)


def _table_fields(shown: StartMap, exact: Sequence[str], fields_of_job: Mapping[str, Any]) -> dict[str, Any]:
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
            {"name": html_symbol(shown.table, each.name), "texts": each.texts, "of": each.of_record.tolist()}
            for each in shown.slices
        ],
        "statuses": {status.name: status_sentence(status.name, fields_of_job) for status in Status},
    }
    if shown.edges is not None and shown.at is not None:
        fields |= {
            "edges": [[float(f"{edge:.9g}") for edge in edges] for edges in shown.edges],
            "at": [shown.at[:, 0].tolist(), shown.at[:, 1].tolist()],
            "closed": list(shown.closed),
        }
    return fields


class _Replays:
    """The animated records, simulated again, and their fields on the page.

    Args:
        shown: the records of the page.
        context: their job.
        most: largest number of animated records.
        spent: duration of the job, s.
        on_progress: progress callback.
    """

    def __init__(
        self, shown: StartMap, context: RunContext, most: int, spent: float, on_progress: Progress | None
    ) -> None:
        self._context, self._on_progress = context, on_progress
        self._model, self._shown = context.model, shown.table
        self._outcomes, self._looks = shown.outcome, shown.outcomes
        self._table = shown.table.reset_index(drop=True)
        self._table.attrs = {}  # which pandas would copy with each record
        self._groups, self._beside = replay_groups(
            shown, self._table, context, most, spent, self._on_branch_progress
        )
        self._parts: BodyParts | None = None
        self._sizes: list[tuple[float, float, float]] = []
        self.series = self._drawn_over_cycles()
        self.sentence = "The page has no animated starts."

    def fields(self, room: int) -> dict[str, Any]:
        """The replays that fit into a number of bytes; `sentence` has their number."""
        replays: dict[int, dict[str, Any]] = {}
        around: dict[int, Crossings] = {}
        for group in self._groups:
            replayer = group.replayer()
            windows = group.windows(float(replayer.periods.max()))
            for replayed in replayer.replayed(windows, self._on_sweep_progress(group.rows.size)):
                for record in group.records_of(replayed.row):
                    replays[record] = self._replay(group, replayer, replayed, record)
                    around[record] = group.around(record, replayed)
            self._parts = self._parts or replayer.parts
        self._set_ranges(list(around.values()))
        kept, size = [], 0
        for record in (record for group in self._groups for record in group.records.tolist()):
            replay = {**replays[record], "crossings": self._over_cycles(around[record])}
            size += len(compressed(_json(replay)))
            if size > room:
                break
            kept.append(replay)
        self._count(kept, len(replays))
        cycles = np.concatenate([[], *(np.diff(each.t) for each in around.values())])
        cycle = float(np.median(cycles)) if cycles.size else 1.0
        first = self._first([replay["record"] for replay in kept])
        return {
            "walks": kept,
            "first": first,
            "figure": self._figure(),
            "series": self.series,
            "cycle": cycle,
        }

    def _first(self, animated: list[int]) -> int:
        """The record with which the page opens: one with a settled gait, animated if any is."""
        records = animated[1:2] + animated or list(range(len(self._outcomes)))
        hidden = [look["hollow"] or look["hatched"] or look["leads"] == "none" for look in self._looks]
        return next((record for record in records if not hidden[self._outcomes[record]]), records[0])

    def _on_branch_progress(self, note: str = "", share: float = 0.0) -> None:
        """Report progress while branches are followed again."""
        if self._on_progress is not None:
            self._on_progress(0, 1, 0.0, 0.0, "following branches again")

    def _on_sweep_progress(self, rows: int) -> Callable[[SweepProgress], None]:
        def on_progress(now: SweepProgress) -> None:
            if self._on_progress is not None:
                done = min(round(now.share * now.rows), rows)
                self._on_progress(done, rows, done / max(now.seconds, 1e-9), done / rows, "walking")

        return on_progress

    def _replay(
        self, group: ReplayGroup, replayer: Replayer, replayed: ReplayedRow, record: int
    ) -> dict[str, Any]:
        """The fields of one animated record."""
        period = float(replayer.periods[replayed.place])
        motions = [replayer.motion(replayed, each) for each in group.stretches(record, replayed, period)]
        motions = [each for each in motions if each is not None]
        self._sizes += [(p.half, p.height, p.depth) for each in motions if (p := each.pictures) is not None]
        return {
            "record": record,
            "motions": [motion_fields(motion) for motion in motions],
            **self._differs(record, replayed),
        }

    def _over_cycles(self, crossings: Crossings) -> dict[str, Any]:
        """The observables drawn over the cycles."""
        numbers = np.array([each["number"] for each in self.series], int)
        low, high = (np.array([each[end] for each in self.series]) for end in ("low", "high"))
        return crossing_fields(crossings, numbers, low, high)

    def _differs(self, record: int, replayed: ReplayedRow) -> dict[str, Any]:
        """Describe differences between a row simulated again and the table."""
        row, run = self._table.iloc[record], self._context.job.run
        if run.kind_name == "continuation":  # a fixed point, which the next crossing has to give back
            return self._apart(record, replayed, 1, "n")
        if not run.one_a_row or str(row["status"]) not in Status.SOUND:
            return {}
        name = str(gaits(self._model, np.array([replayed.gait]))[0]) if replayed.gait != -1 else "none"
        other = not pd.isna(row["gait"]) and name != str(row["gait"])
        later = {"later": name} if other else {}
        return {**later, **self._apart(record, replayed, int(row["cycles"]), "end")}

    def _apart(self, record: int, replayed: ReplayedRow, crossing: int, suffix: str) -> dict[str, Any]:
        """Differences of angles at a crossing from the table's."""
        if crossing >= len(replayed.crossings.number):
            return {}
        row = self._table.iloc[record]
        ends = np.array([float(row[f"{q.name}_{suffix}"]) for q in self._model.observables])
        apart = changes(self._model, replayed.crossings.observed[crossing], ends)[circular(self._model)]
        most = float(np.nanmax(apart, initial=0.0))
        return {"apart": most} if most > _APART else {}

    def _drawn_over_cycles(self) -> list[dict[str, Any]]:
        """The observables drawn over the cycles, in groups with one unit each, angles first.

        The page draws one group at a time; `group` is its name in HTML.
        """
        observables = self._model.observables
        units = dict.fromkeys((not q.circular, q.unit) for q in observables)
        found = []
        for other, unit in sorted(units, key=lambda each: each[0]):
            alike = [q for q in observables if (not q.circular, q.unit) == (other, unit)]
            most = _MOST_SERIES if other else len(alike)  # angles are compared with each other
            for some in (alike[i : i + most] for i in range(0, len(alike), most)):
                symbols = [html_symbol(self._shown, q.name) for q in some]
                shown_unit = "" if unit == "1" else unit
                names = ", ".join(symbols) if len(symbols) <= _NAMED else f"{symbols[0]} ... {symbols[-1]}"
                group = f"{names} ({html.escape(shown_unit)})" if shown_unit else names
                found += [
                    {
                        "name": q.name,
                        "symbol": symbol,
                        "unit": shown_unit,
                        "circular": q.circular,
                        "number": observables.index(q),
                        "group": group,
                    }
                    for q, symbol in zip(some, symbols, strict=True)
                ]
        return found

    def _set_ranges(self, crossings: list[Crossings]) -> None:
        """Set the ranges of the observables drawn over the cycles."""
        for each in self.series:
            seen = [some.observed[:, each["number"]] for some in crossings]
            values = np.concatenate(seen) if seen else np.zeros(0)
            values = values[np.isfinite(values)]
            each["low"], each["high"] = (float(f(values)) if values.size else 0.0 for f in (np.min, np.max))

    def _figure(self) -> dict[str, Any] | None:
        """Parts of the body in the frames, and its size; None for a model without a skeleton."""
        if self._parts is None or not self._sizes:
            return None
        half, height, depth = np.quantile(np.array(self._sizes), 0.98, axis=0)
        return {
            "limbs": list(self._parts.limbs),
            "bodies": list(self._parts.bodies),
            "springs": self._parts.springs,
            "note": self._parts.note,
            "half": half,
            "height": height,
            "depth": depth,
        }

    @property
    def limbs(self) -> tuple[LimbLook, ...]:
        """The names and places of limbs: those of the skeleton, those of the model, or numbers."""
        if self._parts is not None and self._parts.names:
            named = zip(self._parts.names, self._parts.pairs, strict=True)
            return tuple(LimbLook(name, pair, far) for name, (pair, far) in named)
        count = sum(q.name.startswith("contact_") for q in self._model.signals)
        if len(self._model.limbs) == count:
            return tuple(self._model.limbs)
        return tuple(LimbLook(f"leg {number + 1}") for number in range(count))

    def _count(self, kept: list[dict[str, Any]], made: int) -> None:
        """State the number of animated records, and of those that differ from the table."""
        starts = self._context.job.run.one_a_row or self._context.job.run.kind_name == "return_map"
        total = self._table["row"].nunique() if starts else len(self._table)
        noun = ("start" if starts else "record") + "s" * (total != 1)
        beside = f", {self._beside} of them beside a boundary" if self._beside and len(kept) == made else ""
        full = f"; {made - len(kept)} more did not fit" if len(kept) < made else ""
        other = sum("later" in each or "apart" in each for each in kept)
        differ = f"; {other} of them differ from the table, as the page shows" if other else ""
        self.sentence = f"{len(kept)} of {total} {noun} are animated{beside}{full}{differ}."


def _python(table: pd.DataFrame, context: RunContext) -> dict[str, Any]:
    """A job of one row in Python, with marks for the row's number and its values of the varied quantities."""
    fields = table.attrs["job"]
    given = {name: fields[name] for name in ("model", "structure", "params", "start", "numerics")}
    given["run"] = {k: v for k, v in fields["run"].items() if v is not None and k not in _OF_MANY_ROWS}
    name = f"{context.job.name}_row_@row@"
    lines = [
        f"name={name!r}",
        *(f"{key}={value!r}" for key, value in given.items() if value),
        "vary={@vary@}",
    ]
    text = "".join(f"    {line},\n" for line in lines)
    varied = [name for name in context.design.names if name in table.columns]
    return {
        "python": f"import gaitsweep as gs\n\njob = gs.Job(\n{text})\nprint(gs.run(job).table)\n",
        "varied": varied,
    }


def _passes(table: pd.DataFrame, context: RunContext) -> dict[str, Any]:
    """The direction, colour and marker of each pass of a parameter that rises and falls; none for others."""
    run = context.job.run
    turns = run.turns if "pass" in table.columns else ()
    rises = [after > before for before, after in itertools.pairwise(turns)]
    looks = [{"rises": up, "colour": UP if up else DOWN, "marker": "^" if up else "v"} for up in rises]
    return {"moved": run.moved, "passes": looks if len(set(rises)) == 2 else []}


def _about(shown: StartMap, table: pd.DataFrame, context: RunContext, replays: _Replays) -> dict[str, Any]:
    """Header of the page: name, model, limbs, remarks and provenance."""
    job, model = context.job, context.model
    manifest = table.attrs.get("manifest", {})
    notes = [*remarks(table)]
    if shown.thinned:
        notes.append(f"shown: {shown.thinned}")
    colours = limb_colours(replays.limbs)
    return {
        "name": job.name,
        "model": model.name,
        "source": model.source,
        "what": (type(model).__doc__ or "").strip().split("\n")[0],
        "run": job.run.kind_name,
        "rows": int(manifest.get("rows", table["row"].nunique())),
        "remarks": notes,
        "told": replays.sentence,
        "limbs": [
            {"name": look.name, "colour": colour, "far": look.far}
            for look, colour in zip(replays.limbs, colours, strict=True)
        ],
        "provenance": {
            "gaitsweep": version(),
            "job": str(manifest.get("job_hash", ""))[:12],
            "commit": str(manifest.get("git_commit", "") or "")[:12],
            "engine": str(manifest.get("engine", "")),
            "device": str(manifest.get("device", "")),
        },
    }


def _json(fields: Any) -> bytes:
    # a browser reads no NaN: a number that may be missing goes through `rounded`
    return json.dumps(
        fields, separators=(",", ":"), ensure_ascii=False, default=_plain, allow_nan=False
    ).encode()


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value)} is not JSON")


def _part(name: str) -> str:
    return resources.files("gaitsweep.view.explorer").joinpath("page", name).read_text("utf-8")


def _filled(texts: Mapping[str, str], plotly: str, data: str, size: str) -> str:
    """The template filled with its parts; `texts` are escaped, and `size` is that of the page in MB."""
    parts = {f"{{{{{name}}}}}": html.escape(text) for name, text in texts.items()}
    parts |= {
        "{{size}}": size,
        **{f"{{{{{mark}}}}}": _part(name) for mark, name in _PARTS.items()},
        "{{data}}": data,
        "{{plotly}}": plotly,
    }
    # all at once, so that no text is searched for marks
    return re.sub("|".join(map(re.escape, parts)), lambda mark: parts[mark[0]], _part(_TEMPLATE))
