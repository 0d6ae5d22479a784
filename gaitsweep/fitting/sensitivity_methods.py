"""Methods of a sensitivity analysis: the sets of parameters that each draws, and its indices."""

from __future__ import annotations

import contextlib
import dataclasses
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.angles import TURN, wrapped_difference
from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.free_parameters import FreeParameter, sets_at

Method = Literal["one_at_a_time", "morris", "sobol"]
LEVELS = 4  # of each range, on which Morris's trajectories run
PerSet = Float[np.ndarray, " sets"]  # a number for each set
LEVEL = 0.95  # of confidence intervals
_RESAMPLES = 200  # of the bootstrap
_MIN_TRAJECTORIES = 4
_MIN_GIVEN_ROWS = 100  # of RBD-FAST, which sums ten harmonics
_ROUNDING = 1e-12  # relative difference of values that count as equal
# Mean resultant length of angles below which they lie so far around the circle that a cut matters.
_SPREAD = 0.5
_OWN_SET = "the job's own values"
COLUMNS = ("method", "output", "parameter", "index", "value", "confidence", "rows", "unit", "note")
# The index by which parameters are sorted, and the others, by method.
INDICES = {
    "one_at_a_time": ("change_low", "change_middle", "change_high", "elasticity"),
    "morris": ("mu_star", "mu", "sigma"),
    "sobol": ("ST", "S1"),
    "rbd_fast": ("S1", "ST"),
}


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
        method: the method.
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
    cube = unit_cube(len(ranges))
    if method == "morris":
        from SALib.sample import morris

        # trajectories: each of their points is a step of one parameter from the last
        shares = morris.sample(cube, n, num_levels=LEVELS, seed=seed)
    else:
        from SALib.sample import sobol

        # for each base point A: A, A with each coordinate of another one, B, in turn, and B
        shares = sobol.sample(cube, n, calc_second_order=False, seed=seed)
    return SensitivityDesign(method, sets_at(ranges, shares), shares=shares)


def unit_cube(dimension: int) -> dict[str, object]:
    """Return SALib's description of ranges from 0 to 1."""
    names = [f"x{i}" for i in range(dimension)]
    return {"num_vars": dimension, "names": names, "bounds": [[0.0, 1.0]] * dimension}


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


@dataclasses.dataclass(frozen=True)
class Output:
    """An output of each set (n,), NaN where it has no value; its unit, and whether it is an angle (rad)."""

    values: PerSet
    unit: str = "1"
    circular: bool = False


@dataclasses.dataclass(frozen=True)
class _Index:
    """An index: its value, half its confidence interval, the rows that it is from, and a remark."""

    value: float
    confidence: float
    rows: int
    note: str = ""


IndicesByParameter = dict[str, dict[str, _Index]]


def indices(design: SensitivityDesign, outputs: Mapping[str, Output], seed: int) -> pd.DataFrame:
    """Compute the indices of each output with respect to each parameter.

    Args:
        design: the sets.
        outputs: outputs by name; rows without a value are left out.
        seed: seed of the bootstrap of the intervals.

    Returns:
        One record an index, with COLUMNS: `confidence` is half the interval of 95 %, NaN where the method
        gives none; `note` says why a value is NaN, and how many rows are left if some have no value. Outputs
        are in their order, parameters in the order of their importance.

    Source:
        Morris 1991, Technometrics 33:161, and Campolongo et al. 2007, Environ. Model. Softw. 22:1509
        (`mu_star`, `sigma`); Saltelli et al. 2010, Comput. Phys. Commun. 181:259 (`S1`, `ST`); for outputs
        without a value in some rows, RBD-FAST: Tarantola et al. 2006, Reliab. Eng. Syst. Saf. 91:717, in the
        form for given data of Plischke 2010, 95:354, without bias by Tissot and Prieur 2012, 107:205.
    """
    records = []
    for name, output in outputs.items():
        method, by_parameter = _of_output(design, output, seed)
        by_importance = sorted(by_parameter.items(), key=lambda item: -_importance(item[1]))
        for parameter, by_index in by_importance:
            records.extend(_index_records(method, name, parameter, by_index, output))
    return pd.DataFrame(records, columns=list(COLUMNS))


def _of_output(design: SensitivityDesign, output: Output, seed: int) -> tuple[str, IndicesByParameter]:
    """Return the method for an output, which depends on missing values, and the indices of each parameter."""
    if design.method == "one_at_a_time":
        return "one_at_a_time", _changes(design, output)
    values = unwrapped(output)
    if design.method == "morris":
        return "morris", _elementary_effects(design, values, seed)
    if np.isfinite(values).all():
        return "sobol", _variance_shares(design, values, seed, circular=output.circular)
    return "rbd_fast", _given_data(design, values, seed, circular=output.circular)


