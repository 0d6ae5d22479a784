"""Measures of the paper's claims, beside the general measures such as `share` and `value`."""

import functools

import numpy as np
import pandas as pd

import gaitsweep as gs

_COORDINATES = ("theta_s", "theta_s_dot", "theta_ns_dot")


@gs.claims.measure
def goswami1998_least_slope(table: pd.DataFrame, *, column: str) -> float:
    """Least change of a column over the slope of the ground, along the stable part of a branch (unit/deg)."""
    stable = table.loc[table["stable"].fillna(False).astype(bool)].sort_values("phi")
    if len(stable) < 2:
        raise gs.UserError("The branch has less than two stable points.")
    return float(np.min(np.diff(stable[column]) / np.diff(stable["phi"])))


@gs.claims.measure
def goswami1998_energy_error(table: pd.DataFrame, *, mass: float, g: float) -> float:
    """Largest difference (J) of a strike's loss from the work of gravity in a step, along a branch.

    The work is mass g sin(phi) times the length of the step.
    """
    fixed = table.dropna(subset=["loss_n"])
    work = mass * g * np.sin(np.deg2rad(fixed["phi"])) * fixed["step_length_n"]
    return float(np.abs(fixed["loss_n"] - work).max())


@gs.claims.measure
def goswami1998_steps_differ_from(table: pd.DataFrame, *, apart: float = 1e-3) -> float:
    """The least slope (deg) on which the periods of a row's steps differ by more than `apart` (s)."""
    rows = table.groupby("phi")["T_n"].agg(["min", "max"])
    differ = rows.index[np.asarray(rows["max"] - rows["min"] > apart)]
    if not len(differ):
        raise gs.UserError(f"No row has steps whose periods differ by more than {apart:g} s.")
    return float(differ.min())


@gs.claims.measure
def goswami1998_doublings(*tables: pd.DataFrame) -> list[float]:
    """The slope (deg) of the first flip of each branch."""
    return [_first_flip(table) for table in tables]


@gs.claims.measure
def goswami1998_last_ratio(*tables: pd.DataFrame) -> float:
    """The ratio of the last two distances between successive doublings, first flips of branches (1)."""
    before, between = np.diff([_first_flip(table) for table in tables])[-2:]
    return float(before / between)


@gs.claims.measure
def goswami1998_gaits_at_most(table: pd.DataFrame, *, below: float = 90.0, apart: float = 1e-3) -> float:
    """The number of gaits on the slope that has most, among slopes below `below` (deg).

    Gaits of one step differ if their periods do, by more than `apart` (s); others if they repeat after
    another number of steps. Rows that neither fell nor settled count as one more gait.
    """
    most = 0
    for _, rows in table.loc[table["phi"] < below].groupby("phi"):
        settled = rows.loc[np.asarray(rows["status"] == "settled")]
        one = np.sort(settled.loc[settled["attractor_period"] == 1, "T_end"])
        gaits = int(len(one) > 0) + int(np.sum(np.diff(one) > apart))
        gaits += settled.loc[settled["attractor_period"] > 1, "attractor_period"].nunique()
        gaits += bool((rows["status"] == "cycle_limit").any())
        most = max(most, gaits)
    return float(most)


@gs.claims.measure
def goswami1998_closest_steps(table: pd.DataFrame, *, phi: float) -> float:
    """The least distance of two steps of a row: the largest difference of coordinates (rad, rad/s)."""
    at = _points(table, phi)
    return min(float(np.abs(at[k + 1 :] - at[k]).max(axis=1).min()) for k in range(len(at) - 1))


@gs.claims.measure
def goswami1998_exponent(table: pd.DataFrame, *, phi: float) -> float:
    """The largest Lyapunov exponent along a row's steps (1/step)."""
    jacobians = _jacobians(_points(table, phi)[:400].tobytes(), phi)
    direction, grown = np.ones(len(_COORDINATES)), 0.0
    for each in jacobians:
        direction = each @ direction
        size = np.linalg.norm(direction)
        direction, grown = direction / size, grown + np.log(size)
    return float(grown / len(jacobians))


@gs.claims.measure
def goswami1998_contraction(table: pd.DataFrame, *, phi: float) -> float:
    """The factor by which a step changes a small volume of the section, the geometric mean of a row (1)."""
    jacobians = _jacobians(_points(table, phi)[:400].tobytes(), phi)
    return float(np.exp(np.mean(np.log(np.abs(np.linalg.det(jacobians))))))


def _first_flip(table: pd.DataFrame) -> float:
    flips = table.loc[np.asarray(table["special"] == "flip"), "phi"]
    if flips.empty:
        raise gs.UserError("The branch has no flip.")
    return float(flips.iloc[0])


def _points(table: pd.DataFrame, phi: float) -> np.ndarray:
    """The coordinates (n, 3) of the steps of the row on one slope."""
    row = table.loc[np.isclose(table["phi"], phi) & np.asarray(table["status"] == "complete")]
    if row.empty:
        raise gs.UserError(f"No row walks on at phi = {phi:g} deg.")
    return row[[f"{name}_n" for name in _COORDINATES]].to_numpy(float)


@functools.cache  # two claims ask for the same ones, which take seconds
def _jacobians(points: bytes, phi: float) -> np.ndarray:
    """The derivative of the step at each point (n, 3, 3)."""
    at = np.frombuffer(points).reshape(-1, len(_COORDINATES))
    return gs.return_map("goswami1998", phi=phi).jacobian(at)
