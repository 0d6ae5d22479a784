"""Sections `numerics` and `engine` of a job."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, PlainValidator, WithJsonSchema

from gaitsweep.contract import Model
from gaitsweep.engine.numerics import Numerics, ResolvedNumerics
from gaitsweep.engine.solver.methods import Precision
from gaitsweep.engine.sweep.sweep_spec import RequestedEngine
from gaitsweep.schema import former_names
from gaitsweep.schema.numbers import Count, Flag, LaneCount, Positive, Word, checked, read_real, read_whole
from gaitsweep.schema.strict_model import StrictModel

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

    method: Annotated[
        MethodName,
        Word(former_names.METHODS),
    ] = Field(
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
        default=None, description="trajectories advanced at once; by default chosen for the device"
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
