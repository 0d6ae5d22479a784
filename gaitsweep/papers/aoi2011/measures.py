"""The measures of Aoi, Yamashita and Tsuchiya 2011: its equations, and hysteresis, return maps and footfalls.

Equations are compared with what the model computes, at random states: by formulas written out here, or by
MuJoCo, which shares nothing with gaitsweep's equations of motion but the description of the body.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from gaitsweep.analyses import (
    TURN,
    AnalysisError,
    fixed_points,
    mean_direction,
    require,
    stable_ranges,
    transition_points,
    transition_points_by_gait,
    unwrap_from,
    wrapped_difference,
)
from gaitsweep.claims import (
    Condition,
    defaults,
    masked,
    measure,
    records,
    row_params,
    stances,
    stored_job,
    value,
)
from gaitsweep.dynamics.tree import movements, places, rates, turned, velocity
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.papers.aoi2011.waist_quadruped.drawing import scaled_mjcf
from gaitsweep.papers.aoi2011.waist_quadruped.foot_path import LATE
from gaitsweep.papers.aoi2011.waist_quadruped.mechanics import HIP, KNEE, LIMBS, WAIST, body
from gaitsweep.papers.aoi2011.waist_quadruped.rhythm import after_events, phase_rates, transitions
from gaitsweep.papers.aoi2011.waist_quadruped.state import State

MODEL = WaistQuadruped()
STATES = 20  # random states at which an equation is tested
# largest relative deviation of the times between touchdowns from one cycle, where a foot lands once a cycle
_ONCE = 0.2


# ---- constants and equations -----------------------------------------------------------------------------


@measure
def degrees_of_freedom() -> float:
    """Number of degrees of freedom of the waist quadruped."""
    return float(body()[0].nv)


@measure
def nominal_gait(*, beta: float) -> list[float]:
    """Duty factor, frequency (rad/s), stride (m) and speed (m/s) of eq. (3), from the model's oscillators."""
    p = _params(beta=beta)
    cycle = TURN / float(p.omega)
    stance = cycle - float(p.T_sw)
    return [stance / cycle, float(p.omega), cycle / stance * float(p.D), float(p.D) / stance]


@measure
def phase_rate_error() -> float:
    """Largest difference (rad/s) of the oscillators' rates from eq. (2) with eq. (6)."""
    rng, worst = np.random.default_rng(1), 0.0
    pairs = [(i, j) for i in range(4) for j in range(4) if i != j]
    for _ in range(STATES):
        gains = {
            f"K_{i + 1}{j + 1}": gain for (i, j), gain in zip(pairs, rng.uniform(0.0, 20.0, 12), strict=True)
        }
        leads = {f"delta_star_{i + 1}{j + 1}": rng.uniform(0.0, TURN) for i, j in pairs if i < j}
        p, phi = _params(**gains, **leads), rng.uniform(0.0, TURN, 4)
        wanted = np.full(4, float(p.omega))
        for i, j in pairs:
            lead = leads[f"delta_star_{min(i, j) + 1}{max(i, j) + 1}"] * (1.0 if i < j else -1.0)
            wanted[i] -= gains[f"K_{i + 1}{j + 1}"] * math.sin(phi[i] - phi[j] - lead)
        computed = phase_rates(p, _state(phi=jnp.asarray(phi)), jnp.zeros(()))
        worst = max(worst, float(np.max(np.abs(np.asarray(computed) - wanted))))
    return worst


@measure
def reset_error() -> float:
    """Largest difference (rad) of the phase after a landing from phi_AEP, eq. (7)."""
    p, worst = _params(), 0.0
    aep = float(p.phi_AEP)
    for phase in np.linspace(0.51, 0.99, STATES) * aep:
        s = _state(phi=jnp.full(4, phase), segment=jnp.full(4, LATE), contact=jnp.zeros(4, bool),
                   lifted=jnp.ones(4, bool))  # fmt: skip
        now = transitions(s, jnp.zeros(4, bool), jnp.ones(4, bool))
        after = after_events(p, s, now, (s.landing_x, s.landing_z), 0.0)
        worst = max(worst, float(np.max(np.abs(np.asarray(after.phi) - aep))))
    return worst


