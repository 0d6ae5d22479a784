"""Observables of the planar quadruped at the section, such as its cost of transport, and its signals.

The section is LF's swing onset.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from gaitsweep.contract import Quantity
from gaitsweep.dynamics.matsuoka import FLEXOR
from gaitsweep.papers.fukuoka2015.planar_quadruped.cycle import LF, MIN_AIR_TIME
from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import (
    HIP,
    KNEE,
    NQ,
    PITCH,
    X,
    Z,
    forces_on_joints,
    joint_powers,
)
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS, PAIRS
from gaitsweep.papers.fukuoka2015.planar_quadruped.rhythm import swinging
from gaitsweep.papers.fukuoka2015.planar_quadruped.state import Params, State

# A scale so large that no run waits for a quantity to settle: what it follows from has its own.
_NEVER_AWAITED = 1.0e9

_PAIRS = {i: f"{hind} less that of {fore}" for i, (fore, hind) in enumerate(PAIRS, 1)}


def _of_legs(
    name: str, unit: str, meaning: str, symbol: str, scale: float | None = None
) -> tuple[Quantity, ...]:
    """A quantity of each leg, whose name goes into the `{}` of the meaning."""
    return tuple(
        Quantity(
            f"{name}_{leg}", unit, meaning.format(leg), symbol=f"{symbol}^\\mathrm{{{leg}}}", scale=scale
        )
        for leg in LEGS
    )


OBSERVABLES = (
    *(
        Quantity(f"delta_{i}", "cycles", f"phase of {legs}, -0.5 to 0.5", symbol=rf"\delta_{i}", scale=1.0)
        for i, legs in _PAIRS.items()
    ),
    Quantity("speed", "m/s", "mean forward speed over LF's last cycle", symbol="v"),
    Quantity("period", "s", "duration of LF's last cycle", symbol="T"),
    Quantity("flight", "1", "share of the last cycle without a foot on the ground", scale=1.0),
    *(
        Quantity(f"delta_{i}_mean", "cycles", f"phase of {legs}, averaged over the last cycles",
                 symbol=rf"\bar\delta_{i}", scale=1.0)
        for i, legs in _PAIRS.items()
    ),
    *(
        Quantity(f"delta_{i}_touchdown", "cycles", f"phase of {legs} by touchdowns, not swing onsets: of "
                 f"feet that were in the air for {1e3 * MIN_AIR_TIME:g} ms or more",
                 symbol=rf"\bar\delta_{i}^\mathrm{{td}}", scale=_NEVER_AWAITED)
        for i, legs in _PAIRS.items()
    ),
    Quantity("antiphase", "cycles", "phase between the pairs' middles, 0 to 1, averaged likewise", scale=1.0),
    Quantity("length", "1", "least resultant length of both shifts and that of the fore legs", scale=1.0),
    Quantity("length_touchdown", "1", "the same of touchdowns; a leg that does not touch down once a cycle "
             "lowers it", scale=_NEVER_AWAITED),
    Quantity("variation", "1", "coefficient of variation of the period over the last cycles", scale=1.0),
    Quantity("pitch_mean", "rad", "pitch over the last cycle, nose down positive", scale=1.0),
    Quantity("pitch_range", "rad", "largest less smallest pitch in the last cycle", scale=1.0),
    Quantity("pitch_once", "1", "share of the pitch's variance over the last cycles that goes once a cycle",
             scale=_NEVER_AWAITED),
    Quantity("pitch_twice", "1", "share of the pitch's variance likewise that goes twice a cycle",
             scale=_NEVER_AWAITED),
    *_of_legs("since", "s", "time since {}'s last swing onset", r"t", scale=1.0),
    *_of_legs("late_load", "N", "mean load on {} in late stance", r"F_\mathrm{late}"),
    *_of_legs("stance_load", "N", "mean load on {} in stance", "F"),
    *_of_legs("late_pitch", "rad", "mean pitch in {}'s late stance", r"\phi_\mathrm{late}", scale=1.0),
    *_of_legs("stance_pitch", "rad", "mean pitch in {}'s stance", r"\phi", scale=1.0),
    Quantity("power_hip", "W", "mean positive mechanical power of the hips over LF's last cycle",
             symbol=r"P_\mathrm{hip}", scale=_NEVER_AWAITED),
    Quantity("power_knee", "W", "mean positive mechanical power of the knees over LF's last cycle",
             symbol=r"P_\mathrm{knee}", scale=_NEVER_AWAITED),
    Quantity("cost_of_transport", "1", "both powers over weight times speed", symbol="c",
             scale=_NEVER_AWAITED),
)  # fmt: skip

LABEL_FIELDS = (
    Quantity("margin", "cycles", "smaller distance of delta_1_mean and delta_2_mean, by which the gait is "
             "named, from the threshold or half a cycle: to the next gait"),
    Quantity("gait_by_touchdowns", "gait", "the gait by delta_1_touchdown and delta_2_touchdown; `gait` is "
             "by swing onsets, where flexors become active"),
)  # fmt: skip

SIGNALS = (
    *_of_legs("u_f", "1", "potential of {}'s flexor; the leg swings while it is positive", "u_f"),
    *_of_legs("F", "N", "load on {}", "F"),
    *(Quantity(f"contact_{i + 1}", "1", f"1 while {leg} is on the ground") for i, leg in enumerate(LEGS)),
    Quantity("x", "m", "middle between the hips, forward"),
    Quantity("z", "m", "its height"),
    Quantity("pitch", "rad", "pitch of the torso, nose down positive"),
    Quantity("speed", "m/s", "forward speed of the middle between the hips", symbol="v"),
    *_of_legs("theta", "rad", "angle of {}'s hip, forward positive", r"\theta"),
    *_of_legs("l", "m", "length of {}'s knee", "l"),
    *(Quantity(f"q_{i}", "m or rad", f"position {i} of the tree, as MuJoCo's qpos") for i in range(NQ)),
    *_of_legs("P_hip", "W", "mechanical power of {}'s hip", r"P_\mathrm{hip}"),
    *_of_legs("P_knee", "W", "mechanical power of {}'s knee", r"P_\mathrm{knee}"),
)


def observed(params: Params, state: State) -> dict[str, jax.Array]:
    """The observables of a state at the end of LF's cycle."""
    c = state.cycle
    mean, landed = c.average.shifts()
    pairs = {"delta_{}": c.shifts()[0], "delta_{}_mean": mean, "delta_{}_touchdown": landed}
    lengths = c.average.lengths().min(axis=1)
    once, twice = c.average.pitch_shares()
    of_legs = {
        "since": c.clock - c.onset,
        "late_load": c.late_load,
        "stance_load": c.stance_load,
        "late_pitch": c.late_pitch,
        "stance_pitch": c.stance_pitch,
    }
    weight = params.mechanics.total_mass() * params.mechanics.g
    travelled = jnp.abs(c.speed)
    moves = travelled > 0.0
    cost = jnp.where(moves, c.power.sum() / (weight * jnp.where(moves, travelled, 1.0)), 0.0)
    between = mean[2] + 0.5 * (mean[1] - mean[0])
    return {
        **{name.format(i + 1): values[i] for name, values in pairs.items() for i in range(len(PAIRS))},
        "speed": c.speed,
        "period": c.period[LF],
        "flight": c.flight,
        "antiphase": between - jnp.floor(between),
        "length": lengths[0],
        "length_touchdown": lengths[1],
        "variation": c.average.variation(),
        "pitch_mean": c.pitch_mean,
        "pitch_range": c.pitch_range,
        "pitch_once": once,
        "pitch_twice": twice,
        **{f"{name}_{leg}": values[i] for name, values in of_legs.items() for i, leg in enumerate(LEGS)},
        "power_hip": c.power[0],
        "power_knee": c.power[1],
        "cost_of_transport": cost,
    }


def signalled(params: Params, state: State) -> dict[str, jax.Array]:
    """The signals of a state."""
    s = state
    swings = swinging(s.u)
    tau = forces_on_joints(*params.motors.forces(swings, s.q[HIP], s.q[KNEE]))
    hip, knee = joint_powers(tau, params.mechanics.damping(swings), s.v)
    of_legs = {"u_f": s.u[FLEXOR], "F": s.load, "theta": s.q[HIP], "l": s.q[KNEE]}
    of_legs |= {"P_hip": hip, "P_knee": knee}
    down = (s.load > 0.0).astype(s.q.dtype)
    return {
        **{f"{name}_{leg}": values[i] for name, values in of_legs.items() for i, leg in enumerate(LEGS)},
        **{f"contact_{i + 1}": down[i] for i in range(len(LEGS))},
        "x": s.q[X],
        "z": s.q[Z],
        "pitch": s.q[PITCH],
        "speed": s.v[X],
        **{f"q_{i}": s.q[i] for i in range(NQ)},
    }
