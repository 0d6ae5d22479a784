"""The figures of a result directory, drawn from its table, or from an even selection of its rows."""

from __future__ import annotations

import functools
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

import gaitsweep
from gaitsweep import near_miss, plot
from gaitsweep.errors import EXIT_FAILURE, ArgumentError, UserError
from gaitsweep.job import JobError, read_figures
from gaitsweep.plot.figure_style import STYLE_FIELDS, FigureStyle, StyleError, read_style
from gaitsweep.plot.kind import kinds_with_gait_colours
from gaitsweep.runs.progress import Progress
from gaitsweep.schema.yaml_document import read_document, read_value
from gaitsweep.table import (
    ResultDirectory,
    Snapshot,
    TableError,
    load_with_snapshot,
    own_folder,
    read_file,
    replace_file,
    writing,
)
from gaitsweep.table.manifest import FIGURES, JOB, read_manifest

# Rows of a table of which all are shown; a page has fewer distinguishable points.
MOST_SHOWN = 2_000_000


class FigureError(UserError):
    """Some of a table's figures could not be drawn; `drawn` has the files of the others."""

    exit_code = EXIT_FAILURE

    def __init__(self, message: str, drawn: Sequence[Path]) -> None:
        self.drawn = tuple(drawn)
        super().__init__(message)

    def __reduce__(self) -> tuple[type[FigureError], tuple[str, tuple[Path, ...]]]:
        return FigureError, (str(self), self.drawn)


def draw_of_complete(
    directory: ResultDirectory,
    job: Mapping[str, Any],
    on_progress: Progress,
    on_message: Callable[[str], None],
) -> None:
    """Draw the figures that a complete table lacks; errors say that the table is complete.

    Args:
        directory: the result directory.
        job: the resolved job.
        on_progress: progress callback.
        on_message: called with a sentence before an unexpected exception is raised.

    Raises:
        FigureError: some figures are not drawn.
    """
    rows = directory.layout.rows
    safe = f"The run is complete ({rows} row{'s' * (rows != 1)} in {directory.path})"
    try:
        _draw_missing_figures(directory, job, on_progress)
    except FigureError as error:
        raise FigureError(f"{safe}, but a figure is not drawn. {error}", error.drawn) from error
    except UserError as error:
        raise FigureError(f"{safe}, but its figures are not drawn. {error}", ()) from error
    except Exception:
        on_message(f"{safe}. What follows is a fault in drawing its figures.")
        raise


def _draw_missing_figures(directory: ResultDirectory, job: Mapping[str, Any], on_progress: Progress) -> None:
    """Draw the figures that a complete directory lacks; existing ones were drawn from the same rows."""
    drawn = directory.manifest.get("figures_drawn", {})
    specs, style = read_figures(job, str(directory.path / JOB))
    style_fields = style.model_dump(mode="json", exclude_none=True)
    by_name = {
        name: style_fields | spec
        for spec in specs
        for name in _file_names(spec, spec.get("format") or style.format)
    }
    wanted = {
        name
        for name, spec in by_name.items()
        # one that shows another table too may have changed with that
        if spec.get("with_table")
        or name not in drawn
        or drawn[name] != _figure_digest(directory.path / FIGURES / name, spec)
    }
    if not wanted:
        return

    rows = directory.layout.rows

    def on_figure(number: int) -> None:
        on_progress(rows, rows, 0.0, 1.0, f"figure {number} of {len(wanted)}")

    draw_figures(directory.path, wanted, on_figure)
    now = {name: _figure_digest(directory.path / FIGURES / name, spec) for name, spec in by_name.items()}
    directory.update_manifest(figures_drawn={name: digest for name, digest in now.items() if digest})


def _file_names(spec: Mapping[str, Any], formats: Sequence[str] | None) -> list[str]:
    """The names of a figure's files, one for each of its formats, by default PNG."""
    return [f"{spec.get('name') or spec['kind']}.{ending}" for ending in formats or ("png",)]


def _figure_digest(file: Path, spec: dict[str, Any]) -> str | None:
    """Return the digest of a figure's file and specification; None if the file does not exist."""
    try:
        drawn = read_file(file)
    except OSError:
        return None
    made_by = json.dumps([spec, gaitsweep.__version__], sort_keys=True)
    return hashlib.sha256(made_by.encode() + drawn).hexdigest()


