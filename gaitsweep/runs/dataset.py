"""A table as an xarray dataset: dimensions are the axes of the job."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

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
    lengths = {dimension: length for dimension, _, length in axes}
    row = table["row"].to_numpy(np.int64)
    record = table.groupby("row").cumcount().to_numpy()
    records = int(record.max(initial=0)) + 1
    kind = RUN_KINDS.get(job["run"]["kind"])
    several = records > 1 or kind is None or not kind.one_a_row
    shape = (*lengths.values(), *((records,) if several else ()))
    dimensions = (*lengths, *((RECORD,) if several else ()))
    place = row * records + record if several else row
    quantities = table.attrs.get("quantities", {})

    def variable(name: str) -> tuple[tuple[str, ...], Shaped[np.ndarray, " ..."], dict[str, Any]]:
        values, attributes = _numbers(table[name])
        quantity = quantities.get(name, {})
        for key, field in (("units", "unit"), ("long_name", "meaning")):
            if quantity.get(field):
                attributes[key] = quantity[field]
        return dimensions, _on_grid(values, place, shape, "flag_values" in attributes), attributes

    names = [str(name) for name in table.columns if name != "row"]
    variables = {name: variable(name) for name in names}
    coordinates = {}
    for dimension, moved, _ in axes:
        for name in moved:
            _, values, attributes = variables.pop(name)
            along = _along(values, dimensions.index(dimension))
            if along is None:  # an axis whose points follow another one
                coordinates[name] = (dimensions, values, attributes)
            else:
                coordinates[name] = ((dimension,), along, attributes)
    for name in [name for name in variables if name in dimensions]:
        variables[f"{name}_value"] = variables.pop(name)  # xarray keeps a dimension's name for its coordinate
    for dimension in [name for name in coordinates if name in dimensions and len(coordinates[name][0]) > 1]:
        coordinates[f"{dimension}_value"] = coordinates.pop(dimension)
    about = {"name": job["name"], "model": job["model"], "job": json.dumps(job)}
    about |= {key: manifest[key] for key in ("gaitsweep", "job_hash", "created") if key in manifest}
    return xarray.Dataset(variables, coordinates, about)


def _axes(manifest: Mapping[str, Any]) -> list[tuple[str, list[str], int]]:
    """Return dimension, names that vary along it, and length of each axis of a table."""
    points = itertools.chain([POINT], (f"{POINT}_{number}" for number in itertools.count(2)))
    groups = [(axis["names"], axis["length"]) for axis in manifest["axes"]]
    return [(names[0] if len(names) == 1 else next(points), names, length) for names, length in groups]


def _numbers(column: Any) -> tuple[Shaped[np.ndarray, " records"], dict[str, Any]]:
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
    values: Shaped[np.ndarray, " records"],
    place: Int[np.ndarray, " records"],
    shape: tuple[int, ...],
    flags: bool,
) -> Shaped[np.ndarray, " ..."]:
    """Place values (n,) on the grid; NaN, or -1 for flags, elsewhere."""
    size = int(np.prod(shape))
    if not flags and values.size < size:
        values = values.astype(np.float64)
    grid = np.full(size, -1 if flags else 0 if values.size == size else np.nan, values.dtype)
    grid[place] = values
    return grid.reshape(shape)


def _along(values: Shaped[np.ndarray, " ..."], axis: int) -> Shaped[np.ndarray, " points"] | None:
    """Return values (n,) along one axis if they are equal along all others; NaN stands for no record."""
    by_point = np.moveaxis(values, axis, 0).reshape(values.shape[axis], -1)
    known = ~np.isnan(by_point)
    low = np.min(by_point, axis=1, initial=np.inf, where=known)
    high = np.max(by_point, axis=1, initial=-np.inf, where=known)
    return low if np.array_equal(low, high) else None
