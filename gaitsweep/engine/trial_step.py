"""A trial step: its end, its error, and the events and switches that may begin and end within it.

Step control decides whether it is accurate enough, and the lengths of the next steps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.carry import Carry, Flag, GuardFlags, Guards, Number, unlikely
from gaitsweep.engine.hidden_events import PROBES, guard_slopes, interpolated, may_hide, unresolved
from gaitsweep.engine.numerics import (
    DEFAULT_STEPS_PER_PERIOD,
    MIN_STEPS_PER_PERIOD,
    ORDER,
    ResolvedNumerics,
    tolerance_scale,
)
from gaitsweep.engine.solver.methods import METHODS, Method
from gaitsweep.engine.solver.taylor import Expansion, bends_back, first_zero, order_of
from gaitsweep.engine.switches import may_switch, switches_within

# The safety factor of a step, and the smallest factor by which a step that missed the tolerance is
# shortened.
SAFETY_FACTOR = 0.9
MIN_FACTOR = 0.2
# Binary digits of the power with which the error of a step changes its length.
_DIGITS = 7
# The smallest step, as a share of the longest, which is accepted with any error (a state that diverges is
# then reported as diverged).
MIN_STEP = 1e-9
# The first step of a trajectory, as a share of the longest: the time scale of the flow is unknown.
FIRST_STEP = 1e-3


@dataclasses.dataclass(frozen=True)
class StepLengths:
    """The upper bound of the next steps (`Carry.h_max`, s), and the next step `h` (s)."""

    h_max: Number
    h: Number


@dataclasses.dataclass(frozen=True)
class EventSearch:
    """The search for an event after a trial.

    Attributes:
        hit: whether a guard fired at the trial.
        land: whether the trial is the event.
        locating: whether an event is still being located.
        guess: the next trial of that location (s).
    """

    hit: Flag
    land: Flag
    locating: Flag
    guess: Number


def fitting_change(
    error: Rates, carry: Carry, trial: State, numerics: ResolvedNumerics, order: int
) -> Number:
    """The factor on a step with which its error would meet the tolerance, times SAFETY_FACTOR.

    It is at least SAFETY_FACTOR if the step itself meets the tolerance, and 0 if the error is NaN.

    Args:
        error: the estimated error of each field.
        carry: the trajectory before the step.
        trial: the state at the end of the step.
        numerics: the tolerances.
        order: the power of the step's length with which the error grows.
    """
    scale = tolerance_scale(carry.step_factor)
    worst = jnp.zeros_like(carry.t)
    for name, error_of_field in error.items():
        size = jnp.maximum(jnp.abs(getattr(carry.state, name)), jnp.abs(getattr(trial, name)))
        tolerance = scale * (numerics.atol + numerics.rtol * size)
        worst = jnp.maximum(worst, jnp.max(jnp.abs(error_of_field) / tolerance))
    worst = jax.lax.stop_gradient(worst)
    floor = (SAFETY_FACTOR / 10.0) ** order
    worst = jnp.maximum(worst, floor)
    # for tsit5 the fourth root instead of the fifth: two square roots are far cheaper, and the tolerance is
    # met as well
    change = SAFETY_FACTOR / _root(worst, order)
    return jnp.where(worst >= 0.0, change, 0.0)


def _root(value: Number, degree: int) -> Number:
    """The root of a degree by square roots, which are far cheaper than a logarithm.

    The power is the sum of up to seven binary digits of 1 / degree: exact for 4, 8 and 16, at most 11 %
    smaller for others up to 20.
    """
    root, power, left = jnp.ones_like(value), value, 1.0 / degree
    for digit in range(1, _DIGITS + 1):
        if left < 0.5**_DIGITS:
            break
        power = jnp.sqrt(power)
        if 0.5**digit <= left:
            root = root * power
            left -= 0.5**digit
    return root


def growing_step(method: Method, carry: Carry, search: EventSearch, *, still: Flag) -> StepLengths:
    """The lengths of the next steps of a method without step control, which grow after an event.

    Args:
        method: the method.
        carry: the trajectory before the attempt.
        search: the search for an event after it.
        still: whether the trial has zero length.
    """
    # a step shortened by a stop or an event does not limit the next step
    grown = jnp.minimum(carry.dt, method.growth * carry.h_max)
    first = method.first_step * carry.dt
    unchanged = search.hit | search.locating
    h_max = jnp.where(search.land | still, first, jnp.where(unchanged, carry.h_max, grown))
    next_h = jnp.where(search.land, 0.0, jnp.where(search.locating, search.guess, h_max))
    return StepLengths(h_max, next_h)


def controlled_step(
    method: Method, carry: Carry, search: EventSearch, *, h: Number, change: Number, failed: Flag
) -> StepLengths:
    """The lengths of the next steps of a method with step control.

    Args:
        method: the method.
        carry: the trajectory before the attempt.
        search: the search for an event after it.
        h: the length of the trial (s).
        change: its `fitting_change`.
        failed: whether it missed the tolerance.
    """
    dt = carry.dt
    shortest = MIN_STEP * dt
    first = jnp.where(carry.h_max > 0.0, method.first_step * carry.h_max, FIRST_STEP * dt)
    first = jnp.maximum(first, shortest)
    shorter = jnp.maximum(h * jnp.maximum(change, MIN_FACTOR), shortest)
    fitting = h * jnp.minimum(change, method.growth)
    # a step shortened by a stop or an event only shows that its length is accurate
    fitting = jnp.where(h < carry.h_max, jnp.maximum(carry.h_max, fitting), fitting)
    fitting = jnp.minimum(dt, jnp.maximum(fitting, shortest))
    h_max = jnp.where(search.hit | search.locating, carry.h_max, fitting)
    h_max = jnp.where(search.land, carry.h_max, jnp.where(h == 0.0, first, h_max))
    h_max = jnp.where(failed, shorter, h_max)
    next_h = jnp.where(failed, shorter, jnp.where(search.locating, search.guess, h_max))
    return StepLengths(h_max, jnp.where(search.land, 0.0, next_h))


# Steps shorter than this share of the nominal period do not end a chain of jumps.
CHAIN_STEP = 1e-9
# The longest step, as a share of the nominal period, in which the flow may switch.
SWITCH_STEP = 1e-7
# Where the parameters of a schedule are read for the end of a step that ends at a stop, as a share of it:
# before the value to which a schedule of steps changes there.
STEP_END = 1.0 - 1e-9

Flow = Callable[[Params, State], Rates]
Drive = Callable[[Params, Number], Params]


@dataclasses.dataclass(frozen=True)
class StepFunctions:
    """The functions of one step.

    Attributes:
        step: the step of `Method.step`: an `Estimate` if the method is adaptive, the function that returns an
            `Expansion` if it is a series, else a `Step`.
        flow: the rates at the beginning of the step.
        flow_after: the rates at its end.
    """

    step: Callable[..., Any]
    flow: Flow
    flow_after: Flow

    @classmethod
    def of(cls, model: HybridModel, numerics: ResolvedNumerics) -> StepFunctions:
        """The functions of a model and a method."""
        method = METHODS[numerics.method]
        assert method.step is not None
        step = method.step(model, order_of(numerics.rtol)) if method.series else method.step(model)
        return cls(step, model.flow, model.flow)


@dataclasses.dataclass(frozen=True)
class Scheme:
    """A hybrid model and its method, with all that is fixed while a trajectory advances.

    Attributes:
        model: the model.
        numerics: the method and its tolerances.
        functions: the functions of a step.
        drive: the parameters at a time (s); None if they are constant.
        sensitivities: whether forward-mode derivatives include those of event times.
    """

    model: HybridModel
    numerics: ResolvedNumerics
    functions: StepFunctions
    drive: Drive | None
    sensitivities: bool

    @property
    def method(self) -> Method:
        """The method of `numerics`."""
        return METHODS[self.numerics.method]

    @property
    def order(self) -> int:
        """The power of the step's length with which its error grows."""
        return order_of(self.numerics.rtol) if self.method.series else ORDER - 1

    @property
    def in_turn(self) -> bool:
        """Whether guards that fire in the same trial jump one at a time."""
        # independent jumps need their turns only for the derivative of each one's event time
        simultaneous = self.model.simultaneous
        return simultaneous == "in_turn" or (simultaneous == "independent" and self.sensitivities)


