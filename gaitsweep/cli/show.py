"""Text output of commands about models, estimates and result directories."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from gaitsweep.contract import Model, Quantity
from gaitsweep.runs.sentences import (
    DESCRIBED,
    IF_IT_DOES_NOT_WALK,
    REMARKS,
    axes,
    plain,
    remarks,
    repeating,
    self_check_sentence,
    settings_of,
    status_sentence,
    unsettled,
)
from gaitsweep.status import Status
from gaitsweep.table import Snapshot, TableError
from gaitsweep.table.parquet_parts import PARTS

if TYPE_CHECKING:
    from gaitsweep.runs.estimate import Estimate

_MODEL_FILES = (".yaml", ".yml")  # of a body in an MJCF and its controller
# Entries of a manifest that other lines have, or that no reader needs.
_NOT_LISTED = {
    "rows", "counts", "complete", "periods", "quantities", "job", "figures_drawn", "program", "sha256",
    *DESCRIBED,
}  # fmt: skip
_PIPED_WIDTH = 240  # columns, where the output is no terminal


def estimate(needs: Estimate) -> str:
    """Format the resources that a job would need."""
    time = f"about {duration(needs.seconds)}"
    records = f"about {needs.records}"
    if needs.records_longer > needs.records:
        time += f", {duration(needs.seconds_longer)} if each branch folds twice and is followed again"
        records += f", {needs.records_longer} if each branch folds twice"
    if needs.seconds_most > 1.05 * needs.seconds:
        time += f", at most {duration(needs.seconds_most)} (measured on the first rows)"
    if needs.self_check_s > 0.05 * needs.seconds:
        rows = f"{needs.self_check_rows} row{'s' * (needs.self_check_rows != 1)}"
        check = f"about {duration(needs.self_check_s)} for the self-check of {rows}"
        further = {
            "rows that end as cycle_limit add up to {} reruns": needs.unsettled_reruns,
            "up to {} others are added if none of its rows ends soundly": needs.added_rows,
        }
        if any(further.values()):
            check += f" ({'; '.join(words.format(most) for words, most in further.items() if most)})"
        time += f"; of these {check} (`verify: 0` turns it off)"
    refined = f", about {needs.simulated} of them simulated" if needs.simulated < needs.rows else ""
    lines = {"rows": f"{needs.rows} in {needs.blocks} block{'s' * (needs.blocks != 1)}{refined}"}
    if needs.records > needs.rows:
        lines["records"] = records
    lines |= {
        "engine": f"{needs.engine} on {needs.device}, {needs.lanes} lanes",
        "memory": f"about {size(needs.memory_bytes)}",
        "disk": f"about {size(needs.disk_bytes)}",
        "time": time,
    }
    return aligned(lines)


def counts(by_status: Mapping[str, int]) -> str:
    """Format the number of rows with each status: "15 settled, 1 fell"."""
    return ", ".join(f"{number} {status}" for status, number in by_status.items()) or "none finished"


def gaits_of_sound_rows(gaits: Mapping[str, int], rows: int) -> str:
    """Format the gaits of rows, and how many have none: "9 walk, 1 hop; 3 rows that did not settle ..."."""
    left_out = rows - sum(gaits.values())
    if left_out == 0:
        return counts(gaits)
    noun, verb = ("row", "is") if left_out == 1 else ("rows", "are")
    return f"{counts(gaits)}; {left_out} {noun} that failed or did not settle {verb} not counted"


def shares(by_status: Mapping[str, int]) -> str:
    """Format the share of rows with each status: "93.8 % settled, 6.2 % fell"."""
    rows = sum(by_status.values())
    return ", ".join(f"{100.0 * number / rows:.3g} % {status}" for status, number in by_status.items())


def stalled(stalls: Mapping[str, Mapping[str, Any]]) -> str:
    """Format the guards that stalled rows, and times: "3 event_stall: leg 2 touches or lifts, t = 1.25 s"."""
    texts = []
    for guards, stall in stalls.items():
        times = ""
        for key, words in (("t", "t ="), ("after", "after t =")):
            span = [f"{t:.6g}" for t in stall.get(key, [])]
            if span:
                times = f", {words} {' to '.join(dict.fromkeys(span))} s"
        texts.append(f"{stall.get('rows', 0)} {Status.event_stall.name}: {guards}{times}")
    return "; ".join(texts)


def distance(far: Mapping[str, Any]) -> str:
    """Format the largest distance from the analytic solutions: "0.110 rad (row 123)"."""
    return f"{far.get('rad', float('nan')):.3f} rad (row {far.get('row', '?')})"


def outcome(snapshot: Snapshot) -> str:
    """Format the results of a run on disk."""
    manifest = snapshot.manifest
    rows = manifest["rows"]
    parts = len(snapshot.files.footers)
    so_far = "" if snapshot.complete else f" of {rows}"
    lines = [f"{snapshot.rows_done}{so_far} row{'s' * (rows != 1)}: {counts(snapshot.counts)}."]
    if snapshot.counts and not set(snapshot.counts) & Status.SOUND:
        worst = next(iter(snapshot.counts))
        meaning = "This version does not know this status."
        if worst in Status.__members__:
            meaning = status_sentence(worst, snapshot.job, manifest)
        lines.append(f"No row ended normally. {worst}: {meaning}")
        if str(snapshot.job.get("model")).endswith(_MODEL_FILES):
            lines[-1] += f" {IF_IT_DOES_NOT_WALK} helps to find a gait."
    if slowest := manifest.get("slowest"):
        lines.append(f"Rows did not settle because of {unsettled(slowest)}.{repeating(manifest)}")
    if stalls := manifest.get("stalls"):
        lines.append(f"Stalled: {stalled(stalls)}.")
    lines += manifest.get("findings", [])
    if gaits := manifest.get("gaits"):
        lines.append(f"Gaits: {gaits_of_sound_rows(gaits, rows)}.")
    elif len(snapshot.counts) > 1:
        lines.append(f"Shares: {shares(snapshot.counts)}.")
    lines.append(f"Table: {snapshot.files.folder} ({parts} part{'s' * (parts != 1)}).")
    if far := manifest.get("largest_distance"):
        lines.append(f"Largest distance from the analytic solutions: {distance(far)}.")
    if isinstance(check := manifest.get("self_check"), dict):
        lines.append(self_check_sentence(check))
    lines += remarks(manifest)
    lines += [f"Figure: {figure}" for figure in snapshot.figures]
    return "\n".join(lines)


def directory(snapshot: Snapshot) -> str:
    """Format the contents of a result directory: job, progress, statuses of rows, provenance."""
    rows = snapshot.manifest["rows"]
    state = "complete" if snapshot.complete else "not complete; run the same command to continue"
    lines = {
        "job": f"{snapshot.job.get('name', '?')} (model {snapshot.job.get('model', '?')})",
        "rows": f"{snapshot.rows_done} of {rows}, {state}",
    }
    for status, number in snapshot.counts.items():
        sentence = status_sentence(status, snapshot.job, snapshot.manifest)
        lines[f"  {status}"] = f"{number}   {sentence}".rstrip()
    if snapshot.rows_open:
        lines["rows open"] = f"{snapshot.rows_open} more rows have ended in incomplete blocks"
    for number, fault in sorted(snapshot.files.faults.items()):
        what = "from another job" if fault.foreign else "damaged"
        lines[f"part {number}"] = f"{what}: {fault.file}: {fault.what} Run the job again to replace it"
    for fault in (*snapshot.files.strangers, *snapshot.files.open_faults):
        lines[fault.file.name] = fault.what
    if snapshot.files.undigested:
        lines["digests"] = snapshot.without_digests
    if snapshot.job_edited:
        lines["job.yaml"] = "changed after the run; the job that was run is in the manifest"
    lines |= _of_manifest(snapshot.manifest)
    for number, figure in enumerate(snapshot.figures):
        lines["figures" if number == 0 else " " * (8 + number)] = str(figure)
    return aligned(lines)


def columns_of(snapshot: Snapshot) -> None:
    """Print the unit and the meaning of each column of a run on disk."""
    import pyarrow.parquet as pq  # which loads slowly

    snapshot.require_sound()
    if not snapshot.files.footers:
        raise TableError(f"{snapshot.path} has no complete part yet: run its job further.")
    schema = pq.read_schema(snapshot.files.folder / PARTS.name(min(snapshot.files.footers)))
    described = [(field.name, field.metadata or {}) for field in schema]
    rows = [
        (name, *(known.get(key, b"").decode() for key in (b"unit", b"meaning"))) for name, known in described
    ]
    _print_table("", ("name", "unit", "meaning"), rows)


def _of_manifest(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Format entries of a manifest as lines, by their titles."""
    of_errors = f".{text}" if (text := repeating(manifest)) else ""
    formats: dict[str, tuple[str, Callable[[Any], str]]] = {
        "stalls": ("stalls", stalled),
        "slowest": (
            "unsettled",
            lambda of: f"{unsettled(of)} (largest change relative to its tolerance){of_errors}",
        ),
        "largest_distance": (
            "distance",
            lambda of: f"{distance(of)}, the largest from the analytic solutions",
        ),
        "axes": ("axes", lambda of: axes(of) or "none"),
        "gaits": ("gaits", lambda of: gaits_of_sound_rows(of, manifest["rows"])),
        "self_check": ("self-check", lambda of: self_check_sentence(of).removeprefix("Self-check: ")),
    }
    lines = settings_of(manifest)
    for key, value in manifest.items():
        if key in formats and isinstance(value, dict | list):
            title, text_of = formats[key]
            if value or key == "axes":
                lines[title] = text_of(value)
        elif key == "findings" and isinstance(value, list):
            lines |= {key if number == 0 else " " * number: text for number, text in enumerate(value)}
        elif key in REMARKS:
            lines[key.replace("_", " ")] = " ".join(remarks({key: value}))
        elif key not in _NOT_LISTED:
            lines[key] = plain(value)
    return lines


