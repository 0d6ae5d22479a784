"""One return of a trajectory to the Poincare section.

`crossing_of` is the whole return as a JAX function with forward-mode derivatives, by XLA or a kernel.

By classic Runge-Kutta with located events, a return evaluates the flow once in each of its attempts: the
arithmetic is that of an attempt of `rk4`, split into stages: the rates at two mid-points, at the end, and at
the trial state, where the event logic follows. The program is a fifth as long, which matters when it is
differentiated and compiled as straight-line code. No evaluation is repeated: the rates at an accepted trial
are those at the next state, and after a rejected trial the rates at the state are kept.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable
from functools import partial
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaitsweep.contract import HybridModel, Model, Params, Rates, State
from gaitsweep.engine.advance import advance
from gaitsweep.engine.carry import Carry, Halt, is_stalled, select, start
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.devices import default_platform
from gaitsweep.engine.numerics import ResolvedNumerics, step_of
from gaitsweep.engine.recorders.recorder import ATTEMPTS_PER_STEP, variables_of
from gaitsweep.engine.solver.methods import derivative_refusal, euler_update
from gaitsweep.engine.trial_step import StepFunctions
from gaitsweep.errors import ArgumentError
from gaitsweep.status import ResultCode

# Nominal periods within which a return has to end.
MAX_PERIODS = 4.0

Returned = tuple[Float[Array, ""], State, Int[Array, ""]]  # the time (s), the state, and the `ReturnStatus`
Crossing = Callable[[Params, State], Returned]
ReturnEngine = Literal["auto", "kernel", "quick", "xla"]


# Stages of the next evaluation: `FIRST` to `LAST` are those after the rates at the state, then the trial
# follows.
FIRST = 1
LAST = 3
TRIAL = 4


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Stages:
    """The progress of an attempt.

    Attributes:
        stage: the stage of the next evaluation of the flow.
        at: the continuous fields of that evaluation.
        first: the rates at the state.
        total: the weighted sum of the rates so far.
    """

    stage: Int[Array, ""]
    at: Rates
    first: Rates
    total: Rates


Pair = tuple[Carry, Stages]


def begin_stages(model: HybridModel, params: Params, carry: Carry) -> Pair:
    """The carry and stages of a new trajectory, whose first attempt has zero length.

    Args:
        model: the model.
        params: its parameters.
        carry: the trajectory at its start.
    """
    at = {name: getattr(carry.state, name) for name in jax.eval_shape(model.flow, params, carry.state)}
    unknown = {name: jnp.zeros_like(value) for name, value in at.items()}
    return carry, Stages(jnp.full_like(carry.halt, TRIAL), at, unknown, unknown)


def stagewise(model: HybridModel, numerics: ResolvedNumerics) -> Callable[[Params, Pair], Pair]:
    """The function of one stage; forward-mode derivatives include those of located event times.

    Args:
        model: the model.
        numerics: the tolerances of the method rk4.
    """

    def evaluate(params: Params, pair: Pair) -> Pair:
        carry, stages = pair
        stage_state = dataclasses.replace(carry.state, **stages.at)
        rates = model.flow(params, stage_state)
        tried = stages.stage == TRIAL
        functions = StepFunctions(lambda *_: stage_state, lambda *_: stages.first, lambda *_: rates)
        conclude = advance(model, numerics, sensitivities=True, functions=functions)
        fired = jnp.any(model.guards(params, stage_state) >= 0.0)
        after = conclude(params, carry)
        # a step may be rejected without an event: it is tried again from the same state
        accepted = tried & ~fired & ((after.t > carry.t) | (carry.h == 0.0))
        carry = select(tried, after, carry)

        first = select(accepted, rates, stages.first)
        weight = jnp.where(stages.stage == LAST, 1.0, 2.0)
        summed = {name: total + weight * rates[name] for name, total in stages.total.items()}
        total = select(tried, first, summed)
        next_stage = jnp.where(tried, FIRST, stages.stage + 1)
        h = jnp.minimum(carry.h, jnp.maximum(carry.stop - carry.t, 0.0))
        share = jnp.where(next_stage == TRIAL, 1.0 / 6.0, jnp.where(next_stage == LAST, 1.0, 0.5))
        along = select(next_stage == TRIAL, total, select(tried, first, rates))
        # the attempt after a jump has zero length, and its rates are not known yet
        jumped = tried & (carry.h == 0.0)
        along = {name: jnp.where(jumped, 0.0, rate) for name, rate in along.items()}
        next_state = euler_update(carry.state, along, h * share)
        at = {name: getattr(next_state, name) for name in stages.at}
        stage = jnp.where(jumped, TRIAL, next_stage).astype(stages.stage.dtype)
        return carry, Stages(stage, at, first, total)

    return evaluate


class ReturnStatus(ResultCode):
    """The result code of a return, with its sentence.

    Tables of edge states have the numbers: existing numbers must not change, and new ones are added at the
    end.
    """

    crossed = 0, "The section was crossed."
    late = 1, "No crossing came within four nominal periods."
    stalled = 2, "Events followed each other at one instant without end."
    lost = 3, "A state variable became NaN or infinite, or the model's period is."
    fell = 4, "The body fell: the model's function `failed` became true."
    elsewhere = 5, "The section was crossed in a way that its coordinates do not have."
    step_limit = 6, "The return needed more steps than its limit, which follows from its longest step."


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ReturnState:
    """A trajectory between two crossings.

    Attributes:
        carry: its state of integration.
        stages: the stages of the current step if it is computed stage by stage, else ().
        limit: the largest number of attempts.
    """

    carry: Carry
    stages: Stages | tuple[()]
    limit: Float[Array, ""]


class PoincareReturn:
    """The functions of one return; each engine iterates them differently.

    With located events, forward-mode derivatives are exact through all events, event times included. With
    fixed steps no event is located, and `differentiable` is False.

    Args:
        model: the model.
        numerics: the method and its tolerances.
        derivatives: whether derivatives are asked for; without them an attempt is that of a row of a run.
    """

    def __init__(self, model: Model, numerics: ResolvedNumerics, *, derivatives: bool = True) -> None:
        self.model = model
        self.numerics = numerics
        self.refusal = derivative_refusal(numerics.method, model)
        self.differentiable = derivatives and self.refusal is None
        self._begin: Callable[[Params, Carry], tuple[Carry, Any]]
        self._attempt: Callable[[Params, Any], tuple[Carry, Any]]
        if self.differentiable and numerics.method == "rk4":
            assert isinstance(model, HybridModel)
            self._begin = partial(begin_stages, model)
            self._attempt = stagewise(model, numerics)
        else:
            step = advance(model, numerics, sensitivities=self.differentiable)
            self._begin = lambda params, carry: (carry, ())
            self._attempt = lambda params, pair: (step(params, pair[0]), ())

    def begin(self, params: Params, state: State) -> ReturnState:
        """The trajectory that starts from a state just after the jump of a crossing.

        Args:
            params: the parameters of the model.
            state: the state.
        """
        # the step length depends on the parameters, but the result does not depend on the step length
        dt = self.numerics.factor * jax.lax.stop_gradient(step_of(self.model, self.numerics, params))
        stop = MAX_PERIODS * self.model.period(params)
        carry = start(self.model, params, state, dt=dt, stop=stop, step_factor=self.numerics.factor)
        limit = ATTEMPTS_PER_STEP * (carry.stop / dt * self.numerics.steps_in_longest + 1000.0)
        limit = jnp.where(limit < jnp.inf, limit, 0.0)  # also NaN, which no number of attempts exceeds
        return ReturnState(*self._begin(params, carry), limit)

    def attempt(self, params: Params, trajectory: ReturnState) -> ReturnState:
        """The trajectory after one more attempt, or one more stage of an attempt.

        Args:
            params: the parameters of the model.
            trajectory: the trajectory.
        """
        return ReturnState(*self._attempt(params, (trajectory.carry, trajectory.stages)), trajectory.limit)

    def ended(self, trajectory: ReturnState) -> Bool[Array, ""]:
        """Whether the return has ended, by a crossing or otherwise."""
        carry = trajectory.carry
        return (carry.halt != Halt.GOING) | is_stalled(self.model, carry) | self._is_over_limit(trajectory)

    def _is_over_limit(self, trajectory: ReturnState) -> Bool[Array, ""]:
        return trajectory.carry.attempts > trajectory.limit

    def status(self, params: Params, trajectory: ReturnState) -> Int[Array, ""]:
        """The `ReturnStatus` of a return that has ended.

        Args:
            params: the parameters of the model.
            trajectory: the trajectory.
        """
        carry = trajectory.carry
        numbers = [carry.t, carry.unit, *variables_of(self.model, params, carry.state)]
        sound = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in numbers]))
        status = jnp.where(self._is_over_limit(trajectory), ReturnStatus.step_limit, ReturnStatus.late)
        status = jnp.where(carry.halt == Halt.FELL, ReturnStatus.fell, status)
        # a stalled trajectory halts as one that fell
        status = jnp.where(is_stalled(self.model, carry), ReturnStatus.stalled, status)
        status = jnp.where(carry.halt == Halt.CROSSING, ReturnStatus.crossed, status)
        return jnp.where(sound, status, ReturnStatus.lost).astype(jnp.int32)


def crossing(model: Model, numerics: ResolvedNumerics, engine: ReturnEngine = "auto") -> Crossing:
    """The function `(params, state) -> (t, state, status)` up to the next crossing.

    `t` is the time that it takes (s), `state` the state just after the crossing's jump, `status` the
    `ReturnStatus`. The function has forward-mode derivatives (`jax.jvp`, `jax.jacfwd`).

    Args:
        model: the model.
        numerics: the method and its tolerances. With fixed steps no event is located: the state is a
            discontinuous function of its start, and derivatives are refused.
        engine: kernel, xla, or auto: kernel where the model and the machine allow it; quick is a kernel for
            few returns, which is compiled in less time and runs longer. Where derivatives are refused, xla.

    Raises:
        ArgumentError: the engine is unknown.
        UnsupportedError: a kernel is required, and derivatives are not refused, but the model uses operations
            that no kernel has.
    """
    if engine not in get_args(ReturnEngine):
        raise ArgumentError(f"engine is {engine}. Allowed: {', '.join(get_args(ReturnEngine))}.")
    functions = PoincareReturn(model, numerics)

    def by_xla(params: Params, state: State) -> Returned:
        end = jax.lax.while_loop(
            lambda trajectory: ~functions.ended(trajectory),
            lambda trajectory: functions.attempt(params, trajectory),
            functions.begin(params, state),
        )
        return end.carry.t, end.carry.state, functions.status(params, end)

    if functions.refusal is not None:
        return_map = f"The return map of {model.name} by {numerics.method}"
        return _without_derivative(by_xla, f"{return_map} has no derivative: {functions.refusal}")
    if engine == "xla" or (engine == "auto" and default_platform() != "cpu"):
        return by_xla
    return _by_kernel(functions, None if engine == "kernel" else by_xla, quick=engine == "quick")


# `crossing` of a model whose content is known, kept.
crossing_of = cached_by_content(maxsize=16)(crossing)


def _by_kernel(crossing: PoincareReturn, substitute: Crossing | None, *, quick: bool) -> Crossing:
    """The return by a kernel, which is compiled for each structure of parameters and states.

    Args:
        crossing: the functions of the return.
        substitute: the function to use where there is no kernel; None: that is an error.
        quick: compile in less time to code that runs longer.
    """
    returns: dict[Hashable, Crossing] = {}

    def by_kernel(params: Params, state: State) -> Returned:
        from gaitsweep.engine.kernel.poincare_returns import KernelReturns
        from gaitsweep.engine.kernel.trace import UnsupportedError

        shapes = jax.tree.map(
            lambda leaf: jax.ShapeDtypeStruct(jnp.shape(leaf), jnp.result_type(leaf)), (params, state)
        )
        key = jax.tree.structure(shapes), tuple(jax.tree.leaves(shapes))
        if key not in returns:
            try:
                returns[key] = KernelReturns(crossing, *shapes, quick=quick)
            except UnsupportedError:
                if substitute is None:
                    raise
                returns[key] = substitute
        return returns[key](params, state)

    return by_kernel


def _without_derivative(crossing: Crossing, refusal: str) -> Crossing:
    """The same function, whose derivative raises an ArgumentError with the sentence `refusal`."""

    @jax.custom_jvp
    def run(params: Params, state: State) -> Returned:
        return crossing(params, state)

    @run.defjvp
    def _refused(primals: Any, tangents: Any) -> Any:
        raise ArgumentError(refusal)

    return run
