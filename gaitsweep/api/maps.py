"""Return map of a model at given parameters: images, derivative, fixed points and branches."""

from __future__ import annotations

import abc
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any, overload

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float, Inexact
from numpy.typing import ArrayLike

from gaitsweep import near_miss
from gaitsweep.analysis.basins.fractions import LEVEL
from gaitsweep.analysis.continuation.continuation import LevelMap, continuation
from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.newton import FixedPoints, newton
from gaitsweep.analysis.phase_response import phase_response
from gaitsweep.analysis.rare_falls import SCALES, Draws, RareFalls, TooFewFallsError, rare_falls
from gaitsweep.analysis.records import names_in
from gaitsweep.api.keywords import AnyModel, job_of
from gaitsweep.contract import HybridModel
from gaitsweep.engine.poincare.maps import Map, Points
from gaitsweep.engine.poincare.model_map import ModelMap
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.poincare.stationary_map import StationaryMap
from gaitsweep.engine.pushed_model import flow_places
from gaitsweep.engine.solver.methods import derivative_refusal
from gaitsweep.errors import ArgumentError
from gaitsweep.job import Job
from gaitsweep.kinds import ReturnMap
from gaitsweep.kinds.columns import AT_REST, gaits, quantities_of
from gaitsweep.kinds.fixed_points import gait_numbers

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
        self,
        job: Job,
        without_start: Sequence[str],
        map_of: Callable[..., ModelMap],
        period: int = 1,
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
        self._parameters = parameters
        self._without_start = tuple(without_start)
        self._starts = {
            name: value
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
            tolerance: residual of a fixed point, relative to the size of each coordinate.
            most: Newton steps.

        Returns:
            For each point: `converged`, `outcome`, `points` (`points.at` are coordinates), `residual`,
            `iterations`, `images` with their derivatives.

        Raises:
            ArgumentError: the map has no derivative, or `fix` names a quantity that it does not conserve.

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
        points = self._points(x)[0]
        conserved = self.conserved if fix is None else names_in(fix)
        return newton(self.mapping, points, self._values, fix=conserved, tolerance=tolerance, most=most)

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
            within: its range, two numbers.
            towards: 1 or -1, the direction in which a branch begins; both by default.
            fix: conserved quantities that are held; all of `conserved` by default.

        Returns:
            One record a point of a branch, as of `analysis.continuation.continuation`; `row` is the place of
            its start, `direction` that of the branch at its start, and `gait` its gait.
            `gs.plot.continuation` draws it.

        Raises:
            ArgumentError: the map has no derivative, the parameter is not the model's, its value is outside
                the range, or the range is not two numbers.

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
        if isinstance(within, str) or len(within) != 2 or not min(within) < max(within):
            raise ArgumentError(f"within is {within!r}, but must be two different numbers.")
        low, high = min(within), max(within)
        if not (low <= begin.min() and begin.max() <= high):
            raise ArgumentError(
                f"{parameter} is {begin[0]:g} at the map's points, but the range is from {low:g} to {high:g}."
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
                within=within,
                begin=np.broadcast_to(begin, (len(points),)),
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
        if parameter not in self._parameters:
            self.mapping.complete({parameter: 0.0}, 1)  # refuses names that the model does not have
        values = self._parameters[parameter]
        return values if parameter in self._values else values[:1]

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
        table.attrs |= {"quantities": quantities_of(self.model), "recorded": recorded}
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
        at = np.asarray(x, np.float64)
        size = len(self.coordinates)
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
        known = [quantity.name for quantity in self.model.initial_conditions]
        for name in starts:
            if name not in known:
                near = near_miss.suggestion(name, known)
                raise ArgumentError(f"{name} is not a start value of {self.model.name}{near}")
        start_values = {**self._starts, **starts}
        missing = [name for name in self._without_start if name not in start_values]
        if missing:
            raise ArgumentError(f"{missing[0]} of {self.model.name} has no default: give this start value.")
        points, halts = self._once.settled(start_values, self._values, cycles * self._period)
        failed = int(np.count_nonzero(halts))
        if failed:
            warnings.warn(
                f"{failed} of {len(points)} starts did not cross the section {cycles} times.", stacklevel=2
            )
        return points


class PoincareMap(FixedPointsOfModel):
    """Map from a state just after one section crossing to the state just after the next.

    Coordinates are those of the model's chart (`coordinates`), or all numbers of a state. Where parameters
    were given as arrays, there is one map for each of their combinations, and points belong to them in order.

    Points are given as one of

    - an array of coordinates (size,) or (n, size). Its discrete modes (contacts, leg segments) are those of
      the map's own start, so it has to be near that;
    - start values by name, numbers or (n,): the section state with which a run begins;
    - the points that `settled`, `fixed_points` or the map itself returned, with their modes.
    """

    def __init__(self, job: Job, period: int, without_start: Sequence[str]) -> None:
        """Use `gaitsweep.return_map`; `without_start` are the start values that were not given."""
        map_of = partial(BatchedReturnMap, numerics=job.integration, engine=job.engine.name)
        super().__init__(job, without_start, map_of, period)

    @property
    def _return_map(self) -> BatchedReturnMap:
        """The map from one crossing to the next."""
        assert isinstance(self._once, BatchedReturnMap)
        return self._once

    @overload
    def __call__(self, x: SectionPoints) -> Points: ...
    @overload
    def __call__(self, x: ArrayLike) -> Float[np.ndarray, "*points coordinates"]: ...
    def __call__(self, x: Any) -> Any:
        """Return the images of points: coordinates for coordinates, else points with their modes.

        Coordinates are NaN if a trajectory falls or does not return to the section.
        """
        points, single = self._points(x)
        images = self.mapping.images(points, self._values)
        at = np.where(images.sound[:, None], images.points.at, np.nan)
        if isinstance(x, Points | FixedPoints | Mapping):
            return Points(at, images.points.modes)
        return at[0] if single else at

    def jacobian(self, x: SectionPoints | ArrayLike) -> Float[np.ndarray, "*points coordinates coordinates"]:
        """Return the Jacobian over the coordinates, (n, size, size); (size, size) for one array (size,).

        Raises:
            ArgumentError: the map has no derivative.
        """
        self._require_fixed_points()
        points, single = self._points(x)
        jacobians = self.mapping.linearised(points, self._values).jacobian
        return jacobians[0] if single else jacobians

    def multipliers(self, x: SectionPoints | ArrayLike) -> Inexact[np.ndarray, "*points coordinates"]:
        """Return the Floquet multipliers of fixed points, complex (n, size), largest modulus first.

        Raises:
            ArgumentError: the map has no derivative.

        Example:
            The hopper has two 1:1 gaits, one stable and one unstable. The product of the multipliers of each
            is the hopper's restitution:

            >>> import gaitsweep as gs
            >>> from gaitsweep.examples.hopper import Hopper
            >>> hops = gs.return_map(Hopper(), omega=3.7)
            >>> gaits = [hops.fixed_points(near) for near in ([0.4, 8.3], [5.9, 8.3])]
            >>> [abs(hops.multipliers(gait)).max().round(4).item() for gait in gaits]
            [0.8367, 1.6567]
            >>> [hops.multipliers(gait).prod().real.round(4).item() for gait in gaits]
            [0.7, 0.7]
        """
        return multipliers(self.jacobian(x))

    def orbit(self, x: SectionPoints | ArrayLike) -> Float[np.ndarray, "*points period coordinates"]:
        """Return the section crossings of gaits, (n, period, size), from one crossing of each.

        Example:
            Beyond its flip the ball bounces high and low in turns:

            >>> import gaitsweep as gs
            >>> from gaitsweep.examples.bouncing_ball import BouncingBall
            >>> ball = gs.return_map(BouncingBall(), G=1.6, period=2)
            >>> gait = ball.fixed_points([0.5, 3.6])
            >>> ball.orbit(gait)[0, :, 1].round(3).tolist()
            [3.658, 2.59]
        """
        points, single = self._points(x)
        crossings = [points]
        for _ in range(self._period - 1):
            crossings.append(self._once.images(crossings[-1], self._values).points)
        orbits = np.stack([crossing.at for crossing in crossings], axis=1)
        return orbits[0] if single else orbits

    def events(self, x: SectionPoints | ArrayLike) -> list[list[tuple[float, str]]]:
        """Return the events between each of n points and its image: their times (s) and names, in order.

        Example:
            A runner lands, lifts off, and passes the apex of its flight, where its cycle ends:

            >>> import gaitsweep as gs
            >>> from gaitsweep.examples.slip_runner import SlipRunner
            >>> run = gs.return_map(SlipRunner())
            >>> [name for _, name in run.events(run.settled())[0]]
            ['foot lands', 'foot lifts off', 'apex']
        """
        return self.mapping.events(self._points(x)[0], self._values)

    def phase_response(
        self, x: SectionPoints | ArrayLike, push: str | Sequence[str], phases: int | ArrayLike = 64
    ) -> pd.DataFrame:
        """Return the phase that a stable gait gains for good by small pushes, exactly, by the adjoint.

        Args:
            x: one crossing of the gait, as `fixed_points` gives it.
            push: variables of the flow that are pushed, such as `rate`, or `phi_1` of an array.
            phases: shares of the gait's period after that crossing, from 0 to below 1, or how many.

        Returns:
            A table with `push_phase`, and `response_NAME` for each variable: the share of the gait's period
            by which later crossings come early, per unit of the push.

        Raises:
            ArgumentError: the map has no derivative; the gait is unstable, or its period changes along a
                family of gaits; a name is no variable of the flow; a phase is outside its range.

        Example:
            A clock on a circle gains -sin(2 pi phase) / (2 pi) by a push along x (Winfree 2001, The Geometry
            of Biological Time, ch. 6):

            >>> import jax.numpy as jnp, gaitsweep as gs
            >>> class Clock(gs.DeclaredModel):
            ...     omega = gs.parameter("rad/s", "angular frequency", 6.0)
            ...     x = gs.variable("1", "first coordinate", 1.0)
            ...     y = gs.variable("1", "second coordinate")
            ...
            ...     def flow(self, p, s):
            ...         pull = 1.0 - s.x**2 - s.y**2
            ...         return {"x": pull * s.x - p.omega * s.y, "y": pull * s.y + p.omega * s.x}
            ...
            ...     @gs.event("turn ends", section=True)
            ...     def turn(self, p, s):
            ...         return s.y
            ...
            ...     def period(self, p):
            ...         return 2.0 * jnp.pi / p.omega
            >>> turns = gs.return_map(Clock())
            >>> gait = turns.fixed_points(turns.settled(cycles=20))
            >>> turns.phase_response(gait, ["x"], [0.0, 0.25, 0.5])["response_x"].abs().round(4).tolist()
            [0.0, 0.1592, 0.0]
        """
        self._require_fixed_points()
        assert isinstance(self.model, HybridModel)  # others have no derivative
        places = flow_places(self.model)
        push = names_in(push)
        for name in push:
            if name not in places:
                near = near_miss.suggestion(name, places)
                raise ArgumentError(f"{name} is no variable of the flow of {self.model.name}{near}")
        shares = np.arange(phases) / phases if isinstance(phases, int) else np.asarray(phases, np.float64)
        if shares.ndim != 1 or not np.all((shares >= 0.0) & (shares < 1.0)):
            raise ArgumentError("phases are a whole number, or numbers (n,) from 0 to below 1.")
        points = self._points(x)[0]
        if len(points) != 1:
            raise ArgumentError(f"x has {len(points)} points: give one gait.")
        variables = [places[name] for name in push]
        response = phase_response(self._return_map, points, self._values, self._period, variables, shares)
        columns = {f"response_{name}": response[:, k] for k, name in enumerate(push)}
        return pd.DataFrame({"push_phase": shares, **columns})

    def settled(self, starts: Mapping[str, Any] | None = None, cycles: int = 1) -> Points:
        """Return the section points of start values after a number of crossings.

        Args:
            starts: numbers or (n,) by name; the others as given to `return_map`, else the model's defaults.
            cycles: crossings, 0 or more. A trajectory that fails stays where it failed, with a warning.
        """
        return self._settled(starts or {}, cycles)

    def _require_fixed_points(self) -> None:
        method = self._return_map.integration.method
        if (refusal := derivative_refusal(method, self.model)) is not None:
            raise ArgumentError(
                f"The return map of {self.model.name} by {method} has no derivative: {refusal}"
            )

    def rare_falls(
        self,
        noise: str,
        draws: Draws,
        *,
        seed: str = "seed",
        steps: int = 6,
        rounds: int = 64,
        scales: Sequence[float] = SCALES,
        level: float = LEVEL,
    ) -> RareFalls:
        """Estimate the mean number of steps to a fall, also of one that is too rare for plain runs.

        Some steps are made with a larger noise, and falls are weighted by the quotient of the densities of
        the numbers drawn on the way: importance sampling, without bias. Where plain steps meet enough falls,
        these are counted.

        Args:
            noise: the parameter to which the noise at events is proportional, such as `roughness`.
            draws: a function (params, state) -> the numbers that the last jump drew, as standard normal ones
                (a number, or an array (k,)): `lambda p, s: (s.ahead - p.slope) / p.roughness`. All noise of
                the model has to be among them.
            seed: the parameter of the seed; each step has one of its own.
            steps: steps with larger noise before a fall; more than the walker remembers.
            rounds: rounds of 2048 windows.
            scales: factors on the noise, of which a few rounds choose the one with the smallest error.
            level: confidence level of the interval.

        Raises:
            AnalysisError: an argument is not allowed, or too few falls were met.
            ArgumentError: the map has parameters with several values: use `steps_to_fall`.

        Example:
            >>> import gaitsweep as gs
            >>> from gaitsweep.examples.rimless_wheel import RimlessWheel
            >>> wheel = gs.return_map(RimlessWheel(), roughness=0.03)
            >>> drawn = lambda p, s: (s.ahead - p.slope) / p.roughness
            >>> found = wheel.rare_falls("roughness", drawn, rounds=8)
            >>> 1e4 < found.steps < 1e6
            True
        """
        if self._values:
            raise ArgumentError(
                f"{next(iter(self._values))} of this map has several values: steps_to_fall estimates each."
            )
        settings = {"seed": seed, "steps": steps, "rounds": rounds, "scales": scales, "level": level}
        return rare_falls(self._once, {}, self._start_of(0), noise, draws, **settings)

    def steps_to_fall(
        self, noise: str, draws: Draws, *, seed: str = "seed", level: float = LEVEL, **options: Any
    ) -> pd.DataFrame:
        """Estimate the mean number of steps to a fall at each value of the map's parameters.

        Args:
            noise, draws, seed, level: as for `rare_falls`.
            options: `steps`, `rounds` and `scales` of `rare_falls`.

        Returns:
            One record for each combination of the parameters that were given as arrays, which are columns:
            `steps` (the mean), `low` and `high` (its confidence interval), `falls`, `scale` (the factor on
            the noise; 1 where plain steps met enough falls) and `simulated` (steps). Numbers are NaN where
            an estimate met too few falls or all rows fell at once, which `note` says.

        Raises:
            AnalysisError: an argument is not allowed.

        Example:
            >>> import gaitsweep as gs
            >>> from gaitsweep.examples.rimless_wheel import RimlessWheel
            >>> wheel = gs.return_map(RimlessWheel(), roughness=[0.06, 0.08], slope=[0.13, 0.15])
            >>> drawn = lambda p, s: (s.ahead - p.slope) / p.roughness
            >>> table = wheel.steps_to_fall("roughness", drawn, rounds=8)
            >>> table[["roughness", "slope"]].to_numpy().tolist()
            [[0.06, 0.13], [0.06, 0.15], [0.08, 0.13], [0.08, 0.15]]
            >>> (table["low"] < table["steps"]).all() and bool(table["steps"][1] > table["steps"][0])
            True
        """
        if seed in self._values:
            raise ArgumentError(f"{seed} has several values, but each step has a seed of its own.")
        options = {"steps": 6, "rounds": 64, "scales": SCALES, **options}
        records: list[dict[str, Any]] = []
        count = max((len(column) for column in self._values.values()), default=1)
        for row in range(count):
            values = {name: float(column[row]) for name, column in self._values.items()}
            record: dict[str, Any] = dict(values)
            try:
                estimate = rare_falls(
                    self._once, values, self._start_of(row), noise, draws, seed=seed, level=level, **options
                )
            except TooFewFallsError as error:
                record["note"] = str(error)
            else:
                low, high = estimate.steps_interval
                record |= {"steps": estimate.steps, "low": low, "high": high, "falls": estimate.falls}
                record |= {"scale": estimate.scale, "simulated": estimate.simulated, "note": ""}
            records.append(record)
        columns = [*self._values, "steps", "low", "high", "falls", "scale", "simulated", "note"]
        return pd.DataFrame(records, columns=columns)

    def _start_of(self, row: int) -> dict[str, float]:
        """The start values that the map has, of a row of its parameters."""
        starts = {name: np.ravel(value) for name, value in self._starts.items()}
        return {name: float(value[row if len(value) > 1 else 0]) for name, value in starts.items()}


def return_map(
    model: AnyModel,
    *,
    params: Mapping[str, Any] | None = None,
    start: Mapping[str, Any] | None = None,
    numerics: Mapping[str, Any] | None = None,
    engine: str = "auto",
    period: int = 1,
    **values: Any,
) -> PoincareMap:
    """Create the return map of a model's Poincare section.

    Args:
        model: an instance, a class, a registered name, or "package.module:attribute".
        params, start, numerics: as for `sweep`.
        engine: auto, kernel or xla.
        period: crossings from a point to its image: fixed points are gaits that repeat after so many.
        values: parameters, and default start values of points.

    Raises:
        ArgumentError: a name that the model does not have.
        JobError: all other errors.

    Example:
        The hopper's map is known: a hop lasts 2 launch / g, and its phase grows by omega times that.

        >>> import numpy as np, gaitsweep as gs
        >>> from gaitsweep.examples.hopper import Hopper
        >>> hops = gs.return_map(Hopper(), omega=3.7)
        >>> hops.coordinates
        ['phase', 'launch']
        >>> phase = 3.7 * 2.0 * 2.5 / 9.81
        >>> np.allclose(hops([0.0, 2.5]), [phase, 0.7 * 2.5 + 2.6 * (1.0 + np.cos(phase)) / 2.0])
        True
    """
    job, without_start = job_of_map(model, params, start, values, numerics=numerics, engine=engine)
    return PoincareMap(job, period, without_start)


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
        warnings.warn(caveat, stacklevel=3)
    given = {*values, *(start or {})}
    without_default = [q.name for q in job.design.model.initial_conditions if q.default is None]
    return job, [name for name in without_default if name not in given]
