"""Summary of a run for its manifest: settings, counts of rows by their end, and units of the columns."""

from __future__ import annotations

import collections
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from gaitsweep import models
from gaitsweep.contract import Model
from gaitsweep.dynamics.declared import Declared
from gaitsweep.dynamics.gaits_by_footfalls import TOGETHER
from gaitsweep.dynamics.mjcf import OfMjcf
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.kernel.lanes import over_started_rows
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.sweep.lane import RowDrive
from gaitsweep.kinds.columns import AT_REST
from gaitsweep.kinds.run_kind import table_columns
from gaitsweep.own_modules import folder_of_class
from gaitsweep.runs.prepare import RunContext
from gaitsweep.runs.sentences import (
    BACKWARDS,
    MISLABELLED,
    NO_STRIDE,
    OTHER_LAGS,
    SEVERAL,
    SHORT_CONTACTS,
    STARTS_BEYOND,
    UNEVEN_STRIDES,
    UNSETTLED,
    WITHOUT_GAIT,
    WITHOUT_PERIOD,
    WITHOUT_START,
    WITHOUT_STRIDES,
)
from gaitsweep.runs.unstable_rests import strides_of_feet
from gaitsweep.status import Status, StatusNames
from gaitsweep.table import Table

# Rows whose starts are examined, at most.
_MOST_STARTS = 100_000
_MOST_STARTS_OF_HOST = 64  # of models whose parameters the host computes row by row
_BACKWARDS = -1e-3  # m/s, a mean speed above which a body marches on the spot
# Parts of the path of a project's folder, at least, of which / is the first: /home/user is none.
_PROJECT_DEPTH = 4


def describe(context: RunContext, table: Table) -> None:
    """Write the axes of the rows and the settings of the run into the manifest.

    `axes` are in the order of the rows, the last varying fastest: the names that vary together, the number
    of points, and whether these are drawn as a sample.
    """
    steps = context.steps.dt[(context.steps.dt > 0.0) & (context.steps.dt < np.inf)]
    table.update_manifest(
        engine=context.engine,
        device=context.device,
        lanes=context.spec.lanes,
        precision=context.spec.numerics.precision,
        method=context.spec.numerics.method,
        dt=[float(np.min(steps)), float(np.max(steps))] if steps.size else [],
        axes=[
            {"names": list(group.names), "length": group.length, "drawn": group.drawn}
            for group in context.design.groups
        ],
        quantities=context.quantities,
        **_model_folder(context, table.path),
    )


def _model_folder(context: RunContext, path: Path | None) -> dict[str, str]:
    """The folder of a user's model, for `--trust` from elsewhere; none for the papers' models.

    It is relative to the result directory, and omitted if the two share no project folder, so that a
    directory which is passed on does not reveal where its owner's files are.
    """
    if path is None or context.job.model in models.names():
        return {}
    if (folder := folder_of_class(type(context.model.original))) is None:
        return {}
    shared = Path(os.path.commonpath([folder, path.resolve()]))
    relative = os.path.relpath(folder, path.resolve())
    return {} if len(shared.parts) < _PROJECT_DEPTH else {models.MODEL_FOLDER: relative}


def sum_up(context: RunContext, table: Table, timings: dict[str, float]) -> None:
    """Write timings, counts and, once complete, the summary of the records into the manifest, at once.

    Args:
        context: the job's context.
        table: its table.
        timings: the time spent (s), by its name in the manifest.
    """
    complete = not table.missing_blocks()
    fields: dict[str, Any] = {"timings": timings, "counts": table.counts(), "complete": complete}
    if complete:
        table.tidy_digests()
        fields |= _of_records(context, table)
        fields |= _of_starts(context)
    table.update_manifest(**fields)