def model_list(models: Iterable[tuple[str, type[Model]]]) -> None:
    """Print the names and descriptions of models."""
    rows = [(name, (kind.__doc__ or "").strip().partition("\n")[0], kind.source) for name, kind in models]
    _print_table("", ("model", "description", "source"), rows)


def extent_of(model: Model) -> str:
    """Format the number of a model's quantities by kind."""
    counts = {
        "parameter": model.parameters,
        "start": model.initial_conditions,
        "observable": model.observables,
        "signal": model.signals,
        "gait": model.gaits,
    }
    return ", ".join(f"{len(items)} {name}{'s' * (len(items) != 1)}" for name, items in counts.items())


def model(name: str, kind: type[Model]) -> None:
    """Print the quantities of a model that a job can set, and its outputs, under a name that jobs use."""
    from gaitsweep.models.starts import idle_starts  # which imports the engine

    instance = kind()
    summary = (kind.__doc__ or "").strip().partition("\n")[0]
    console = _console()
    console.print(f"{name}: {summary}\n{kind.source}", highlight=False, markup=False)
    fields = dataclasses.fields(kind)  # pyright: ignore[reportArgumentType] (each is a dataclass)
    structure = [structure_field(field) for field in fields]
    if structure:
        _print_table("structure (one value per job)", ("name", "default", "allowed", "meaning"), structure)
    columns = ("name", "unit", "default", "allowed", "meaning", "source")
    _print_table("parameters", columns, [quantity(parameter) for parameter in instance.parameters])
    idle = idle_starts(instance)
    starts = [quantity(start)[:5] for start in instance.initial_conditions if start.name not in idle]
    _print_table("start", columns[:5], starts)
    for title, quantities in (
        ("observables", instance.observables),
        ("signals", instance.signals),
        ("label fields", instance.label_fields),
    ):
        if quantities:
            rows = [(q.name, q.unit, q.meaning) for q in quantities]
            _print_table(title, ("name", "unit", "meaning"), rows)
    console.print(f"\ngaits: {', '.join(kind.gaits)}", highlight=False, markup=False)


