"""Fixed points of a map of a model's states, at given parameters, and their branches along another one.

`gs.stationary` searches those of a flow: its stationary points, their eigenvalues, and cycles born at Hopf
points.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Complex, Float
from numpy.typing import ArrayLike

from gaitsweep import near_miss
from gaitsweep.analysis.atlas.periodic_orbits import rows_of
from gaitsweep.analysis.continuation.continuation import continuation
from gaitsweep.analysis.continuation.newton import FixedPoints, newton
from gaitsweep.analysis.continuation.normal_forms import hopf_cycle
from gaitsweep.analysis.records import names_in
from gaitsweep.api.keywords import AnyModel, job_of
from gaitsweep.design.design import inside, requirement
from gaitsweep.engine.content import held_contents
from gaitsweep.engine.poincare.map_derivatives import LevelMap
from gaitsweep.engine.poincare.maps import Map, Points, column
from gaitsweep.engine.poincare.model_map import ModelMap
from gaitsweep.engine.poincare.stationary_map import StationaryMap, linearised_flow
from gaitsweep.errors import ArgumentError, warn
from gaitsweep.job import Job
from gaitsweep.kinds import ReturnMap
from gaitsweep.kinds.columns import AT_REST, Column, drifts, gaits, quantities_of
from gaitsweep.kinds.fixed_points import gait_numbers, starts_with

# Points of the section: their coordinates, start values by name, or what these methods return.
SectionPoints = Points | FixedPoints | Mapping[str, Any]


class FixedPointsOfModel(abc.ABC):
    """Fixed points of a map of a model's states, and their branches.

    Args:
        job: the job whose parameters and starts the map has.
        without_start: the start values that were not given.
        map_of: makes the map, as `map_of(model, settings)`.
        period: how often the map is applied from a point to its image.
    """

    def __init__(
        self, job: Job, without_start: Sequence[str], map_of: Callable[..., ModelMap], period: int = 1
    ) -> None:
        design = job.design
        names = [quantity.name for quantity in design.model.parameters]
        parameters, starts = design.values(0, design.n_rows)
        moving = {name for name in names if design.spans(name)}
        settings = {}
        for name in names:
            if name in design.derived:  # stays a formula, so that a branch moves it too
                settings[name] = design.derived[name]
            else:
                settings[name] = 0.0 if name in moving else design.settings[name]
        self.model = design.model
        self._once = map_of(design.model, tuple(settings.items()))
        self._period = period
        self.mapping: Map = self._once.iterated(period)
        self._values = {name: parameters[name] for name in moving if name not in design.derived}
        self._design = design
        self._parameters = parameters
        self._without_start = tuple(without_start)
        # a start of one value is one number, whatever number of points it meets
        self._starts = {
            name: value if design.spans(name) else value[:1]
            for name, value in starts.items()
            if name not in without_start and not np.isnan(value).all()
        }

    def __repr__(self) -> str:
        moving = f" over {', '.join(self._values)}" if self._values else ""
        return f"{type(self).__name__}({self.model.name}: {', '.join(self.coordinates)}{moving})"

    @property
    def coordinates(self) -> list[str]:
        """Names of the coordinates, in their order."""
        return [quantity.name for quantity in self.mapping.coordinates]

    @property
    def conserved(self) -> list[str]:
        """Names of the conserved quantities."""
        return [quantity.name for quantity in self.mapping.conserved]

    @held_contents()
    def fixed_points(
        self,
        x: SectionPoints | ArrayLike,
        *,
        fix: str | Sequence[str] | None = None,
        tolerance: float = 1e-9,
        most: int = 20,
    ) -> FixedPoints:
        """Find fixed points near points, stable or not, by Newton's method.

        Args:
            x: start points of the searches.
            fix: conserved quantities that are held; all of `conserved` by default.
            tolerance: residual of a fixed point, relative to the size of each coordinate, above 0.
            most: the largest number of Newton steps, 1 or more.

        Returns:
            For each point: `converged`, `outcome`, `points` (`points.at` are coordinates), `residual`,
            `iterations`, `images` with their derivatives.

        Raises:
            ArgumentError: the map has no derivative, `fix` names a quantity that it does not conserve, or a
                number is outside its range.

        Example:
            In the hopper's 1:1 gait its oscillator turns once a hop, so the launch is pi g / omega:

            >>> import numpy as np, gaitsweep as gs
            >>> from gaitsweep.examples.hopper import Hopper
            >>> gait = gs.return_map(Hopper(), omega=3.7).fixed_points([0.4, 8.3])
            >>> gait.converged.tolist(), gait.points.at.round(4).tolist()
            ([True], [[0.3971, 8.3295]])
            >>> round(np.pi * 9.81 / 3.7, 4)
            8.3295
        """
        self._require_fixed_points()
        _require_positive("tolerance", tolerance)
        require_whole("most", most, 1)
        points = self._points(x)[0]
        conserved = self.conserved if fix is None else names_in(fix)
        return newton(self.mapping, points, self._values, fix=conserved, tolerance=tolerance, most=most)

    @held_contents()
    def continue_(
        self,
        x: SectionPoints | ArrayLike,
        parameter: str,
        within: Sequence[float],
        *,
        towards: int | None = None,
        fix: str | Sequence[str] | None = None,
    ) -> pd.DataFrame:
        """Follow the branches of fixed points through points along a parameter, around folds.

        Args:
            x: points near fixed points at the map's own value of the parameter.
            parameter: name of a parameter, or of a quantity in `conserved`: then the family of gaits is
                followed along it.
            within: its range, two numbers within the parameter's bounds.
            towards: 1 or -1, the direction of the parameter in which a branch begins; both by default.
            fix: conserved quantities that are held; all of `conserved` by default.

        Returns:
            One record a point of a branch, as of `analysis.continuation.continuation`; `row` is the place of
            its start, `direction` that of the branch at its start, and `gait` its gait. Observables have
            their own names, such as `z`; in the table of a job they are `z_n`, as at any crossing.
            `gs.plot.continuation` draws it.

        Raises:
            ArgumentError: the map has no derivative, the parameter is not the model's, its values are not
                one for each point, one is outside the range, the range is not two finite numbers within the
                parameter's bounds, `towards` is no direction, or the map does not conserve what `fix` names.

        Example:
            The hopper's 1:1 gait, with a launch of pi g / omega, ends in a fold. There its leg adds all of
            `push` to replace the speed that a landing takes, (1 - restitution) launch:

            >>> import numpy as np, gaitsweep as gs
            >>> from gaitsweep.examples.hopper import Hopper
            >>> branch = gs.return_map(Hopper(), omega=3.7).continue_([0.4, 8.3], "omega", (3.5, 3.7))
            >>> branch.loc[branch["special"] == "fold", "omega"].round(4).tolist()
            [3.556]
            >>> round((1.0 - 0.7) * np.pi * 9.81 / 2.6, 4)
            3.556
        """
        self._require_fixed_points()
        points = self._points(x)[0]
        begin = self._begin(points, parameter)
        low, high = self._range(parameter, within)
        if towards is not None and (isinstance(towards, bool) or np.ndim(towards) or towards not in (1, -1)):
            raise ArgumentError(f"towards is {towards!r}, but must be 1, -1, or None for both directions.")
        for value in begin[~((low <= begin) & (begin <= high))][:1]:
            raise ArgumentError(
                f"{parameter} is {value:g} at the map's points, but the range is from {low:g} to {high:g}."
            )
        mapping: Map = self.mapping
        fixed = self.conserved if fix is None else names_in(fix)
        constrained: Sequence[str] | dict[str, float | None] = fixed
        if parameter in self.conserved:
            mapping = LevelMap(mapping, parameter)
            constrained = {**dict.fromkeys(fixed), parameter: 0.0}
        values = {name: value for name, value in self._values.items() if name != parameter}
        tables = []
        for direction in (1, -1) if towards is None else (towards,):
            end = high if direction > 0 else low
            if towards is None and np.all(begin == end):
                continue
            branches = continuation(
                mapping,
                points,
                values,
                parameter=parameter,
                within=(low, high),
                begin=begin,
                towards=direction,
                fix=constrained,
                with_points=isinstance(self._once, StationaryMap),
            )
            tables.append(branches.assign(direction=direction))
        table = pd.concat(tables, ignore_index=True)
        return self._described(table.assign(gait=self._gaits(table)), parameter)

    def _begin(self, points: Points, parameter: str) -> Float[np.ndarray, " begin"]:
        """The values of a parameter or a conserved quantity at points: one each, or one for all."""
        if parameter in self.conserved:
            images = self.mapping.linearised(points, self._values)
            return images.conserved_values[:, self.conserved.index(parameter)]
        if not isinstance(parameter, str):
            raise ArgumentError(f"parameter is {parameter!r}, but must be a name.")
        if parameter not in self._parameters:
            self.mapping.complete({parameter: 0.0}, 1)  # refuses names that the model does not have
        values = self._parameters[parameter]
        # a formula of parameters with several values has several, too
        return column(parameter, values if np.ptp(values) > 0.0 else values[:1], len(points))

    def _range(self, parameter: str, within: Sequence[float]) -> tuple[float, float]:
        """The lower and the upper end of a range; refuse one that is none, or leaves a parameter's bounds."""
        ends: list[Any] = list(within) if np.iterable(within) else []
        if [_is_number(end) for end in ends] != [True, True] or ends[0] == ends[1]:
            raise ArgumentError(f"within is {within!r}, but must be two different finite numbers.")
        for quantity in self.model.parameters:
            if quantity.name == parameter and not inside(np.array(ends, float), quantity).all():
                raise ArgumentError(f"within is {within!r}, but {parameter} {requirement(quantity)}.")
        return float(min(ends)), float(max(ends))

    def _gaits(self, table: pd.DataFrame) -> pd.Categorical:
        """The gait at each record of a table of branches, as in the table of a job."""
        if isinstance(self._once, StationaryMap):
            return pd.Categorical([AT_REST] * len(table))
        has_point = table["stable"].notna().to_numpy()
        codes = np.full(len(table), -1)
        if has_point.any():
            points = table.loc[has_point]
            row = points["row"].to_numpy(np.int64)
            values = {name: column[row] for name, column in self._values.items()}
            values |= {name: points[name].to_numpy(float) for name in self._parameters if name in points}
            # observables have other names where another column has theirs
            names = {
                q.name: f"{q.name}_n" if f"{q.name}_n" in points else q.name for q in self.model.observables
            }
            observed = {name: points[column].to_numpy(float) for name, column in names.items()}
            codes[has_point] = gait_numbers(self._once, values, observed, len(points))
        return gaits(self.model, codes)

    def _described(self, table: pd.DataFrame, parameter: str) -> pd.DataFrame:
        """A table of branches with its coordinates, and with what figures read of a job's table."""
        if "at" in table:  # not every variable of a flow is an observable
            known = np.flatnonzero(table["at"].notna())
            for k, name in enumerate(self.coordinates):
                table.loc[known, name] = [point.points.at[0, k] for point in table["at"].iloc[known]]
            table = table.drop(columns="at")
        table.attrs["job"] = {"run": {"kind": "continuation", "parameter": parameter}}
        names = (*self.coordinates, *(quantity.name for quantity in self.model.observables))
        recorded = [name for name in dict.fromkeys(names) if name in table]
        conserved = self.mapping.conserved
        described = [Column(name) for name in table if name not in recorded]
        described += [Column(q.name, None, q) for q in conserved]
        described += drifts(self.conserved, conserved)
        table.attrs |= {"quantities": quantities_of(self.model, described), "recorded": recorded}
        return table

    def _points(self, x: Any) -> tuple[Points, bool]:
        """Return points, and whether they were one array of coordinates (size,); refuse no points."""
        points, single = self._any_points(x)
        if not len(points):
            raise ArgumentError("x has no points: give at least one.")
        return points, single

    def _any_points(self, x: Any) -> tuple[Points, bool]:
        """As `_points`, of any number of points."""
        if isinstance(x, FixedPoints):
            return x.points, False
        if isinstance(x, Points):
            return x, False
        if isinstance(x, Mapping):
            return self._settled(x, 0), False
        size = len(self.coordinates)
        try:
            at = np.asarray(x, np.float64)
        except (TypeError, ValueError):
            of_gait = (
                " The multipliers of the gait to which a start settles are those of a map m, "
                "m.multipliers(m.fixed_points(m.settled({...}))), with start values by name in the braces."
            )
            raise ArgumentError(
                f"Points are {x!r}, which are not numbers: give coordinates (n, {size}), start values by "
                "name, or what the map's fixed_points or settled returned."
                + ("" if isinstance(self._once, StationaryMap) else of_gait)
            ) from None
        if at.ndim not in (1, 2) or at.shape[-1] != size:
            raise ArgumentError(
                f"Points have the shape {at.shape}, but the map has {size} coordinates: give (n, {size})."
            )
        rows = np.atleast_2d(at)
        like = jax.tree.map(lambda leaf: np.repeat(leaf[:1], len(rows), axis=0), self._start.modes)
        return Points(rows, like), at.ndim == 1 and not self._values

    @cached_property
    def _start(self) -> Points:
        """The points of the map's own start values."""
        return self._settled({}, 0)

    @abc.abstractmethod
    def _require_fixed_points(self) -> None:
        """Raise ArgumentError if the map has no isolated fixed points, or no derivative."""

    def _settled(self, starts: Mapping[str, Any], cycles: int) -> Points:
        """The points of start values after a number of applications of the map."""
        require_whole("cycles", cycles, 0)
        known = [quantity.name for quantity in self.model.initial_conditions]
        for name in starts:
            if name not in known:
                near = near_miss.suggestion(name, known)
                raise ArgumentError(f"{name} is not a start value of {self.model.name}{near}")
        start_values = {**self._starts, **starts}
        missing = [name for name in self._without_start if name not in start_values]
        if missing:
            raise ArgumentError(f"{missing[0]} of {self.model.name} has no default: give this start value.")
        start_values = starts_with(self._once, self._design, starts, start_values, self._values)
        points, halts = self._once.settled(start_values, self._values, cycles * self._period)
        failed = int(np.count_nonzero(halts))
        if failed:
            crossings = cycles * self._period
            warn(f"{failed} of {len(points)} starts did not cross the section {crossings} times.")
        return points


