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

from gaitsweep.errors import UserError
from gaitsweep.kinds import RUN_KINDS

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
        Numbers of missing rows or records are NaN.

    Raises:
        MissingPackageError: xarray is not installed.

    Source: flags follow the CF conventions 1.11, sec. 3.5.
    """
    try:
        import xarray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise MissingPackageError(
            "to_xarray needs the package xarray: install it with pip install 'gaitsweep[xarray]'."
        ) from None
    job, manifest = table.attrs["job"], table.attrs["manifest"]
    axes = _axes(manifest)
    grid = _grid(table, axes)
    quantities = table.attrs.get("quantities", {})
    variables = {
        str(name): _variable(column, quantities.get(name, {}), grid)
        for name, column in table.items()
        if name != "row"
    }
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
    axes = []
    for axis in manifest["axes"]:
        names = axis["names"]
        axes.append(_Axis(names[0] if len(names) == 1 else next(points), names, axis["length"]))
    return axes


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


def _coordinates(variables: dict[str, _Variable], axes: Sequence[_Axis], grid: _Grid) -> dict[str, _Variable]:
    """Take the coordinates of the axes out of the variables; rename what has the name of a dimension."""
    coordinates: dict[str, _Variable] = {}
    for axis in axes:
        for name in axis.names:
            _, values, attributes = variables.pop(name)
            along = _along(values, grid.dimensions.index(axis.dimension))
            if along is None:  # an axis whose points follow another one
                coordinates[name] = (grid.dimensions, values, attributes)
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


def _along(values: Shaped[np.ndarray, " ..."], axis: int) -> Shaped[np.ndarray, " points"] | None:
    """Return values (n,) along one axis if they are equal along all others; NaN stands for no record."""
    by_point = np.moveaxis(values, axis, 0).reshape(values.shape[axis], -1)
    known = ~np.isnan(by_point)
    low = np.min(by_point, axis=1, initial=np.inf, where=known)
    high = np.max(by_point, axis=1, initial=-np.inf, where=known)
    return low if np.array_equal(low, high) else None
