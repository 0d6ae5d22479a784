"""One trajectory, one straight-line attempt: try a step, look at the guards, accept, shorten or jump.

The same function serves every engine. All decisions are selects, so that it can be vmapped or printed as
a scalar kernel, and each trajectory has a time and a step of its own. `trial_step` tries the step and checks
it, and `event_location` describes how an event is located.

Guards that fire in the same trial jump one at a time, in the order of the guards, each in an attempt of zero
length. After each jump the others are looked at again: one that is below zero by then does not jump. Each
has its own derivative of the event time. Guards that a jump causes follow, again in their order. A crossing
of the section halts the trajectory when the guards that fired in the same trial have jumped. Guards of a
model that says so jump together (`HybridModel.simultaneous`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import cast

import jax.numpy as jnp

from gaitsweep.contract import FixedStepDynamics, HybridModel, Model, Params, State
from gaitsweep.engine.carry import (
    Carry,
    Flag,
    GuardFlags,
    Halt,
    Number,
    likely,
    longest_chain,
    select,
    unlikely,
)
from gaitsweep.engine.event_location import (
    BISECTION_AFTER,
    MAX_OVERSHOOT,
    MIN_OVERSHOOT,
    PATIENT_TRIALS,
    Bracket,
    Rise,
    cubic_root,
    first_of,
    first_to_fire,
    implicit_event_time,
    next_bracket,
    next_trial,
    secant_root,
)
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.solver.methods import euler_update, fixed_step_scheme
from gaitsweep.engine.solver.taylor import polynomial
from gaitsweep.engine.switches import may_bend
from gaitsweep.engine.trial_step import (
    Checks,
    Drive,
    EventSearch,
    Scheme,
    StepFunctions,
    StepLengths,
    Trial,
    check_step,
    controlled_step,
    growing_step,
    try_step,
)
from gaitsweep.errors import ArgumentError

Advance = Callable[[Params, Carry], Carry]


def advance(
    model: Model,
    numerics: ResolvedNumerics,
    *,
    drive: Drive | None = None,
    sensitivities: bool = False,
    functions: StepFunctions | None = None,
) -> Advance:
    """The function of one attempt, `(params, carry) -> carry`.

    Args:
        model: the model.
        numerics: step, method and tolerances.
        drive: for a ramp, the parameters at a time (s): a step's flow has those at its middle, its guards and
            jumps those at its end; a step of fixed length, with its events, has those at its middle.
        sensitivities: include the derivative of event times in forward-mode derivatives: each event time is
            corrected to first order, t_e - g/g', by a term of value zero.
        functions: those of a step, by default of the model and the method.

    Raises:
        ArgumentError: sensitivities are requested, and the method takes steps of fixed length.
    """
    steps = fixed_step_scheme(numerics.method, model)
    if steps is None:
        hybrid = cast(HybridModel, model)  # another model has only its own steps
        scheme = Scheme(
            hybrid, numerics, functions or StepFunctions.of(hybrid, numerics), drive, sensitivities
        )
        return lambda params, carry: _attempt(scheme, params, carry)
    if sensitivities and not steps.is_return_map:
        fixed = f"{numerics.method} takes steps of fixed length"
        raise ArgumentError(f"Derivatives need located events, but {fixed}: use rk4.")
    return _advance_stepped(steps, numerics, drive)


@dataclasses.dataclass(frozen=True)
class _Attempt:
    """An attempt up to the decision on its trial.

    Attributes:
        carry: the trajectory before it.
        room: the time (s) until the next stop.
        tolerance: that of the event time (s).
        trial: its trial.
        checks: the reasons why the trial is tried again.
        going: whether the trajectory does not wait for its recorder.
        hit: whether a guard fires.
        accepted: whether the trajectory moves on without an event.
        pending: of guards that jump one at a time, those that fired in the same trial as the last jump and
            have not jumped yet.
        waiting: whether one of these jumps now.
        owed: whether a crossing of the section at this instant has not been recorded.
        leaves: whether it is recorded before anything else happens.
    """

    carry: Carry
    room: Number
    tolerance: Number
    trial: Trial
    checks: Checks
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

    Attributes:
        rise: the guard that fires first, at both ends of the bracket.
        land: whether the trial is the event.
        early: whether it is nearer to the root than the jump may be.
        astray: whether the secant is wrong about the root.
        jumping: the guards that jump if the trial is the event.
        others: the guards that jump at the same instant, after them.
    """

    rise: Rise
    land: Flag
    early: Flag
    astray: Flag
    jumping: GuardFlags
    others: GuardFlags