def _index_records(
    method: str, name: str, parameter: str, by_index: Mapping[str, _Index], output: Output
) -> Iterator[tuple[Any, ...]]:
    """Yield the records, with COLUMNS, of the indices of a parameter for an output of this name."""
    remark = "" if method == "one_at_a_time" else _remark(output)  # whose changes go the shorter way
    for index_name in INDICES[method]:
        if index_name not in by_index:
            continue
        index = by_index[index_name]
        unit = "1" if index_name in ("S1", "ST", "elasticity") else output.unit
        note = "; ".join(text for text in (index.note, remark) if text)
        yield method, name, parameter, index_name, index.value, index.confidence, index.rows, unit, note


def _importance(by_index: Mapping[str, _Index]) -> float:
    """Return the sort key of a parameter: the largest change, mu_star, ST, or S1 without ST."""
    changes = [abs(index.value) for name, index in by_index.items() if name.startswith("change")]
    main = [by_index[name].value for name in ("mu_star", "ST", "S1") if name in by_index]
    finite = [value for value in (*changes, *main) if np.isfinite(value)]
    if not finite:
        return -np.inf
    return max(finite) if changes else finite[0]


def unwrapped(output: Output) -> PerSet:
    """Return the values of an output, angles in the turn around their circular mean."""
    if not output.circular or not np.isfinite(output.values).any():
        return output.values
    mean = np.angle(_resultant(output))
    return mean + wrapped_difference(output.values - mean)


def _resultant(output: Output) -> complex:
    """Return the mean of angles as points of the unit circle."""
    return complex(np.nanmean(np.exp(1j * output.values)))


def _remark(output: Output) -> str:
    """Return a remark if angles lie all around the circle."""
    if not output.circular or not np.isfinite(output.values).any() or abs(_resultant(output)) >= _SPREAD:
        return ""
    return "angles all around the circle, cut opposite to their mean"


def _missing(method: str, names: Sequence[str], why: str, rows: int) -> IndicesByParameter:
    """Return indices without a value, and the reason, for each parameter and each index of a method."""
    without_value = _Index(np.nan, np.nan, rows, why)
    return {name: dict.fromkeys(INDICES[method], without_value) for name in names}


def _changes(design: SensitivityDesign, output: Output) -> IndicesByParameter:
    """Compute the changes from the job's value to the ends and the middle of each range, and elasticities."""
    assert design.places is not None
    by_parameter = {}
    for name, (low, middle, high) in design.places.items():
        by_index = {"change_low": _change_from_own(output, low, "low end")}
        if middle != 0:  # else the job itself is the middle
            by_index["change_middle"] = _change_from_own(output, middle, "middle")
        by_index["change_high"] = _change_from_own(output, high, "high end")
        x = design.sets[name]
        y = float(output.values[0])
        dy = _change(output, low, high)
        by_index["elasticity"] = _elasticity(x[0], y, x[high] - x[low], dy, circular=output.circular)
        by_parameter[name] = by_index
    return by_parameter


def _change(output: Output, begin: int, end: int) -> float:
    """Return the change of an output from one row to another; of an angle it is within half a turn."""
    difference = output.values[end] - output.values[begin]
    return float(wrapped_difference(difference)) if output.circular else float(difference)


def _change_from_own(output: Output, row: int, place: str) -> _Index:
    """Return the change of an output from the job's own values (row 0) to a place in a range."""
    value = _change(output, 0, row)
    if np.isfinite(value):
        return _Index(value, np.nan, 2)
    missing_at = f"the {place}" if np.isfinite(output.values[0]) else _OWN_SET
    return _Index(value, np.nan, 2, f"no value at {missing_at}")


def _elasticity(x: float, y: float, dx: float, dy: float, *, circular: bool) -> _Index:
    """Compute (dy / y) / (dx / x), over the whole range."""
    why = ""
    if circular:
        why = "an angle has no zero, to which a change could be relative"
    elif not np.isfinite([x, y, dy]).all():
        why = f"no value at one of the ends, or at {_OWN_SET}"
    elif x == 0.0 or y == 0.0:
        zero = "parameter" if x == 0.0 else "output"
        why = f"the job's own {zero} is 0"
    value = np.nan if why else float(dy / y / (dx / x))
    return _Index(value, np.nan, 3, why)


