"""Stability quantifiers of a table, with those that need its model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.analysis.basins import quantifiers as of_tables
from gaitsweep.analysis.basins.fractions import LEVEL
from gaitsweep.analysis.basins.state_space import check_scales
from gaitsweep.analysis.continuation.floquet_multipliers import largest_growth
from gaitsweep.analysis.continuation.newton import newton
from gaitsweep.analysis.records import AnalysisError, axes_of, require
from gaitsweep.engine.content import held_contents
from gaitsweep.engine.poincare.maps import Points, Values
from gaitsweep.engine.poincare.model_map import ModelMap
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.solver.methods import derivative_refusal
from gaitsweep.job import Job
from gaitsweep.job.load import stored_job


@held_contents()
def quantifiers(
    table: pd.DataFrame,
    parameter: str,
    *,
    label: str = "attractor",
    within: float | None = None,
    level: float = LEVEL,
    scales: Mapping[str, float] | None = None,
    amplification: bool = False,
    **grouping: Any,
) -> pd.DataFrame:
    """Quantify the stability of each attractor at each value of a parameter.

    Args:
        table: a settle table over starts and the parameter.
        parameter: the column of the parameter.
        label: the column of the outcomes; `attractor` groups the settled states, matched along the parameter,
            if the table does not have it.
        within: a time (s), for the share of starts that settle to the attractor until then.
        level: confidence level of the intervals.
        scales: unit of each axis of starts in the distance of shocks and the size of deviations, where axes
            have different units; with `amplification`, of any start of the model.
        amplification: whether to compute the maximal amplifications, from the table's model.
        grouping: arguments of `analyses.attractors`.

    Returns:
        One record for each value and attractor, with columns that are NaN where they do not follow from the
        table.

        - rows, fraction, low, high: starts that settle to it, their share of all starts and its interval:
          the basin stability (Menck, Heitzig, Marwan and Kurths 2013, Nat. Phys. 9:89).
        - within, within_low, within_high: the same of starts that settle until `within`: the finite-time
          basin stability (Schultz, Menck, Heitzig and Kurths 2017, New J. Phys. 19:023005).
        - time_mean, time_median, time_tail, time_most (s): times after which starts have settled: their mean,
          median, the time that 5 % exceed, and the longest. They include the crossings that the test of
          settling needs. Chaotic and quasi-periodic rows have none, since they run to their limit, nor has an
          attractor with inferred rows.
        - resilience (1/s): the rate at which small deviations decay, -lyapunov_1 in the mean (Pimm 1984,
          Nature 307:321). It needs `exponents` in the run, and is that of the rows that were simulated.
        - least_shock: the distance from the attractor's crossings to the nearest start with another outcome,
          in the units of the starts: the minimal fatal shock (Halekotte and Feudel 2020, Sci. Rep. 10:11783).
          It is no less than the true one, which lies between starts. It needs the observables of all axes
          (x_end for x_0), so that starts are displaced crossings.
        - boundary_exponent: the uncertainty exponent of the basin against all others: 1 for a smooth
          boundary, less for a fractal one, and 0 for basins that are intermingled (Grebogi, McDonald, Ott and
          Yorke 1983, Phys. Lett. A 99:415; Ott, Alexander, Kan, Sommerer and Yorke 1994, Physica D 76:384).
          It needs a grid of starts with three sizes, so 32 starts along each axis.
        - wada: the least share of the basin's boundary that is within 5 steps of the boundary of another
          basin: 1 for a boundary that all basins share, at the resolution of the grid (Daza, Wagemakers and
          Sanjuan 2018, Sci. Rep. 8:9954). It needs a grid of starts and three outcomes.
        - amplification: the maximal amplification of a gait: the largest factor by which a small deviation
          from a section crossing grows until any later one, where it may grow before it decays: the largest
          singular value of all products of the return map's Jacobians around the gait, 1 where all
          deviations shrink at once (Trefethen and Embree 2005, Spectra and Pseudospectra, ch. 14;
          Krakovska, Kuehn and Longo 2024, Eur. J. Appl. Math. 35:155). The norm is the Euclidean one of the
          section's coordinates, each in units of 1, or of `scales` for the start of its name. NaN for
          rest, chaos, and gaits with neutral or growing deviations.

    Raises:
        AnalysisError: the table lacks a column, an argument is not allowed, its inferred rows lack the state
            or the time that is asked for, or the return map of the table's model has no derivative.
        ArgumentError: `amplification` is asked for, and the table is joined of several.
        JobError: the table's model is not found.

    Example:
        >>> import numpy as np, gaitsweep as gs
        >>> class Wells(gs.MapModel):
        ...     pull = gs.parameter("1", "pull to the wells at -1 and 1", 0.2)
        ...     x = gs.variable("1", "place", 0.0)
        ...
        ...     def image(self, p, s):
        ...         return {"x": s.x + p.pull * (s.x - s.x**3)}
        >>> run = gs.Settle(exponents=1, tolerance=1e-6)
        >>> table = gs.sweep(Wells(), x_0=np.linspace(-1.5, 1.5, 100), pull=[0.2, 0.4], run=run).table
        >>> quantified = gs.quantifiers(table, "pull")
        >>> quantified[["pull", "fraction", "resilience", "least_shock"]].round(2).to_numpy().tolist()
        [[0.2, 0.5, 0.51, 1.02], [0.2, 0.5, 0.51, 1.02], [0.4, 0.5, 1.61, 1.02], [0.4, 0.5, 1.61, 1.02]]
    """
    amplifications = None
    if amplification:
        require(table, parameter, "row", "status", "cycles", "attractor_period")
        amplifications = _Amplifications(table, scales or {})
    options = {"label": label, "within": within, "level": level, "scales": scales, **grouping}
    return of_tables.quantifiers(table, parameter, amplifications=amplifications, **options)


class _Amplifications:
    """Maximal amplifications of the gaits on which rows of a table have settled.

    Args:
        table: the table, with its job.
        scales: unit of the deviation of each start, by name; 1 for the others.
    """

    def __init__(self, table: pd.DataFrame, scales: Mapping[str, float]) -> None:
        if "job" not in table.attrs:
            raise AnalysisError("amplification needs the table's model, but this table has no job.")
        self._job: Job = stored_job(table.attrs)
        model, method = self._job.design.model, self._job.integration.method
        if (refusal := derivative_refusal(method, model)) is not None:
            raise AnalysisError(f"The return map of {model.name} by {method} has no derivative: {refusal}")
        engine = self._job.engine.name
        self._once: ModelMap = BatchedReturnMap(model, numerics=self._job.integration, engine=engine)
        allowed = {*(start.name for start in model.initial_conditions), *axes_of(table)}
        check_scales(scales, sorted(allowed))
        starts = [f"{quantity.name}_0" for quantity in self._once.coordinates]
        self._sizes = np.array([scales.get(start, 1.0) for start in starts])

    def __call__(self, rows: pd.DataFrame) -> Float[np.ndarray, " attractors"]:
        growths = np.full(len(rows), np.nan)
        periods = rows["attractor_period"].to_numpy(int)
        for period in np.unique(periods):
            of_period = np.flatnonzero(periods == period)
            growths[of_period] = self._of_period(rows.iloc[of_period], int(period))
        return growths

    def _of_period(self, rows: pd.DataFrame, period: int) -> Float[np.ndarray, " attractors"]:
        """The maximal amplifications of gaits with the same number of crossings."""
        design = self._job.design
        numbers = rows["row"].to_numpy(np.int64)
        values = design.at(numbers, [q.name for q in design.model.parameters])
        starts = design.at(numbers, [q.name for q in design.model.initial_conditions])
        cycles = int(np.max(rows["cycles"].to_numpy(np.int64)))
        settled, _ = self._once.settled(starts, values, cycles)
        conserved = [quantity.name for quantity in self._once.conserved]
        gaits = newton(self._once.iterated(period), settled, values, fix=conserved)
        jacobians = self._jacobians(gaits.points, values, period)
        growths = [largest_growth(list(around)) for around in jacobians]
        return np.where(gaits.converged, growths, np.nan)

    def _jacobians(
        self, points: Points, values: Values, period: int
    ) -> Float[np.ndarray, "attractors period coordinates coordinates"]:
        """The Jacobians at all crossings of gaits, of deviations in units of their sizes."""
        around = []
        for _ in range(period):
            image = self._once.linearised(points, values)
            around.append(image.jacobian * self._sizes / self._sizes[:, None])
            points = image.points
        return np.stack(around, axis=1)
