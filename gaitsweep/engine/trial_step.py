"""A trial step: its end, its error, and the events and switches that may begin and end within it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.carry import Carry, Flag, GuardFlags, Guards, Number, unlikely
from gaitsweep.engine.hidden_events import PROBES, guard_slopes, interpolated, may_hide, unresolved
from gaitsweep.engine.numerics import DEFAULT_STEPS_PER_PERIOD, MIN_STEPS_PER_PERIOD, ORDER, ResolvedNumerics
from gaitsweep.engine.solver.methods import METHODS, Method, Step
from gaitsweep.engine.solver.taylor import Expansion, bends_back, first_zero, order_of
from gaitsweep.engine.step_control import fitting_change, is_accurate
from gaitsweep.engine.switches import may_switch, switches_within

# Steps shorter than this share of the nominal period do not end a chain of jumps.
CHAIN_STEP = 1e-9
# The longest step, as a share of the nominal period, in which the flow may switch.
SWITCH_STEP = 1e-7
# Where the parameters of a schedule are read for the end of a step, as a share of it: before the value to
# which a schedule of steps changes at the end.
STEP_END = 1.0 - 1e-9

Flow = Callable[[Params, State], Rates]
Drive = Callable[[Params, Number], Params]


@dataclasses.dataclass(frozen=True)
class Precomputed:
    """A step and the rates at its beginning and end, of an attempt that only has to decide on them."""

    step: Step
    flow: Flow
    flow_after: Flow


@dataclasses.dataclass(frozen=True)
class Scheme:
    """A hybrid model and its method, with all that is fixed while a trajectory advances.

    Attributes:
        model: the model.
        numerics: the tolerances.
        method: the method of `numerics`.
        order: the power of the step's length with which its error grows.
        step: the model's step: an `Estimate` if the method is adaptive, the function that returns an
            `Expansion` if it is a series, else a `Step`.
        flow: the rates at the beginning of a step.
        flow_after: the rates at its end.
        drive: the parameters at a time (s); None if they are constant.
        sensitivities: whether forward-mode derivatives include those of event times.
        in_turn: whether guards that fire in the same trial jump one at a time.
    """

    model: HybridModel
    numerics: ResolvedNumerics
    method: Method
    order: int
    step: Callable[..., Any]
    flow: Flow
    flow_after: Flow
    drive: Drive | None
    sensitivities: bool
    in_turn: bool

    @classmethod
    def of(
        cls,
        model: HybridModel,
        numerics: ResolvedNumerics,
        *,
        drive: Drive | None,
        sensitivities: bool,
        precomputed: Precomputed | None,
    ) -> Scheme:
        """The scheme of an attempt.

        Args:
            model: the model.
            numerics: the method and its tolerances.
            drive: as of `Scheme`.
            sensitivities: as of `Scheme`.
            precomputed: the step and its rates, if they are computed beforehand.
        """
        method = METHODS[numerics.method]
        assert method.step is not None
        order = order_of(numerics.rtol) if method.series else ORDER - 1
        if precomputed is None:
            step = method.step(model, order) if method.series else method.step(model)
            precomputed = Precomputed(step, model.flow, model.flow)
        # independent jumps need their turns only for the derivative of each one's event time
        in_turn = model.simultaneous == "in_turn" or (model.simultaneous == "independent" and sensitivities)
        return cls(
            model=model,
            numerics=numerics,
            method=method,
            order=order,
            step=precomputed.step,
            flow=precomputed.flow,
            flow_after=precomputed.flow_after,
            drive=drive,
            sensitivities=sensitivities,
            in_turn=in_turn,
        )


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
        short: whether it is too short to end a chain of jumps.
        still: whether it has zero length.
        inaccurate: whether its error is above the tolerance.
        hidden: whether an event or a switch may begin and end within it.
        missed: whether it ends at an event of a guard's polynomial that the guard itself does not show.
        rejected: whether any of the last three holds.
    """

    guards: GuardsAtEnd
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
    drive = scheme.drive
    within = params if drive is None else drive(params, carry.t + 0.5 * h)
    at_end = params if drive is None else drive(params, carry.t + h * STEP_END)
    if scheme.method.series:
        return _try_series(scheme, carry, h, finest, within, at_end)
    if not scheme.method.adaptive:
        end = scheme.step(within, carry.state, h)
        return Trial(h, within, at_end, end, change=None, planned=h)
    end, error = scheme.step(within, carry.state, h)
    change = fitting_change(error, carry, end, scheme.numerics, scheme.order)
    return Trial(h, within, at_end, end, change, planned=h)


def _try_series(
    scheme: Scheme, carry: Carry, longest: Number, finest: Number, within: Params, at_end: Params
) -> Trial:
    """The trial of a step of Taylor's method, which ends at its first event."""
    model = scheme.model
    expansion: Expansion = scheme.step(within, carry.state, longest)
    smooth = not may_switch(model, within, carry.state)
    # events are searched between few points of a step whose polynomials do not hold throughout
    few_points = carry.dt * (MIN_STEPS_PER_PERIOD / DEFAULT_STEPS_PER_PERIOD)
    planned = longest if smooth else jnp.minimum(longest, few_points)
    guards = expansion.along(lambda state: model.guards(within, state), carry.state)
    past_root = 0.5 * finest * jnp.exp2(2.0 * carry.trials)
    # the event of a ramp would have the parameters of another length
    root = first_zero(guards, planned) + past_root if scheme.drive is None else jnp.inf
    near_time = jnp.where(root < planned, jnp.maximum(root - 2.0 * past_root, 0.0), 0.0)
    h = jnp.minimum(planned, root)
    bends = bends_back(guards, h)
    end = expansion.at(carry.state, h)
    error = expansion.error(h, None if smooth else scheme.flow_after(at_end, end))
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
    accurate = jnp.asarray(True) if change is None else is_accurate(h, change, carry.dt)
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
    leaving = scheme.flow(trial.within, carry.state)
    arriving = scheme.flow_after(trial.at_end, trial.end)
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
    shows, unseen = switches_within(scheme.flow, trial.within, ends, end_rates, h, inside)
    return hides | ((h > SWITCH_STEP * carry.unit) & (shows | unseen))