def draw_figures(
    path: str | Path,
    names: set[str] | None = None,
    on_progress: Callable[[int], None] | None = None,
    style: FigureStyle | None = None,
    folder: Path | None = None,
    fields: Sequence[str] = (),
) -> list[Path]:
    """Draw the figures of a result directory from its table, without simulating.

    The figures are those of its `job.yaml`, in which titles and columns may be edited. For a table of more
    than `MOST_SHOWN` rows they show an even selection, and say so.

    Args:
        path: the directory.
        names: file names of the figures to draw; all by default.
        on_progress: called before each figure with its number.
        style: style of all figures, over that of the job and of the figures.
        folder: folder of the files, made if it does not exist; by default `figures` of the directory.
        fields: texts "field=value" with a YAML value, for all figures that have the field.

    Returns:
        The files, in the job's order.

    Raises:
        TableError: there is no table yet, or `job.yaml` asks for an unknown figure.
        StyleError: the style has colours of gaits, and no figure shows gaits by colour.
        WriteError: a figure cannot be written; the old file is kept.
        FigureError: the table lacks data for some figures; the others are drawn.
    """
    path = Path(path)
    selection = thinned(read_manifest(path))
    snapshot, table = load_with_snapshot(path, rows=None if selection is None else selection.rows)
    if selection is not None:
        table.attrs["thinned"] = selection.remark
    specs, job_style = _figures_of(snapshot, fields)
    if not specs:
        return []
    style = style or FigureStyle()
    _require_coloured_gaits(specs, style, path)
    folder = _made_folder(path, folder)
    files: list[Path] = []
    errors: list[str] = []
    for number, spec in enumerate(specs):
        kind = spec["kind"]
        figure_style, own_fields = _style_and_fields(spec, style, job_style)
        file_names = _file_names(spec, figure_style.format)
        wanted = [folder / name for name in file_names if names is None or name in names]
        if not wanted:
            continue
        if on_progress is not None:
            on_progress(len(files) + 1)
        style_fields = {key: value for key, value in figure_style if value is not None}
        try:
            figure = plot.draw(kind, table, **own_fields, **style_fields)
        except UserError as error:
            errors.append(f"figures[{number}] ({kind}): {error}")
            continue
        for file in wanted:
            save = functools.partial(figure.savefig, format=file.suffix[1:], dpi=figure_style.dpi or 150)
            with writing(f"{file} could not be written"):
                replace_file(file, save)
        files += wanted
    if errors:
        raise FigureError("\n".join(errors), files)
    return files


def _require_coloured_gaits(specs: Sequence[Mapping[str, Any]], style: FigureStyle, path: Path) -> None:
    """Raise StyleError if a style has colours of gaits and no figure shows gaits by colour."""
    kinds = [spec["kind"] for spec in specs]
    colours = style.colours or {}
    used = (plot.FIGURES[spec["kind"]].colours_of(gait, spec) for spec in specs for gait in colours)
    if colours and not any(used):
        text = f"colours has no effect: no figure of {path} colours gaits ({', '.join(kinds)})."
        raise StyleError(f"{text} {kinds_with_gait_colours()}")


def _made_folder(path: Path, folder: Path | None) -> Path:
    """The folder of the figures of a directory, created where it is missing."""
    made = path / FIGURES if folder is None else folder
    with writing(f"{made} cannot be made"):
        if folder is None:
            own_folder(made)
        else:
            made.mkdir(parents=True, exist_ok=True)
    return made


def _style_and_fields(
    spec: Mapping[str, Any], style: FigureStyle, job_style: FigureStyle
) -> tuple[FigureStyle, dict[str, Any]]:
    """The style of a figure, and the fields of its kind.

    Args:
        spec: the figure in the job.
        style: the style that has precedence over the figure's own.
        job_style: the style of the job's figures.
    """
    own_style = read_style(**{key: value for key, value in spec.items() if key in STYLE_FIELDS})
    figure_style = style.over(own_style).over(job_style)
    kind = plot.FIGURES[spec["kind"]]  # other colours are for other figures of the job
    all_colours = (figure_style.colours or {}).items()
    colours = {gait: colour for gait, colour in all_colours if kind.colours_of(gait, spec)}
    colours |= own_style.colours or {}
    fields = {key: value for key, value in spec.items() if key not in (*STYLE_FIELDS, "kind", "name")}
    return figure_style.model_copy(update={"colours": colours or None}), fields