def _of_starts(context: RunContext) -> dict[str, Any]:
    """Count rows without a start, with one beyond an event's surface, or without a positive nominal period.

    Returns:
        For each reason, each event, and each such value of the period: the number of rows `rows`, and the
        first one `row`; with more than `_MOST_STARTS` rows, `of` evenly spaced ones are examined.
    """
    n = context.spec.n_rows
    model = context.model
    most = _MOST_STARTS_OF_HOST if model.host_parameters else _MOST_STARTS
    rows = np.arange(n) if n <= most else np.linspace(0, n - 1, most).astype(np.int64)
    parameters, starts = context.design.values_in(rows)
    of_rows = _period_and_faults_of_start(model, context.spec.numerics.dtype, context.spec.drive)
    period, beyond, without = of_rows(model.on_host(parameters), starts)
    begins = ~np.any([np.zeros(rows.size, bool), *without.values()], axis=0)
    times = {"NaN": np.isnan(period), "0": period == 0.0, "a number below 0": period < 0.0}
    masks = {
        STARTS_BEYOND: {name: mask & begins for name, mask in beyond.items()},
        WITHOUT_START: without,
        WITHOUT_PERIOD: {**times, "infinity": period == np.inf},
    }
    counts: dict[str, dict[str, dict[str, int]]] = {}
    examined = {"of": int(rows.size)} if rows.size < n else {}
    for field, mask_by_name in masks.items():
        for name, mask in mask_by_name.items():
            if (hits := rows[mask]).size:
                count = {"rows": int(hits.size), "row": int(hits[0])}
                counts.setdefault(field, {})[name] = count | examined
    return counts


@cached_by_content(maxsize=16)
def _period_and_faults_of_start(
    model: Model, dtype: str, drive: RowDrive | None
) -> Callable[..., tuple[Any, ...]]:
    """The function `(values, starts) -> (period, beyond, without)` of rows, by events and by reasons."""
    kind = type(model.original)

    def of_start(params: Any, state: Any) -> tuple[jax.Array, dict[str, jax.Array], dict[str, jax.Array]]:
        beyond = model.beyond_at_start(params, state)
        return model.period(params), beyond, model.without_start(params, state)

    def period(values: Any, start: Any) -> tuple[jax.Array, dict[str, jax.Array], dict[str, jax.Array]]:
        return model.period(model.params(values)), {}, {}

    if kind.beyond_at_start is Model.beyond_at_start and kind.without_start is Model.without_start:
        return over_rows(period, "period", model)
    return over_started_rows(of_start, "faults of start", model, dtype, drive)


def summed_up(context: RunContext, table: Table) -> bool:
    """Return whether the manifest of a table with all its parts is complete."""
    manifest = table.manifest
    if manifest.get("complete") is not True or manifest.get("counts") != table.counts():
        return False
    # without mislabelled rows, or with strides, there is no field for them
    needed = {*_summaries(context, table), "quantities"} - {MISLABELLED, BACKWARDS, *_OF_STRIDES}
    return needed <= manifest.keys()


def tallied_column(context: RunContext) -> str | None:
    """The column whose values are counted while rows run: a row's outcome or gait; None: its status."""
    if tuple(context.model.gaits) == ("none",) or not context.job.run.one_a_row:
        return None
    columns = table_columns(context.design, context.job.run)
    return next((name for name in ("outcome", "gait") if name in columns), None)