@measure
def waist_constants(*, f: float) -> list[float]:
    """Stiffness and damping of the waist as shares of kappa_0 (2 pi f)^2 and 2 kappa_0 zeta_0 (2 pi f)."""
    p, values = _params(f=f), _defaults()
    rate = TURN * f
    spring, damper = values["kappa_0"] * rate**2, 2.0 * values["kappa_0"] * values["zeta_0"] * rate
    return [float(p.mechanics.kappa_w) / spring, float(p.mechanics.sigma_w) / damper]


@measure
def torque_error(*, joints: str) -> float:
    """Largest difference (N m) of the torques of the `waist`, eq. (A6), or the `limbs`, eq. (4)."""
    m, worst = _params().mechanics, 0.0
    for q, v in _moments():
        x, z = jnp.full(4, 0.01), jnp.full(4, -0.12)
        tau = np.asarray(m.torques(jnp.asarray(q), jnp.asarray(v), x, z))
        if joints == "waist":
            wanted = {WAIST - 1: -float(m.kappa_w) * q[WAIST] - float(m.sigma_w) * v[WAIST - 1]}
        else:
            wanted = {}
            for i in LIMBS:
                hip, knee = _by_cosines(0.01, -0.12, float(m.link_length), float(m.bends[i]))
                for at, angle, k, s in (
                    (HIP[i], hip, m.kappa_1, m.sigma_1),
                    (KNEE[i], knee, m.kappa_2, m.sigma_2),
                ):
                    wanted[at - 1] = -float(k) * (q[at] - angle) - float(s) * v[at - 1]
        worst = max(worst, *(abs(tau[at] - value) for at, value in wanted.items()))
    return worst


@measure
def ground_force_error() -> float:
    """Largest difference (N) of the force on a foot from eq. (A8), in contact and off the ground."""
    p, rng, worst = _params(), np.random.default_rng(3), 0.0
    m = p.mechanics
    for _ in range(STATES):
        at, speed, anchor = (
            rng.normal(0.0, 1e-3, (4, 3)),
            rng.normal(0.0, 0.1, (4, 3)),
            rng.normal(0.0, 1e-3, (4, 2)),
        )
        contact = at[:, 2] <= 0.0
        sunk = at - np.concatenate([anchor, np.zeros((4, 1))], axis=1)
        wanted = np.where(contact[:, None], -float(m.K_TL) * sunk - float(m.D_TL) * speed, 0.0)
        computed = m.ground_forces(
            jnp.asarray(at), jnp.asarray(speed), jnp.asarray(anchor), jnp.asarray(contact)
        )
        worst = max(worst, float(np.max(np.abs(np.stack([f.force for f in computed]) - wanted))))
    return worst


@measure
def angular_velocity_error() -> float:
    """Largest error (1/s) of the quaternion's rate against the 3-1-2 Euler angles of eq. (A1) and (A2)."""
    rng, step, worst = np.random.default_rng(4), 1e-6, 0.0

    def quaternion(angles: np.ndarray) -> np.ndarray:
        return Rotation.from_euler("ZXY", angles[[2, 0, 1]]).as_quat(scalar_first=True)

    for _ in range(STATES):
        angles, turning = rng.uniform(-1.0, 1.0, 3), rng.normal(0.0, 2.0, 3)
        (s1, c1), (s2, c2) = ((math.sin(a), math.cos(a)) for a in angles[:2])
        b = np.array([[c2, 0.0, -c1 * s2], [0.0, 1.0, s1], [s2, 0.0, c1 * c2]])
        q = np.concatenate([np.zeros(3), quaternion(angles), np.zeros(9)])
        v = np.concatenate([np.zeros(3), b @ turning, np.zeros(9)])
        moved = (quaternion(angles + step * turning) - quaternion(angles - step * turning)) / (2.0 * step)
        computed = np.asarray(rates(body()[0], jnp.asarray(q), jnp.asarray(v)))[3:7]
        worst = max(worst, float(np.max(np.abs(computed - moved))))
    return worst


