"""Stationary points of a model's flow: their eigenvalues, branches, Hopf points and the cycles born there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Complex
from numpy.typing import ArrayLike

from gaitsweep import near_miss
from gaitsweep.analysis.atlas.periodic_orbits import rows_of
from gaitsweep.analysis.continuation.normal_forms import hopf_cycle
from gaitsweep.analysis.records import names_in
from gaitsweep.api.fixed_points import FixedPointsOfModel, SectionPoints, job_of_map
from gaitsweep.api.keywords import AnyModel
from gaitsweep.engine.poincare.stationary_map import StationaryMap, linearised_flow
from gaitsweep.errors import ArgumentError
from gaitsweep.job import Job


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
        if hopf.get("special") != "hopf":
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
        if not (np.isfinite(amplitude) and amplitude > 0.0):
            raise ArgumentError(f"amplitude is {amplitude:g}, but must be a number above 0.")
        if points < 1:
            raise ArgumentError(f"points is {points}, but must be 1 or more.")

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
