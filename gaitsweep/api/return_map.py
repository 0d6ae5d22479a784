"""Return map of a model: images, derivative, multipliers, events, phase response and rare falls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, overload

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float, Inexact
from numpy.typing import ArrayLike

from gaitsweep import near_miss
from gaitsweep.analysis.basins.fractions import LEVEL
from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.newton import FixedPoints, NewtonOutcome
from gaitsweep.analysis.phase_response import phase_response
from gaitsweep.analysis.rare_falls import SCALES, Draws, RareFalls, TooFewFallsError, rare_falls
from gaitsweep.analysis.records import names_in
from gaitsweep.api.fixed_points import FixedPointsOfModel, SectionPoints, job_of_map, require_whole
from gaitsweep.api.keywords import AnyModel
from gaitsweep.contract import HybridModel
from gaitsweep.dynamics.declarations import Variable
from gaitsweep.dynamics.section_coordinates import SectionCoordinates
from gaitsweep.engine.content import held_contents
from gaitsweep.engine.poincare.maps import Points
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.pushed_model import flow_places
from gaitsweep.engine.solver.methods import derivative_refusal
from gaitsweep.errors import ArgumentError, warn
from gaitsweep.job import Job

_BESIDE = 1e-3  # distance from a point to one beside it, in sizes of coordinates


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

        It is NaN if a trajectory falls or does not return to the section.

        Raises:
            ArgumentError: the map has no derivative.
        """
        self._require_fixed_points()
        points, single = self._points(x)
        images = self.mapping.linearised(points, self._values)
        jacobians = np.where(images.sound[:, None, None], images.jacobian, np.nan)
        return jacobians[0] if single else jacobians

    def multipliers(self, x: SectionPoints | ArrayLike) -> Inexact[np.ndarray, "*points coordinates"]:
        """Return the Floquet multipliers of fixed points, complex (n, size), largest modulus first.

        They are NaN, with a warning, of points of `fixed_points` that are not fixed to its tolerance.

        Args:
            x: fixed points, as `fixed_points` gives them; of the gait to which a start settles:
                `m.multipliers(m.fixed_points(m.settled({"psi_1": 1.1}, cycles=60)))`.

        Raises:
            ArgumentError: the map has no derivative, or x is the name of a gait.

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
        factors = multipliers(self.jacobian(x))
        if isinstance(x, FixedPoints) and not x.fixed.all():
            factors[~x.fixed] = complex(np.nan, np.nan)
            outcomes = sorted({NewtonOutcome(outcome).name for outcome in x.outcome[~x.fixed]})
            warn(
                f"{np.count_nonzero(~x.fixed)} of {len(x.fixed)} points are no fixed points "
                f"({', '.join(outcomes)}): their multipliers are NaN."
            )
        if missing := self._missing_coordinates(self._points(x)[0]):
            names = " and ".join(missing)
            warn(
                f"The images of points depend on {names}, which section_coordinates of {self.model.name} "
                f"leaves out, so the multipliers are wrong: add {names}, or set it from the coordinates in "
                "`complete`."
            )
        return factors

    def _missing_coordinates(self, points: Points) -> list[str]:
        """Return the left-out variables that vary from crossing to crossing and change the next one.

        The image of a point that lies beside the first one is mapped with all of its state, and with each
        left-out variable as at the first point.
        """
        if not isinstance(chart := self._return_map.chart, SectionCoordinates):
            return []
        first = points[:1]
        chosen = dict(chart.model.section_variables())
        others = [name for name in chart.model.declarations.of_kind(Variable) if name not in chosen]
        if not others:
            return []
        values = {name: value[:1] if np.ndim(value) else value for name, value in self._values.items()}
        beside = Points(first.at + _BESIDE * self.mapping.sizes(first.at), first.modes)
        image = self.mapping.linearised(beside, values)
        alike = [
            np.array_equal(one, other)
            for one, other in zip(*map(jax.tree.leaves, (first.modes, image.points.modes)), strict=True)
            if not np.issubdtype(one.dtype, np.floating)
        ]
        if not (image.sound.all() and all(alike)):
            return []
        modes = image.points.modes
        states = [modes, *(modes.replace(**{name: getattr(first.modes, name)}) for name in others)]
        own, *replaced = (self.mapping.linearised(Points(image.points.at, s), values) for s in states)
        return [
            name
            for name, other in zip(others, replaced, strict=True)
            if own.sound.all()
            and other.sound.all()
            and self.mapping.distance(own.points.at, other.points.at).max() > 1e-2 * _BESIDE
        ]

    @held_contents()
    def orbit(self, x: SectionPoints | ArrayLike) -> Float[np.ndarray, "*points period coordinates"]:
        """Return the section crossings of gaits, (n, period, size), from one crossing of each.

        Crossings are NaN from where a trajectory falls or does not return to the section.

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
        crossings = [points.at]
        sound = np.ones(len(points), bool)
        for _ in range(self._period - 1):
            images = self._once.images(points, self._values)
            points, sound = images.points, sound & images.sound
            crossings.append(np.where(sound[:, None], points.at, np.nan))
        orbits = np.stack(crossings, axis=1)
        return orbits[0] if single else orbits

    @held_contents()
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

    @held_contents()
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
            ArgumentError: the map has no derivative; x is no gait, an unstable one, or one whose period
                changes along a family of gaits; a name is no variable of the flow; a phase is outside its
                range.

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
        if not push:
            raise ArgumentError(f"push is empty: name a variable of the flow. {near_miss.allowing(places)}")
        for name in push:
            if name not in places:
                near = near_miss.suggestion(name, places)
                raise ArgumentError(f"{name} is no variable of the flow of {self.model.name}{near}")
        count = isinstance(phases, int | np.integer)
        shares = np.arange(phases) / phases if count else np.asarray(phases, np.float64)
        if shares.ndim != 1 or not shares.size or not np.all((shares >= 0.0) & (shares < 1.0)):
            raise ArgumentError("phases are a whole number above 0, or numbers (n,) from 0 to below 1.")
        points = self._points(x)[0]
        if len(points) != 1:
            raise ArgumentError(f"x has {len(points)} points: give one gait.")
        variables = [places[name] for name in push]
        response = phase_response(self._return_map, points, self._values, self._period, variables, shares)
        columns = {f"response_{name}": response[:, k] for k, name in enumerate(push)}
        return pd.DataFrame({"push_phase": shares, **columns})

    @held_contents()
    def settled(self, starts: Mapping[str, Any] | None = None, cycles: int = 1) -> Points:
        """Return the section points of start values after a number of applications of the map.

        Args:
            starts: numbers or (n,) by name; the others as given to `return_map`, else the model's defaults.
            cycles: applications of the map, 0 or more, each of `period` crossings. A trajectory that fails
                stays where it failed, with a warning.
        """
        return self._settled(starts or {}, cycles)

    def _require_fixed_points(self) -> None:
        method = self._return_map.integration.method
        if (refusal := derivative_refusal(method, self.model)) is not None:
            raise ArgumentError(
                f"The return map of {self.model.name} by {method} has no derivative: {refusal}"
            )

    @held_contents()
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
            scales: factors on the noise, of which a few rounds choose the one with the smallest error; those
                with which it is beyond its allowed range are left out.
            level: confidence level of the interval.

        Raises:
            AnalysisError: an argument is not allowed, or too few falls were met.
            ArgumentError: the map has parameters or starts with several values: use `steps_to_fall`.

        Example:
            >>> import gaitsweep as gs
            >>> from gaitsweep.examples.rimless_wheel import RimlessWheel
            >>> wheel = gs.return_map(RimlessWheel(), roughness=0.03)
            >>> drawn = lambda p, s: (s.ahead - p.slope) / p.roughness
            >>> found = wheel.rare_falls("roughness", drawn, rounds=8)
            >>> 1e4 < found.steps < 1e6
            True
        """
        if several := next(iter(self._varied()), None):
            raise ArgumentError(f"{several} of this map has several values: steps_to_fall estimates each.")
        settings = {"seed": seed, "steps": steps, "rounds": rounds, "scales": scales, "level": level}
        return rare_falls(self._once, {}, self._start_of(0), noise, draws, **settings)

    @held_contents()
    def steps_to_fall(
        self, noise: str, draws: Draws, *, seed: str = "seed", level: float = LEVEL, **options: Any
    ) -> pd.DataFrame:
        """Estimate the mean number of steps to a fall at each value of the map's parameters and starts.

        Args:
            noise, draws, seed, level: as for `rare_falls`.
            options: `steps`, `rounds` and `scales` of `rare_falls`.

        Returns:
            One record for each combination of the parameters and starts that were given as arrays, which are
            columns: `steps` (the mean), `low` and `high` (its confidence interval), `falls`, `scale` (the
            factor on the noise; 1 where plain steps met enough falls) and `simulated` (steps). Numbers are
            NaN where an estimate met too few falls or all rows fell at once, which `note` says.

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
        varied = self._varied()
        count = max(map(len, varied.values()), default=1)
        for row in range(count):
            values = {name: float(column[row]) for name, column in self._values.items()}
            record: dict[str, Any] = {name: float(column[row]) for name, column in varied.items()}
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
        columns = [*varied, "steps", "low", "high", "falls", "scale", "simulated", "note"]
        return pd.DataFrame(records, columns=columns)

    def _varied(self) -> dict[str, Float[np.ndarray, " rows"]]:
        """The parameters and starts with several values."""
        starts = {name: np.ravel(value) for name, value in self._starts.items()}
        return self._values | {name: value for name, value in starts.items() if np.ptp(value) > 0.0}

    def _start_of(self, row: int) -> dict[str, float]:
        """The start values that the map has, of a row of its parameters."""
        starts = {name: np.ravel(value) for name, value in self._starts.items()}
        return {name: float(value[row if len(value) > 1 else 0]) for name, value in starts.items()}


@held_contents()
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
        ArgumentError: a name that the model does not have, or a period that is no whole number from 1 on.
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
    require_whole("period", period, 1)
    job, without_start = job_of_map(model, params, start, values, numerics=numerics, engine=engine)
    return PoincareMap(job, period, without_start)