def _summaries(context: RunContext, table: Table) -> dict[str, set[str]]:
    """Return the fields of the manifest that summarise records, with the columns that each needs."""
    columns = set(table_columns(context.design, context.job.run))
    counts = table.counts()
    strides = columns & set(_feet_by_stride(context))
    of_steps = {"gait", "attractor_period", *strides, *map(_duty_of, strides)}
    columns_of_rows = columns if context.job.run.one_a_row else set()
    names_gaits = tuple(context.model.gaits) != ("none",)
    speed = {f"{q.name}_end" for q in context.model.observables if (q.name, q.unit) == ("speed", "m/s")}
    is_body = isinstance(context.model.original, OfMjcf)
    needs = {
        BACKWARDS: (speed, is_body and speed & columns_of_rows),
        SHORT_CONTACTS: (of_steps, strides and of_steps <= columns_of_rows and _shortest_contact(context)),
        MISLABELLED: ({"gait"}, "gait" in columns),
        WITHOUT_STRIDES: (strides, strides),
        UNEVEN_STRIDES: (of_steps, strides and of_steps <= columns_of_rows),
        WITHOUT_GAIT: (of_steps, strides and of_steps <= columns_of_rows),
        "stalls": ({"stalled_by", "t_end", "t"} & columns, counts.get(Status.event_stall.name)),
        "gaits": ({"gait"}, names_gaits and "gait" in columns_of_rows),
        "periods": ({"attractor_period"}, counts.get(Status.settled.name) and "attractor_period" in columns),
        "slowest": ({"slowest"}, counts.get(Status.cycle_limit.name) and "slowest" in columns),
        "largest_distance": ({"distance", "gait"}, {"distance", "gait"} <= columns_of_rows),
        "findings": (set(context.job.run.columns_of_findings), context.job.run.columns_of_findings),
    }
    return {field: names for field, (names, applies) in needs.items() if applies}


def _feet_by_stride(context: RunContext) -> dict[str, str]:
    """Return the foot of each column of strides that a table may have."""
    strides = strides_of_feet(context.model)
    return {f"{name}{end}": foot for name, foot in strides.items() for end in ("_n", "_end")}


def _duty_of(stride: str) -> str:
    """The column of the duty factor that belongs to a column of strides."""
    return stride.replace("stride", "duty", 1)


def _of_records(context: RunContext, table: Table) -> dict[str, Any]:
    """Summarise the records of a complete table, which are read part by part."""
    summaries = _summaries(context, table)
    if not summaries:
        return {}
    feet = _feet_by_stride(context)
    without_stride = {feet[column] for column in summaries.get(WITHOUT_STRIDES, ())}
    adders = {name: add for name, add in _adders(context, feet).items() if name in summaries}
    about: dict[str, dict[str, Any]] = collections.defaultdict(dict)
    counts = {name: collections.Counter[str]() for name in _COUNTED if name in summaries}
    distances: list[tuple[float, int]] = []
    parts_of_findings: list[pd.DataFrame] = []
    for part in table.load_parts(["row", "status", *sorted(set().union(*summaries.values()))]):
        if WITHOUT_STRIDES in summaries:
            strides = part[sorted(summaries[WITHOUT_STRIDES])]
            without_stride -= {feet[str(name)] for name in strides.columns[strides.notna().any()]}
        for name, add in adders.items():
            add(about[name], part)
        for name, counter in counts.items():
            column, statuses = _COUNTED[name]
            values: Any = part[column][statuses.among(part["status"])]
            counter.update({str(value): int(n) for value, n in values.value_counts().items() if n})
        if "findings" in summaries:
            parts_of_findings.append(part.filter(list(context.job.run.columns_of_findings)))
        if "largest_distance" in summaries:
            distances += filter(None, [context.model.analytic_distance(part)])
    farthest = max(distances, key=lambda distance: distance[0], default=None)
    fields: dict[str, Any] = {
        **{name: dict(counter.most_common()) for name, counter in counts.items()},
        "stalls": dict(sorted(about["stalls"].items())),
        "largest_distance": {"rad": farthest[0], "row": farthest[1]} if farthest else {},
    }
    if "periods" in fields:
        fields["periods"] = dict(sorted(fields["periods"].items(), key=lambda item: int(item[0])))
    if parts_of_findings:
        records = pd.concat(parts_of_findings, ignore_index=True)
        fields["findings"] = context.job.run.findings(records)
    fields |= {name: about[name] for name in (MISLABELLED, SHORT_CONTACTS, BACKWARDS) if about[name]}
    fields |= _of_strides(context, without_stride, about[UNEVEN_STRIDES], about[WITHOUT_GAIT])
    return {name: fields[name] for name in summaries if name in fields}