@measure
def mechanics_error(*, of: str) -> float:
    """Largest relative difference of `kinetic_energy`, `feet` or `accelerations` from MuJoCo's.

    Eq. (A3), (A7), (1). Accelerations are those under gravity, joint torques and forces on the feet.
    """
    p = _params()
    m, rng = p.mechanics, np.random.default_rng(5)
    by = mujoco.MjModel.from_xml_string(scaled_mjcf(_defaults()))
    data, worst = mujoco.MjData(by), 0.0
    functions = _mechanics()
    for q, v in _moments():
        data.qpos, data.qvel = q, v
        tau, forces = rng.normal(0.0, 1.0, 15), rng.normal(0.0, 10.0, (4, 3))
        mujoco.mj_forward(by, data)
        if of == "kinetic_energy":
            mujoco.mj_energyVel(by, data)
            computed, wanted = np.array([functions[of](m, q, v)]), np.array([data.energy[1]])
        elif of == "feet":
            computed = np.asarray(functions[of](m, q, v))
            wanted = np.stack([data.site(f"foot_{i + 1}").xpos for i in LIMBS])
        else:
            data.qfrc_applied = tau
            for i in LIMBS:
                site, jacobian = data.site(f"foot_{i + 1}").id, np.zeros((3, by.nv))
                mujoco.mj_jacSite(by, data, jacobian, None, site)
                data.qfrc_applied += jacobian.T @ forces[i]
            mujoco.mj_forward(by, data)
            computed, wanted = np.asarray(functions["accelerations"](m, q, v, tau, forces)), data.qacc
        worst = max(worst, float(np.max(np.abs(computed - wanted)) / np.max(np.abs(wanted))))
    return worst


def _mechanics() -> dict[str, Any]:
    def accelerations(m: Any, q: Any, v: Any, tau: Any, forces: Any) -> Any:
        zero = jnp.zeros((4, 3))
        placed = m.ground_forces(zero, zero, zero[:, :2], jnp.zeros(4, bool))
        pushed = [dataclasses.replace(push, force=force) for push, force in zip(placed, forces, strict=True)]
        return m.accelerations(q, v, tau, pushed)

    return {
        "kinetic_energy": jax.jit(lambda m, q, v: _kinetic_energy(m.geometry(), q, v)),
        "feet": jax.jit(lambda m, q, v: m.feet(q, v)[0]),
        "accelerations": jax.jit(accelerations),
    }


def _kinetic_energy(geometry: Any, q: Any, v: Any) -> Any:
    """The kinetic energy of the bodies and links, J."""
    placed, total = places(body()[0], geometry, q), 0.0
    for i, (place, moving) in enumerate(zip(placed, movements(body()[0], placed, v), strict=True)):
        speed, w = velocity(place, moving, geometry.com[i]), moving.angular
        spin = w @ turned(place.turn, geometry.inertia[i]) @ w
        total = total + 0.5 * (geometry.mass[i] * (speed @ speed) + spin)
    return total


@cache
def _defaults() -> dict[str, float]:
    return defaults(MODEL.parameters)


def _params(**changed: float) -> Any:
    values = {**_defaults(), **changed}
    return MODEL.params({name: jnp.asarray(value) for name, value in values.items()})


def _state(**changed: Any) -> State:
    """A state that is zero except for the given values."""
    zeros = {field.name: jnp.zeros(()) for field in dataclasses.fields(State)}
    zeros |= {name: jnp.zeros(4) for name in ("landing_x", "landing_z", "height", "gain")}
    zeros |= {"q": jnp.zeros(16), "v": jnp.zeros(15)}
    flags = {"contact": jnp.zeros(4, bool), "lifted": jnp.zeros(4, bool), "segment": jnp.zeros(4, int)}
    return State(**{**zeros, **flags, **changed})