def _figures_of(snapshot: Snapshot, fields: Sequence[str]) -> tuple[list[dict[str, Any]], FigureStyle]:
    """The figures of a directory and their style, from `job.yaml` if it was edited.

    `fields` ("field=value") replace those of all figures that have them.
    """
    file = snapshot.path / JOB
    try:
        asked: Mapping[str, Any] = snapshot.job
        if snapshot.written is not snapshot.job or "job" not in snapshot.manifest:
            asked = read_document(file).data if file.exists() else {}
        return read_figures(_with_fields(asked, fields), str(file))
    except JobError as error:
        raise TableError(str(error)) from None


def _with_fields(asked: Mapping[str, Any], fields: Sequence[str]) -> Mapping[str, Any]:
    """A job in which fields ("field=value") of its figures have other values; a dot leads into a mapping.

    Raises:
        ArgumentError: a text is not of this form, or no figure has the field.
    """
    specs = [dict(spec) for spec in asked.get("figures") or []]
    kinds = [plot.FIGURES.get(str(spec.get("kind"))) for spec in specs]
    for text in fields:
        path, equals, written = text.partition("=")
        field, _, key = path.strip().partition(".")
        if not equals:
            raise ArgumentError(f"--set is {text}, but must be FIELD=VALUE, such as title=none.")
        value = read_value(written, f"--set {text}")
        allowed: dict[str, None] = {}
        for spec, kind in zip(specs, kinds, strict=True):
            of_kind = {} if kind is None else kind.model_fields
            allowed |= dict.fromkeys(name for name in of_kind if name not in ("kind", "name"))
            if key and not isinstance(spec.get(field) or {}, Mapping):
                raise ArgumentError(f"--set {text}: {field} has no fields of its own.")
            if field in of_kind:
                spec[field] = {**(spec.get(field) or {}), key: value} if key else value
        if specs and None not in kinds and field not in allowed:  # an unknown kind is refused by itself
            near = near_miss.suggestion(field, allowed)
            raise ArgumentError(f"--set {field}: no figure has this field{near}")
    return {**asked, "figures": specs} if specs else asked


class Thinned(NamedTuple):
    """The rows (n,) that a figure shows, in rising order, and a remark on them."""

    rows: Int[np.ndarray, " shown"]
    remark: str


def thinned(manifest: Mapping[str, Any], most: int = MOST_SHOWN) -> Thinned | None:
    """Select the rows that figures of a table show, at most `most`; None if they show all.

    The longest axes are thinned: of a grid, every n-th point; of a sample, its first points, since
    every n-th of a Sobol sequence may lie in one half of an axis.

    Args:
        manifest: that of the table; a table without axes is not thinned.
        most: the largest number of rows.
    """
    axes: Sequence[Mapping[str, Any]] = manifest.get("axes", ())
    if manifest["rows"] <= most or math.prod(axis["length"] for axis in axes) != manifest["rows"]:
        return None
    steps = [1] * len(axes)
    lengths = [axis["length"] for axis in axes]
    while math.prod(lengths) > most:
        longest = lengths.index(max(lengths))
        # odd steps, so that the points of a grid of cells are the middles of larger cells
        steps[longest] += 2
        lengths[longest] = _shown(axes[longest], steps[longest])
    rows = np.zeros(1, np.int64)
    thinned_names: dict[str, list[str]] = {}
    for axis, step in zip(axes, steps, strict=True):
        shown = np.arange(_shown(axis, step))
        points = shown if axis["drawn"] else shown * step + step // 2
        rows = (rows[:, None] * axis["length"] + points[None, :]).ravel()
        if step > 1:
            which = f"the first {shown.size} of" if axis["drawn"] else f"every {_ordinal(step)}"
            thinned_names.setdefault(which, []).extend(axis["names"])
    text = "; ".join(f"{which} {', '.join(names)}" for which, names in thinned_names.items())
    return Thinned(rows, f"{rows.size} of {manifest['rows']} rows: {text}")


def _shown(axis: Mapping[str, Any], step: int) -> int:
    """The number of points of an axis that are shown."""
    length = axis["length"]
    points = length // step if axis["drawn"] else len(range(step // 2, length, step))
    return max(points, 1)


def _ordinal(number: int) -> str:
    """An ordinal number: 3rd, 11th, 21st."""
    if number % 100 in (11, 12, 13):
        return f"{number}th"
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"
