"""One trajectory, one straight-line attempt: propose a step, look at the guards, accept, shrink or jump.

The same function serves every engine. All decisions are selects, so that it can be vmapped or printed as
a scalar kernel, and each trajectory has a time and a step of its own.

An event is located by a bracket. Its near end is the state itself (every accepted step moves it forward),
its far end is the shortest step known to fire a guard. The next trial is where the secant through both
ends crosses zero (regula falsi with the Illinois weights, which keep both ends moving), and the jump is
applied at a trial past the root by a quarter of the event tolerance to a whole one: the far side of the
bracket, where the guard has changed sign and the mode that the jump sets is already armed. The distance from
the root is above rounding, so guards whose roots are the same instant fire in the same trial.

Guards that fire in the same trial jump one at a time, in the order of the guards, each in an attempt of zero
length. After each jump the others are looked at again: one that is below zero by then does not jump. Each
has its own derivative of the event time. Guards that a jump causes follow, again in their order. A crossing
of the section halts the trajectory when the guards that fired in the same trial have jumped. Guards of a
model that says so jump together (`HybridModel.simultaneous`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Num

from gaitsweep.contract import FixedStepDynamics, HybridModel, Model, Params, Rates, State
from gaitsweep.engine.hidden_events import PROBES, between, guard_slopes, may_hide, unresolved
from gaitsweep.engine.numerics import (
    FEWEST_STEPS,
    ORDER,
    SHORTEST_CYCLE,
    ResolvedNumerics,
    tolerance_scale,
)
from gaitsweep.engine.rarity import likely, unlikely
from gaitsweep.engine.shapes import Flag, GuardFlags, Guards, Integer, Number
from gaitsweep.engine.solver import METHODS, Method, Step, euler_update, fixed_step_scheme
from gaitsweep.engine.solver.taylor import bends_back, first_zero, order_of, polynomial
from gaitsweep.engine.switches import may_bend, may_switch, switches_within


class Halt:
    """The reasons why a trajectory waits for its recorder.

    It does not move until the recorder has polled it, so no crossing is lost and none has to be copied.
    """

    GOING, CROSSING, TIME, FINISHED, FELL = range(5)


# Jumps at one instant, for each guard, beyond which a row is stalled: far above most physical chains of
# events.
JUMPS_A_GUARD = 4
# Steps shorter than this share of the nominal period do not end a chain of jumps.
CHAIN_STEP = 1e-9
# A guard's value before a step is limited to this multiple of its value after it: a model may disarm a guard
# by a large negative number, with which the secant would locate nothing.
STEEPEST = 1e9
# Trials before the location of an event falls back to bisection (superlinear location takes 5 to 8), and
# before its tolerance begins to grow (bisection of a whole step to 1e-12 s takes another 31).
SECANT_TRIALS = 24
PATIENT_TRIALS = 60
# The longest step, as a share of the nominal period, in which the flow may switch.
SWITCH_STEP = 1e-7
# Least distance of an event's trial from the root, as a share of the tolerance.
LEAST_LATE = 0.25
# The largest time past a guard's root by its own rate, as a multiple of the tolerance: a guard that jumps
# to a small number above zero looks nearer to its root by the secant than it is.
LARGEST_LATE = 4.0
# Where the parameters of a schedule are read for the end of a step, as a share of it.
STEP_END = 1.0 - 1e-9
# Step control: the safety factor of a step, the smallest factor by which a failed step is shortened, and the
# smallest step as a share of the longest, which is accepted with any error (a state that diverges is then
# reported as diverged).
CAUTION = 0.9
STEEPEST_CUT = 0.2
LEAST_SHARE = 1e-9


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Carry:
    """The state of a trajectory's integration.

    `t` is the time (s); `h` the next step (s); `h_max` its upper bound (s), which grows after an event;
    `near` the guards at the state; `far` the shortest step known to fire (infinite unless an event is being
    located) and `far_guards` the guards there; at an instant with jumps it is >= 0 for all guards that have
    fired, and infinite for those that wait for their jump; `weight` the Illinois weight of
    the end that was kept (above zero: the near end, below: the far end); `trials` the attempts to locate this
    event; `chain` the jumps at this instant; `attempts` their total number; `closed` whether the section was
    crossed at this instant, before other guards that wait for their jump, and `shift` the time (s) of their
    events after that crossing: zero, but for its derivative; `stop` the time (s) at which to halt; `halt` the
    reason why the trajectory waits; `tangents` its derivatives along some directions (`tangents.Tangent`), if
    they are followed. Constants of the trajectory: `dt` its longest step (s), `share` the
    factor on that step, by which tolerances are finer as well, and `unit` the nominal period (s), the unit of
    the tolerance on event times.
    """

    state: State
    t: Number
    h: Number
    h_max: Number
    near: Guards
    far: Number
    far_guards: Guards
    weight: Number
    trials: Integer
    chain: Integer
    attempts: Integer
    closed: Flag
    shift: Number
    stop: Number
    halt: Integer
    dt: Number
    share: Number
    unit: Number
    tangents: Any = ()


Advance = Callable[[Params, Carry], Carry]
Flow = Callable[[Params, State], Rates]
Drive = Callable[[Params, Number], Params]
T = TypeVar("T")  # a pytree


def start(
    model: Model,
    params: Params,
    state: State,
    *,
    dt: Number | float,
    stop: Number | float = jnp.inf,
    share: Number | float = 1.0,
) -> Carry:
    """A trajectory at t = 0; the first attempt of a hybrid model has zero length and fires guards >= 0 there.

    Args:
        model, params, state: the model, its parameters and its initial state.
        dt: its longest step (s), with the factor `share` applied.
        stop: the time (s) at which to halt.
        share: see `Carry`.
    """
    # the step of a stepped model is not shortened, since no event is located
    near = model.guards(params, state) if isinstance(model, HybridModel) else jnp.zeros((0,), jnp.float64)
    zero = jnp.zeros((), near.dtype)
    count = jnp.zeros((), jnp.int32)
    # a tolerance in time does not depend on the parameters as the trajectory does
    unit = jax.lax.stop_gradient(model.period(params))
    return Carry(
        state=state,
        t=zero,
        h=zero,
        h_max=zero,
        near=near,
        far=zero + jnp.inf,
        far_guards=jnp.where(near >= 0.0, jnp.inf, near),
        weight=zero + 1.0,
        trials=count,
        chain=count,
        attempts=jnp.zeros((), jnp.int64),
        closed=jnp.zeros((), bool),
        shift=zero,
        stop=zero + stop,
        halt=count,
        dt=zero + dt,
        share=zero + share,
        unit=zero + unit,
    )


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

    def attempt(params: Params, carry: Carry) -> Carry:
        dtype, dt = carry.t.dtype, carry.dt
        # a tolerance below the resolution of time would never be met in float32
        finest = carry.unit * jnp.asarray(
            max(numerics.event_tolerance, 16 * float(jnp.finfo(dtype).eps)), dtype
        )
        # if a guard rises so slowly that rounding hides the event, no bracket of that width fires: after
        # two rounds of location the tolerance grows
        impatience = jnp.maximum(carry.trials - PATIENT_TRIALS, 0).astype(dtype)
        tolerance = finest * (1.0 + impatience * impatience)
        going = likely(carry.halt == Halt.GOING)
        room = jnp.maximum(carry.stop - carry.t, 0.0)
        h = jnp.where(going, jnp.minimum(carry.h, room), 0.0)
        params_within = params if drive is None else drive(params, carry.t + 0.5 * h)
        # before the value to which a schedule of steps changes at the end
        params_at_end = params if drive is None else drive(params, carry.t + h * STEP_END)
        expansion, smooth, polynomials = None, False, []
        planned, bends, near_time = h, jnp.asarray(False), jnp.zeros_like(h)
        if method.series:
            expansion = step(params_within, carry.state, h)
            smooth = not may_switch(model, params_within, carry.state)
            # events are searched between few points of a step whose polynomials do not hold throughout
            h = h if smooth else jnp.minimum(h, dt * (FEWEST_STEPS / SHORTEST_CYCLE))
            polynomials = expansion.along(lambda s: model.guards(params_within, s), carry.state)
            # a step ends at its first event; that of a ramp would have the parameters of another length
            planned, past_root = h, 0.5 * finest * jnp.exp2(2.0 * carry.trials)
            root = first_zero(polynomials, h) + past_root if drive is None else jnp.inf
            near_time = jnp.where(root < h, jnp.maximum(root - 2.0 * past_root, 0.0), 0.0)
            h = jnp.minimum(h, root)
            bends = bends_back(polynomials, h)
            trial = expansion.at(carry.state, h)
            rates = None if smooth else flow_after(params_at_end, trial)
            error = expansion.error(h, rates)
        elif method.adaptive:
            trial, error = step(params_within, carry.state, h)
        else:
            trial, error = step(params_within, carry.state, h), None
        change = None if error is None else _fitting_change(error, carry, trial, numerics, order)
        # a rejected step is shortened and tried again
        taken = jnp.asarray(True) if change is None else (change >= CAUTION) | (h <= LEAST_SHARE * dt)
        guards = model.guards(params_at_end, trial)
        fired = guards >= 0.0
        failed = unlikely(going & ~taken)
        short = unlikely(h <= CHAIN_STEP * carry.unit)
        still = short & (h == 0.0)
        leaving, arriving = flow(params_within, carry.state), flow_after(params_at_end, trial)
        slopes = guard_slopes(model, params_within, carry.state, leaving)
        speed = guard_slopes(model, params_at_end, trial, arriving)
        hides = may_hide(carry.near, slopes, guards, h)
        if method.adaptive:

            def within(share: float) -> State:
                if expansion is not None:
                    return expansion.at(carry.state, share * h)
                return between(carry.state, leaving, trial, arriving, h, share)

            if not smooth:
                inside = [model.guards(params_within, within(share)) for share in PROBES]
                hides = hides | unresolved(carry.near, slopes, guards, speed, inside, h)
            if expansion is not None:
                hides = bends if smooth else hides | bends
            ends, end_rates = (carry.state, trial), (leaving, arriving)
            shows, unseen = switches_within(flow, params_within, ends, end_rates, h, within)
            hides = hides | ((h > SWITCH_STEP * carry.unit) & (shows | unseen))
        hidden = unlikely(going & taken & ~short & hides)
        # a guard that is above zero by its polynomial, and not by its value, is tried further past the root
        rounded = method.series & unlikely(going & taken & ~hidden & (h < planned) & ~jnp.any(fired))
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
        # the guard that fires first, below zero at the near end of the bracket and above it at the far one
        below, above = _first_to_fire(
            jnp.where(hit, carry.near, guards), jnp.where(hit, guards, carry.far_guards)
        )
        late = h - h * _share(below, above)
        if expansion is not None:
            # the secant of a short bracket, which every guard that fired has entered below zero
            entering = polynomial(polynomials, near_time)
            brackets = hit & (near_time > 0.0) & jnp.all(~fired | (entering < 0.0))
            rest = (h - near_time) * (1.0 - _share(*_first_to_fire(entering, guards)))
            late = jnp.where(brackets, rest, late)
        # of a smooth guard, the secant through so short a bracket has its slope
        past = jnp.asarray(False)
        if may_bend(model.guards, params_at_end, trial, arriving):
            past = jnp.any(fired & (guards > LARGEST_LATE * tolerance * speed))
        # once the bracket is as short as the tolerance, the rates need not be trusted
        astray = hit & (late <= tolerance) & past & (h > tolerance)
        early = hit & (late < LEAST_LATE * tolerance) & ~still & ~astray & (h < room)
        early = early & (carry.trials <= SECANT_TRIALS) & (h < carry.far)
        land = hit & (late <= tolerance) & ~astray & ~early

        # in turn: one guard jumps in an attempt
        due = jnp.where(waiting, waits, fired)
        jumping = _first_of(due) if in_turn else fired
        others = due & ~jumping
        bracket = _next_bracket(carry, h, guards, on, hit, land, hit & (jumping | ~still))
        bracket["far_guards"] = jnp.where(land & ~still & others, jnp.inf, bracket["far_guards"])
        bracket["trials"] = jnp.where(
            astray, jnp.maximum(bracket["trials"], SECANT_TRIALS + 1), bracket["trials"]
        )
        guess = _guess(bracket, below, above, tolerance)
        # the trial is past the root by rounding: the next one is past it by half the tolerance
        bracket["far"] = jnp.where(early, jnp.minimum(h + 0.5 * tolerance, carry.far), bracket["far"])
        guess = jnp.where(early, jnp.minimum(bracket["far"], room), guess)
        locating = bracket["far"] < jnp.inf
        # a step shortened by a stop or an event does not limit the next step
        if change is None:
            grown = jnp.minimum(dt, method.growth * carry.h_max)
            first = method.first_step * dt
            h_max = jnp.where(land | still, first, jnp.where(hit | locating, carry.h_max, grown))
            next_h = jnp.where(land, 0.0, jnp.where(locating, guess, h_max))
        else:
            h_max, next_h = _controlled(method, carry, h, change, failed, land, hit, locating, guess)
        # an event that may begin and end within the step is searched in its first half
        h_max, next_h = jnp.where(hidden, carry.h_max, h_max), jnp.where(hidden, 0.5 * h, next_h)
        h_max, next_h = jnp.where(rounded, carry.h_max, h_max), jnp.where(rounded, planned, next_h)
        bracket["trials"] = jnp.where(rounded, carry.trials + 1, bracket["trials"])
        # an event that a jump caused follows the crossing at the same instant
        next_h = jnp.where(leaves, 0.0, next_h)

        remaining = jnp.any(others) & (waiting | ~still)
        end, shift = trial, carry.shift
        t = carry.t + h
        if sensitivities:
            # an event caused by a jump has no root: it happens at the time of that jump
            rooted = _first_of(jumping & ((still & waits) | ((carry.near < 0.0) & (h > 0.0)))) & land
            end, later = _implicit_event_time(trial, arriving, guards, speed, rooted)
            # a crossing is read at its own time
            end = euler_update(end, arriving, jnp.where(leaves, -shift, 0.0))
            t = t + later - jnp.where(leaves, shift, 0.0)
            shift = jnp.where(leaves, 0.0, shift + jnp.where(owed, later, 0.0))
        after = model.jump(params_at_end, end, jumping)
        crossed = owed | (land & model.section(params_at_end, trial, jumping))
        # at its own time, which needs the rates after the last jump, if other guards have jumped since
        closed = crossed & ((land & ~remaining & ~owed) | leaves)
        timed = unlikely(on & (h >= room) & ~leaves)

        before = jnp.where(short, carry.chain, 0)
        chain = jnp.where(land, before + 1, jnp.where(on, before, carry.chain))
        halt = jnp.where(closed, Halt.CROSSING, jnp.where(timed, Halt.TIME, Halt.GOING))
        if method.adaptive:
            # many cycles can pass between two polls of the recorder, so a fall is tested after every step
            down = (on | land) & model.failed(params_at_end, select(land, after, end))
            halt = jnp.where(down, Halt.FELL, halt)
        stuck = land & (chain > _longest_chain(model, guards))
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


def _fitting_change(
    error: Rates, carry: Carry, trial: State, numerics: ResolvedNumerics, order: int
) -> Number:
    """The factor on a step with which its error would meet the tolerance, with the safety factor CAUTION.

    It is at least CAUTION if the step itself meets the tolerance, and 0 if the error is NaN.
    """
    assert numerics.rtol is not None
    assert numerics.atol is not None
    finer = tolerance_scale(carry.share)
    worst = jnp.zeros_like(carry.t)
    for name, error_of_field in error.items():
        size = jnp.maximum(jnp.abs(getattr(carry.state, name)), jnp.abs(getattr(trial, name)))
        worst = jnp.maximum(
            worst, jnp.max(jnp.abs(error_of_field) / (finer * (numerics.atol + numerics.rtol * size)))
        )
    worst = jax.lax.stop_gradient(worst)
    floor = (CAUTION / 10.0) ** order
    worst = jnp.maximum(worst, floor)
    # of tsit5 the fourth root instead of the fifth: two square roots are far cheaper, and the tolerance is
    # met as well
    root = jnp.sqrt(jnp.sqrt(worst)) if order == ORDER - 1 else jnp.exp(jnp.log(worst) / order)
    change = CAUTION / root
    return jnp.where(worst >= 0.0, change, 0.0)


def _controlled(
    method: Method,
    carry: Carry,
    h: Number,
    change: Number,
    failed: Flag,
    land: Flag,
    hit: Flag,
    locating: Flag,
    guess: Number,
) -> tuple[Number, Number]:
    """`h_max` and the next step, for methods with step control; `failed`: the step missed the tolerance."""
    dt, least = carry.dt, LEAST_SHARE * carry.dt
    # at the start the time scale of the flow is unknown
    begun = jnp.maximum(jnp.where(carry.h_max > 0.0, method.first_step * carry.h_max, 1e-3 * dt), least)
    shorter = jnp.maximum(h * jnp.maximum(change, STEEPEST_CUT), least)
    # a step shortened by a stop or an event only shows that its length is accurate
    longer = jnp.maximum(carry.h_max, h * jnp.minimum(change, method.growth))
    met = jnp.where(h < carry.h_max, longer, h * jnp.minimum(change, method.growth))
    h_max = jnp.where(hit | locating, carry.h_max, jnp.minimum(dt, jnp.maximum(met, least)))
    h_max = jnp.where(failed, shorter, jnp.where(land, carry.h_max, jnp.where(h == 0.0, begun, h_max)))
    next_h = jnp.where(land, 0.0, jnp.where(failed, shorter, jnp.where(locating, guess, h_max)))
    return h_max, next_h


def _first_to_fire(near: Guards, far: Guards) -> tuple[Number, Number]:
    """The guard, of those that fire at the far end, whose secant crosses zero first.

    Returns:
        Its distance below zero at the near end and above zero at the far end, both >= 0; (1, 0) if none
        fires. The smallest quotient below / above is found without division.
    """
    if near.size == 0:  # a flow without events
        none = jnp.zeros((), near.dtype)
        return none + 1.0, none
    fires = far >= 0.0
    above = jnp.where(fires, far, 0.0)
    steepest = STEEPEST * above
    below = jnp.where(fires, jnp.where(-near > steepest, steepest, -near), 1.0)
    while below.size > 1:
        half = below.size // 2
        pairs = slice(0, half), slice(half, 2 * half), slice(2 * half, None)
        (b1, b2, b_rest), (a1, a2, a_rest) = ([x[part] for part in pairs] for x in (below, above))
        second = b2 * a1 < b1 * a2
        below = jnp.concatenate([jnp.where(second, b2, b1), b_rest])
        above = jnp.concatenate([jnp.where(second, a2, a1), a_rest])
    return below[0], above[0]


def _share(below: Number, above: Number) -> Number:
    """The zero of the secant, as a share of the bracket from its near end."""
    rise = below + above
    return jnp.where(rise > 0.0, below / jnp.where(rise > 0.0, rise, 1.0), 0.0)


def _next_bracket(
    carry: Carry, h: Number, guards: Guards, on: Flag, hit: Flag, land: Flag, keeps: GuardFlags
) -> dict[str, Num[Array, " ..."]]:
    """The bracket after this attempt, with its far end (back) or its near end (on) at the trial.

    `keeps` are the guards whose values at the trial are kept: at an instant with jumps only that which jumps.
    """
    back = hit & ~land
    rest = carry.far - h
    # an accepted step that reaches the far end without firing (rounding) ends the location
    fresh = likely(carry.far == jnp.inf)
    far = jnp.where(back, h, jnp.where(fresh, jnp.inf, jnp.where(on & (rest > 0.0), rest, jnp.inf)))
    stayed_near = jnp.where(carry.weight > 0.0, 0.5 * carry.weight, 1.0)
    stayed_far = jnp.where(carry.weight < 0.0, 0.5 * carry.weight, -1.0)
    weight = jnp.where(fresh, 1.0, jnp.where(back, stayed_near, stayed_far))
    # a location that ended without an event is continued: only an accepted step resets its trials
    trials = jnp.where(land | (on & fresh), 0, carry.trials + 1)
    waits = ~(on | hit)
    return {
        "near": jnp.where(on, guards, carry.near),
        "far": jnp.where(waits, carry.far, far),
        "far_guards": jnp.where(keeps, guards, carry.far_guards),
        "weight": jnp.where(waits, carry.weight, weight),
        "trials": jnp.where(waits, carry.trials, trials),
    }


def _guess(bracket: dict[str, Num[Array, " ..."]], below: Number, above: Number, tolerance: Number) -> Number:
    """The next trial inside the bracket: the weighted secant, half a tolerance past its root."""
    weight = bracket["weight"]
    below = below * jnp.where(weight > 0.0, weight, 1.0)
    above = above * jnp.where(weight < 0.0, -weight, 1.0)
    far = jnp.where(bracket["far"] < jnp.inf, bracket["far"], 0.0)
    secant = far * _share(below, above) + 0.5 * tolerance
    guess = jnp.where(bracket["trials"] > SECANT_TRIALS, 0.5 * far, secant)
    # so short a bracket is stepped as a whole: if rounding hides the event, the step reaches the far end
    # without firing and the location ends, instead of bisecting without end
    return jnp.where((far <= tolerance) | (guess > far), far, guess)


def _implicit_event_time(
    trial: State, rates: Rates, guards: Guards, speed: Guards, rooted: GuardFlags
) -> tuple[State, Number]:
    """State at the event, and the shift (s) of its time: zero, with the derivative of the event time.

    g(x(t)) = 0 along every neighbouring trajectory, so dt = -dg/g' for the guard that jumps (`rooted`).
    """
    if guards.size == 0:
        return trial, jnp.zeros(())
    speed = jnp.where(rooted & (speed != 0.0), speed, 1.0)
    drift = (guards - jax.lax.stop_gradient(guards)) / speed
    shift = -jnp.sum(jnp.where(rooted, drift, 0.0))
    return euler_update(trial, rates, shift), shift


def _first_of(flags: GuardFlags) -> GuardFlags:
    """The first flag that is set, alone."""
    taken, first = jnp.zeros((), bool), []
    for i in range(flags.size):
        first.append(flags[i] & ~taken)
        taken = taken | flags[i]
    return jnp.stack(first) if first else flags


def _advance_stepped(model: FixedStepDynamics, numerics: ResolvedNumerics, drive: Drive | None) -> Advance:
    def attempt(params: Params, carry: Carry) -> Carry:
        dt = carry.dt
        going = carry.halt == Halt.GOING
        # a simulator's step cannot be shortened, so a stop is at the nearest end of a step
        timed = carry.stop - carry.t <= 0.5 * dt
        params_within = params if drive is None else drive(params, carry.t + 0.5 * dt)
        trial = model.step(params_within, carry.state, jnp.asarray(dt, numerics.stepped))
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


def select(condition: Flag, yes: T, no: T) -> T:
    """`yes` or `no`, two pytrees of the same structure, leaf by leaf."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def stalled(model: Model, carry: Carry) -> Flag:
    """Whether jumps follow each other at one instant without end (`HybridModel.longest_chain`)."""
    return carry.chain > _longest_chain(model, carry.near)


def _longest_chain(model: Model, guards: Guards) -> int:
    longest = model.longest_chain if isinstance(model, HybridModel) else None
    return JUMPS_A_GUARD * (guards.size + 1) if longest is None else longest


def fired_last(carry: Carry) -> GuardFlags:
    """Guards that fired at the last instant of an event, in any of its jumps (a bool each)."""
    return carry.far_guards >= 0.0