def structure_field(field: dataclasses.Field[Any]) -> tuple[str, str, str, str]:
    """Name, default, allowed values and meaning of a field of a model's structure."""
    meaning = str(field.metadata.get("meaning", ""))
    return field.name, str(field.default), _bounds(field.metadata), meaning


def quantity(q: Quantity) -> tuple[str, ...]:
    """Name, unit, default, allowed values, meaning and source of a quantity."""
    if q.default is None:
        default = "required"
    elif isinstance(q.default, float) and math.isnan(q.default):
        default = "the model's"
    else:
        default = plain(q.default)
    limits = _interval(q.low, q.high, open_ends=q.open_ends)
    allowed = ", ".join(filter(None, [limits, "whole" if q.whole else ""]))
    return q.name, q.unit, default, allowed, q.meaning, q.source


def _bounds(metadata: Mapping[str, Any]) -> str:
    """The allowed values of a structure field: a list, or an interval."""
    allowed = metadata.get("allowed")
    if isinstance(allowed, tuple):
        return ", ".join(map(str, allowed))
    low, high = metadata.get("low", -math.inf), metadata.get("high", math.inf)
    return _interval(low, high)


def _interval(low: float, high: float, *, open_ends: bool = False) -> str:
    """An interval, "[1, inf)"; nothing without bounds."""
    left = "(" if open_ends or math.isinf(low) else "["
    right = ")" if open_ends or math.isinf(high) else "]"
    return f"{left}{low:g}, {high:g}{right}" if math.isfinite(low) or math.isfinite(high) else ""


def _console() -> Console:
    """A console of the terminal's width, or of a fixed one where the output is no terminal."""
    return Console() if sys.stdout.isatty() else Console(width=_PIPED_WIDTH)


def _print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table below its title; long cells are folded, but for names."""
    console = _console()
    if title:
        console.print(f"\n{title}", highlight=False, style="bold")
    table = Table(box=None, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold", no_wrap=column == "name")
    for row in rows:
        table.add_row(*(text.replace("[", r"\[") for text in row))
    console.print(table, highlight=False)


def aligned(lines: dict[str, str]) -> str:
    """Format keys and values in two columns."""
    width = max(map(len, lines)) + 2
    return "\n".join(f"{key:<{width}}{value}".rstrip() for key, value in lines.items())


def size(number: float) -> str:
    """Format a number of bytes with a suitable unit."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if number < 999.5:  # which would be written as 1e+03
            return f"{number:.3g} {unit}"
        number /= 1000
    return f"{number:.3g} TB"


def duration(seconds: float) -> str:
    """Format a time with a suitable unit."""
    unit, number = "s", seconds
    for longer_unit, length in (("min", 60.0), ("h", 3600.0), ("days", 86400.0)):
        if seconds >= 2.0 * length:
            unit, number = longer_unit, seconds / length
    return f"{number:.0f} {unit}" if number >= 10 else f"{number:.2g} {unit}"