def _is_number(value: Any) -> bool:
    """Whether a value is a finite number, which flags are not."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and math.isfinite(value)


def _written(value: Any) -> str:
    """An argument in a message."""
    return f"{value:g}" if isinstance(value, float | np.number) else repr(value)


def _require_positive(name: str, value: Any) -> None:
    """Refuse an argument that is no number above 0, raising ArgumentError."""
    if not (_is_number(value) and value > 0.0):
        raise ArgumentError(f"{name} is {_written(value)}, but must be a number above 0.")


def require_whole(name: str, value: Any, low: int) -> None:
    """Refuse an argument that is no whole number from `low` on, raising ArgumentError."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < low:
        raise ArgumentError(f"{name} is {_written(value)}, but must be a whole number from {low} on.")


def job_of_map(
    model: AnyModel,
    params: Mapping[str, Any] | None,
    start: Mapping[str, Any] | None,
    values: Mapping[str, Any],
    **fields: Any,
) -> tuple[Job, list[str]]:
    """Return the job of a map, and the start values that nothing gives.

    Args:
        model, params, start, values, fields: as of `return_map`.

    Returns:
        The job, and the names of initial conditions without a default, to which no value is given.
    """
    run = ReturnMap(crossings=1)
    job = job_of(model, values, run=run, params=params, start=start, any_start=True, **fields)
    for caveat in job.design.model.caveats():
        warn(caveat)
    with_value = {*values, *(params or {}), *(start or {})}
    without_default = [q.name for q in job.design.model.initial_conditions if q.default is None]
    return job, [name for name in without_default if name not in with_value]