@dataclasses.dataclass(frozen=True)
class SeriesStep:
    """The polynomials of time along a trial of Taylor's method.

    Attributes:
        expansion: the solution.
        guards: the coefficients of the guards.
        bends: whether a guard may have more zeros within the trial than it shows.
        near_time: a time (s) within the trial that is before its event; 0 if it shows none.
        smooth: whether the flow does not switch, so that the polynomials hold throughout.
    """

    expansion: Expansion
    guards: list[Guards]
    bends: Flag
    near_time: Number
    smooth: bool


@dataclasses.dataclass(frozen=True)
class Trial:
    """A trial step.

    Attributes:
        h: its length (s).
        within: the parameters in its middle.
        at_end: the parameters at its end.
        end: the state at its end.
        change: the factor on the step with which its error would meet the tolerance; None for methods without
            step control.
        planned: its length (s) before it was shortened to an event.
        series: the polynomials along it, of Taylor's method.
    """

    h: Number
    within: Params
    at_end: Params
    end: State
    change: Number | None
    planned: Number
    series: SeriesStep | None = None


@dataclasses.dataclass(frozen=True)
class GuardsAtEnd:
    """The guards at the end of a trial.

    Attributes:
        values: their values.
        fired: which of them fire.
        speed: their time derivatives.
        rates: the rates of the flow there.
    """

    values: Guards
    fired: GuardFlags
    speed: Guards
    rates: Rates


