"""The numerics of a run: the integration method, its tolerances, and the longest step.

A model recommends its numerics (`Model.recommended`), and the longest step follows from a row's parameters.
These are the defaults of a job.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TypeVar, get_args

import jax
import jax.numpy as jnp

from gaitsweep import near_miss
from gaitsweep.contract import HybridModel, Model, Params
from gaitsweep.engine.carry import Number
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.solver.methods import METHODS, Precision, fixed_step_scheme
from gaitsweep.engine.solver.taylor import lacking_recurrence
from gaitsweep.engine.stored_traces import shapes_of, stored
from gaitsweep.engine.switches import ROOTS, may_switch, moving_operations
from gaitsweep.errors import ArgumentError

_Factor = TypeVar("_Factor", float, jax.Array)

# The name, among a row's initial conditions, of the factor on its steps: 1, or less if a row is repeated to
# test how its results depend on the step. No name of a model has a dot. An input of its own would give the
# compiled kernels other arguments.
STEP_FACTOR = "numerics.share"
# Order of the local error in the step, for methods with step control.
ORDER = 5
# The recommended share of the longest accurate step.
RECOMMENDED_SHARE = 0.85
# Number of adaptive steps in the longest step beyond which a row has too many steps.
MAX_ADAPTIVE_STEPS = 64.0
# Fewest steps in a nominal period: the default for adaptive methods, so that few events begin and end inside
# a step (`hidden_events`), and the limit for a step that a job sets.
DEFAULT_STEPS_PER_PERIOD = 32.0
MIN_STEPS_PER_PERIOD = 8.0
# Relative tolerance, and functions in the flow, with which taylor is faster than tsit5 (docs/performance.md).
FINE_TOLERANCE = 1e-10
_CIRCULAR = {"sin", "cos"}


@dataclasses.dataclass(frozen=True)
class Numerics:
    """The numerics that a job asks for; None or auto stands for the model's recommendation.

    Attributes:
        dt: the longest step (s).
        method: one of `METHODS`.
        precision: the dtype of states and times; mixed: they are float64, and a step's length is passed to
            the model as float32, so that it may compute forces in float32.
        event_tolerance: the tolerance on event times, as a share of the nominal period.
        rtol, atol: the relative and absolute tolerances on the local error, for methods with step control.
        contraction: whether a kernel may compute a product and a sum in one instruction, which rounds once.
    """

    dt: float | None = None
    method: str = "auto"
    precision: Precision = "float64"
    event_tolerance: float = 1.0e-12
    rtol: float | None = None
    atol: float | None = None
    contraction: bool = True

    def resolve(self, model: Model) -> ResolvedNumerics:
        """Complete the numerics by the recommendations of a model.

        Raises:
            ArgumentError: the method or the precision is unknown, or the step or a tolerance is not a
                number above 0.
        """
        recommended = model.recommended
        rtol = recommended.rtol if self.rtol is None else self.rtol
        method = recommended.method if self.method == "auto" else self.method
        if method == "auto":
            fine = rtol <= FINE_TOLERANCE and self.precision == "float64"
            method = "taylor" if fine and taylor_is_faster(model) else "tsit5"
        if method not in METHODS:
            raise ArgumentError(f"numerics.method is {method}{near_miss.suggestion(method, METHODS)}")
        if self.precision not in get_args(Precision):
            near = near_miss.suggestion(self.precision, get_args(Precision))
            raise ArgumentError(f"numerics.precision is {self.precision}{near}")
        atol = recommended.atol if self.atol is None else self.atol
        positive = {"dt": self.dt, "event_tolerance": self.event_tolerance, "rtol": rtol, "atol": atol}
        for name, value in positive.items():
            if value is not None and not 0.0 < value < math.inf:
                raise ArgumentError(f"numerics.{name} is {value:g}, but must be a number above 0.")
        return ResolvedNumerics(**{**vars(self), "method": method, "rtol": rtol, "atol": atol})


@cached_by_content(maxsize=64)
def taylor_is_faster(model: Model) -> bool:
    """Whether taylor is faster than tsit5 to fine tolerances.

    It is for flows that do not switch and have sines or cosines, which its recurrences compute once a step,
    and no roots of what moves; all operations need a recurrence.
    """
    if not isinstance(model, HybridModel) or model.host_parameters or lacking_recurrence(model):
        return False
    return stored("taylor_is_faster", model, (), lambda: _moves_smoothly_in_circles(model))


def _moves_smoothly_in_circles(model: HybridModel) -> bool:
    """Whether a flow does not switch, has a moving sine or cosine, and no root of what moves."""
    # the programs of the flow and the guards are traced with shapes, without values
    params, state = shapes_of(model)
    operations = moving_operations(model, params, state)
    if _CIRCULAR.isdisjoint(operations) or not ROOTS.isdisjoint(operations):
        return False
    return not may_switch(model, params, state)


@dataclasses.dataclass(frozen=True)
class ResolvedNumerics:
    """The numerics of runs of one model, with nothing left to the model; other attributes as of `Numerics`.

    Attributes:
        dt: the longest step (s) of all rows; None: that of each row follows from its parameters (`step_of`).
        factor: the factor on all steps, at most 1; tolerances become finer accordingly.
    """

    dt: float | None
    method: str
    precision: Precision
    event_tolerance: float
    rtol: float
    atol: float
    contraction: bool
    factor: float = 1.0

    def refined(self, factor: float) -> ResolvedNumerics:
        """The same with steps that are shorter by a further factor."""
        return dataclasses.replace(self, factor=factor * self.factor)

    @property
    def adaptive(self) -> bool:
        """Whether the method has step control."""
        return METHODS[self.method].adaptive

    @property
    def steps_in_longest(self) -> float:
        """Steps that the limit on attempts allows in each longest step."""
        return MAX_ADAPTIVE_STEPS if self.adaptive else 1.0

    @property
    def dtype(self) -> str:
        """The dtype of values, states and times."""
        return "float64" if self.precision == "mixed" else self.precision

    @property
    def step_dtype(self) -> str:
        """The dtype of the step that is passed to a stepped model."""
        return "float32" if self.precision == "mixed" else self.precision


def longest_step(model: Model, method: str, params: Params) -> Number | None:
    """The longest accurate step (s) of a method with these parameters; None if it is unknown.

    Args:
        model: the model.
        method: a name of `METHODS`.
        params: its parameters.

    Raises:
        ArgumentError: the method needs a flow, but the model has only steps.
    """
    steps = fixed_step_scheme(method, model)
    if steps is not None:
        return steps.longest_step(params)
    assert isinstance(model, HybridModel)  # another model has only its own steps
    if METHODS[method].adaptive:
        return model.period(params) / MIN_STEPS_PER_PERIOD
    modes = model.fast_modes(params)
    if modes is None:
        return None
    rates, damping = modes
    ratios, limits = zip(*METHODS[method].limits, strict=True)
    allowed = jnp.interp(damping, jnp.asarray(ratios), jnp.asarray(limits))
    # even if all motions are slow, a step has to be short compared with a cycle
    return jnp.minimum(jnp.min(allowed / rates), model.period(params) / MIN_STEPS_PER_PERIOD)


def recommended_step(model: Model, numerics: ResolvedNumerics, params: Params) -> Number | None:
    """The longest step (s) of a row, from the numerics or else from the recommendation of its model.

    Args:
        model: the model.
        numerics: its numerics.
        params: the parameters of the row.

    Returns:
        The step, or None if neither is known.

    Raises:
        ArgumentError: as for `longest_step`.
    """
    if numerics.dt is not None:
        return jnp.full_like(model.period(params), numerics.dt)
    longest = longest_step(model, numerics.method, params)
    takes_longest = METHODS[numerics.method].series or fixed_step_scheme(numerics.method, model) is not None
    if longest is None or takes_longest:
        return longest
    if numerics.adaptive:
        return longest * (MIN_STEPS_PER_PERIOD / DEFAULT_STEPS_PER_PERIOD)
    return RECOMMENDED_SHARE * longest


def step_of(model: Model, numerics: ResolvedNumerics, params: Params) -> Number:
    """The `recommended_step` (s).

    Args:
        model: the model.
        numerics: its numerics.
        params: the parameters of the row.

    Raises:
        ArgumentError: as for `longest_step`.
        ValueError: neither the numerics nor the model determine it.
    """
    dt = recommended_step(model, numerics, params)
    if dt is None:
        raise ValueError(unknown_step(model, numerics.method))
    return dt


def unknown_step(model: Model, method: str) -> str:
    """The error message for a step that neither the numerics nor the model determine."""
    return f"{model.name} does not recommend a step length for {method}: set numerics.dt."


def tolerance_scale(step_factor: _Factor) -> _Factor:
    """The factor on the tolerances of a row with this factor on its steps: 1/32 for half the step."""
    return step_factor**ORDER