def _moments() -> list[tuple[np.ndarray, np.ndarray]]:
    """Random positions and velocities of the whole body."""
    rng, moments = np.random.default_rng(2), []
    for _ in range(STATES):
        turn = Rotation.from_euler("ZXY", rng.uniform(-0.5, 0.5, 3)).as_quat(scalar_first=True)
        q = np.concatenate([rng.normal(0.0, 0.2, 3), turn, rng.uniform(-0.8, 0.8, 9)])
        moments.append((q, rng.normal(0.0, 1.0, 15)))
    return moments


def _by_cosines(x: float, z: float, link: float, bend: float) -> tuple[float, float]:
    """Hip and knee angles of a limb of two equal links with its foot at (x, z), by the law of cosines."""
    inner = math.acos(min(math.hypot(x, z) / (2.0 * link), 1.0))
    return math.atan2(-x, -z) - bend * inner, 2.0 * bend * inner


# ---- hysteresis, return maps and branches ----------------------------------------------------------------


@measure
def transition_at(
    table: pd.DataFrame, *, observable: str, parameter: str, direction: str, least: float = 0.15
) -> float:
    """Middle of the interval in which a ramp or staircase jumps as the parameter is `rising` or `falling`."""
    points = transition_points(table, observable, parameter, least)
    points_of_direction = points.loc[points["direction"] == direction]
    return _first_middle(points_of_direction, f"No row jumps as {parameter} is {direction}.")


@measure
def hysteresis_widths(
    table: pd.DataFrame, *, observable: str, parameter: str, by: str | None = None
) -> list[float]:
    """Transition point of the rising pass less that of the falling one, for each value of `by`."""
    points = transition_points(table, observable, parameter, by=[] if by is None else [by])
    middle = (points["low"] + points["high"]) / 2.0
    groups = sorted(table[by].dropna().unique()) if by is not None else [None]
    widths = []
    for group in groups:
        in_group = points["direction"].notna() if group is None else points[by] == group
        ways = {way: middle[in_group & (points["direction"] == way)] for way in ("rising", "falling")}
        if any(way.empty for way in ways.values()):
            place = "" if group is None else f" at {by} = {group:g}"
            raise AnalysisError(f"The observable does not jump in each direction{place}.")
        widths.append(float(ways["rising"].iloc[0] - ways["falling"].iloc[0]))
    return widths


@measure
def ranges_of_both(
    table: pd.DataFrame, *, observable: str, parameter: str, apart: float, by: str
) -> list[float]:
    """Length of the parameter's range in which settled holds are apart, for each value of `by`.

    Args:
        table: a staircase's table.
        observable: an angle, whose two values at one parameter differ by more than `apart` (rad).
        parameter: the parameter that moves; each of its values stands for one stair.
        by: the column of the groups.
    """
    settled = table.loc[table["settled"].astype(bool)]
    stairs = settled[parameter].round(9)
    stair = float(np.diff(np.unique(stairs.to_numpy())).min())
    lengths = dict.fromkeys(sorted(table[by].unique()), 0.0)
    for place, holds in settled.groupby([settled[by], stairs]):
        angles = holds[f"{observable}_n"].to_numpy(float)
        if np.ptp(wrapped_difference(angles - angles[0])) > apart:
            lengths[place[0]] += stair
    return list(lengths.values())


@measure
def gait_lost_at(
    table: pd.DataFrame, *, parameter: str, gait: str, direction: str, start: str = "delta_13"
) -> float:
    """Middle of the interval of the parameter in which settled rows lose a gait."""
    points = transition_points_by_gait(table, parameter, start)
    losses = points.loc[(points["gait"] == gait) & (points["direction"] == direction)]
    return _first_middle(losses, f"The gait {gait} is not lost as {parameter} is {direction}.")


