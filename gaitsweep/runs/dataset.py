"""A table as an xarray dataset: dimensions are the axes of the job."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Int, Shaped

from gaitsweep.errors import JobError, UserError
from gaitsweep.job.load import job_fields, stored_job
from gaitsweep.kinds import RUN_KINDS
from gaitsweep.table import TableError

if TYPE_CHECKING:
    import xarray  # pyright: ignore[reportMissingImports]

RECORD = "record"  # the dimension of several records of one row: crossings, samples, steps of a staircase
POINT = "point"  # the dimension of a `zip` or a `sample`, which moves several names


class MissingPackageError(UserError, ImportError):
    """An optional package is not installed; the message names the extra that installs it."""


def dataset_of(table: pd.DataFrame) -> xarray.Dataset:
    """Convert a table into a dataset on the grid of its job.

    Args:
        table: a whole table as returned by `load`, with its `.attrs`.

    Returns:
        Dimensions: each axis by its name, `point` (`point_2`, ...) for each `zip` or `sample`, and `record`
        where rows have several records. Coordinates: what varies. Variables have `units` and `long_name`.
        Names (`status`, `gait`) are integers with `flag_values` and `flag_meanings`, -1 where there is none.
        Numbers of missing rows or records are NaN; their coordinates are those of the job, NaN where its
        model is not found.

    Raises:
        ArgumentError: the table has no job in its `.attrs`.
        TableError: the table does not have the column of an axis, or is not that of one grid.
        MissingPackageError: xarray is not installed.

    Source: flags follow the CF conventions 1.11, sec. 3.5.
    """
    try:
        import xarray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise MissingPackageError(
            "to_xarray needs the package xarray: install it with pip install 'gaitsweep[xarray]'."
        ) from None
    job, manifest = job_fields(table.attrs), table.attrs.get("manifest", {})
    if "axes" not in manifest or "joined" in table.attrs:
        raise TableError("A dataset needs the grid of one job, which this table lacks.")
    axes = _axes(manifest)
    for name in ("row", *itertools.chain.from_iterable(axis.names for axis in axes)):
        if name not in table:
            raise TableError(f"A dataset needs the column {name} of the job's grid, which this table lacks.")
    grid = _grid(table, axes)
    quantities = table.attrs.get("quantities", {})
    variables = {
        str(name): _variable(column, quantities.get(name, {}), grid)
        for name, column in table.items()
        if name != "row"
    }
    if np.unique(table["row"].to_numpy()).size < math.prod(axis.length for axis in axes):
        variables |= _planned(table.attrs, variables, axes)
    coordinates = _coordinates(variables, axes, grid)
    about = {"name": job["name"], "model": job["model"], "job": json.dumps(job)}
    about |= {key: manifest[key] for key in ("gaitsweep", "job_hash", "created") if key in manifest}
    return xarray.Dataset(variables, coordinates, about)


class _Axis(NamedTuple):
    """A dimension, the names that vary along it, and its length."""

    dimension: str
    names: list[str]
    length: int


class _Grid(NamedTuple):
    """The dimensions of a dataset, its shape, and the place of each record in it (n,)."""

    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    place: Int[np.ndarray, " records"]


def _axes(manifest: Mapping[str, Any]) -> list[_Axis]:
    """The axes of a table, in the order of its rows."""
    points = itertools.chain([POINT], (f"{POINT}_{number}" for number in itertools.count(2)))
    groups = [(axis["names"], axis["length"]) for axis in manifest["axes"]]
    return [_Axis(names[0] if len(names) == 1 else next(points), names, n) for names, n in groups]


def _grid(table: pd.DataFrame, axes: Sequence[_Axis]) -> _Grid:
    """The grid of a table: its axes, and `record` where rows may have several records."""
    dimensions = tuple(axis.dimension for axis in axes)
    shape = tuple(axis.length for axis in axes)
    row = table["row"].to_numpy(np.int64)
    record = table.groupby("row").cumcount().to_numpy()
    records = int(record.max(initial=0)) + 1
    kind = RUN_KINDS.get(table.attrs["job"]["run"]["kind"])
    if records == 1 and kind is not None and kind.one_a_row:
        return _Grid(dimensions, shape, row)
    return _Grid((*dimensions, RECORD), (*shape, records), row * records + record)


# What xarray takes as a variable: its dimensions, values and attributes.
_Variable = tuple[tuple[str, ...], Shaped[np.ndarray, " ..."], dict[str, Any]]


def _variable(column: pd.Series, quantity: Mapping[str, Any], grid: _Grid) -> _Variable:
    """A column on the grid, with the unit and the meaning of its quantity."""
    values, attributes = _numbers(column)
    for key, field in (("units", "unit"), ("long_name", "meaning")):
        if quantity.get(field):
            attributes[key] = quantity[field]
    return grid.dimensions, _on_grid(values, grid, flags="flag_values" in attributes), attributes


def _planned(
    attrs: Mapping[Any, Any], variables: Mapping[str, _Variable], axes: Sequence[_Axis]
) -> dict[str, _Variable]:
    """The axes' values in all rows of the job, also without records; none if the model is not found."""
    try:
        design = stored_job(attrs).design
    except JobError:
        return {}
    shape = tuple(axis.length for axis in axes)
    dimensions = tuple(axis.dimension for axis in axes)
    names = [name for axis in axes for name in axis.names if "flag_values" not in variables[name][2]]
    values = design.at(np.arange(math.prod(shape), dtype=np.int64), names)
    return {name: (dimensions, np.array(values[name]).reshape(shape), variables[name][2]) for name in names}