class StationaryPoints(FixedPointsOfModel):
    """Stationary points of a model's flow, in the discrete modes of the points from which they are searched.

    Coordinates are all variables that the flow moves, but those `without`. Points are given as for
    `PoincareMap`: coordinates, start values by name, or what `fixed_points` returned.
    """

    def __init__(self, job: Job, without: Sequence[str], without_start: Sequence[str]) -> None:
        """Use `gaitsweep.stationary`."""
        super().__init__(job, without_start, partial(StationaryMap, without=tuple(without)))

    def eigenvalues(self, x: SectionPoints | ArrayLike) -> Complex[np.ndarray, "*points coordinates"]:
        """Return the eigenvalues (1/s) of the flow at points, complex (n, size), largest real part first."""
        points, single = self._points(x)
        values = self._flow.complete(self._values, len(points))
        program = linearised_flow(self._flow)
        jacobians = []
        for k in range(len(points)):
            values_of_point = {name: column[k] for name, column in values.items()}
            jacobians.append(program(values_of_point, points.at[k], points[k].modes)[1])
        unordered = np.array(np.linalg.eigvals(np.stack(jacobians)), complex)
        order = np.lexsort((-np.imag(unordered), -np.real(unordered)))
        eigenvalues = np.take_along_axis(unordered, order, axis=-1)
        return eigenvalues[0] if single else eigenvalues

    @held_contents()
    def cycle(
        self, hopf: Mapping[Any, Any] | pd.Series, parameter: str, amplitude: float, points: int = 32
    ) -> pd.DataFrame:
        """Return the cycle of a small amplitude that begins at a Hopf point, to second order.

        A return map finds the cycle itself from there, if the model has a section that it crosses.

        Args:
            hopf: the record of a Hopf point, as `continue_` returns it.
            parameter: the parameter along which it was found.
            amplitude: the largest displacement of a coordinate, above 0.
            points: the number of points around the cycle, 1 or more.

        Returns:
            One record a point: time (s), the coordinates, the value of the parameter at which the cycle has
            this amplitude, and its period (s) there.

        Raises:
            ArgumentError: the record is of no Hopf point, or of one along another parameter; or a number is
                outside its range.
        """
        self._refuse_cycle(hopf, parameter, amplitude, points)
        at, _ = self._points(np.array([[hopf[name] for name in self.coordinates]], float))
        row = np.array([hopf["row"]], int)
        values = {**rows_of(self._values, row), parameter: hopf[parameter]}
        return hopf_cycle(self._flow, at, values, parameter, amplitude, points)

    def _refuse_cycle(
        self, hopf: Mapping[Any, Any] | pd.Series, parameter: str, amplitude: float, points: int
    ) -> None:
        """Refuse arguments of `cycle`, raising ArgumentError."""
        if not isinstance(hopf, Mapping | pd.Series) or hopf.get("special") != "hopf":
            raise ArgumentError("The record is of no Hopf point: take one whose special is hopf.")
        missing = [name for name in ("row", *self.coordinates) if name not in hopf]
        if missing:
            raise ArgumentError(f"The record has no {missing[0]}: take a whole record of `continue_`.")
        parameters = [quantity.name for quantity in self.model.parameters]
        if parameter not in parameters:
            near = near_miss.suggestion(parameter, parameters)
            raise ArgumentError(f"{parameter} is not a parameter of {self.model.name}{near}")
        if parameter not in hopf:
            raise ArgumentError(
                f"The record has no {parameter}: give the parameter along which it was found."
            )
        _require_positive("amplitude", amplitude)
        require_whole("points", points, 1)

    @property
    def _flow(self) -> StationaryMap:
        """The map whose fixed points are the stationary points."""
        assert isinstance(self._once, StationaryMap)
        return self._once

    @cached_property
    def _refusal(self) -> str | None:
        """The reason why the flow has no stationary points, or None."""
        return self._flow.refusal(self._start, self._values)

    def _require_fixed_points(self) -> None:
        if self._refusal is not None:
            raise ArgumentError(self._refusal)