def _first_middle(points: pd.DataFrame, without: str) -> float:
    """The middle of the first interval; an AnalysisError with the sentence `without` if there is none."""
    if points.empty:
        raise AnalysisError(without)
    return float((points["low"].iloc[0] + points["high"].iloc[0]) / 2.0)


@measure
def kinds_of_fixed_points(
    table: pd.DataFrame, *, observable: str, parameter: str, at: float, bandwidth: float | None = None
) -> list[str]:
    """Kinds of the fixed points of the return map at a value of the parameter, in order of the observable."""
    points = fixed_points(table, observable, parameter, bandwidth)
    at_value = np.flatnonzero(np.isclose(points[parameter].to_numpy(float), at))
    order = at_value[np.argsort(points["value"].to_numpy(float)[at_value])]
    return ["stable" if points["stable"].iloc[k] else "unstable" for k in order]


@measure
def stable_until(
    table: pd.DataFrame,
    *,
    observable: str,
    parameter: str,
    between: Sequence[float],
    take: str,
    bandwidth: float | None = None,
) -> float:
    """Largest (`max`) or smallest (`min`) parameter at which the return map has a stable point in a range."""
    points = fixed_points(table, observable, parameter, bandwidth)
    low, high = between
    value, stable = points["value"].to_numpy(float), points["stable"].to_numpy(bool)
    stable_values = points[parameter].to_numpy(float)[stable & (value >= low) & (value <= high)]
    if not stable_values.size:
        raise AnalysisError(f"No stable fixed point has {observable} between {low:g} and {high:g}.")
    return float(stable_values.max() if take == "max" else stable_values.min())


@measure
def share_with_unstable_between(
    table: pd.DataFrame, *, observable: str, parameter: str, bandwidth: float | None = None
) -> float:
    """Share of the parameter values with two stable fixed points that have an unstable one between (1)."""
    points = fixed_points(table, observable, parameter, bandwidth)
    several = [
        [bool(stable) for stable in points_at_value.sort_values("value")["stable"]]
        for _, points_at_value in points.groupby(parameter)
        if np.count_nonzero(points_at_value["stable"].to_numpy(bool)) >= 2
    ]
    if not several:
        raise AnalysisError("No value of the parameter has two stable fixed points.")
    return sum(not all(kinds) and kinds[0] and kinds[-1] for kinds in several) / len(several)


@measure
def gaits_of_branch(table: pd.DataFrame, *, parameter: str) -> list[str]:
    """Gaits of the stable pieces of the first branch of a continuation, in the order in which they follow."""
    pieces = stable_ranges(table, parameter)
    return list(dict.fromkeys(pieces.loc[pieces["row"] == pieces["row"].min(), "gait"].astype(str)))


@measure
def gap_of_edges(
    table: pd.DataFrame, *, parameter: str, upper: str, lower: str, start: str = "delta_13"
) -> float:
    """Width of the range in which both gaits persist: the edge of `upper` minus that of `lower`."""
    lost = {
        gait: gait_lost_at(table, parameter=parameter, gait=gait, direction=way, start=start)
        for gait, way in ((upper, "rising"), (lower, "falling"))
    }
    return lost[upper] - lost[lower]


@measure
def directions_of_loss(*tables: pd.DataFrame, observable: str, parameters: Sequence[str]) -> list[str]:
    """Direction of each table's parameter in which the observable jumps down."""
    directions = []
    for table, parameter in zip(tables, parameters, strict=True):
        points = transition_points(table, observable, parameter)
        down = points.loc[points["size"] < 0.0, "direction"]
        if down.empty:
            raise AnalysisError(f"{observable} does not jump down as {parameter} moves.")
        directions.append(str(down.iloc[0]))
    return directions


@measure
def least_change_of_transition(
    *tables: pd.DataFrame, observable: str, parameter: str, by: Sequence[str]
) -> float:
    """Smallest, over the tables and both directions, of the range of transition points within a table."""
    ranges = []
    for table, column in zip(tables, by, strict=True):
        points = transition_points(table, observable, parameter, by=[column])
        middle = (points["low"] + points["high"]) / 2.0
        ranges += [float(np.ptp(middle[points["direction"] == way])) for way in ("rising", "falling")]
    return min(ranges)


