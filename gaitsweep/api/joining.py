"""Joining of results: one table of several, with units, gaits and the constants in which they differ."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Int

from gaitsweep.analysis.records import axes_of
from gaitsweep.api.result import Result
from gaitsweep.errors import ArgumentError
from gaitsweep.expression import evaluate, names_used
from gaitsweep.table.frames import with_same_categories
from gaitsweep.table.manifest import self_check_warned

_CONSTANTS = ("structure", "params", "start")  # the parts of a job that hold constants of all its rows
_SETTINGS = ("run", "numerics")
_FIELDWISE = (*_CONSTANTS, *_SETTINGS)  # the parts of which a joined table keeps the fields in common
# The first column of a table of branches after the axes: its others depend on fields of the run.
_OF_BRANCHES = ("point", "part")
Tables = pd.DataFrame | Result | Sequence[pd.DataFrame | Result]


def concat(*tables: Tables) -> pd.DataFrame:
    """Join results of one model and run kind into one table, with units and provenance in `.attrs`.

    `pandas.concat` drops `.attrs`, and makes text of gaits where tables have different ones; figures then
    lack units and the model's colours.

    Args:
        tables: tables or results, in a list or one by one.

    Returns:
        The records of all tables, with an index from 0 and `row` numbered on from table to table. A constant
        that differs between the jobs, or that varies in another one, is a column behind `row`, as an axis is.

    Raises:
        ArgumentError: models, run kinds, moved parameters or units differ; a table lacks `.attrs`, or an axis
            of the others, or any of their columns if none has a job; two tables have the same row of one job,
            which would count twice, or two rows settle from one start; they are of atlases; an argument is no
            table, or there is none.

    Example:
        >>> import gaitsweep as gs
        >>> from gaitsweep.examples.hopper import Hopper
        >>> soft = gs.sweep(Hopper(), launch_0=[2.5, 5.0], phase_0=2.0, restitution=0.6)
        >>> hard = gs.sweep(Hopper(), launch_0=[2.5, 5.0], phase_0=2.0, restitution=0.7)
        >>> both = gs.concat([soft, hard])
        >>> both[["row", "restitution", "launch_0"]].to_numpy().tolist()
        [[0.0, 0.6, 2.5], [1.0, 0.6, 5.0], [2.0, 0.7, 2.5], [3.0, 0.7, 5.0]]
        >>> both.attrs["quantities"]["launch_end"]["unit"]
        'm/s'
    """
    frames = _frames(tables)
    jobs = [frame.attrs.get("job") or {} for frame in frames]
    if any(jobs):
        _require_alike(jobs)
        _require_different_rows(frames)
        frames = _with_differing_constants(frames, jobs)
        _require_different_starts(frames, jobs)
    _require_columns(frames, axes_only=any(jobs))
    attrs = _joined_attrs([frame.attrs for frame in frames])
    frames, parts = _with_rows_numbered_on(frames)
    joined = pd.concat(same_categories(*frames), ignore_index=True)
    if attrs:
        attrs["joined"] = parts
    joined.attrs = attrs
    return joined


def same_categories(*tables: Tables) -> list[pd.DataFrame]:
    """Return tables in which columns of one name, such as `gait`, have the same categories in the same order.

    Of columns with other categories `pandas.concat` and `merge` make plain text, whose order is alphabetical.
    `gs.concat` joins tables with the same categories, and keeps their units.

    Args:
        tables: tables or results, in a list or one by one. Each keeps its units and provenance in `.attrs`.

    Returns:
        The tables. Their categories are those of the first one, then new ones of the others; outcomes that
        are no gaits are the last.

    Raises:
        ArgumentError: an argument is no table.

    Example:
        >>> import pandas as pd, gaitsweep as gs
        >>> slow = pd.DataFrame({"gait": pd.Categorical(["walk"], ["walk", "trot", "none"])})
        >>> fast = pd.DataFrame({"gait": pd.Categorical(["gallop"], ["walk", "gallop", "none"])})
        >>> pd.merge(*gs.same_categories(slow, fast), on="gait", how="outer")["gait"].cat.categories.tolist()
        ['walk', 'trot', 'gallop', 'none']
    """
    return with_same_categories(_frames(tables))


def _frames(tables: Sequence[Tables]) -> list[pd.DataFrame]:
    """The tables in arguments: each a table or a result, or all in one list.

    Raises:
        ArgumentError: there is none, or one is neither.
    """
    listed: Iterable[Any] = tables
    if len(tables) == 1 and isinstance(tables[0], Iterable):
        whole = isinstance(tables[0], pd.DataFrame | str | Mapping)
        listed = tables if whole else tables[0]
    frames = []
    for number, table in enumerate(listed, 1):
        frame = table.table if isinstance(table, Result) else table
        if not isinstance(frame, pd.DataFrame):
            hint = f": load it by gs.load({table!r})" if isinstance(table, str) else ""
            raise ArgumentError(f"Table {number} is a {type(table).__name__}, but must be a table{hint}.")
        frames.append(frame)
    if not frames:
        raise ArgumentError("There is no table: give at least one.")
    return frames


def _require_alike(jobs: Sequence[Mapping[str, Any]]) -> None:
    """Refuse tables of different models, run kinds or moved parameters, of atlases, and those without a job.

    Raises:
        ArgumentError: with both values, or the number of the table.
    """
    for number, job in enumerate(jobs, 1):
        if not job:
            raise ArgumentError(
                f"Table {number} has no units and no job in .attrs, which pandas.concat and merge drop: join "
                "tables as gs.load or gs.sweep returned them."
            )
    runs = [job.get("run", {}) for job in jobs]
    for what, values in (
        ("models", [job.get("model") for job in jobs]),
        ("run kinds", [run.get("kind") for run in runs]),
        ("moved parameters", [run.get("parameter") for run in runs]),
    ):
        if len(dict.fromkeys(values)) > 1:
            listed = " and ".join(map(str, dict.fromkeys(values)))
            raise ArgumentError(
                f"The tables have different {what}, {listed}, and cannot be joined: give tables with one and "
                f"the same {what.removesuffix('s')}."
            )
    if runs[0].get("kind") == "atlas":
        raise ArgumentError("Tables of atlases cannot be joined: their branches have numbers of their own.")


def _parts(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """The jobs of a table's rows.

    Returns:
        For each job its hash, the range of the table's rows that are of it, and `shift`, the difference
        between these numbers and those of the job. Rows of a table without a hash have no part.
    """
    if "row" not in frame.columns or not len(frame):
        return []
    rows = frame["row"].to_numpy()
    if "joined" not in frame.attrs:
        job_hash = (frame.attrs.get("manifest") or {}).get("job_hash")
        return [] if job_hash is None else [_part(rows, {"job_hash": job_hash, "shift": 0})]
    in_parts = [
        (part, rows[(rows >= part["first"]) & (rows <= part["last"])]) for part in frame.attrs["joined"]
    ]
    return [_part(of_part, part) for part, of_part in in_parts if of_part.size]


def _part(rows: Int[np.ndarray, " rows"], of_job: Mapping[str, Any]) -> dict[str, Any]:
    """The job of some rows, as `_parts` describes it, with their range."""
    return {**of_job, "first": int(rows.min()), "last": int(rows.max())}


def _require_different_rows(frames: Sequence[pd.DataFrame]) -> None:
    """Refuse tables that share rows of one job, which are the same simulations.

    Raises:
        ArgumentError: the message has the number of such rows and how to select the others.
    """
    rows_of: dict[str, list[tuple[int, Int[np.ndarray, " rows"]]]] = {}
    for number, frame in enumerate(frames, 1):
        for part in _parts(frame):
            rows = np.unique(frame["row"].to_numpy(np.int64))
            rows = rows[(rows >= part["first"]) & (rows <= part["last"])] - part["shift"]
            for other, other_rows in rows_of.setdefault(part["job_hash"], []):
                repeated = np.intersect1d(rows, other_rows, assume_unique=True)
                if repeated.size:
                    raise ArgumentError(_repeated_rows(repeated, other, number, frames))
            rows_of[part["job_hash"]].append((number, rows))


def _repeated_rows(
    repeated: Int[np.ndarray, " repeated"], other: int, number: int, frames: Sequence[pd.DataFrame]
) -> str:
    """Name the rows of one job that two tables share, and how to select the others."""
    count = f"{repeated.size} row{'s' * (repeated.size != 1)}"
    text = f"Tables {other} and {number} both have {count} of the same job, such as row {repeated[0]}"
    if any("joined" in frames[index - 1].attrs for index in (other, number)):
        return f"{text} of that job, which would count twice. Join the results themselves, each once."
    return (
        f"{text}, which would count twice. Give each row once: "
        "table[~table['row'].isin(other['row'])] has those that the other table lacks."
    )


def _with_differing_constants(
    frames: Sequence[pd.DataFrame], jobs: Sequence[Mapping[str, Any]]
) -> list[pd.DataFrame]:
    """The tables with a column for each constant that differs between their jobs, or is a column of another.

    Raises:
        ArgumentError: a table has neither a column nor a constant of a name that another one has.
    """
    constants = [
        {key: value for part in _CONSTANTS for key, value in (job.get(part) or {}).items()} for job in jobs
    ]
    names = []
    for name in dict.fromkeys(name for of_job in constants for name in of_job):
        values = {repr(of_job.get(name)) for of_job in constants}
        if len(values) > 1 or any(name in frame for frame in frames):
            names.append(name)
    completed = []
    for number, (frame, of_job) in enumerate(zip(frames, constants, strict=True), 1):
        missing = [name for name in names if name not in frame]
        for name in missing:
            if name not in of_job:
                raise ArgumentError(
                    f"{name} is a column or a constant of another table, but table {number} lacks it."
                )
        structure = jobs[number - 1].get("structure") or {}
        place = int("row" in frame.columns)
        order = [*frame.columns[:place], *missing, *frame.columns[place:]]
        with_columns = frame.assign(
            **{
                # a text of the structure, such as the kind of ground, is no formula
                name: of_job[name] if name in structure else _value_of(name, frame, of_job)
                for name in missing
            }
        )[order]
        with_columns.attrs = frame.attrs
        completed.append(with_columns)
    return completed


def _require_columns(frames: Sequence[pd.DataFrame], *, axes_only: bool) -> None:
    """Refuse a table that lacks a column of another one, or an axis, whose values would all be NaN.

    Raises:
        ArgumentError: with the column and the numbers of the tables.
    """
    for other, with_column in enumerate(frames, 1):
        axes = itertools.takewhile(lambda name: name not in _OF_BRANCHES, axes_of(with_column))
        for name in axes if axes_only else with_column.columns:
            for number, frame in enumerate(frames, 1):
                if name not in frame:
                    raise ArgumentError(f"{name} is a column of table {other}, but table {number} lacks it.")


def _require_different_starts(frames: Sequence[pd.DataFrame], jobs: Sequence[Mapping[str, Any]]) -> None:
    """Refuse rows of kind settle of several tables that have the same parameters and start.

    A column of the user's own, such as a name of each table, tells such rows apart.

    Raises:
        ArgumentError: with the limits and numerics that differ, or the values of such a row.
    """
    settings = [
        {f"{part}.{k}": v for part in _SETTINGS for k, v in (job.get(part) or {}).items()} for job in jobs
    ]
    differing = [
        name
        for name in dict.fromkeys(itertools.chain(*settings))
        if len({repr(of.get(name)) for of in settings}) > 1
    ]
    # rows of one job are not repeated, even if it has drawn a start twice
    if settings[0].get("run.kind") != "settle" or all(job == jobs[0] for job in jobs):
        return
    described = {name for frame in frames for name in frame.attrs.get("quantities") or {}}
    inputs = [[*axes_of(frame), *(name for name in frame if name not in described)] for frame in frames]
    names = [name for name in dict.fromkeys(itertools.chain(*inputs)) if name != "row"]
    starts_of = [frame.reindex(columns=names) for frame in frames]
    starts = pd.concat([of_frame.drop_duplicates() for of_frame in starts_of])
    repeated = starts.duplicated().to_numpy()
    if not repeated.any():
        return
    if differing:
        raise ArgumentError(
            "Rows of these tables have the same parameters and start and would count twice: they differ only "
            f"in {', '.join(differing)}. Give each table a column that tells them apart, such as "
            "table.assign(limits='long')."
        )
    # where rows of one table are alike, a column that told them apart has been left out
    if len(starts) == sum(map(len, starts_of)):
        first = starts.iloc[int(repeated.argmax())]
        values = [f"{name} = {first[name]}" for name in dict.fromkeys(itertools.chain(*map(axes_of, frames)))]
        raise ArgumentError(
            "Rows of these tables have the same parameters and start and would count twice"
            f"{', such as ' * bool(values)}{', '.join(values)}: leave them out of one table, or give each "
            "table a column that tells them apart, such as table.assign(run='first')."
        )


def _value_of(name: str, frame: pd.DataFrame, constants: Mapping[str, Any]) -> Any:
    """The value of a constant in the rows of a table, from its formula over columns and other constants."""
    value = constants[name]
    if not isinstance(value, str):
        return value
    values = {
        used: frame[used].to_numpy() if used in frame.columns else _value_of(used, frame, constants)
        for used in names_used(value)
        if used in frame.columns or used in constants
    }
    return evaluate(value, values)


def _with_rows_numbered_on(frames: Sequence[pd.DataFrame]) -> tuple[list[pd.DataFrame], list[dict[str, Any]]]:
    """The tables with row numbers that follow those of the table before, and the parts of all their rows."""
    numbered, parts = [], []
    first = 0
    for frame in frames:
        if "row" in frame.columns and len(frame):
            shift = first - int(frame["row"].to_numpy().min()) if first else 0
            parts += [
                part | {name: part[name] + shift for name in ("first", "last", "shift")}
                for part in _parts(frame)
            ]
            frame = frame.assign(row=frame["row"] + shift) if shift else frame
            first = int(frame["row"].to_numpy().max()) + 1
        numbered.append(frame)
    return numbered, parts


def _joined_attrs(attrs: Sequence[Mapping[Any, Any]]) -> dict[Any, Any]:
    """Units and provenance of a joined table: what its tables have in common, and their rows in all.

    Raises:
        ArgumentError: a quantity has different units.
    """
    quantities: dict[str, Any] = {}
    for of_table in attrs:
        for name, quantity in (of_table.get("quantities") or {}).items():
            unit, other = quantities.setdefault(name, quantity).get("unit"), quantity.get("unit")
            if unit != other:
                raise ArgumentError(f"{name} is in {unit} in one table and in {other} in another.")
    if not quantities and not any("job" in of_table for of_table in attrs):
        return {}
    jobs = [of_table.get("job") or {} for of_table in attrs]
    job = _common(jobs) | {part: _common([of_job.get(part) or {} for of_job in jobs]) for part in _FIELDWISE}
    manifests = [of_table.get("manifest") or {} for of_table in attrs]
    checks = [manifest["self_check"] for manifest in manifests if manifest.get("self_check")]
    missing = [of_table.get("rows_missing", 0) for of_table in attrs]
    return {
        "job": job,
        "manifest": {
            "rows": sum(manifest.get("rows", 0) for manifest in manifests),
            # a figure says that one of them warned
            "self_check": next(filter(self_check_warned, checks), checks[0] if checks else None),
        },
        "quantities": quantities,
        "complete": all(of_table.get("complete", True) for of_table in attrs),
        "rows_missing": sum(missing),
    }


def _common(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The fields that have the same value in all parts of jobs."""
    return {
        key: value
        for key, value in parts[0].items()
        if all(key in part and part[key] == value for part in parts)
    }