@held_contents()
def stationary(
    model: AnyModel,
    *,
    without: str | Sequence[str] = (),
    params: Mapping[str, Any] | None = None,
    start: Mapping[str, Any] | None = None,
    **values: Any,
) -> StationaryPoints:
    """Create the search for stationary points of a model's flow, where it rests, stable or not.

    Args:
        model: an instance, a class, a registered name, or "package.module:attribute".
        without: variables of the flow that need not rest, such as a clock or how far a body has come: they
            keep their start values.
        params, start: as for `sweep`.
        values: parameters, and start values; those decide the discrete modes.

    Raises:
        ArgumentError: a name that the model does not have, or a model without a flow.
        JobError: all other errors.

    Example:
        The two rolls of Lorenz's convection lose their stability at a subcritical Hopf point, at
        rho = sigma (sigma + b + 3) / (sigma - b - 1):

        >>> import gaitsweep as gs
        >>> from gaitsweep.examples.lorenz import Lorenz
        >>> rolls = gs.stationary(Lorenz(), rho=20.0)
        >>> branch = rolls.continue_([7.0, 7.0, 19.0], "rho", (0.5, 28.0), towards=1)
        >>> hopf = branch[branch["special"] == "hopf"].iloc[0]
        >>> float(hopf["rho"].round(6)), bool(hopf["coefficient"] > 0.0)
        (24.736842, True)
        >>> round(10.0 * (10.0 + 8.0 / 3.0 + 3.0) / (10.0 - 8.0 / 3.0 - 1.0), 6)
        24.736842
    """
    job, without_start = job_of_map(model, params, start, values)
    return StationaryPoints(job, names_in(without), without_start)