def _adders(
    context: RunContext, feet: Mapping[str, str]
) -> dict[str, Callable[[dict[str, Any], pd.DataFrame], None]]:
    """The functions that add the rows of a part to what is known about rows of one kind, by field."""
    gaits, shortest_contact = [*context.model.gaits, AT_REST], _shortest_contact(context)
    periods = _periods(context)
    return {
        MISLABELLED: lambda known, part: _add_mislabelled(known, part, gaits),
        UNEVEN_STRIDES: lambda known, part: add_uneven_strides(known, part, feet),
        WITHOUT_GAIT: lambda known, part: add_without_gait(known, part, feet),
        SHORT_CONTACTS: lambda known, part: add_short_contacts(known, part, feet, shortest_contact, periods),
        BACKWARDS: add_backwards,
        "stalls": _add_stalls,
    }


def _of_strides(
    context: RunContext,
    without_stride: set[str],
    uneven: dict[str, dict[str, Any]],
    without_gait: dict[str, dict[str, Any]],
) -> dict[str, Any]:
    """Summarise feet without a stride in any row, and settled rows without a gait; `_OF_STRIDES`."""
    fields: dict[str, Any] = {}
    feet = list(dict.fromkeys(_feet_by_stride(context).values()))
    is_body = isinstance(context.model.original, OfMjcf)
    if uneven:
        fields[UNEVEN_STRIDES] = {"feet": uneven, "body": is_body}
    if without_stride:
        about: dict[str, Any] = {"rows": context.spec.n_rows, "row": 0, "body": is_body}
        if without_stride < set(feet):
            about["feet"] = [foot for foot in feet if foot in without_stride]
        fields[WITHOUT_STRIDES] = {context.model.name: about}
        without_gait = {reason: rows for reason, rows in without_gait.items() if reason != NO_STRIDE}
    if without_gait:
        fields[WITHOUT_GAIT] = {"legs": len(feet), "reasons": without_gait}
    return fields


_OF_STRIDES = {WITHOUT_STRIDES, UNEVEN_STRIDES, WITHOUT_GAIT, SHORT_CONTACTS}  # fields that few tables have

# Fields that count the values of a column, and the statuses of the rows that count.
_COUNTED = {
    "gaits": ("gait", Status.SOUND),
    "periods": ("attractor_period", StatusNames({"settled"})),
    "slowest": ("slowest", StatusNames({"cycle_limit"})),
}


def _add_mislabelled(
    mislabelled: dict[str, dict[str, int]], part: pd.DataFrame, gaits: Sequence[str]
) -> None:
    """Add the rows of a part whose label is not the index of a gait, by its name in the table."""
    for name in part["gait"].cat.categories.difference(list(gaits)):
        rows = part.loc[part["gait"] == name, "row"]
        if rows.size:
            known = mislabelled.setdefault(str(name), {"rows": 0, "row": int(rows.iloc[0])})
            known["rows"] += int(rows.nunique())


def add_uneven_strides(
    uneven: dict[str, dict[str, Any]], part: pd.DataFrame, feet: Mapping[str, str]
) -> None:
    """Add the rows of a part on which a foot lands more than once a stride, whose gait is none.

    The last stride of such a foot is shorter than its last stance, so that its duty factor is NaN; or, on an
    orbit of one crossing, it is the shortest of strides that differ. Each row counts for one foot; those that
    settled with strides that differ over several crossings do not count.

    Args:
        uneven: by foot, the number of such rows, the first of them, and the shortest and the longest of the
            foot's last contacts (s), as `contact`; it is extended.
        part: records of a table.
        feet: the foot of each column of strides.
    """
    rows, columns = _ended_without_gait(part, feet)
    rows = rows[rows[columns].notna().all(axis=1)]
    strides = rows[columns].to_numpy(float)
    uneven_and_settled = _are_settled(rows) & _are_uneven(strides)
    of_one_crossing = (rows["attractor_period"] == 1).to_numpy(bool)
    several = uneven_and_settled & ~of_one_crossing
    land_within = ~several[:, None] & _land_within(rows, columns)
    has_such = land_within.any(axis=1)
    repeated = has_such | (uneven_and_settled & of_one_crossing)
    shortest = np.argmin(np.where(land_within | ~has_such[:, None], strides, np.inf), axis=1)
    for k, column in enumerate(columns):
        is_short = (shortest == k) & repeated
        if not is_short.any():
            continue
        contacts = strides[is_short, k] * rows[_duty_of(column)].to_numpy(float)[is_short]
        row = int(rows["row"].to_numpy()[is_short][0])
        of_foot = uneven.setdefault(feet[column], {"rows": 0, "row": row, "contact": []})
        of_foot["rows"] += int(np.count_nonzero(is_short))
        known = [*of_foot["contact"], *contacts[np.isfinite(contacts)].tolist()]
        of_foot["contact"] = [min(known), max(known)] if known else []


