"""Stiffness of a job's rows, by which the method `auto` becomes rodas5p."""

from __future__ import annotations

import dataclasses

import numpy as np

from gaitsweep.contract import HybridModel
from gaitsweep.design.design import Design
from gaitsweep.engine.flow_spectrum import STIFF, decay_per_period
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.solver.methods import refusal
from gaitsweep.expression import functions_of, resolve
from gaitsweep.kinds import RunKind

# Number of rows whose flow is examined for stiffness.
MAX_STIFFNESS_ROWS = 16


def suited_to_stiffness(design: Design, run: RunKind, numerics: ResolvedNumerics) -> ResolvedNumerics:
    """The numerics of a job that leaves the method open: those given, or rodas5p where some row is stiff.

    A flow is stiff if some motion decays more than `STIFF` times in a nominal period, at the start of one of
    `MAX_STIFFNESS_ROWS` evenly spaced rows. A method that the model recommends is kept.

    Args:
        design, run: the job's rows and their run kind.
        numerics: the resolved numerics, of the method auto.
    """
    model = design.model
    if not isinstance(model, HybridModel) or model.recommended.method != "auto" or model.host_parameters:
        return numerics
    if refusal("rodas5p", model, numerics.precision) is not None:
        return numerics
    count = min(design.n_rows, MAX_STIFFNESS_ROWS)
    values, starts = design.values_in(np.linspace(0, design.n_rows - 1, count).astype(np.int64))
    places = list(run.places())
    for place in places[:: max(1, (len(places) - 1) // 2)]:  # both ends and the middle of a path
        placed = {**values, **{name: np.full(count, at) for name, at in place.items()}}
        placed = resolve(design.following(*place), placed, functions_of(np))
        if decay_per_period(model, placed, starts) > STIFF:
            return dataclasses.replace(numerics, method="rodas5p")
    return numerics
