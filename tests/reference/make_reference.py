"""Write the data files beside it: `cd tests && python -m reference.make_reference crossings|settled|traces`.

Each row is stored in a cache folder, so that an interrupted run (--minutes) can be continued.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import platform
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from . import multilegged_exact, multilegged_scipy
from .multilegged_page import TURN, Array, Crossing, Parameters, Record, State

HERE = Path(__file__).parent
GRAZE = 1e-6  # rad or s; a start at which the two methods differ by more grazes a guard
SETTLING_CROSSINGS = 120
COMPARED = 20  # starts of the settled set that are also computed by solve_ivp
TRACE_TIMES = [round(0.7351 * k + 0.0137, 4) for k in range(50)]  # s; over two cycles, off the events


@dataclasses.dataclass(frozen=True)
class StartSet:
    """Random starts that share parameters, uniform in [0, highest]; the seed of set number k is [2021, k]."""

    name: str
    starts: int
    crossings: int
    changes: dict[str, Any] = dataclasses.field(default_factory=dict)
    highest: tuple[float, ...] = (TURN,)

    @property
    def parameters(self) -> Parameters:
        return Parameters(**self.changes)


SETS = (
    StartSet("base", 120, 10),
    StartSet("clamp", 20, 10, {"clamp": True}),
    StartSet("legs5", 20, 10, {"N": 4}),
    StartSet("legs10", 20, 3, {"N": 9}),
    StartSet("masses", 20, 10, {"m_1": 0.85, "m_end": 0.95}),
    StartSet("beta", 20, 10, {"beta": 0.7}),
    StartSet("kappa", 20, 10, {"kappa": 150.0}),
    StartSet("settled", 200, 10),
    StartSet("traces", 3, 2),
    # Leg 1 passes 2 pi without landing in most starts with psi_1 and psi_2 near 0, in 1 of 2000 elsewhere.
    StartSet("wraps", 20, 4, {}, (0.08, 0.24, TURN)),
)
BY_NAME = {chosen.name: chosen for chosen in SETS}
CROSSING_SETS = tuple(chosen for chosen in SETS if chosen.name not in ("settled", "traces"))


def random_starts(name: str) -> Array:
    """The starts psi (rad, six decimals) of a set, (starts, N)."""
    number, chosen = list(BY_NAME).index(name), BY_NAME[name]
    shape = (chosen.starts, chosen.parameters.N)
    draw = np.random.default_rng([2021, number]).uniform(0.0, chosen.highest, shape)
    return np.round(draw - 5e-7, 6).clip(0.0)


class Cache:
    """A folder of results as JSON files, and the deadline after which no new one is computed."""

    def __init__(self, folder: Path, minutes: float) -> None:
        self.folder, self.deadline = folder, time.monotonic() + 60.0 * minutes
        folder.mkdir(parents=True, exist_ok=True)

    def get(self, key: str, make: Callable[[], Any]) -> Any | None:
        """The stored result, or a new one, or None after the deadline."""
        path = self.folder / f"{key}.json"
        if path.exists():
            return json.loads(path.read_text())
        if time.monotonic() > self.deadline:
            return None
        result = make()
        hidden = path.with_suffix(".part")
        hidden.write_text(json.dumps(result))
        hidden.rename(path)
        return result


def plain(crossings: list[Crossing]) -> list[list[float]]:
    """Crossings as numbers: time (s), 1 if leg 1 landed, and psi (rad)."""
    return [[c.t, float(c.landed), *map(float, c.psi)] for c in crossings]


def difference(one: Array, other: Array) -> Array:
    """Largest difference (rad or s) up to each crossing; 9 where one landed and the other did not."""
    gap = np.abs(one - other)
    gap[:, 2:] = np.minimum(gap[:, 2:], TURN - gap[:, 2:])
    gap[:, 1] *= 9.0
    return np.maximum.accumulate(gap.max(axis=1))


def header(lines: list[str]) -> str:
    """The comment at the head of a data file: lines of its own, versions and the sets of starts."""
    made = f"numpy {np.__version__}, scipy {scipy.__version__}, Python {platform.python_version()}"
    sets = [f"set {s.name}: {s.starts} starts, {json.dumps(s.changes)}" for s in SETS]
    lines = [*lines, f"made by tests/reference/make_reference.py; {made}", *sets]
    return "".join(f"# {line}\n" for line in lines)


def compute(cache: Cache, method: str, chosen: StartSet, k: int, psi: Array) -> list[list[float]] | None:
    """The crossings of start number k of a set by one method, exact or scipy; None after the deadline."""
    run = multilegged_exact.run if method == "exact" else multilegged_scipy.run
    key = f"{method}-{chosen.name}-{k:03d}"
    return cache.get(key, lambda: plain(run(chosen.parameters, psi, chosen.crossings).crossings))


def make_crossings(cache: Cache) -> str:
    """multilegged_crossings.csv: both methods on every start of the sets with crossings to compare."""
    work = [(s, k, psi) for s in CROSSING_SETS for k, psi in enumerate(random_starts(s.name))]
    results = {method: [compute(cache, method, *item) for item in work] for method in ("exact", "scipy")}
    rows, worst, grazing, unchecked = [], 0.0, 0, 0
    for (chosen, k, _), exact, record in zip(work, results["exact"], results["scipy"], strict=True):
        if exact is None:
            continue
        table = np.array(record or exact)
        apart = difference(np.array(exact), table) if record else np.full(len(table), -1.0)
        graze = apart[-1] > GRAZE
        grazing, unchecked = grazing + graze, unchecked + (record is None)
        worst = worst if graze else max(worst, float(apart[-1]))
        for n, (t, landed, *psi) in enumerate(table):
            cells = [f"{angle:.12f}" for angle in psi] + [""] * (9 - len(psi))
            row = f"{chosen.name},{k},{n},{t:.12f},{landed:.0f},{graze:d},{apart[n]:.1e}"
            rows.append(",".join([row, *cells]))
    names = "set,start,crossing,t,landed,graze,difference," + ",".join(f"psi_{i}" for i in range(1, 10))
    lines = [
        "Section crossings of the multi-legged model: t (s), psi (rad, mod 2 pi); crossing 0 is the start.",
        "Values: scipy solve_ivp DOP853, rtol 1e-11, atol 1e-13, max_step 10 ms, terminal events.",
        "difference: from the exact propagator, largest so far (rad, s); graze: above 1e-6 in this start.",
        f"Largest difference of {len(rows)} rows, {grazing} grazing starts aside: {worst:.1e}; "
        f"not compared: {unchecked} starts.",
    ]
    (HERE / "multilegged_crossings.csv").write_text(header(lines) + names + "\n" + "\n".join(rows) + "\n")
    return lines[-1]


def make_settled(cache: Cache) -> str:
    """multilegged_settled.csv: psi at the last of SETTLING_CROSSINGS crossings, by the exact propagator."""
    chosen = BY_NAME["settled"]
    long = dataclasses.replace(chosen, crossings=SETTLING_CROSSINGS)
    rows, checked, unfinished = [], [], 0
    for k, psi in enumerate(random_starts("settled")):
        exact = compute(cache, "exact", long, k, psi)
        if exact is None:
            unfinished += 1
            continue
        table = np.array(exact)
        if k < COMPARED:
            record = compute(cache, "scipy", chosen, k, psi)
            checked += [difference(table[: chosen.crossings + 1], np.array(record))[-1]] if record else []
        step = np.abs((table[-1, 2:] - table[-2, 2:] + np.pi) % TURN - np.pi).max()
        cells = [f"{angle:.6f}" for angle in psi] + [f"{angle:.9f}" for angle in table[-1, 2:]]
        rows.append(f"{k},{table[-1, 0]:.9f},{int((table[:, 1] == 0).sum())},{step:.1e}," + ",".join(cells))
    lines = [
        f"psi (rad) at crossing {SETTLING_CROSSINGS} of random starts (N = 3, Table 1), propagated exactly.",
        "t: its time (s); wraps: crossings without a landing; step: largest last change of psi (rad).",
        f"Ten crossings of {len(checked)} starts: within {max(checked, default=np.nan):.1e} of solve_ivp.",
        f"Unfinished: {unfinished} starts.",
    ]
    names = "start,t,wraps,step,psi_1,psi_2,psi_3,psi_1_end,psi_2_end,psi_3_end"
    (HERE / "multilegged_settled.csv").write_text(header(lines) + names + "\n" + "\n".join(rows) + "\n")
    return lines[-2] + " " + lines[-1]


def flat(state: State, p: Parameters) -> list[float]:
    """A state as numbers: time, heights, velocities, phases, lags and contacts."""
    return [state.t, *(state.x + p.L), *state.v, *state.phi, *state.y, *map(float, state.contact)]


def make_traces(cache: Cache) -> str:
    """multilegged_traces.csv: the state at TRACE_TIMES of three starts, and how far the methods differ."""
    p = BY_NAME["traces"].parameters
    rows, apart, unfinished = [], np.zeros(5), 0
    for k, psi in enumerate(random_starts("traces")):
        both = []
        for run in (multilegged_scipy.run, multilegged_exact.run):
            key = f"{run.__module__.split('_')[-1]}-traces-{k}"
            both.append(cache.get(key, partial(sample, run, p, psi)))
        if None in both:
            unfinished += 1
            continue
        record, exact = (np.array(table) for table in both)
        apart = np.maximum(apart, np.abs(record - exact)[:, 1:].reshape(-1, 5, p.N + 1).max(axis=(0, 2)))
        start = ",".join(f"{angle:.6f}" for angle in psi)
        for line in record:
            cells = [f"{number:.12f}" for number in line[1:17]] + [f"{flag:.0f}" for flag in line[17:]]
            rows.append(f"{k},{start},{line[0]:.4f}," + ",".join(cells))
    names = ("x", "v", "phi", "y", "contact")
    distances = ", ".join(f"{name} {d:.0e}" for name, d in zip(names, apart, strict=True))
    lines = [
        "The state at times t (s) of three starts psi (N = 3, Table 1): x (height, m), v (m/s), phi (rad,",
        "0 to 2 pi), y (rad/s), contact (0 or 1) of legs 1..4, by solve_ivp as in multilegged_crossings.csv.",
        f"Largest distance from the exact propagator: {distances}. Unfinished: {unfinished} starts.",
    ]
    columns = ",".join(["start,psi_1,psi_2,psi_3,t", *(f"{name}_{i}" for name in names for i in range(1, 5))])
    (HERE / "multilegged_traces.csv").write_text(header(lines) + columns + "\n" + "\n".join(rows) + "\n")
    return lines[-1]


def sample(run: Callable[..., Record], p: Parameters, psi: Array) -> list[list[float]]:
    """The states of one start at TRACE_TIMES."""
    return [flat(state, p) for state in run(p, psi, 1, times=TRACE_TIMES).samples]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["crossings", "settled", "traces"])
    parser.add_argument("--cache", type=Path, default=Path("/tmp/gaitsweep-reference"), help="finished rows")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no new row after this many minutes")
    chosen = parser.parse_args()
    cache = Cache(chosen.cache, chosen.minutes)
    print({"crossings": make_crossings, "settled": make_settled, "traces": make_traces}[chosen.what](cache))


if __name__ == "__main__":
    main()