@dataclasses.dataclass(frozen=True)
class Checks:
    """The reasons why a trial is tried again instead of accepted.

    Attributes:
        guards: the guards at its end.
        slopes: their time derivatives at its beginning.
        short: whether it is too short to end a chain of jumps.
        still: whether it has zero length.
        inaccurate: whether its error is above the tolerance.
        hidden: whether an event or a switch may begin and end within it.
        missed: whether it ends at an event of a guard's polynomial that the guard itself does not show.
        rejected: whether any of the last three holds.
    """

    guards: GuardsAtEnd
    slopes: Guards
    short: Flag
    still: Flag
    inaccurate: Flag
    hidden: Flag
    missed: Flag
    rejected: Flag


def try_step(scheme: Scheme, params: Params, carry: Carry, h: Number, finest: Number) -> Trial:
    """The trial of a step.

    Args:
        scheme: the model and its method.
        params: the parameters, or what the scheme's drive reads.
        carry: the trajectory before the step.
        h: the largest length of the step (s).
        finest: the finest tolerance on event times (s).
    """
    if scheme.method.series:
        return _try_series(scheme, params, carry, h, finest)
    within, at_end = _driven(scheme, params, carry, h)
    if not scheme.method.adaptive:
        end = scheme.functions.step(within, carry.state, h)
        return Trial(h, within, at_end, end, change=None, planned=h)
    end, error = scheme.functions.step(within, carry.state, h)
    change = fitting_change(error, carry, end, scheme.numerics, scheme.order)
    return Trial(h, within, at_end, end, change, planned=h)


def _driven(scheme: Scheme, params: Params, carry: Carry, h: Number) -> tuple[Params, Params]:
    """The parameters in the middle and at the end of a step of length `h` (s).

    Those at the end are those of the next step's beginning: an event that is located by others could happen
    again. Only at a stop may a schedule have changed.
    """
    drive = scheme.drive
    if drive is None:
        return params, params
    end = jnp.where(h < carry.stop - carry.t, h, h * STEP_END)
    return drive(params, carry.t + 0.5 * h), drive(params, carry.t + end)


