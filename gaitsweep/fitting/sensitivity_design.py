"""Sets of parameters of a sensitivity analysis, by its method."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Literal

import numpy as np
from jaxtyping import Float

from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.free_parameters import FreeParameter, sets_at

Method = Literal["one_at_a_time", "morris", "sobol"]
METHODS: tuple[Method, ...] = ("one_at_a_time", "morris", "sobol")
LEVELS = 4  # of each range, on which Morris's trajectories run


@dataclasses.dataclass(frozen=True)
class SensitivityDesign:
    """Sets of parameters.

    `sets` (n,) by name; `shares` (n, parameters) of their ranges, from 0 to 1, for morris and sobol;
    `places`, for one_at_a_time, the rows of each parameter's low end, middle and high end. Row 0 of
    one_at_a_time is the job itself.
    """

    method: Method
    sets: dict[str, Float[np.ndarray, " sets"]]
    shares: Float[np.ndarray, "sets parameters"] | None = None
    places: dict[str, tuple[int, int, int]] | None = None

    @property
    def n_rows(self) -> int:
        """Number of sets, each a row of the table."""
        return next(iter(self.sets.values())).size

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return list(self.sets)


def design_of(
    method: Method, n: int | None, seed: int, ranges: Mapping[str, FreeParameter], base: Mapping[str, float]
) -> SensitivityDesign:
    """Return the sets of a method.

    Args:
        method: one of METHODS.
        n: trajectories (morris), or base points (sobol); None for one_at_a_time.
        seed: seed of all random numbers.
        ranges: range of each parameter.
        base: the job's own values.

    Raises:
        ArgumentError: morris or sobol without n.
    """
    if method == "one_at_a_time":
        return _one_at_a_time(ranges, base)
    if n is None:
        raise ArgumentError(f"{method} needs n, its number of trajectories or of base points.")
    sample = _trajectories if method == "morris" else _saltelli
    shares = sample(len(ranges), n, seed)
    return SensitivityDesign(method, sets_at(ranges, shares), shares=shares)


def unit_cube(dimension: int) -> dict[str, object]:
    """Return SALib's description of ranges from 0 to 1."""
    names = [f"x{i}" for i in range(dimension)]
    return {"num_vars": dimension, "names": names, "bounds": [[0.0, 1.0]] * dimension}


def _trajectories(dimension: int, n: int, seed: int) -> Float[np.ndarray, "sets parameters"]:
    """Draw Morris's trajectories: n (dimension + 1) points, each a step of one parameter from the last."""
    from SALib.sample import morris

    return morris.sample(unit_cube(dimension), n, num_levels=LEVELS, seed=seed)


def _saltelli(dimension: int, n: int, seed: int) -> Float[np.ndarray, "sets parameters"]:
    """Draw Saltelli's points, n (dimension + 2): for each base point A, A with each coordinate of B, B."""
    from SALib.sample import sobol

    return sobol.sample(unit_cube(dimension), n, calc_second_order=False, seed=seed)


def _one_at_a_time(ranges: Mapping[str, FreeParameter], base: Mapping[str, float]) -> SensitivityDesign:
    """Return the job itself, then the ends and the middle of each range that differ from the job's value."""
    rows = [dict(base)]

    def row_with(name: str, value: float) -> int:
        """Return the row of the job with this value of a parameter; add it if it differs from the job's."""
        if np.isclose(value, base[name], rtol=1e-12, atol=0.0):
            return 0
        rows.append({**base, name: value})
        return len(rows) - 1

    places = {}
    for name, parameter in ranges.items():
        low, middle, high = parameter.at(np.array([0.0, 0.5, 1.0])).tolist()
        places[name] = (row_with(name, low), row_with(name, middle), row_with(name, high))
    sets = {name: np.array([row[name] for row in rows]) for name in ranges}
    return SensitivityDesign("one_at_a_time", sets, places=places)
