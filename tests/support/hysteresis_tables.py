"""Tables of a map with two branches, known in closed form, as runs leave them: for analyses and figures.

The relative phase is delta = CENTRE + SCALE x, and from crossing to crossing x' = x + eps (f + x - x^3): the
normal form of two folds, at f = +-FOLD. Between them two fixed points are stable and one is not, where
f + x - x^3 = 0, with slope 1 + eps (1 - 3 x^2). Let the parameter rise and fall slowly through all: the upper
branch is lost as it falls through -FOLD, the lower one as it rises through +FOLD, and the area between them
is the integral of x df = (3 x^2 - 1) x dx along both, 3/2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

TURN = 2 * np.pi
FOLD = 2 / (3 * np.sqrt(3))
SCALE, AREA = 0.3, 1.5
CENTRE = 2.6  # rad: the branches lie from 2.2 to 3.0 rad
STATUSES = ["settled", "cycle_limit", "fell", "complete"]
QUANTITIES = {
    "f": {"unit": "Hz", "meaning": "stiffness frequency of the joint", "symbol": "f", "circular": False},
    "delta_13": {
        "unit": "rad",
        "meaning": "phase of the fore leg ahead of the hind leg",
        "symbol": r"\Delta_{13}",
        "circular": True,
    },
}


def roots(f: float) -> np.ndarray:
    """The fixed points x at a value of the parameter, ascending."""
    result = np.roots([-1.0, 0.0, 1.0, f])
    return np.sort(result[np.abs(result.imag) < 1e-9].real)


def delta(x: np.ndarray | float, centre: float = CENTRE) -> np.ndarray:
    return np.mod(centre + SCALE * np.asarray(x), TURN)


def ramp_table(
    rows: int = 1,
    *,
    steps: int = 4000,
    eps: float = 0.2,
    noise: float = 0.0,
    centre: float = CENTRE,
    top: float = 0.8,
) -> pd.DataFrame:
    """The parameter from -top to top and back, `steps` crossings a pass, after 30 crossings at -top."""
    way = np.linspace(-top, top, steps + 1)
    f = np.concatenate([np.full(30, -top), way, way[-2::-1]])
    passes = np.where(np.arange(len(f)) <= 30 + steps, 0, 1)
    parts = []
    for row in range(rows):
        random = np.random.default_rng(row)
        x = np.empty(len(f))
        x[0] = roots(-top)[0] - 0.5  # a start off the branch: a transient
        for n in range(1, len(f)):
            x[n] = x[n - 1] + eps * (f[n - 1] + x[n - 1] - x[n - 1] ** 3) + noise * random.normal()
        parts.append(
            pd.DataFrame(
                {
                    "row": row,
                    "crossing": np.arange(1, len(f) + 1),
                    "pass": passes,
                    "f": f,
                    "t": 0.4 * np.arange(1, len(f) + 1),
                    "status": pd.Categorical(["complete"] * len(f), STATUSES),
                    "delta_13_n": delta(x, centre),
                }
            )
        )
    return with_attrs(pd.concat(parts, ignore_index=True), "ramp", [-top, top, -top])


def staircase_table(
    rows: int = 1, *, stairs: int = 17, hold: int = 400, centre: float = CENTRE, top: float = 0.8
) -> pd.DataFrame:
    """The parameter held for `hold` crossings at each of `stairs` values up and again down."""
    up = np.linspace(-top, top, stairs)
    values = np.concatenate([up, up[-2::-1]])
    records = []
    for row in range(rows):
        before, x, shift = -1.2, -1.2, 0.01 * row  # rows differ a little in where their folds lie
        for stair, f in enumerate(values):
            for _ in range(hold):
                before, x = x, x + 0.2 * (f + shift + x - x**3)
            settled = bool(abs(x - before) < 1e-4)
            gait = "walk" if x < 0 else "trot"
            number = (stair + 1) * hold
            records.append(
                [
                    row,
                    stair,
                    int(stair >= stairs),
                    f,
                    0.4 * number,
                    number,
                    settled,
                    "complete",
                    delta(x, centre),
                    gait,
                ]
            )
    columns = ["row", "stair", "pass", "f", "t", "crossing", "settled", "status", "delta_13_n", "gait"]
    table = pd.DataFrame(records, columns=columns).astype({"delta_13_n": float})
    table["status"] = pd.Categorical(table["status"], STATUSES)
    table["gait"] = pd.Categorical(table["gait"], ["trot", "walk", "none"])
    return with_attrs(table, "staircase", [-top, top, -top])


def map_table(
    values: Sequence[float] | np.ndarray = (0.0,),
    *,
    starts: int = 30,
    crossings: int = 40,
    eps: float = 0.05,
    noise: float = 0.0,
    seed: int = 0,
    centre: float = CENTRE,
) -> pd.DataFrame:
    """Crossings of `starts` starts, x from -1.5 to 1.5, at each value of the parameter."""
    random = np.random.default_rng(seed)
    parts = []
    for number, f in enumerate(values):
        x = np.linspace(-1.5, 1.5, starts)
        course = [x]
        for _ in range(crossings - 1):
            x = x + eps * (f + x - x**3) + noise * random.normal(size=starts)
            course.append(x)
        row = number * starts + np.arange(starts)
        parts.append(
            pd.DataFrame(
                {
                    "row": np.repeat(row, crossings),
                    "f": f,
                    "crossing": np.tile(np.arange(1, crossings + 1), starts),
                    "t": np.tile(0.4 * np.arange(1, crossings + 1), starts),
                    "status": pd.Categorical(["complete"] * (starts * crossings), STATUSES),
                    "delta_13_n": delta(np.array(course).T.ravel(), centre),
                }
            )
        )
    return with_attrs(pd.concat(parts, ignore_index=True), "return_map")


def settle_table(
    values: Sequence[float] | np.ndarray,
    starts: Sequence[float],
    over: str = "beta",
    others: Sequence[float] | np.ndarray = (0.75,),
) -> pd.DataFrame:
    """The gait that each start x leads to, at each value of the parameter and of another one."""
    records = []
    for other in others:
        for f in values:
            stay = roots(f + 4 * (other - 0.75))
            for start in starts:
                up = start > stay[1] if len(stay) == 3 else stay[0] > 0
                end = stay[-1] if up else stay[0]
                place = [other, f, delta(start), "settled", 40, 16.0, delta(end), "trot" if up else "walk"]
                records.append([len(records), *place])
    columns = ["row", over, "f", "delta_13", "status", "cycles", "t_end", "delta_13_end", "gait"]
    table = pd.DataFrame(records, columns=columns).astype({"delta_13": float, "delta_13_end": float})
    table["status"] = pd.Categorical(table["status"], STATUSES)
    table["gait"] = pd.Categorical(table["gait"], ["trot", "walk", "none"])
    return with_attrs(table, "settle")


def with_attrs(table: pd.DataFrame, kind: str, path: Sequence[float] | None = None) -> pd.DataFrame:
    """Add the job and the quantities, as a loaded table has them in its attributes."""
    run = {"kind": kind} if path is None else {"kind": kind, "parameter": "f", "path": list(path)}
    table.attrs.update(job={"name": kind, "run": run}, quantities=QUANTITIES)
    return table


def half_turn_table() -> pd.DataFrame:
    """Hysteresis between 0 and pi, up to rounding, with gaits: a row jumps at f = 0.4, and back at -0.4."""
    table = staircase_table()
    above = np.where(table["pass"] == 0, table["f"] > FOLD, table["f"] > -FOLD)
    table["delta_13_n"] = np.mod(np.where(above, np.pi, 0.0) + 1e-12 * np.sin(np.arange(len(table))), TURN)
    table["gait"] = pd.Categorical(np.where(above, "trot", "pace"), ["walk", "trot", "pace", "none"])
    return table
