"""What a job does with each row (`run`), and by which numerics and engine."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, WithJsonSchema

from gaitsweep.contract import Model
from gaitsweep.engine.numerics import Numerics as EngineNumerics
from gaitsweep.kinds.numbers import (
    Count,
    CountOrZero,
    LaneCount,
    NotNegative,
    Positive,
    PositiveOrEach,
    Real,
    Refused,
    Text,
    checked,
    read_real,
    read_whole,
    word,
)

MOST_SAMPLES = 10_000_000  # of a row's trace
MOST_STAIRS = 10_000  # of a staircase
MOST_COARSE = 1024  # cells a side
# kinds of runs that may move a `parameter` along a `path`
MOVING = ("ramp", "staircase", "trace", "continuation")


class Part(BaseModel):
    """A part of a job: no field but its own, frozen, numbers possibly written as expressions."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _power_of_two(value: Any) -> int:
    whole = read_whole(value, low=2, high=MOST_COARSE)
    if whole & (whole - 1):
        below = 1 << (whole.bit_length() - 1)
        raise Refused(f"is {whole}, but takes a power of two; did you mean {below} or {2 * below}?")
    return whole


class Settle(Part):
    """Follow each row until its section's state stops moving, or repeats; one row a start."""

    REFINING: ClassVar[tuple[str, ...]] = ("refine", "over", "coarse")  # fields that say which rows are run

    kind: Literal["settle"] = Field(
        description="settle: until the section's state stops moving, or repeats every 2 to 8 crossings"
    )
    max_cycles: Count = Field(default=150, description="cycles after which a row is given up")
    tolerance: PositiveOrEach = Field(
        default=1e-3,
        description="change a cycle below which a row has settled: of angles in rad, of other observables as "
        "a share of their scale; one for all, or by the names of observables (the others keep 1e-3)",
    )
    max_time: Positive | None = Field(
        default=None, description="simulated time after which a row is given up, in s"
    )
    refine: Annotated[Literal["boundary"], word("boundary")] | None = Field(
        default=None,
        description="boundary: of a grid, only cells next to another gait are simulated; "
        "the others are inferred",
    )
    over: list[Text] | None = Field(
        default=None,
        min_length=1,
        description="axes that refine; all linspace and logspace axes of starts if not given",
    )
    coarse: Annotated[int, PlainValidator(checked(_power_of_two)), WithJsonSchema({"type": "integer"})] = (
        Field(
            default=8,
            description="cells between the first starts that refine simulates: a power of two; "
            "what is narrower may be missed",
        )
    )


class Hold(Part):
    """Follow each row for a given time; one row a start, read at its last section crossing."""

    kind: Literal["hold"] = Field(description="hold: a given time, each row read where it ends")
    duration: Positive = Field(description="simulated time, in s")


class Trace(Part):
    """Record the signals of each row at equal intervals of time, a parameter moving if one is named."""

    ALONG: ClassVar[tuple[str, ...]] = ("parameter", "path", "rate", "hold")  # fields that say how it moves

    kind: Literal["trace"] = Field(description="trace: a time series of each row")
    duration: Positive = Field(description="length of the recording, in s")
    every: Positive = Field(description="interval between samples, in s")
    after_cycles: CountOrZero = Field(
        default=0, description="section crossings to let pass first; t counts from there"
    )
    parameter: Text | None = Field(default=None, description="the model's parameter that moves meanwhile")
    path: list[Real] | None = Field(
        default=None, min_length=2, max_length=1000, description="values between which it moves, in order"
    )
    rate: Positive | None = Field(default=None, description="its speed, in its unit a second")
    hold: NotNegative = Field(default=0.0, description="time at the first value before it moves, in s")


class Ramp(Part):
    """Move one parameter slowly along a path and record every section crossing."""

    kind: Literal["ramp"] = Field(description="ramp: a parameter moved slowly, every crossing recorded")
    parameter: Text = Field(description="the model's parameter that moves")
    path: list[Real] = Field(
        min_length=2, max_length=1000, description="values between which it moves, in order"
    )
    rate: Positive = Field(description="its speed, in its unit a second")
    hold: NotNegative = Field(default=0.0, description="time at the first value before it moves, in s")


class ReturnMap(Part):
    """Record successive section values of each row."""

    kind: Literal["return_map"] = Field(description="return_map: successive section values")
    crossings: Count = Field(description="section crossings to record")
    after_cycles: CountOrZero = Field(default=0, description="section crossings to let pass first")