def _elementary_effects(design: SensitivityDesign, y: PerSet, seed: int) -> IndicesByParameter:
    """Compute Morris's measures from whole trajectories; effects are changes over the whole range."""
    assert design.shares is not None
    names = design.names
    points = len(names) + 1  # of a trajectory
    complete = np.isfinite(y.reshape(-1, points)).all(axis=1)
    rows = int(complete.sum()) * points
    note = "" if complete.all() else f"{complete.sum()} of {complete.size} trajectories are whole"
    if complete.sum() < _MIN_TRAJECTORIES:
        return _missing("morris", names, f"{note}, and {_MIN_TRAJECTORIES} are needed", rows)
    from SALib.analyze import morris

    used = np.repeat(complete, points)
    arguments = (design.shares[used], y[used])
    return _by_salib(morris, "morris", names, arguments, seed, rows, note, num_levels=LEVELS)


def _variance_shares(
    design: SensitivityDesign, y: PerSet, seed: int, *, circular: bool
) -> IndicesByParameter:
    """Compute Sobol's first-order and total indices of a design in which all rows have a value."""
    names = design.names
    if _constant(y, circular=circular):
        return _missing("sobol", names, "the output is the same in all rows", y.size)
    from SALib.analyze import sobol

    return _by_salib(sobol, "sobol", names, (y,), seed, y.size, "", calc_second_order=False)


def _given_data(design: SensitivityDesign, y: PerSet, seed: int, *, circular: bool) -> IndicesByParameter:
    """Compute first-order indices from the rows with a value.

    Only the base points A and B are used, since they are drawn independently of each other; the points
    between them share coordinates with them, and would make the intervals too narrow.
    """
    assert design.shares is not None
    names = design.names
    points = len(names) + 2  # of a base point: A, those between, and B
    place = np.arange(y.size) % points
    independent = (place == 0) | (place == points - 1)
    used = independent & np.isfinite(y)
    rows = int(used.sum())
    note = f"{rows} of {independent.sum()} independent rows have a value"
    total = _Index(np.nan, np.nan, rows, f"{note}, and ST needs all rows of the design")
    if rows < _MIN_GIVEN_ROWS:
        return _missing("rbd_fast", names, f"{note}, and RBD-FAST needs {_MIN_GIVEN_ROWS}", rows)
    if _constant(y[used], circular=circular):
        return _missing("rbd_fast", names, f"{note}, and it is the same in all of them", rows)
    from SALib.analyze import rbd_fast

    first_order = _by_salib(rbd_fast, "rbd_fast", names, (design.shares[used], y[used]), seed, rows, note)
    return {name: {**by_index, "ST": total} for name, by_index in first_order.items()}


def _by_salib(
    package: Any,
    method: str,
    names: Sequence[str],
    arguments: Sequence[Float[np.ndarray, "sets ..."]],
    seed: int,
    rows: int,
    note: str,
    **options: Any,
) -> IndicesByParameter:
    """Compute the indices of each parameter by a module of SALib, with their intervals if it gives them.

    Args:
        package: the module of SALib, whose `analyze` is called.
        method: the method, whose INDICES are read.
        names: the parameters.
        arguments: arrays that `analyze` takes after the description of the ranges.
        seed: seed of the bootstrap.
        rows: the number of rows from which the indices are.
        note: the remark of all indices.
        options: further arguments of `analyze`.
    """
    options |= {"num_resamples": _RESAMPLES, "conf_level": LEVEL, "seed": seed}
    with _seeded(seed):
        analysis = package.analyze(unit_cube(len(names)), *arguments, **options)
    by_parameter: IndicesByParameter = {name: {} for name in names}
    for index in INDICES[method]:
        if index in analysis:
            confidence = analysis.get(f"{index}_conf", np.full(len(names), np.nan))
            for name, value, half in zip(names, analysis[index], confidence, strict=True):
                by_parameter[name][index] = _Index(float(value), float(half), rows, note)
    return by_parameter


def _constant(y: PerSet, *, circular: bool) -> bool:
    """Return whether values differ by no more than rounding, of angles that of a turn."""
    return bool(np.ptp(y) <= _ROUNDING * (TURN if circular else np.max(np.abs(y))))


@contextlib.contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Context for SALib, which ignores seed 0 and then draws from NumPy's global generator."""
    state = np.random.get_state()
    np.random.seed(seed % 2**32)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of constant resamples
            yield
    finally:
        np.random.set_state(state)