def add_without_gait(
    without_gait: dict[str, dict[str, Any]], part: pd.DataFrame, feet: Mapping[str, str]
) -> None:
    """Add the rows of a part without a gait by the reason, except those of `add_uneven_strides`.

    They have settled, or their strides still differed at the limit of cycles. `feet` are those that have no
    stride in some of these rows.
    """
    rows, columns = _ended_without_gait(part, feet)
    strides = rows[columns].to_numpy(float)
    settled = _are_settled(rows)
    no_stride = np.isnan(strides).any(axis=1)
    uneven = ~no_stride & _are_uneven(strides)
    within = _land_within(rows, columns).any(axis=1)
    masks = {
        NO_STRIDE: settled & no_stride,
        SEVERAL: settled & uneven & (rows["attractor_period"] != 1).to_numpy(bool),
        OTHER_LAGS: settled & ~no_stride & ~uneven & ~within,
        UNSETTLED: ~settled & uneven & ~within,
    }
    for reason, mask in masks.items():
        if not mask.any():
            continue
        known = without_gait.setdefault(reason, {"rows": 0, "row": int(rows["row"].to_numpy()[mask][0])})
        known["rows"] += int(np.count_nonzero(mask))
        if reason == NO_STRIDE:
            lacking = np.isnan(strides[mask]).any(axis=0)
            named = {*known.get("feet", ()), *(feet[columns[k]] for k in np.flatnonzero(lacking))}
            known["feet"] = [foot for foot in dict.fromkeys(feet.values()) if foot in named]


def add_short_contacts(
    short_contacts: dict[str, Any],
    part: pd.DataFrame,
    feet: Mapping[str, str],
    shortest_contact: float,
    periods: Callable[[Any], Float[np.ndarray, " rows"]],
) -> None:
    """Add the settled rows of a part with a gait that twice the `shortest_contact` would not give them.

    A stance or swing of one of their feet would then not count. `share` are the shortest and the longest of
    these, as shares of the model's period.

    Args:
        short_contacts: the result of the parts before; this part is added.
        part: records of the table.
        feet: the foot of each column of strides.
        shortest_contact: the model's, as a share of its period.
        periods: function from the numbers of rows to their nominal periods, s.
    """
    columns = [name for name in feet if name in part.columns]
    rows: Any = part[_are_settled(part) & (part["gait"] != "none").to_numpy(bool)]
    if not len(rows):
        return
    strides = rows[columns].to_numpy(float)
    stances = strides * rows[[_duty_of(column) for column in columns]].to_numpy(float)
    numbers = rows["row"].to_numpy(np.int64)
    shares = np.minimum(stances, strides - stances) / periods(numbers)[:, None]
    shortest = np.min(shares, axis=1)
    is_short = shortest < 2.0 * shortest_contact
    if not is_short.any():
        return
    known = short_contacts or {"rows": 0, "row": int(numbers[is_short][0]), "feet": [], "share": []}
    counted = [feet[columns[k]] for k in np.argmin(shares, axis=1)[is_short]]
    spans = [*known["share"], *shortest[is_short].tolist()]
    short_contacts |= {
        **known,
        "rows": known["rows"] + int(np.count_nonzero(is_short)),
        "feet": sorted({*known["feet"], *counted}),
        "share": [min(spans), max(spans)],
        "shortest_contact": shortest_contact,
    }