# ---- values of gaits -------------------------------------------------------------------------------------


@measure
def means_of_feet(table: pd.DataFrame, *, column: str, where: Condition | None = None) -> list[float]:
    """Mean of a column of each of the four feet, in its unit.

    Args:
        table: a return map's table.
        column: the column, with {} in place of the foot's number.
        where: a condition that selects records.
    """
    return [value(table, column=column.replace("{}", f"{i + 1}"), where=where, take="mean") for i in LIMBS]


@measure
def spread_over(table: pd.DataFrame, *, column: str, over: str, where: Condition) -> float:
    """Range of the medians of a column at the values of another, in its unit."""
    part = records(table, where)
    require(part, column, over)
    return float(np.ptp(part.groupby(over)[column].median()))


@measure
def difference_of_gaits(
    table: pd.DataFrame, other: pd.DataFrame, *, observable: str, where: Condition, gaits: Sequence[str]
) -> float:
    """Largest difference (rad) of the median of an angle in each gait, between a settle table and holds."""
    worst, chosen = 0.0, records(other, where)
    for gait in gaits:
        one = value(masked(table, table["gait"] == gait), column=f"{observable}_end")
        two = value(masked(chosen, chosen["gait"] == gait), column=f"{observable}_n")
        worst = max(worst, abs(float(wrapped_difference(one - two))))
    return worst


# ---- motion of steady gaits ------------------------------------------------------------------------------


@measure
def farthest_angle(
    table: pd.DataFrame, *, column: str, centre: float, where: Condition | None = None
) -> float:
    """Largest distance (rad) of an angle from a centre."""
    part = records(table, where)
    require(part, column)
    away = np.abs(wrapped_difference(part[column].dropna().to_numpy(float) - centre))
    if not away.size:
        raise AnalysisError(f"No record has a value of {column}.")
    return float(away.max())


@measure
def gait_kept(table: pd.DataFrame, *, gait: str) -> float:
    """Share of the rows with a gait on the first stair that have it on every stair (1)."""
    require(table, "row", "stair", "gait")
    shown = table.assign(same=table["gait"].astype(str) == gait)
    first = shown.loc[shown["stair"] == shown["stair"].min()]
    rows = first.loc[first["same"], "row"]
    if rows.empty:
        raise AnalysisError(f"No row has the gait {gait} on the first stair.")
    always_same = shown.loc[shown["row"].isin(rows)].groupby("row")["same"].all()
    return float(np.mean(always_same.to_numpy()))


@measure
def drift_from_start(table: pd.DataFrame, *, start: str, end: str, where: Condition | None = None) -> float:
    """Largest distance (rad) between an angle at the start of a row and at its end."""
    part = records(table, where)
    require(part, start, end)
    moved = np.abs(wrapped_difference(part[end].to_numpy(float) - part[start].to_numpy(float)))
    return float(np.max(moved))


@measure
def sideways_share(table: pd.DataFrame) -> float:
    """Largest distance from the line between begin and end of a trace, as a share of its length (1)."""
    require(table, "row", "t", "q_0", "q_1")
    worst = 0.0
    for _, part in table.groupby("row"):
        part = part.sort_values("t")
        way = part[["q_0", "q_1"]].to_numpy(float)
        cycle = max(round(0.4 / float(np.median(np.diff(part["t"].to_numpy(float))))), 1)
        # averaged over a cycle, in which the body sways
        way = np.stack([np.convolve(way[:, k], np.full(cycle, 1.0 / cycle), "valid") for k in (0, 1)], axis=1)
        line = way[-1] - way[0]
        length = float(np.hypot(*line))
        off = (way - way[0]) @ np.array([-line[1], line[0]]) / length
        worst = max(worst, float(np.max(np.abs(off))) / length)
    return worst