class Staircase(Part):
    """Move one parameter in stairs along a path, hold it on each, and record the end of each."""

    kind: Literal["staircase"] = Field(
        description="staircase: a parameter moved in stairs and held on each, the end of each recorded"
    )
    parameter: Text = Field(description="the model's parameter that moves")
    path: list[Real] = Field(
        min_length=2,
        max_length=1000,
        description="values between which it moves, in order; each is held once",
    )
    step: Positive = Field(
        description="largest distance between stairs, in its unit; each pass has equal stairs"
    )
    hold: Positive = Field(description="time on each stair, in s")
    first_hold: Positive | None = Field(
        default=None, description="time on the first stair, in s; as on the others if not given"
    )
    tolerance: PositiveOrEach = Field(
        default=1e-3,
        description="change a cycle below which a stair has settled: of angles in rad, of other observables "
        "as a share of their scale; one for all, or by the names of observables (the others keep 1e-3)",
    )


class Continuation(Part):
    """Follow the fixed points of each row's return map along one parameter, stable or not."""

    kind: Literal["continuation"] = Field(
        description="continuation: the steady gaits along a parameter, stable and unstable, around folds"
    )
    parameter: Text = Field(description="the model's parameter along which a branch is followed")
    path: list[Real] = Field(
        min_length=2, max_length=2, description="where the branch starts, and the other end of its range"
    )
    settle: CountOrZero = Field(
        default=100, description="cycles before the search for the first fixed point begins"
    )
    fix: list[Text] = Field(
        default=[], description="conserved quantities to hold as they are after `settle` cycles"
    )
    step: Positive = Field(
        default=0.02, description="length of the first step, as a share of the range where only that moves"
    )
    longest: Positive = Field(default=0.08, description="length of the longest step")
    shortest: Positive = Field(
        default=1e-4, description="length below which a step is given up, and a leap tried"
    )
    most: Count = Field(default=300, description="points of a branch")


def moved_by(run: object) -> str | None:
    """The parameter that a run moves, where there is one."""
    return run.parameter if isinstance(run, Ramp | Staircase | Trace | Continuation) else None


Run = Annotated[
    Settle | Hold | Trace | Ramp | ReturnMap | Staircase | Continuation, Field(discriminator="kind")
]


METHOD_NAMES = ("auto", "tsit5", "rk4", "stabilised", "exact", "semi_implicit")


def _step(value: Any) -> float | str:
    return "auto" if value == "auto" else read_real(value, low=0.0, open_ends=True)


class Numerics(Part):
    """How a trajectory is integrated; what is left out is what the model recommends."""

    method: Annotated[
        Literal["auto", "tsit5", "rk4", "stabilised", "exact", "semi_implicit"], word(*METHOD_NAMES)
    ] = Field(
        default="auto",
        description="auto: what the model recommends; tsit5: Runge-Kutta pair of orders 5 and 4, whose steps "
        "follow from rtol and atol; rk4: classic Runge-Kutta, 4th order; for flows that are linear between "
        "events, stabilised: long steps over stiff contacts, 6th order; exact: the same to 1e-6 of any "
        "transient; semi_implicit: steps of fixed length with events inside them, for models that have such "
        "steps",
    )
    dt: Annotated[
        float | Literal["auto"],
        PlainValidator(checked(_step)),
        WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]}),
    ] = Field(
        default="auto",
        description="longest step, in s; auto: as long as is right for the parameters of each row. A longer "
        "one is refused.",
    )
    rtol: Positive | None = Field(
        default=None, description="relative tolerance of a step's error, for tsit5; the model's if not given"
    )
    atol: Positive | None = Field(
        default=None, description="absolute tolerance of a step's error, for tsit5; the model's if not given"
    )
    precision: Annotated[Literal["float64", "float32", "mixed"], word("float64", "float32", "mixed")] = Field(
        default="float64",
        description="float64; where a model allows it, float32, or mixed: forces in float32, the state and "
        "time in float64",
    )
    event_tolerance: Positive = Field(default=1e-12, description="error of an event's time, in s")

    def engine(self, model: Model) -> EngineNumerics:
        """The engine's numerics for a model, the method and the tolerances resolved."""
        fields = self.model_dump()
        return EngineNumerics(**{**fields, "dt": None if self.dt == "auto" else self.dt}).of(model)


class EngineChoice(Part):
    """On what the rows run."""

    name: Annotated[Literal["auto", "xla", "kernel"], word("auto", "xla", "kernel")] = Field(
        default="auto",
        description="kernel: compiled scalar kernels, the fastest; xla: JAX's own compiler; auto: kernel "
        "where the model and the machine allow it",
    )
    lanes: LaneCount | None = Field(
        default=None, description="trajectories advanced at once; chosen for the device if not given"
    )
    block: Count = Field(default=1024, description="rows of one part of the table")
    devices: Count | None = Field(default=None, description="devices to use; all if not given")
