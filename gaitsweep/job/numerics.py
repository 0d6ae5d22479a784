"""Sections `numerics` and `engine` of a job, their check, and the method of stiff rows."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PlainValidator, WithJsonSchema

from gaitsweep.contract import HybridModel, Model
from gaitsweep.design.design import Design
from gaitsweep.engine.flow_spectrum import STIFF, decay_per_period
from gaitsweep.engine.numerics import Numerics, ResolvedNumerics
from gaitsweep.engine.solver.methods import Precision, fixed_step_scheme, refusal
from gaitsweep.engine.sweep.sweep_spec import RequestedEngine
from gaitsweep.kinds import RunKind
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.numbers import Count, Flag, LaneCount, Positive, Word, checked, read_real, read_whole
from gaitsweep.schema.strict_model import StrictModel

# The largest tolerance on event times, as a share of the nominal period: well below the longest step.
LARGEST_EVENT_TOLERANCE = 1e-3
MAX_STIFFNESS_ROWS = 16  # whose flow is examined for stiffness

MethodName = Literal[
    "auto", "tsit5", "taylor", "rodas5p", "rk4", "propagator6", "propagator", "semi_implicit"
]


def _read_step(value: Any) -> float | Literal["auto"]:
    """Read the length of a step, s, or `auto`."""
    return "auto" if value == "auto" else read_real(value, low=0.0, open_ends=True)


def _read_block(value: Any) -> int | Literal["auto"]:
    """Read a number of rows, or `auto`."""
    return "auto" if value == "auto" else read_whole(value, low=1, high=10**9)


class NumericsSpec(StrictModel):
    """Integration of trajectories; the model recommends values for the fields that are left out."""

    method: Annotated[MethodName, Word()] = Field(
        default="auto",
        description="auto: the method that the model recommends, or else tsit5 (taylor where it is faster, "
        "rodas5p where the flow is stiff); "
        "tsit5: Runge-Kutta pair of orders 5 and 4 with step control by rtol and atol; taylor: Taylor series "
        "of an order that follows from rtol, for smooth flows to fine tolerances; rodas5p: Rosenbrock method "
        "of orders 5 and 4 with step control, for stiff flows of at most 30 variables; rk4: classic "
        "Runge-Kutta of order 4; propagator6: order 6 with long steps over stiff contacts, for flows that "
        "are linear between events; propagator: the same, with each transient resolved to 1e-6; "
        "semi_implicit: steps of fixed length with events inside them, for models that define such steps",
    )
    dt: Annotated[
        float | Literal["auto"],
        PlainValidator(checked(_read_step)),
        WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]}),
    ] = Field(
        default="auto",
        description="longest step, in s; auto: the longest step that is accurate for the parameters of each "
        "row. Longer steps are refused.",
    )
    rtol: Positive | None = Field(
        default=None,
        description="relative tolerance of a step's error, with step control; by default the model's",
    )
    atol: Positive | None = Field(
        default=None,
        description="absolute tolerance of a step's error, with step control; by default the model's",
    )
    precision: Annotated[Precision, Word()] = Field(
        default="float64",
        description="float64; or, if the model allows it, float32 or mixed: forces in float32, state "
        "and time in float64",
    )
    event_tolerance: Positive = Field(
        default=1e-12, description="error of an event's time, as a fraction of the nominal period"
    )

    def resolve(self, model: Model, *, contraction: bool) -> ResolvedNumerics:
        """Return the numerics with the model's recommendations filled in.

        Args:
            model: the model.
            contraction: as in `EngineChoice`.
        """
        dt = None if self.dt == "auto" else self.dt
        return Numerics(**{**self.model_dump(), "dt": dt, "contraction": contraction}).resolve(model)


class EngineChoice(StrictModel):
    """Engine and devices that compute the rows."""

    name: Annotated[RequestedEngine, Word()] = Field(
        default="auto",
        description="kernel: compiled scalar kernels, the fastest; xla: JAX's compiler; auto: kernel if the "
        "model and the machine allow it",
    )
    lanes: LaneCount | None = Field(
        default=None,
        description="trajectories advanced at once; by default chosen for the device. A kernel on a GPU"
        " advances fewer than asked for where more than 131 072 would need over 1 GiB",
    )
    block: Annotated[
        int | Literal["auto"],
        PlainValidator(checked(_read_block)),
        WithJsonSchema({"anyOf": [{"type": "integer"}, {"type": "string"}]}),
    ] = Field(
        default="auto",
        description="rows in a part of the table; auto: 1024 to 32 768, or more to make at most 500 parts",
    )
    devices: Count | None = Field(default=None, description="number of devices to use; by default all")
    contraction: Flag = Field(
        default=True,
        description="whether kernels may compute a product and a sum in one instruction, which is faster and "
        "rounds once; without it they round twice, equally on a CPU and a GPU",
    )


def check_numerics(model: Model, numerics: NumericsSpec, resolved: ResolvedNumerics) -> list[Diagnostic]:
    """Return errors about numerics that do not suit a model.

    Args:
        model: the model.
        numerics: the numerics as written in the job.
        resolved: the same, completed by the model's recommendations.
    """
    diagnostics = []
    if numerics.event_tolerance > LARGEST_EVENT_TOLERANCE:
        most = f"at most {LARGEST_EVENT_TOLERANCE:g} of a period"
        text = f"is {numerics.event_tolerance:g}, but must be {most}."
        diagnostics.append(Diagnostic(("numerics", "event_tolerance"), text))
    if numerics.precision not in model.precisions:
        allowed = ", ".join(model.precisions)
        text = f"is {numerics.precision}, which is not accurate enough for {model.name}. Allowed: {allowed}."
        diagnostics.append(Diagnostic(("numerics", "precision"), text))
    unfit = refusal(resolved.method, model, numerics.precision)
    if unfit is not None:
        diagnostics.append(Diagnostic(("numerics", "method"), unfit))
        return diagnostics
    steps = fixed_step_scheme(resolved.method, model)
    if resolved.dt is not None and steps is not None and steps.is_return_map:
        text = f"is set, but {model.name} is a map, which has no steps in time: remove it."
        diagnostics.append(Diagnostic(("numerics", "dt"), text))
    for name, tolerance in (("rtol", numerics.rtol), ("atol", numerics.atol)):
        if tolerance is not None and not resolved.adaptive:
            text = f"is set, but {resolved.method} has no step control by tolerances: remove it."
            diagnostics.append(Diagnostic(("numerics", name), text))
    return diagnostics


def suited_to_stiffness(design: Design, run: RunKind, numerics: ResolvedNumerics) -> ResolvedNumerics:
    """Return the numerics of a job that leaves the method open, with rodas5p if some row is stiff.

    A flow is stiff if some motion decays more than `STIFF` times in a nominal period, at the start of one of
    `MAX_STIFFNESS_ROWS` evenly spaced rows, with the least, the middle and the largest value of a parameter
    that the run moves. A method that the model recommends is kept.

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
    for place in run.extreme_places():
        if decay_per_period(model, design.with_moved(values, place), starts) > STIFF:
            return dataclasses.replace(numerics, method="rodas5p")
    return numerics