@measure
def foot_slip(table: pd.DataFrame, *, take: str = "median") -> float:
    """Distance (m) that a foot moves along the ground in a stance: `median` or `max` of all stances.

    A foot that bounces is still in its stance; the time off the ground does not count.
    """
    require(table, "row", "t", *(f"q_{i}" for i in range(16)))
    design = stored_job(table.attrs).design
    feet = jax.jit(jax.vmap(lambda m, q: m.feet(q, jnp.zeros(15))[0], in_axes=(None, 0)))
    moved = []
    for row, part in table.groupby("row"):
        part = part.sort_values("t")
        t, mechanics = part["t"].to_numpy(float), row_params(design, int(str(row))).mechanics
        at = np.asarray(feet(mechanics, jnp.asarray(part[[f"q_{i}" for i in range(16)]].to_numpy(float))))
        for i in LIMBS:
            down = part[f"contact_{i + 1}"].to_numpy(float) > 0.5
            for first, last in stances(t, down):
                ground = at[first:last, i, :2][down[first:last]]
                moved.append(float(np.max(np.linalg.norm(ground - ground[0], axis=1))))
    return float(np.max(moved) if take == "max" else np.median(moved))


@measure
def touchdown_lags(
    table: pd.DataFrame,
    *,
    row: int,
    pairs: Sequence[Sequence[int]],
    window: Sequence[float] | None = None,
    near: Sequence[float] | None = None,
) -> list[float]:
    """Phase (rad) by which foot i of each pair [i, j] touches down before foot j.

    Args:
        table: a trace.
        row: its row.
        pairs: numbers of feet.
        window: begin and end of the time that is used, s.
        near: for each pair, the middle of the turn in which its phase is given, rad; pi without it.

    Raises:
        AnalysisError: a foot touches down less or more than once a cycle.
    """
    if window is not None:
        t = table["t"].to_numpy(float)
        table = table.loc[(t >= window[0]) & (t <= window[1])]
    lags = []
    for (i, j), middle in zip(pairs, near or [math.pi] * len(pairs), strict=True):
        first, second = _touchdowns(table, row, i), _touchdowns(table, row, j)
        cycle = float(np.median(np.diff(first)))
        for foot, times in ((i, first), (j, second)):
            if np.max(np.abs(np.diff(times) / cycle - 1.0)) > _ONCE:
                raise AnalysisError(f"Foot {foot} of row {row} does not touch down once a cycle.")
        after = second[:, None] - first[None, :]
        lag = np.asarray(mean_direction(TURN * (after / cycle).ravel()))
        lags.append(float(unwrap_from(lag, middle - math.pi)))
    return lags


@measure
def order_of_footfalls(table: pd.DataFrame, *, row: int, apart: float = 0.2) -> str:
    """Limbs in their order of touchdown from limb 1 on; those within `apart` (rad) joined by +."""
    lags = touchdown_lags(table, row=row, pairs=[[1, 2], [1, 3], [1, 4]], near=[math.pi - apart] * 3)
    order = sorted(zip([0.0, *lags], "1234", strict=True))
    together = [[order[0][1]]]
    for (before, _), (after, limb) in itertools.pairwise(order):
        if after - before > apart:
            together.append([])
        together[-1].append(limb)
    return "-".join("+".join(sorted(limbs)) for limbs in together)


def _touchdowns(table: pd.DataFrame, row: int, foot: int) -> np.ndarray:
    """Times (s) at which a swing of a foot ends; breaks of a stance do not count as swings."""
    require(table, "row", "t", f"contact_{foot}")
    part = table.loc[table["row"].to_numpy() == row].sort_values("t")
    t, down = part["t"].to_numpy(float), part[f"contact_{foot}"].to_numpy(float) > 0.5
    # without its lift-off before it, the first stance is not known to begin with a touchdown
    lands = stances(t, down)[1:, 0]
    if len(lands) < 2:
        raise AnalysisError(f"Foot {foot} of row {row} has fewer than two touchdowns.")
    return t[lands]