def _try_series(scheme: Scheme, params: Params, carry: Carry, longest: Number, finest: Number) -> Trial:
    """The trial of a step of Taylor's method, which ends at its first event."""
    model = scheme.model
    smooth = not may_switch(model, _driven(scheme, params, carry, longest)[0], carry.state)
    # events are searched between few points of a step whose polynomials do not hold throughout
    few_points = carry.dt * (MIN_STEPS_PER_PERIOD / DEFAULT_STEPS_PER_PERIOD)
    planned = longest if smooth else jnp.minimum(longest, few_points)
    within, at_end = _driven(scheme, params, carry, planned)
    expansion: Expansion = scheme.functions.step(within, carry.state, longest)
    guards = expansion.along(lambda state: model.guards(within, state), carry.state)
    past_root = 0.5 * finest * jnp.exp2(2.0 * carry.trials)
    # the event of a ramp would have the parameters of another length
    root = first_zero(guards, planned) + past_root if scheme.drive is None else jnp.inf
    near_time = jnp.where(root < planned, jnp.maximum(root - 2.0 * past_root, 0.0), 0.0)
    h = jnp.minimum(planned, root)
    bends = bends_back(guards, h)
    end = expansion.at(carry.state, h)
    error = expansion.error(h, None if smooth else scheme.functions.flow_after(within, end))
    change = fitting_change(error, carry, end, scheme.numerics, scheme.order)
    series = SeriesStep(expansion, guards, bends, near_time, smooth)
    return Trial(h, within, at_end, end, change, planned, series)


def check_step(scheme: Scheme, carry: Carry, trial: Trial, going: Flag) -> Checks:
    """Compare a trial with the tolerance on its error, and look for events that its end does not show.

    Args:
        scheme: the model and its method.
        carry: the trajectory before the trial.
        trial: the trial.
        going: whether the trajectory does not wait for its recorder.
    """
    h = trial.h
    change = trial.change
    accurate = jnp.asarray(True)
    if change is not None:
        accurate = (change >= SAFETY_FACTOR) | (h <= MIN_STEP * carry.dt)
    guards, slopes, leaving = _guards_at_end(scheme, carry, trial)
    inaccurate = unlikely(going & ~accurate)
    short = unlikely(h <= CHAIN_STEP * carry.unit)
    hides = _may_hide(scheme, carry, trial, guards, slopes, leaving)
    hidden = unlikely(going & accurate & ~short & hides)
    # a guard that is above zero by its polynomial, and not by its value, is tried further past the root
    missed = scheme.method.series & unlikely(
        going & accurate & ~hidden & (h < trial.planned) & ~jnp.any(guards.fired)
    )
    return Checks(
        guards=guards,
        slopes=slopes,
        short=short,
        still=short & (h == 0.0),
        inaccurate=inaccurate,
        hidden=hidden,
        missed=missed,
        rejected=inaccurate | hidden | missed,
    )


def _guards_at_end(scheme: Scheme, carry: Carry, trial: Trial) -> tuple[GuardsAtEnd, Guards, Rates]:
    """The guards at the end of a trial, their time derivatives at its beginning, and the rates there."""
    model = scheme.model
    values = model.guards(trial.at_end, trial.end)
    leaving = scheme.functions.flow(trial.within, carry.state)
    arriving = scheme.functions.flow_after(trial.at_end, trial.end)
    slopes = guard_slopes(model, trial.within, carry.state, leaving)
    speed = guard_slopes(model, trial.at_end, trial.end, arriving)
    return GuardsAtEnd(values, values >= 0.0, speed, arriving), slopes, leaving


def _may_hide(
    scheme: Scheme, carry: Carry, trial: Trial, guards: GuardsAtEnd, slopes: Guards, leaving: Rates
) -> Flag:
    """Whether an event or a switch may begin and end within a trial."""
    model = scheme.model
    series = trial.series
    h = trial.h
    hides = may_hide(carry.near, slopes, guards.values, h)
    if not scheme.method.adaptive:
        return hides

    def inside(share: float) -> State:
        if series is not None:
            return series.expansion.at(carry.state, share * h)
        return interpolated(carry.state, leaving, trial.end, guards.rates, h, share)

    if series is not None and series.smooth:
        hides = series.bends
    else:
        probed = [model.guards(trial.within, inside(share)) for share in PROBES]
        hides = hides | unresolved(carry.near, slopes, guards.values, guards.speed, probed, h)
        if series is not None:
            hides = hides | series.bends
    ends = (carry.state, trial.end)
    end_rates = (leaving, guards.rates)
    shows, unseen = switches_within(scheme.functions.flow, trial.within, ends, end_rates, h, inside)
    return hides | ((h > SWITCH_STEP * carry.unit) & (shows | unseen))