def _coordinates(variables: dict[str, _Variable], axes: Sequence[_Axis], grid: _Grid) -> dict[str, _Variable]:
    """Take the coordinates of the axes out of the variables; rename what has the name of a dimension."""
    coordinates: dict[str, _Variable] = {}
    for axis in axes:
        for name in axis.names:
            dimensions, values, attributes = variables.pop(name)
            along = _along(values, dimensions.index(axis.dimension), flags="flag_values" in attributes)
            if along is None:  # an axis whose points follow another one
                coordinates[name] = (dimensions, values, attributes)
            else:
                coordinates[name] = ((axis.dimension,), along, attributes)
    # xarray keeps the name of a dimension for the coordinate along it
    for name in grid.dimensions:
        if name in variables:
            variables[f"{name}_value"] = variables.pop(name)
        if name in coordinates and len(coordinates[name][0]) > 1:
            coordinates[f"{name}_value"] = coordinates.pop(name)
    return coordinates


def _numbers(column: pd.Series) -> tuple[Shaped[np.ndarray, " records"], dict[str, Any]]:
    """Convert a column to numbers, with the attributes that name the meaning of integers."""
    if not isinstance(column.dtype, pd.CategoricalDtype):
        if not pd.api.types.is_numeric_dtype(column.dtype):
            return _numbers(column.astype("category"))
        return column.to_numpy(), {}
    codes = column.cat.codes.to_numpy()
    meanings = [str(name).replace(" ", "_") for name in column.cat.categories]
    flags = np.arange(len(meanings), dtype=codes.dtype)
    return codes, {"flag_values": flags, "flag_meanings": " ".join(meanings)}


def _on_grid(
    values: Shaped[np.ndarray, " records"], grid: _Grid, *, flags: bool
) -> Shaped[np.ndarray, " ..."]:
    """Place values (n,) on the grid; NaN, or -1 for flags, elsewhere."""
    size = math.prod(grid.shape)
    if flags:
        placed = np.full(size, -1, values.dtype)
    elif values.size < size:
        placed = np.full(size, np.nan)
    else:
        placed = np.zeros(size, values.dtype)
    placed[grid.place] = values
    return placed.reshape(grid.shape)


def _along(
    values: Shaped[np.ndarray, " ..."], axis: int, *, flags: bool
) -> Shaped[np.ndarray, " points"] | None:
    """Return values (n,) along one axis if they are equal along all others; NaN (-1 of flags): no record."""
    by_point = np.moveaxis(values, axis, 0).reshape(values.shape[axis], -1)
    known = by_point != -1 if flags else ~np.isnan(by_point)
    first = by_point[np.arange(len(by_point)), known.argmax(axis=1)]  # NaN or -1 of a point without records
    return first if (~known | (by_point == first[:, None])).all() else None
