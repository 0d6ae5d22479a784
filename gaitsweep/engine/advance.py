"""One trajectory, one straight-line attempt: propose a step, look at the guards, accept, shrink or jump.

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
from gaitsweep.engine.carry import Carry, Halt, longest_chain, select
from gaitsweep.engine.event_location import (
    LARGEST_LATE,
    LEAST_LATE,
    PATIENT_TRIALS,
    SECANT_TRIALS,
    Bracket,
    first_of,
    first_to_fire,
    implicit_event_time,
    next_bracket,
    next_trial,
    secant_root,
)
from gaitsweep.engine.hidden_events import PROBES, between, guard_slopes, may_hide, unresolved
from gaitsweep.engine.numerics import FEWEST_STEPS, ORDER, SHORTEST_CYCLE, ResolvedNumerics
from gaitsweep.engine.rarity import likely, unlikely
from gaitsweep.engine.shapes import Flag, GuardFlags, Guards, Number
from gaitsweep.engine.solver import METHODS, Method, Step, euler_update, fixed_step_scheme
from gaitsweep.engine.solver.taylor import Expansion, bends_back, first_zero, order_of, polynomial
from gaitsweep.engine.step_control import CAUTION, LEAST_SHARE, controlled, fitting_change
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


def advance(
    model: Model,
    numerics: ResolvedNumerics,
    *,
    drive: Drive | None = None,
    sensitivities: bool = False,
    precomputed: tuple[Step, Flow, Flow] | None = None,
) -> Advance:
    """The function of one attempt, `(params, carry) -> carry`.

    Args:
        model: a hybrid or a stepped model.
        numerics: step, method and tolerances.
        drive: for a ramp, the parameters at a time (s): a step's flow has those at its middle, its guards and
            jumps those at its end.
        sensitivities: include the derivative of event times in forward-mode derivatives: each event time is
            corrected to first order, t_e - g/g', by a term of value zero.
        precomputed: the step and the rates at its beginning and end, if they are computed beforehand.
    """
    steps = fixed_step_scheme(numerics.method, model)
    if steps is None:
        return _advance_hybrid(cast(HybridModel, model), numerics, drive, sensitivities, precomputed)
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
    step: Callable[..., Any]
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


def _advance_hybrid(
    model: HybridModel,
    numerics: ResolvedNumerics,
    drive: Drive | None,
    sensitivities: bool,
    precomputed: tuple[Step, Flow, Flow] | None,
) -> Advance:
    method = METHODS[numerics.method]
    assert method.step is not None
    # independent jumps need their turns only for the derivative of each one's event time
    in_turn = model.simultaneous == "in_turn" or (model.simultaneous == "independent" and sensitivities)
    order = order_of(numerics.rtol) if method.series else ORDER - 1
    chosen = method.step(model, order) if method.series else method.step(model)
    step, flow, flow_after = precomputed or (chosen, model.flow, model.flow)
    scheme = _Scheme(model, numerics, method, order, step, flow, flow_after, drive, sensitivities, in_turn)

    def attempt(params: Params, carry: Carry) -> Carry:
        finest, tolerance = _event_tolerances(numerics, carry)
        going = likely(carry.halt == Halt.GOING)
        room = jnp.maximum(carry.stop - carry.t, 0.0)
        h = jnp.where(going, jnp.minimum(carry.h, room), 0.0)
        trial = _try_step(scheme, params, carry, h, finest)
        h, change = trial.h, trial.change
        # a rejected step is shortened and tried again
        taken = jnp.asarray(True) if change is None else (change >= CAUTION) | (h <= LEAST_SHARE * carry.dt)
        values = model.guards(trial.at_end, trial.end)
        fired = values >= 0.0
        failed = unlikely(going & ~taken)
        short = unlikely(h <= CHAIN_STEP * carry.unit)
        still = short & (h == 0.0)
        guards, hides = _look_inside(scheme, carry, trial, values, fired)
        hidden = unlikely(going & taken & ~short & hides)
        # a guard that is above zero by its polynomial, and not by its value, is tried further past the root
        rounded = method.series & unlikely(going & taken & ~hidden & (h < trial.planned) & ~jnp.any(fired))
        again = failed | hidden | rounded
        if in_turn:
            # guards that fired in the same trial as the last jump and have not jumped yet
            waits = fired & (carry.far_guards == jnp.inf)
            waiting = still & jnp.any(waits)
            # a crossing is recorded before the events that its jumps cause
            owed = unlikely(carry.closed)
        else:
            waits, waiting, owed = jnp.zeros_like(fired), jnp.asarray(False), jnp.asarray(False)
        leaves = owed & ~waiting
        hit = unlikely(going & jnp.any(fired) & ~again & ~leaves)
        on = going & ~hit & ~again
        location = _locate(scheme, carry, trial, guards, hit, still, room, tolerance)
        land = location.land

        # in turn: one guard jumps in an attempt
        due = jnp.where(waiting, waits, fired)
        jumping = first_of(due) if in_turn else fired
        others = due & ~jumping
        bracket = next_bracket(carry, h, values, on, hit, land, hit & (jumping | ~still))
        bracket["far_guards"] = jnp.where(land & ~still & others, jnp.inf, bracket["far_guards"])
        bracket, h_max, next_h = _next_step(
            scheme, carry, trial, location, bracket, room, tolerance, failed, still, hit
        )
        # an event that may begin and end within the step is searched in its first half
        h_max, next_h = jnp.where(hidden, carry.h_max, h_max), jnp.where(hidden, 0.5 * h, next_h)
        h_max, next_h = jnp.where(rounded, carry.h_max, h_max), jnp.where(rounded, trial.planned, next_h)
        bracket["trials"] = jnp.where(rounded, carry.trials + 1, bracket["trials"])
        # an event that a jump caused follows the crossing at the same instant
        next_h = jnp.where(leaves, 0.0, next_h)

        remaining = jnp.any(others) & (waiting | ~still)
        end, shift = trial.end, carry.shift
        t = carry.t + h
        if sensitivities:
            # an event caused by a jump has no root: it happens at the time of that jump
            rooted = first_of(jumping & ((still & waits) | ((carry.near < 0.0) & (h > 0.0)))) & land
            end, later = implicit_event_time(trial.end, guards.rates, values, guards.speed, rooted)
            # a crossing is read at its own time
            end = euler_update(end, guards.rates, jnp.where(leaves, -shift, 0.0))
            t = t + later - jnp.where(leaves, shift, 0.0)
            shift = jnp.where(leaves, 0.0, shift + jnp.where(owed, later, 0.0))
        after = model.jump(trial.at_end, end, jumping)
        crossed = owed | (land & model.section(trial.at_end, trial.end, jumping))
        # at its own time, which needs the rates after the last jump, if other guards have jumped since
        closed = crossed & ((land & ~remaining & ~owed) | leaves)
        timed = unlikely(on & (h >= room) & ~leaves)

        before = jnp.where(short, carry.chain, 0)
        chain = jnp.where(land, before + 1, jnp.where(on, before, carry.chain))
        halt = jnp.where(closed, Halt.CROSSING, jnp.where(timed, Halt.TIME, Halt.GOING))
        if method.adaptive:
            # many cycles can pass between two polls of the recorder, so a fall is tested after every step
            down = (on | land) & model.failed(trial.at_end, select(land, after, end))
            halt = jnp.where(down, Halt.FELL, halt)
        stuck = land & (chain > longest_chain(model, values))
        halt = jnp.where(stuck, Halt.FELL, halt).astype(carry.halt.dtype)
        # a waiting lane, or one whose step is rejected, keeps its state
        return dataclasses.replace(
            carry,
            state=select(on | land, select(land, after, end), carry.state),
            t=jnp.where(timed, carry.stop, jnp.where(on | land, t, carry.t)),
            h=jnp.where(going, next_h, carry.h),
            h_max=jnp.where(going, h_max, carry.h_max),
            chain=jnp.where(going, chain, carry.chain),
            attempts=jnp.where(going, carry.attempts + 1, carry.attempts),
            closed=jnp.where(going, crossed & ~closed, carry.closed) if in_turn else carry.closed,
            shift=shift,
            halt=jnp.where(going, halt, carry.halt),
            **bracket,
        )

    return attempt


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
    model, drive, method = scheme.model, scheme.drive, scheme.method
    within = params if drive is None else drive(params, carry.t + 0.5 * h)
    # before the value to which a schedule of steps changes at the end
    at_end = params if drive is None else drive(params, carry.t + h * STEP_END)
    expansion, smooth, polynomials = None, False, []
    planned, bends, near_time = h, jnp.asarray(False), jnp.zeros_like(h)
    if method.series:
        expansion = cast(Expansion, scheme.step(within, carry.state, h))
        smooth = not may_switch(model, within, carry.state)
        # events are searched between few points of a step whose polynomials do not hold throughout
        h = h if smooth else jnp.minimum(h, carry.dt * (FEWEST_STEPS / SHORTEST_CYCLE))
        polynomials = expansion.along(lambda s: model.guards(within, s), carry.state)
        # a step ends at its first event; that of a ramp would have the parameters of another length
        planned, past_root = h, 0.5 * finest * jnp.exp2(2.0 * carry.trials)
        root = first_zero(polynomials, h) + past_root if drive is None else jnp.inf
        near_time = jnp.where(root < h, jnp.maximum(root - 2.0 * past_root, 0.0), 0.0)
        h = jnp.minimum(h, root)
        bends = bends_back(polynomials, h)
        end = expansion.at(carry.state, h)
        error = expansion.error(h, None if smooth else scheme.flow_after(at_end, end))
    elif method.adaptive:
        end, error = scheme.step(within, carry.state, h)
    else:
        end, error = scheme.step(within, carry.state, h), None
    change = None if error is None else fitting_change(error, carry, end, scheme.numerics, scheme.order)
    return _Trial(h, within, at_end, end, change, planned, expansion, polynomials, bends, near_time, smooth)


def _look_inside(
    scheme: _Scheme, carry: Carry, trial: _Trial, values: Guards, fired: GuardFlags
) -> tuple[_GuardsAtEnd, Flag]:
    """The guards at the end of a trial, and whether an event or a switch may begin and end within it."""
    model, flow, h = scheme.model, scheme.flow, trial.h
    leaving, arriving = flow(trial.within, carry.state), scheme.flow_after(trial.at_end, trial.end)
    slopes = guard_slopes(model, trial.within, carry.state, leaving)
    speed = guard_slopes(model, trial.at_end, trial.end, arriving)
    guards = _GuardsAtEnd(values, fired, speed, arriving)
    hides = may_hide(carry.near, slopes, values, h)
    if not scheme.method.adaptive:
        return guards, hides

    def inside(share: float) -> State:
        if trial.expansion is not None:
            return trial.expansion.at(carry.state, share * h)
        return between(carry.state, leaving, trial.end, arriving, h, share)

    if not trial.smooth:
        probed = [model.guards(trial.within, inside(share)) for share in PROBES]
        hides = hides | unresolved(carry.near, slopes, values, speed, probed, h)
    if trial.expansion is not None:
        hides = trial.bends if trial.smooth else hides | trial.bends
    ends, end_rates = (carry.state, trial.end), (leaving, arriving)
    shows, unseen = switches_within(flow, trial.within, ends, end_rates, h, inside)
    return guards, hides | ((h > SWITCH_STEP * carry.unit) & (shows | unseen))


def _locate(
    scheme: _Scheme,
    carry: Carry,
    trial: _Trial,
    guards: _GuardsAtEnd,
    hit: Flag,
    still: Flag,
    room: Number,
    tolerance: Number,
) -> _Location:
    """The place of a trial relative to an event, if a guard fired there (`hit`).

    Args:
        scheme, carry, trial, guards: the attempt so far.
        hit: whether a guard fired at the trial.
        still: whether the trial has zero length.
        room: the time (s) until the next stop.
        tolerance: of the event time (s).
    """
    h, values = trial.h, guards.values
    # the guard that fires first, below zero at the near end of the bracket and above it at the far one
    below, above = first_to_fire(jnp.where(hit, carry.near, values), jnp.where(hit, values, carry.far_guards))
    late = h - h * secant_root(below, above)
    if trial.expansion is not None:
        # the secant of a short bracket, which every guard that fired has entered below zero
        entering = polynomial(trial.polynomials, trial.near_time)
        brackets = hit & (trial.near_time > 0.0) & jnp.all(~guards.fired | (entering < 0.0))
        rest = (h - trial.near_time) * (1.0 - secant_root(*first_to_fire(entering, values)))
        late = jnp.where(brackets, rest, late)
    # of a smooth guard, the secant through so short a bracket has its slope
    past = jnp.asarray(False)
    if may_bend(scheme.model.guards, trial.at_end, trial.end, guards.rates):
        past = jnp.any(guards.fired & (values > LARGEST_LATE * tolerance * guards.speed))
    # once the bracket is as short as the tolerance, the rates need not be trusted
    astray = hit & (late <= tolerance) & past & (h > tolerance)
    early = hit & (late < LEAST_LATE * tolerance) & ~still & ~astray & (h < room)
    early = early & (carry.trials <= SECANT_TRIALS) & (h < carry.far)
    land = hit & (late <= tolerance) & ~astray & ~early
    return _Location(below, above, land, early, astray)


def _next_step(
    scheme: _Scheme,
    carry: Carry,
    trial: _Trial,
    location: _Location,
    bracket: Bracket,
    room: Number,
    tolerance: Number,
    failed: Flag,
    still: Flag,
    hit: Flag,
) -> tuple[Bracket, Number, Number]:
    """The bracket, `Carry.h_max` and the next step (s).

    Args:
        scheme, carry, trial, location: the attempt so far.
        bracket: from `next_bracket`.
        room: the time (s) until the next stop.
        tolerance: of the event time (s).
        failed: whether the step missed the tolerance on its error.
        still: whether the trial has zero length.
        hit: whether a guard fired at the trial.
    """
    h, land, early, method = trial.h, location.land, location.early, scheme.method
    trials = jnp.where(location.astray, jnp.maximum(bracket["trials"], SECANT_TRIALS + 1), bracket["trials"])
    bracket = {**bracket, "trials": trials}
    guess = next_trial(bracket, location.below, location.above, tolerance)
    # the trial is past the root by rounding: the next one is past it by half the tolerance
    bracket["far"] = jnp.where(early, jnp.minimum(h + 0.5 * tolerance, carry.far), bracket["far"])
    guess = jnp.where(early, jnp.minimum(bracket["far"], room), guess)
    locating = bracket["far"] < jnp.inf
    # a step shortened by a stop or an event does not limit the next step
    if trial.change is None:
        grown = jnp.minimum(carry.dt, method.growth * carry.h_max)
        first = method.first_step * carry.dt
        h_max = jnp.where(land | still, first, jnp.where(hit | locating, carry.h_max, grown))
        next_h = jnp.where(land, 0.0, jnp.where(locating, guess, h_max))
    else:
        h_max, next_h = controlled(method, carry, h, trial.change, failed, land, hit, locating, guess)
    return bracket, h_max, next_h


def _advance_stepped(model: FixedStepDynamics, numerics: ResolvedNumerics, drive: Drive | None) -> Advance:
    def attempt(params: Params, carry: Carry) -> Carry:
        dt = carry.dt
        going = carry.halt == Halt.GOING
        # a simulator's step cannot be shortened, so a stop is at the nearest end of a step
        timed = carry.stop - carry.t <= 0.5 * dt
        params_within = params if drive is None else drive(params, carry.t + 0.5 * dt)
        length = jnp.asarray(dt, numerics.stepped)
        factor = (carry.share,) if model.stochastic else ()
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