@dataclasses.dataclass(frozen=True)
class _Jump:
    """The guards that jump at the end of a trial, and the effect if the trial is their event.

    Attributes:
        before: the state before the jump.
        after: the state after it.
        t: its time (s).
        shift: its time (s) after a crossing that has not been recorded (`Carry.shift`).
        crossed: whether the section has been crossed at this instant.
        closed: whether the trajectory halts there.
    """

    before: State
    after: State
    t: Number
    shift: Number
    crossed: Flag
    closed: Flag


def _attempt(scheme: Scheme, params: Params, carry: Carry) -> Carry:
    """The trajectory after one more attempt."""
    attempt = _decide(scheme, params, carry)
    location = _locate(scheme, attempt)
    bracket, lengths = _next_step(scheme, attempt, location)
    jump = _jump(scheme, attempt, location)
    return _carry_after(scheme, attempt, location, bracket, lengths, jump)


def _decide(scheme: Scheme, params: Params, carry: Carry) -> _Attempt:
    """Try a step, and decide whether it is accepted, rejected, or ends at an event."""
    finest, tolerance = _event_tolerances(scheme.numerics, carry)
    going = likely(carry.halt == Halt.GOING)
    room = jnp.maximum(carry.stop - carry.t, 0.0)
    longest = jnp.where(going, jnp.minimum(carry.h, room), 0.0)
    trial = try_step(scheme, params, carry, longest, finest)
    checks = check_step(scheme, carry, trial, going)
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
        carry=carry,
        room=room,
        tolerance=tolerance,
        trial=trial,
        checks=checks,
        going=going,
        hit=hit,
        accepted=accepted,
        pending=pending,
        waiting=waiting,
        owed=owed,
        leaves=leaves,
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


def _locate(scheme: Scheme, attempt: _Attempt) -> _Location:
    """The place of a trial relative to an event, if a guard fired there."""
    carry = attempt.carry
    trial = attempt.trial
    guards = attempt.checks.guards
    hit = attempt.hit
    h = trial.h
    tolerance = attempt.tolerance
    # the guard that fires first, below zero at the near end of the bracket and above it at the far one
    near = jnp.where(hit, carry.near, guards.values)
    far = jnp.where(hit, guards.values, carry.far_guards)
    speed = guards.speed
    slopes = jnp.where(hit, attempt.checks.slopes, speed), jnp.where(hit, speed, 0.0)
    rise = first_to_fire(near, far, slopes)
    overshoot = _overshoot(attempt, rise)
    # of a smooth guard, the secant through so short a bracket has its slope
    past = jnp.asarray(False)
    if may_bend(scheme.model.guards, trial.at_end, trial.end, guards.rates):
        past = jnp.any(guards.fired & (guards.values > MAX_OVERSHOOT * tolerance * guards.speed))
    # once the bracket is as short as the tolerance, the rates need not be trusted
    astray = hit & (overshoot <= tolerance) & past & (h > tolerance)
    near_root = hit & (overshoot < MIN_OVERSHOOT * tolerance)
    early = near_root & ~attempt.checks.still & ~astray & (h < attempt.room)
    early = early & (carry.trials <= BISECTION_AFTER) & (h < carry.far)
    land = hit & (overshoot <= tolerance) & ~astray & ~early
    due = jnp.where(attempt.waiting, attempt.pending, guards.fired)
    # in turn: one guard jumps in an attempt
    jumping = first_of(due) if scheme.in_turn else guards.fired
    return _Location(rise, land, early, astray, jumping, due & ~jumping)


def _overshoot(attempt: _Attempt, rise: Rise) -> Number:
    """The time (s) of a trial past the event, by the cubic or the secant through its bracket."""
    trial = attempt.trial
    guards = attempt.checks.guards
    h = trial.h
    overshoot = h - h * secant_root(rise.below, rise.above)
    if trial.series is None:
        root, is_increasing = cubic_root(rise, h)
        return jnp.where(attempt.hit & is_increasing, h - root, overshoot)
    # the secant of a short bracket, which every guard that fired has entered below zero
    near_time = trial.series.near_time
    entering = polynomial(trial.series.guards, near_time)
    is_bracket = attempt.hit & (near_time > 0.0) & jnp.all(~guards.fired | (entering < 0.0))
    entered = first_to_fire(entering, guards.values)
    of_bracket = (h - near_time) * (1.0 - secant_root(entered.below, entered.above))
    return jnp.where(is_bracket, of_bracket, overshoot)


