"""One trajectory, one straight-line attempt: try a step, look at the guards, accept, shorten or jump.

The same function serves every engine. All decisions are selects, so that it can be vmapped or printed as
a scalar kernel, and each trajectory has a time and a step of its own. `event_location` describes how an event
is located.

Guards that fire in the same trial jump one at a time, in the order of the guards, each in an attempt of zero
length. After each jump the others are looked at again: one that is below zero by then does not jump. Each
has its own derivative of the event time. Guards that a jump causes follow, again in their order. A crossing
of the section halts the trajectory when the guards that fired in the same trial have jumped. Guards of a
model that says so jump together (`HybridModel.simultaneous`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, cast

import jax.numpy as jnp

from gaitsweep.contract import FixedStepDynamics, HybridModel, Model, Params, Rates, State
from gaitsweep.engine.carry import Carry, Flag, GuardFlags, Guards, Halt, Number, likely, select, unlikely
from gaitsweep.engine.event_location import (
    BISECTION_AFTER,
    MAX_OVERSHOOT,
    MIN_OVERSHOOT,
    PATIENT_TRIALS,
    Bracket,
    first_of,
    first_to_fire,
    implicit_event_time,
    next_bracket,
    next_trial,
    secant_root,
)
from gaitsweep.engine.event_stall import longest_chain
from gaitsweep.engine.hidden_events import PROBES, guard_slopes, interpolated, may_hide, unresolved
from gaitsweep.engine.numerics import DEFAULT_STEPS_PER_PERIOD, MIN_STEPS_PER_PERIOD, ORDER, ResolvedNumerics
from gaitsweep.engine.solver import METHODS, Method, Step, euler_update, fixed_step_scheme
from gaitsweep.engine.solver.taylor import Expansion, bends_back, first_zero, order_of, polynomial
from gaitsweep.engine.step_control import (
    MIN_STEP,
    SAFETY_FACTOR,
    StepLengths,
    controlled_step,
    fitting_change,
    growing_step,
)
from gaitsweep.engine.switches import may_bend, may_switch, switches_within

# Steps shorter than this share of the nominal period do not end a chain of jumps.
CHAIN_STEP = 1e-9
# The longest step, as a share of the nominal period, in which the flow may switch.
SWITCH_STEP = 1e-7
# Where the parameters of a schedule are read for the end of a step, as a share of it.
STEP_END = 1.0 - 1e-9

Advance = Callable[[Params, Carry], Carry]
Flow = Callable[[Params, State], Rates]
Drive = Callable[[Params, Number], Params]


@dataclasses.dataclass(frozen=True)
class Precomputed:
    """A step and the rates at its beginning and end, of an attempt that only has to decide on them."""

    step: Step
    flow: Flow
    flow_after: Flow


def advance(
    model: Model,
    numerics: ResolvedNumerics,
    *,
    drive: Drive | None = None,
    sensitivities: bool = False,
    precomputed: Precomputed | None = None,
) -> Advance:
    """The function of one attempt, `(params, carry) -> carry`.

    Args:
        model: a hybrid or a stepped model.
        numerics: step, method and tolerances.
        drive: for a ramp, the parameters at a time (s): a step's flow has those at its middle, its guards and
            jumps those at its end.
        sensitivities: include the derivative of event times in forward-mode derivatives: each event time is
            corrected to first order, t_e - g/g', by a term of value zero.
        precomputed: the step and its rates, if they are computed beforehand.

    Raises:
        ValueError: sensitivities are asked for, and the method takes steps of fixed length.
    """
    steps = fixed_step_scheme(numerics.method, model)
    if steps is None:
        hybrid = cast(HybridModel, model)
        scheme = _scheme(hybrid, numerics, drive, precomputed, sensitivities=sensitivities)
        return lambda params, carry: _attempt(scheme, params, carry)
    if sensitivities and not steps.is_return_map:
        fixed = f"{numerics.method} takes steps of fixed length"
        raise ValueError(f"Derivatives need located events, but {fixed}: use rk4.")
    return _advance_stepped(steps, numerics, drive)


@dataclasses.dataclass(frozen=True)
class _Scheme:
    """A hybrid model and its method, with all that is fixed while a trajectory advances.

    `flow` and `flow_after` give the rates at the beginning and at the end of a step. `in_turn`: guards that
    fire in the same trial jump one at a time.
    """

    model: HybridModel
    numerics: ResolvedNumerics
    method: Method
    order: int
    step: Callable[..., Any]  # an `Estimate`, or of Taylor's method the function that returns an `Expansion`
    flow: Flow
    flow_after: Flow
    drive: Drive | None
    sensitivities: bool
    in_turn: bool


@dataclasses.dataclass(frozen=True)
class _Trial:
    """A trial step of `h` (s), which ends at the state `end`.

    `within` and `at_end` are the parameters in its middle and at its end; `change` is the factor on the step
    with which its error would meet the tolerance, None for methods without step control.

    Of Taylor's method: `expansion` is the solution, `polynomials` are the guards along it, `bends` is whether
    one of them may have more zeros than it shows; `planned` is the step (s) before it was shortened to an
    event, and `near_time` a time (s) within it that is before the event. `smooth`: the model does not switch.
    """

    h: Number
    within: Params
    at_end: Params
    end: State
    change: Number | None
    planned: Number
    expansion: Expansion | None
    polynomials: list[Guards]
    bends: Flag
    near_time: Number
    smooth: bool


@dataclasses.dataclass(frozen=True)
class _GuardsAtEnd:
    """The guards at the end of a trial: their values, which of them fire, and their time derivatives.

    `rates` are those of the flow there.
    """

    values: Guards
    fired: GuardFlags
    speed: Guards
    rates: Rates


@dataclasses.dataclass(frozen=True)
class _Checks:
    """The reasons why a trial is tried again instead of accepted, and whether any of them holds (`rejected`).

    `inaccurate`: its error is above the tolerance; `hidden`: an event or a switch may begin and end within
    it; `missed`: it ends at an event of a guard's polynomial that the guard itself does not show. `short`:
    the trial does not end a chain of jumps; `still`: it has zero length.
    """

    guards: _GuardsAtEnd
    short: Flag
    still: Flag
    inaccurate: Flag
    hidden: Flag
    missed: Flag
    rejected: Flag


@dataclasses.dataclass(frozen=True)
class _Attempt:
    """An attempt up to the decision on its trial.

    `carry` is the trajectory before it, `room` the time (s) until the next stop, `tolerance` that of the
    event time (s). `going`: the trajectory does not wait for its recorder. `hit`: a guard fires; `accepted`:
    the trajectory moves on without an event.

    Of guards that jump one at a time: `pending` are those that fired in the same trial as the last jump and
    have not jumped yet, `waiting` is whether one of them jumps now, `owed` whether a crossing of the section
    at this instant has not been recorded, and `leaves` whether it is recorded before anything else happens.
    """

    carry: Carry
    room: Number
    tolerance: Number
    trial: _Trial
    checks: _Checks
    going: Flag
    hit: Flag
    accepted: Flag
    pending: GuardFlags
    waiting: Flag
    owed: Flag
    leaves: Flag


@dataclasses.dataclass(frozen=True)
class _Location:
    """The place of a trial relative to the event that it is to locate.

    `below` and `above` are the distances from zero, at the ends of the bracket, of the guard that fires
    first. `land`: the trial is the event; `early`: it is nearer to the root than the jump may be; `astray`:
    the secant is wrong about the root.
    """

    below: Number
    above: Number
    land: Flag
    early: Flag
    astray: Flag


@dataclasses.dataclass(frozen=True)
class _Jump:
    """The guards that jump at the end of a trial, and the effect if the trial is their event.

    `before` and `after` are the states around the jump, `t` its time (s), `shift` the time (s) of the jump
    after a crossing that has not been recorded (`Carry.shift`). `crossed`: the section has been crossed at
    this instant; `closed`: the trajectory halts there.
    """

    before: State
    after: State
    t: Number
    shift: Number
    crossed: Flag
    closed: Flag


def _scheme(
    model: HybridModel,
    numerics: ResolvedNumerics,
    drive: Drive | None,
    precomputed: Precomputed | None,
    *,
    sensitivities: bool,
) -> _Scheme:
    """The scheme of an attempt; arguments as of `advance`."""
    method = METHODS[numerics.method]
    assert method.step is not None
    # independent jumps need their turns only for the derivative of each one's event time
    in_turn = model.simultaneous == "in_turn" or (model.simultaneous == "independent" and sensitivities)
    order = order_of(numerics.rtol) if method.series else ORDER - 1
    if precomputed is None:
        step = method.step(model, order) if method.series else method.step(model)
        precomputed = Precomputed(step, model.flow, model.flow)
    return _Scheme(
        model,
        numerics,
        method,
        order,
        precomputed.step,
        precomputed.flow,
        precomputed.flow_after,
        drive,
        sensitivities,
        in_turn,
    )


def _attempt(scheme: _Scheme, params: Params, carry: Carry) -> Carry:
    """The trajectory after one more attempt."""
    attempt = _decide(scheme, params, carry)
    location = _locate(scheme, attempt)
    # in turn: one guard jumps in an attempt
    due = jnp.where(attempt.waiting, attempt.pending, attempt.checks.guards.fired)
    jumping = first_of(due) if scheme.in_turn else attempt.checks.guards.fired
    others = due & ~jumping
    bracket, lengths = _next_step(scheme, attempt, location, jumping, others)
    jump = _jump(scheme, attempt, location, jumping, others)
    return _carry_after(scheme, attempt, location, bracket, lengths, jump)


def _decide(scheme: _Scheme, params: Params, carry: Carry) -> _Attempt:
    """Try a step, and decide whether it is accepted, rejected, or ends at an event."""
    finest, tolerance = _event_tolerances(scheme.numerics, carry)
    going = likely(carry.halt == Halt.GOING)
    room = jnp.maximum(carry.stop - carry.t, 0.0)
    longest = jnp.where(going, jnp.minimum(carry.h, room), 0.0)
    trial = _try_step(scheme, params, carry, longest, finest)
    checks = _check_step(scheme, carry, trial, going)
    fired = checks.guards.fired
    if scheme.in_turn:
        pending = fired & (carry.far_guards == jnp.inf)
        waiting = checks.still & jnp.any(pending)
        # a crossing is recorded before the events that its jumps cause
        owed = unlikely(carry.closed)
    else:
        pending = jnp.zeros_like(fired)
        waiting = jnp.asarray(False)
        owed = jnp.asarray(False)
    leaves = owed & ~waiting
    hit = unlikely(going & jnp.any(fired) & ~checks.rejected & ~leaves)
    accepted = going & ~hit & ~checks.rejected
    return _Attempt(
        carry, room, tolerance, trial, checks, going, hit, accepted, pending, waiting, owed, leaves
    )


def _event_tolerances(numerics: ResolvedNumerics, carry: Carry) -> tuple[Number, Number]:
    """The finest tolerance on event times (s), and that of the present trial."""
    dtype = carry.t.dtype
    # a tolerance below the resolution of time would never be met in float32
    finest = carry.unit * jnp.asarray(max(numerics.event_tolerance, 16 * float(jnp.finfo(dtype).eps)), dtype)
    # if a guard rises so slowly that rounding hides the event, no bracket of that width fires: after two
    # rounds of location the tolerance grows
    impatience = jnp.maximum(carry.trials - PATIENT_TRIALS, 0).astype(dtype)
    return finest, finest * (1.0 + impatience * impatience)


def _try_step(scheme: _Scheme, params: Params, carry: Carry, h: Number, finest: Number) -> _Trial:
    """The trial of a step of at most `h` (s); `finest` is the finest tolerance on event times (s)."""
    model = scheme.model
    drive = scheme.drive
    method = scheme.method
    within = params if drive is None else drive(params, carry.t + 0.5 * h)
    # before the value to which a schedule of steps changes at the end
    at_end = params if drive is None else drive(params, carry.t + h * STEP_END)
    expansion = None
    smooth = False
    polynomials = []
    planned = h
    bends = jnp.asarray(False)
    near_time = jnp.zeros_like(h)
    if method.series:
        expansion = cast(Expansion, scheme.step(within, carry.state, h))
        smooth = not may_switch(model, within, carry.state)
        # events are searched between few points of a step whose polynomials do not hold throughout
        h = h if smooth else jnp.minimum(h, carry.dt * (MIN_STEPS_PER_PERIOD / DEFAULT_STEPS_PER_PERIOD))
        polynomials = expansion.along(lambda s: model.guards(within, s), carry.state)
        # a step ends at its first event; that of a ramp would have the parameters of another length
        planned = h
        past_root = 0.5 * finest * jnp.exp2(2.0 * carry.trials)
        root = first_zero(polynomials, h) + past_root if drive is None else jnp.inf
        near_time = jnp.where(root < h, jnp.maximum(root - 2.0 * past_root, 0.0), 0.0)
        h = jnp.minimum(h, root)
        bends = bends_back(polynomials, h)
        end = expansion.at(carry.state, h)
        error = expansion.error(h, None if smooth else scheme.flow_after(at_end, end))
    elif method.adaptive:
        end, error = scheme.step(within, carry.state, h)
    else:
        end = scheme.step(within, carry.state, h)
        error = None
    change = None if error is None else fitting_change(error, carry, end, scheme.numerics, scheme.order)
    return _Trial(h, within, at_end, end, change, planned, expansion, polynomials, bends, near_time, smooth)


def _check_step(scheme: _Scheme, carry: Carry, trial: _Trial, going: Flag) -> _Checks:
    """Compare a trial with the tolerance on its error, and look for events that its end does not show."""
    h = trial.h
    change = trial.change
    accurate = jnp.asarray(True)
    if change is not None:
        accurate = (change >= SAFETY_FACTOR) | (h <= MIN_STEP * carry.dt)
    values = scheme.model.guards(trial.at_end, trial.end)
    fired = values >= 0.0
    inaccurate = unlikely(going & ~accurate)
    short = unlikely(h <= CHAIN_STEP * carry.unit)
    still = short & (h == 0.0)
    guards, hides = _look_inside(scheme, carry, trial, values, fired)
    hidden = unlikely(going & accurate & ~short & hides)
    # a guard that is above zero by its polynomial, and not by its value, is tried further past the root
    missed = scheme.method.series & unlikely(
        going & accurate & ~hidden & (h < trial.planned) & ~jnp.any(fired)
    )
    return _Checks(guards, short, still, inaccurate, hidden, missed, inaccurate | hidden | missed)


def _look_inside(
    scheme: _Scheme, carry: Carry, trial: _Trial, values: Guards, fired: GuardFlags
) -> tuple[_GuardsAtEnd, Flag]:
    """The guards at the end of a trial, and whether an event or a switch may begin and end within it."""
    model = scheme.model
    flow = scheme.flow
    h = trial.h
    leaving = flow(trial.within, carry.state)
    arriving = scheme.flow_after(trial.at_end, trial.end)
    slopes = guard_slopes(model, trial.within, carry.state, leaving)
    speed = guard_slopes(model, trial.at_end, trial.end, arriving)
    guards = _GuardsAtEnd(values, fired, speed, arriving)
    hides = may_hide(carry.near, slopes, values, h)
    if not scheme.method.adaptive:
        return guards, hides

    def inside(share: float) -> State:
        if trial.expansion is not None:
            return trial.expansion.at(carry.state, share * h)
        return interpolated(carry.state, leaving, trial.end, arriving, h, share)

    if not trial.smooth:
        probed = [model.guards(trial.within, inside(share)) for share in PROBES]
        hides = hides | unresolved(carry.near, slopes, values, speed, probed, h)
    if trial.expansion is not None:
        hides = trial.bends if trial.smooth else hides | trial.bends
    ends = (carry.state, trial.end)
    end_rates = (leaving, arriving)
    shows, unseen = switches_within(flow, trial.within, ends, end_rates, h, inside)
    return guards, hides | ((h > SWITCH_STEP * carry.unit) & (shows | unseen))


def _locate(scheme: _Scheme, attempt: _Attempt) -> _Location:
    """The place of a trial relative to an event, if a guard fired there."""
    carry = attempt.carry
    trial = attempt.trial
    guards = attempt.checks.guards
    hit = attempt.hit
    h = trial.h
    values = guards.values
    tolerance = attempt.tolerance
    # the guard that fires first, below zero at the near end of the bracket and above it at the far one
    below, above = first_to_fire(jnp.where(hit, carry.near, values), jnp.where(hit, values, carry.far_guards))
    overshoot = h - h * secant_root(below, above)
    if trial.expansion is not None:
        # the secant of a short bracket, which every guard that fired has entered below zero
        entering = polynomial(trial.polynomials, trial.near_time)
        brackets = hit & (trial.near_time > 0.0) & jnp.all(~guards.fired | (entering < 0.0))
        of_bracket = (h - trial.near_time) * (1.0 - secant_root(*first_to_fire(entering, values)))
        overshoot = jnp.where(brackets, of_bracket, overshoot)
    # of a smooth guard, the secant through so short a bracket has its slope
    past = jnp.asarray(False)
    if may_bend(scheme.model.guards, trial.at_end, trial.end, guards.rates):
        past = jnp.any(guards.fired & (values > MAX_OVERSHOOT * tolerance * guards.speed))
    # once the bracket is as short as the tolerance, the rates need not be trusted
    astray = hit & (overshoot <= tolerance) & past & (h > tolerance)
    near_root = hit & (overshoot < MIN_OVERSHOOT * tolerance)
    early = near_root & ~attempt.checks.still & ~astray & (h < attempt.room)
    early = early & (carry.trials <= BISECTION_AFTER) & (h < carry.far)
    land = hit & (overshoot <= tolerance) & ~astray & ~early
    return _Location(below, above, land, early, astray)


def _next_step(
    scheme: _Scheme, attempt: _Attempt, location: _Location, jumping: GuardFlags, others: GuardFlags
) -> tuple[Bracket, StepLengths]:
    """The bracket of an event after an attempt, and the lengths of the next steps.

    Args:
        scheme, attempt, location: the attempt so far.
        jumping: the guards that jump if the trial is the event.
        others: the guards that jump at the same instant, after them.
    """
    carry = attempt.carry
    trial = attempt.trial
    checks = attempt.checks
    hit = attempt.hit
    h = trial.h
    land = location.land
    early = location.early
    still = checks.still
    keeps = hit & (jumping | ~still)
    bracket = next_bracket(
        carry, h, checks.guards.values, accepted=attempt.accepted, hit=hit, land=land, keeps=keeps
    )
    far_guards = jnp.where(land & ~still & others, jnp.inf, bracket.far_guards)
    trials = jnp.where(location.astray, jnp.maximum(bracket.trials, BISECTION_AFTER + 1), bracket.trials)
    bracket = dataclasses.replace(bracket, far_guards=far_guards, trials=trials)
    guess = next_trial(bracket, location.below, location.above, attempt.tolerance)
    # the trial is past the root by rounding: the next one is past it by half the tolerance
    further = jnp.minimum(h + 0.5 * attempt.tolerance, carry.far)
    bracket = dataclasses.replace(bracket, far=jnp.where(early, further, bracket.far))
    guess = jnp.where(early, jnp.minimum(bracket.far, attempt.room), guess)
    locating = bracket.far < jnp.inf
    if trial.change is None:
        lengths = growing_step(
            scheme.method, carry, land=land, still=still, hit=hit, locating=locating, guess=guess
        )
    else:
        lengths = controlled_step(
            scheme.method,
            carry,
            h,
            trial.change,
            failed=checks.inaccurate,
            land=land,
            hit=hit,
            locating=locating,
            guess=guess,
        )
    # an event that may begin and end within the step is searched in its first half
    h_max = jnp.where(checks.hidden, carry.h_max, lengths.h_max)
    next_h = jnp.where(checks.hidden, 0.5 * h, lengths.h)
    h_max = jnp.where(checks.missed, carry.h_max, h_max)
    next_h = jnp.where(checks.missed, trial.planned, next_h)
    bracket = dataclasses.replace(bracket, trials=jnp.where(checks.missed, carry.trials + 1, bracket.trials))
    # an event that a jump caused follows the crossing at the same instant
    return bracket, StepLengths(h_max, jnp.where(attempt.leaves, 0.0, next_h))


def _jump(
    scheme: _Scheme, attempt: _Attempt, location: _Location, jumping: GuardFlags, others: GuardFlags
) -> _Jump:
    """The jump at the end of a trial, which counts if the trial is the event; see `_next_step`."""
    carry = attempt.carry
    trial = attempt.trial
    guards = attempt.checks.guards
    still = attempt.checks.still
    land = location.land
    owed = attempt.owed
    leaves = attempt.leaves
    remaining = jnp.any(others) & (attempt.waiting | ~still)
    end = trial.end
    shift = carry.shift
    t = carry.t + trial.h
    if scheme.sensitivities:
        # an event caused by a jump has no root: it happens at the time of that jump
        with_root = (still & attempt.pending) | ((carry.near < 0.0) & (trial.h > 0.0))
        rooted = first_of(jumping & with_root) & land
        end, later = implicit_event_time(trial.end, guards.rates, guards.values, guards.speed, rooted)
        # a crossing is read at its own time
        end = euler_update(end, guards.rates, jnp.where(leaves, -shift, 0.0))
        t = t + later - jnp.where(leaves, shift, 0.0)
        shift = jnp.where(leaves, 0.0, shift + jnp.where(owed, later, 0.0))
    after = scheme.model.jump(trial.at_end, end, jumping)
    crossed = owed | (land & scheme.model.section(trial.at_end, trial.end, jumping))
    # at its own time, which needs the rates after the last jump, if other guards have jumped since
    closed = crossed & ((land & ~remaining & ~owed) | leaves)
    return _Jump(end, after, t, shift, crossed, closed)


def _carry_after(
    scheme: _Scheme,
    attempt: _Attempt,
    location: _Location,
    bracket: Bracket,
    lengths: StepLengths,
    jump: _Jump,
) -> Carry:
    """The trajectory after an attempt, with the reason to halt if there is one."""
    carry = attempt.carry
    trial = attempt.trial
    checks = attempt.checks
    going = attempt.going
    accepted = attempt.accepted
    land = location.land
    timed = unlikely(accepted & (trial.h >= attempt.room) & ~attempt.leaves)
    before = jnp.where(checks.short, carry.chain, 0)
    chain = jnp.where(land, before + 1, jnp.where(accepted, before, carry.chain))
    halt = jnp.where(jump.closed, Halt.CROSSING, jnp.where(timed, Halt.TIME, Halt.GOING))
    if scheme.method.adaptive:
        # many cycles can pass between two polls of the recorder, so a fall is tested after every step
        moves = accepted | land
        fell = moves & scheme.model.failed(trial.at_end, select(land, jump.after, jump.before))
        halt = jnp.where(fell, Halt.FELL, halt)
    stuck = land & (chain > longest_chain(scheme.model, checks.guards.values))
    halt = jnp.where(stuck, Halt.FELL, halt).astype(carry.halt.dtype)
    # a waiting lane, or one whose step is rejected, keeps its state
    return dataclasses.replace(
        carry,
        state=select(accepted | land, select(land, jump.after, jump.before), carry.state),
        t=jnp.where(timed, carry.stop, jnp.where(accepted | land, jump.t, carry.t)),
        h=jnp.where(going, lengths.h, carry.h),
        h_max=jnp.where(going, lengths.h_max, carry.h_max),
        chain=jnp.where(going, chain, carry.chain),
        attempts=jnp.where(going, carry.attempts + 1, carry.attempts),
        closed=jnp.where(going, jump.crossed & ~jump.closed, carry.closed)
        if scheme.in_turn
        else carry.closed,
        shift=jump.shift,
        halt=jnp.where(going, halt, carry.halt),
        **vars(bracket),
    )


def _advance_stepped(model: FixedStepDynamics, numerics: ResolvedNumerics, drive: Drive | None) -> Advance:
    """The attempt of a model in steps of fixed length: one step, with events at its end."""

    def attempt(params: Params, carry: Carry) -> Carry:
        dt = carry.dt
        going = carry.halt == Halt.GOING
        # a simulator's step cannot be shortened, so a stop is at the nearest end of a step
        timed = carry.stop - carry.t <= 0.5 * dt
        params_within = params if drive is None else drive(params, carry.t + 0.5 * dt)
        length = jnp.asarray(dt, numerics.step_dtype)
        factor = (carry.step_factor,) if model.stochastic else ()
        trial = model.step(params_within, carry.state, length, *factor)
        fired = model.events(params_within, carry.state, trial)
        hit = jnp.any(fired)
        closed = hit & model.section(params_within, trial, fired)
        stepped = dataclasses.replace(
            carry,
            state=select(hit, model.jump(params_within, trial, fired), trial),
            t=carry.t + dt,
            attempts=carry.attempts + 1,
            halt=jnp.where(closed, Halt.CROSSING, Halt.GOING).astype(carry.halt.dtype),
        )
        waiting = dataclasses.replace(carry, halt=jnp.full_like(carry.halt, Halt.TIME))
        moved = select(timed, waiting, stepped)
        return select(going, moved, carry)

    return attempt