def add_backwards(backwards: dict[str, Any], part: pd.DataFrame) -> None:
    """Add the settled rows of a part whose body walks backwards; `fastest` is the lowest mean speed, m/s."""
    speeds = part["speed_end"].to_numpy(float)
    walk_back = _are_settled(part) & (speeds < _BACKWARDS)
    if walk_back.any():
        known = backwards or {"rows": 0, "row": int(part["row"].to_numpy()[walk_back][0]), "fastest": 0.0}
        fastest = min(known["fastest"], float(speeds[walk_back].min()))
        rows = known["rows"] + int(np.count_nonzero(walk_back))
        backwards |= {**known, "rows": rows, "fastest": fastest}


def _shortest_contact(context: RunContext) -> float:
    """The `shortest_contact` of a model whose feet bounce; 0 without such feet."""
    original = context.model.original
    if not isinstance(original, Declared) or not original.contacts_bounce:
        return 0.0
    return 0.0 if original.declarations.feet is None else original.declarations.feet.shortest_contact


def _periods(context: RunContext) -> Callable[[Any], Float[np.ndarray, " rows"]]:
    """The function from numbers of rows to their nominal periods, s."""
    model = context.model
    of_rows = over_rows(lambda values: model.period(model.params(values)))
    return lambda rows: np.asarray(of_rows(model.on_host(context.design.values_in(rows)[0])))


def _are_uneven(strides: Float[np.ndarray, "rows feet"]) -> Bool[np.ndarray, " rows"]:
    """Mask of rows whose strides differ by more than those of a gait (`Footfalls.gait`)."""
    first = strides[:, :1]
    return np.any(np.abs(strides - first) > TOGETHER * first, axis=1)


def _land_within(rows: pd.DataFrame, columns: Sequence[str]) -> Bool[np.ndarray, "rows feet"]:
    """Mask of feet whose last stance is longer than their last stride."""
    duties = rows[[_duty_of(column) for column in columns]].to_numpy(float)
    strides = rows[list(columns)].to_numpy(float)
    return np.isnan(duties) & ~np.isnan(strides)


def _are_settled(rows: pd.DataFrame) -> Bool[np.ndarray, " rows"]:
    """Mask of rows that have settled."""
    return (rows["status"] == Status.settled.name).to_numpy(bool)


def _ended_without_gait(part: pd.DataFrame, feet: Mapping[str, str]) -> tuple[Any, list[str]]:
    """The rows of a part that settled, or reached the limit of cycles, as none; its columns of strides."""
    columns = [name for name in feet if name in part.columns]
    ended = part["status"].isin([Status.settled.name, Status.cycle_limit.name])
    return part[ended & (part["gait"] == "none")], columns


def _add_stalls(stalls: dict[str, dict[str, Any]], part: pd.DataFrame) -> None:
    """Add the rows of a part that ended as `event_stall`, by the guards that stalled them.

    `rows` is their number, and `t` the earliest and the latest time (s) of a stall; tables without `t_end`
    have `after` instead, the times of the rows' last records.
    """
    if "stalled_by" not in part.columns:
        return
    stalled = part[part["stalled_by"].notna()]
    time, key = ("t_end", "t") if "t_end" in part.columns else ("t", "after")
    last = stalled.groupby("row").agg(by=("stalled_by", "last"), t=(time, "max"))
    guards = np.asarray(last["by"].astype(str))
    times = np.asarray(last["t"], np.float64)
    for names in np.unique(guards):
        stall = stalls.setdefault(str(names), {"rows": 0, key: []})
        known = np.array([*stall[key], *times[(guards == names) & np.isfinite(times)]])
        stall["rows"] += int(np.count_nonzero(guards == names))
        stall[key] = [float(known.min()), float(known.max())] if known.size else []