def _next_step(scheme: Scheme, attempt: _Attempt, location: _Location) -> tuple[Bracket, StepLengths]:
    """The bracket of an event after an attempt, and the lengths of the next steps."""
    carry = attempt.carry
    trial = attempt.trial
    checks = attempt.checks
    bracket, guess = _next_bracket(attempt, location)
    search = EventSearch(attempt.hit, location.land, bracket.far < jnp.inf, guess)
    if trial.change is None:
        lengths = growing_step(scheme.method, carry, search, still=checks.still)
    else:
        lengths = controlled_step(
            scheme.method, carry, search, h=trial.h, change=trial.change, failed=checks.inaccurate
        )
    # an event that may begin and end within the step is searched in its first half
    h_max = jnp.where(checks.hidden, carry.h_max, lengths.h_max)
    next_h = jnp.where(checks.hidden, 0.5 * trial.h, lengths.h)
    h_max = jnp.where(checks.missed, carry.h_max, h_max)
    next_h = jnp.where(checks.missed, trial.planned, next_h)
    bracket = dataclasses.replace(bracket, trials=jnp.where(checks.missed, carry.trials + 1, bracket.trials))
    # an event that a jump caused follows the crossing at the same instant
    return bracket, StepLengths(h_max, jnp.where(attempt.leaves, 0.0, next_h))


def _next_bracket(attempt: _Attempt, location: _Location) -> tuple[Bracket, Number]:
    """The bracket of an event after an attempt, and the next trial (s) inside it."""
    carry = attempt.carry
    checks = attempt.checks
    h = attempt.trial.h
    land = location.land
    bracket = next_bracket(
        carry,
        h,
        checks.guards.values,
        accepted=attempt.accepted,
        hit=attempt.hit,
        land=land,
        keeps=attempt.hit & (location.jumping | ~checks.still),
    )
    far_guards = jnp.where(land & ~checks.still & location.others, jnp.inf, bracket.far_guards)
    trials = jnp.where(location.astray, jnp.maximum(bracket.trials, BISECTION_AFTER + 1), bracket.trials)
    bracket = dataclasses.replace(bracket, far_guards=far_guards, trials=trials)
    guess = next_trial(bracket, location.rise, attempt.tolerance)
    # the trial is past the root by rounding: the next one is past it by half the tolerance
    further = jnp.minimum(h + 0.5 * attempt.tolerance, carry.far)
    bracket = dataclasses.replace(bracket, far=jnp.where(location.early, further, bracket.far))
    return bracket, jnp.where(location.early, jnp.minimum(bracket.far, attempt.room), guess)


def _jump(scheme: Scheme, attempt: _Attempt, location: _Location) -> _Jump:
    """The jump at the end of a trial, which counts if the trial is the event."""
    carry = attempt.carry
    trial = attempt.trial
    guards = attempt.checks.guards
    still = attempt.checks.still
    land = location.land
    jumping = location.jumping
    owed = attempt.owed
    leaves = attempt.leaves
    remaining = jnp.any(location.others) & (attempt.waiting | ~still)
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
    scheme: Scheme,
    attempt: _Attempt,
    location: _Location,
    bracket: Bracket,
    lengths: StepLengths,
    jump: _Jump,
) -> Carry:
    """The trajectory after an attempt, with the reason to halt if there is one."""
    carry = attempt.carry
    checks = attempt.checks
    going = attempt.going
    moves = attempt.accepted | location.land
    timed = unlikely(attempt.accepted & (attempt.trial.h >= attempt.room) & ~attempt.leaves)
    earlier_jumps = jnp.where(checks.short, carry.chain, 0)
    unchanged = jnp.where(attempt.accepted, earlier_jumps, carry.chain)
    chain = jnp.where(location.land, earlier_jumps + 1, unchanged)
    state = select(location.land, jump.after, jump.before)
    halt = jnp.where(jump.closed, Halt.CROSSING, jnp.where(timed, Halt.TIME, Halt.GOING))
    if scheme.method.adaptive:
        # many cycles can pass between two polls of the recorder, so a fall is tested after every step
        fell = moves & scheme.model.failed(attempt.trial.at_end, state)
        halt = jnp.where(fell, Halt.FELL, halt)
    stuck = location.land & (chain > longest_chain(scheme.model, checks.guards.values))
    halt = jnp.where(stuck, Halt.FELL, halt).astype(carry.halt.dtype)
    closed = carry.closed
    if scheme.in_turn:
        closed = jnp.where(going, jump.crossed & ~jump.closed, closed)
    # a waiting lane, or one whose step is rejected, keeps its state
    return dataclasses.replace(
        carry,
        state=select(moves, state, carry.state),
        t=jnp.where(timed, carry.stop, jnp.where(moves, jump.t, carry.t)),
        h=jnp.where(going, lengths.h, carry.h),
        h_max=jnp.where(going, lengths.h_max, carry.h_max),
        chain=jnp.where(going, chain, carry.chain),
        attempts=jnp.where(going, carry.attempts + 1, carry.attempts),
        closed=closed,
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
