"""Settled rows: observables by their own size, orbits by their period; and rows that are not settled."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import gaitsweep as gs
from gaitsweep.analysis.basins.attractor_matching import follow_attractors
from gaitsweep.analysis.basins.attractors import attractors
from gaitsweep.contract import Quantity
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.bounds import slowest
from gaitsweep.engine.recorders.orbit_period import first_crossing, over_periods
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.job import JobError
from gaitsweep.plot import draw
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.status import Status
from gaitsweep.table import Snapshot
from plane_maps import Logistic, Spiral
from simplest_walker import ANGLE, RATE, SimplestWalker
from tests.support.plot_tables import legend_texts
from tests.support.sweeping import run_rows
from toy_model import Toy

ONE = Numerics(dt=1.0)  # a step is a crossing
ENGINES = ("xla", "kernel")


def logistic(r: Any, *, start: Any = 0.3, cycles: int = 150, engine: str = "kernel") -> RowOutcome:
    r = np.atleast_1d(np.asarray(r, float))
    starts = {"x_0": np.broadcast_to(start, r.shape)}
    model = Logistic()
    return run_rows(
        model, SettleRecorder(model, cycles), starts, params={"r": r}, numerics=ONE, lanes=256, engine=engine
    )


def true_periods(r: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The period (0: none up to 64) of each orbit of the logistic map after 200 000 steps, by NumPy."""
    for _ in range(200_000):
        x = r * x * (1.0 - x)
    period, y = np.zeros(r.size, int), x
    for k in range(1, 65):
        y = r * y * (1.0 - y)
        period = np.where((period == 0) & (np.abs(y - x) < 1e-7), k, period)
    return period


@pytest.mark.slow("xla")
@pytest.mark.parametrize("engine", ENGINES)
def test_orbits_of_the_logistic_map_settle_with_their_period(engine: str) -> None:
    """The cascade at 3, 3.4495, 3.5441, 3.5644 and the window of period 3 at 3.8284 (May 1976)."""
    r = [2.8, 3.2, 3.5, 3.55, 3.83, 3.845, 3.74, 3.566, 3.9]
    result = logistic(r, engine=engine)
    assert result.numbers["period"].tolist() == [1, 2, 4, 8, 3, 6, 5, 0, 0]
    names = [Status(code).name for code in result.status]
    assert names == ["settled"] * 7 + ["cycle_limit"] * 2
    x = result.last[:, 0]
    for row, p in enumerate(result.numbers["period"]):
        y = x[row]
        for _ in range(p):
            y = r[row] * y * (1.0 - y)
        # ten tolerances of its size at a fixed point; an orbit's motion over the 150 cycles is less than that
        assert p == 0 or abs(y - x[row]) < 1e-2 * (1.0 if p == 1 else p / 150)


@pytest.mark.slow
def test_no_false_periods() -> None:
    """3 000 orbits, chaotic ones and slow ones near bifurcations among them, against 200 000 steps of NumPy.

    No chaotic row that passes its unstable fixed point, or an orbit of up to 8 crossings, counts as settled.
    """
    random = np.random.default_rng(12)
    r, start = random.uniform(2.9, 4.0, 3000), random.uniform(0.05, 0.95, 3000)
    true = true_periods(r, start)
    for cycles in (150, 600):
        result = logistic(r, start=start, cycles=cycles).numbers["period"]
        np.testing.assert_array_equal(result[result > 0], true[result > 0])
        there = (true > 1) & (true <= 8)
        assert np.mean(result[there] == true[there]) > (0.88 if cycles == 150 else 0.97)


@pytest.mark.slow
@pytest.mark.parametrize("cycles", [150, 1000])
def test_spirals_into_a_fixed_point_are_not_orbits(cycles: int) -> None:
    """They turn by nearly k/p of a circle and shrink by 1e-5 to 0.3 a step, so every p-th point is close."""
    random = np.random.default_rng(3)
    n = 4000
    p, k = random.integers(1, 9, n), random.integers(0, 8, n)
    angle = 2.0 * np.pi * k / p + random.normal(size=n) * 10.0 ** random.uniform(-6, -1, n)
    ratio = 1.0 - 10.0 ** random.uniform(-5, -0.5, n)
    model = Spiral()
    result = run_rows(
        model,
        SettleRecorder(model, cycles),
        {"x_0": random.uniform(0.0, 2.0, n)},
        params={"ratio": ratio, "angle": angle},
        numerics=ONE,
        lanes=256,
        engine="kernel",
    )
    assert set(result.numbers["period"].tolist()) == {0, 1}


@pytest.mark.slow
def test_observables_settle_by_their_own_size() -> None:
    """500 N, 1 N and 1e-3 N of the same row settle at the same crossing; the tolerance is a share of each."""
    starts, ends = {"x_0": [1.5, 2.0, 0.9]}, []
    for size in (1e-3, 1.0, 500.0):
        model = Spiral(size)
        fields = {"ratio": 0.9, "angle": 0.3}
        ends.append(run_rows(model, SettleRecorder(model), starts, params=fields, numerics=ONE))
    for end in ends:
        assert end.status.tolist() == [Status.settled] * 3
        np.testing.assert_array_equal(end.cycles, ends[1].cycles)
    # |x_n - x_(n - j)| < 1e-2 of the range from crossing 1 on, on the exact orbit from (1.5, 0) about (1, 1)
    n = np.arange(200)
    at = (0.5 - 1.0j) * 0.9**n * np.exp(0.3j * n)
    points = np.stack([1.0 + at.real, 1.0 + at.imag], axis=1)
    expected = next(
        last
        for last in range(10, 200)
        if np.all(
            np.abs(points[last] - points[last - 10 : last]) < 1e-2 * np.ptp(points[1 : last + 1], axis=0)
        )
    )
    assert ends[1].cycles[0] == expected


class Declining(Spiral):
    """A spiral whose x tends to 0 and has a scale."""

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return Quantity("x", "m/s", "x", scale=2.0), Quantity("y", "1", "y")

    def observe(self, params, state):
        return {"x": state.x - 1.0, "y": state.y}


class Scaleless(Declining):
    @property
    def observables(self) -> tuple[Quantity, ...]:
        return Quantity("x", "m/s", "x"), Quantity("y", "1", "y")


@pytest.mark.slow
def test_scales_of_a_model_apply_to_observables_that_tend_to_0() -> None:
    starts, given = {"x_0": 2.0, "y_0": 1.0}, {"ratio": 0.9, "angle": 0.0}
    result = run_rows(Declining(), SettleRecorder(Declining()), starts, params=given, numerics=ONE)
    # 0.9^n (0.9^-10 - 1) < 10 * 1e-3 * 2
    assert result.cycles.tolist() == [int(np.ceil(np.log(0.02 / (0.9**-10 - 1.0)) / np.log(0.9)))]
    # with none, its range counts, from crossing 1 on: 0.9^n (0.9^-10 - 1) < 1e-2 (0.9 - 0.9^n)
    result = run_rows(Scaleless(), SettleRecorder(Scaleless(), 150), starts, params=given, numerics=ONE)
    assert result.cycles.tolist() == [int(np.ceil(np.log(0.009 / (0.9**-10 - 1.0 + 0.01)) / np.log(0.9)))]


@dataclasses.dataclass(frozen=True)
class Shifted(Logistic):
    """A logistic map whose x is counted from another zero."""

    zero: float = 0.0

    def observe(self, params, state):
        return {"x": state.x + self.zero, "y": state.y + self.zero}


@pytest.mark.slow
def test_the_zero_of_an_observable_does_not_matter() -> None:
    """Attractors some tenths wide: from 1000 on they are less than the tolerance of their magnitude."""
    r = [2.8, 3.2, 3.5, 3.83, 3.7, 3.9]
    results = [
        run_rows(
            Shifted(zero=zero),
            SettleRecorder(Shifted(zero=zero), 200),
            {"x_0": np.full(6, 0.3)},
            params={"r": r},
            numerics=ONE,
            lanes=8,
            engine="kernel",
        )
        for zero in (0.0, 1000.0)
    ]
    for each in results:
        assert each.numbers["period"].tolist() == [1, 2, 4, 3, 0, 0]
        np.testing.assert_array_equal(each.cycles, results[0].cycles)


def test_a_row_that_starts_at_its_fixed_point_settles() -> None:
    """The range of x is 0, or that of rounding; y copies x from crossing 1 on."""
    r = np.array([2.5, 2.8, 2.9])
    result = logistic(r, start=1.0 - 1.0 / r)
    assert result.numbers["period"].tolist() == [1, 1, 1]
    assert result.cycles.tolist() == [11, 11, 11]


@pytest.mark.slow("0.5")
@pytest.mark.parametrize("restitution", [0.5, 0.9])
def test_accumulating_bounces_do_not_settle(restitution: float) -> None:
    """Launch speeds and times between bounces tend to 0; with a kick both have a limit above 0."""
    model = Toy()
    starts = {"launch_1": [1.0, 1.0]}
    params = {"restitution": restitution, "kicking": [0.0, 1.0]}
    numerics = Numerics(dt=0.02)
    result = run_rows(model, SettleRecorder(model, 300), starts, params=params, numerics=numerics)
    assert Status(result.status[0]) != Status.settled
    assert (Status(result.status[1]).name, result.numbers["period"][1]) == ("settled", 1)


class Pendulum(gs.DeclaredModel):
    """A damped pendulum with a torque: it hangs at asin(torque), or turns over and over."""

    damping = gs.parameter("1", "damping", 0.2)
    torque = gs.parameter("1", "torque", 0.5)
    theta = gs.variable("rad", "angle", 0.5, circular=True)
    omega = gs.variable("rad/s", "rate", 0.0, scale=1.0)

    def flow(self, p, s):
        return {"theta": s.omega, "omega": p.torque - p.damping * s.omega - jnp.sin(s.theta)}

    @gs.event("it passes the top", section=True)
    def top(self, p, s):
        return jnp.sin(0.5 * (s.theta - jnp.pi))

    def period(self, p):
        return 2.0 * jnp.pi + 0.0 * p.damping


class Unforced(gs.DeclaredModel):
    """The same without a section, and with a place that its swings move."""

    damping = gs.parameter("1", "damping", 0.2)
    speed = gs.parameter("m/s", "speed", 0.0)
    theta = gs.variable("rad", "angle", 0.5)
    omega = gs.variable("rad/s", "rate", 0.0)
    place = gs.variable("m", "place", 0.0)

    def flow(self, p, s):
        return {"theta": s.omega, "omega": -p.damping * s.omega - jnp.sin(s.theta), "place": p.speed}

    def period(self, p):
        return 2.0 * jnp.pi + 0.0 * p.damping


@pytest.mark.slow
def test_a_fixed_point_of_the_flow_is_an_attractor_beside_a_cycle() -> None:
    table = gs.sweep(
        Pendulum, theta_0=[-2.0, 0.0, 2.0], omega_0=[-1.0, 0.0, 4.0], run=gs.Settle(), verify=0
    ).table
    ends = {str(status): part for status, part in table.groupby("status", observed=True)}
    assert set(ends) == {"at_rest", "settled"}
    np.testing.assert_allclose(ends["at_rest"]["theta_end"], np.arcsin(0.5), rtol=0, atol=1e-6)
    np.testing.assert_allclose(ends["at_rest"]["omega_end"], 0.0, rtol=0, atol=1e-6)
    assert np.all(ends["at_rest"]["attractor_period"] == 0)
    result = attractors(table)
    assert sorted(result.summary["kind"]) == ["point", "rest"]
    assert set(result.column[table["status"] == "at_rest"]).isdisjoint(
        result.column[table["status"] == "settled"]
    )


def test_rest() -> None:
    """Equilibria without a section are at rest; undamped swings and starts near a saddle are not."""
    table = gs.sweep(
        Unforced,
        damping=[0.0, 0.3],
        speed=[0.0, 0.1],
        theta_0=[0.0, 0.1, 3.14, np.pi - 1e-9],
        run=gs.Settle(max_cycles=40),
        verify=0,
    ).table
    rests = (table["status"] == "at_rest").to_numpy()
    expected = (table["speed"] == 0.0) & ((table["damping"] > 0.0) | (table["theta_0"] == 0.0))
    np.testing.assert_array_equal(rests, expected.to_numpy())
    # it left the saddle and hangs
    np.testing.assert_allclose(np.sin(table["theta_end"].to_numpy()[rests]), 0.0, rtol=0, atol=1e-5)
    np.testing.assert_allclose(np.cos(table["theta_end"].to_numpy()[rests]), 1.0, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_the_slowest_observable_is_named(engine: str) -> None:
    model = Logistic()
    recorder = SettleRecorder(model, 60, (10.0, 1e-3))
    result = run_rows(
        model, recorder, {"x_0": [0.3, 0.3]}, params={"r": [3.9, 2.8]}, numerics=ONE, engine=engine
    )
    assert [Status(code).name for code in result.status] == ["cycle_limit", "settled"]
    assert result.numbers["slowest"].tolist() == [1, -1]


def test_an_observable_that_repeats_is_not_the_slowest() -> None:
    """A row all but repeats after two crossings: what drifts is named, not what takes turns."""
    lags = jnp.arange(1.0, 11.0)
    turns, drifts = jnp.where(lags % 2 == 1, 100.0, 0.0), 0.5 * lags
    assert int(slowest(over_periods(jnp.stack([turns, drifts], axis=1)))) == 1
    # a drift as large as the turn is no orbit, and an unknown change no observable
    assert int(slowest(over_periods(jnp.stack([turns, 10.0 * drifts], axis=1)))) == 0
    assert int(slowest(over_periods(jnp.stack([turns.at[9].set(jnp.nan), drifts], axis=1)))) == -1


def job(**fields: Any) -> dict[str, Any]:
    return {
        "name": "orbits",
        "model": "plane_maps:Logistic",
        "vary": {"r": {"values": [2.8, 3.2, 3.5, 3.9]}},
        "run": {"kind": "settle", "max_cycles": 100, "tolerance": {"x": 1e-3}},
        "numerics": {"dt": 1.0},
        **fields,
    }


@pytest.mark.slow
def test_the_table_of_orbits(tmp_path: Path) -> None:
    table = gs.run(gs.Job.model_validate(job(engine={"block": 1})), tmp_path / "out").table
    assert table["attractor_period"].dtype == np.int8
    assert table["attractor_period"].tolist() == [1, 2, 4, 0]
    assert table["slowest"].astype(object).where(table["slowest"].notna(), None).tolist() == [None] * 3 + [
        "x"
    ]
    assert list(table["slowest"].cat.categories) == ["x", "y"]
    assert np.all(table["stalled_by"].isna())
    # the gait is that of the last crossing's values
    assert table["gait"].tolist() == ["high" if x > 0.6 else "low" for x in table["x_end"]]
    result = attractors(table)
    assert result.column.astype(object).where(result.column.notna(), None).tolist() == [
        "A1",
        "A2",
        "A3",
        None,
    ]
    assert result.summary["kind"].tolist() == ["point", "period 2", "period 4"]
    assert result.summary["rows"].tolist() == [1, 1, 1]
    assert attractors(table.iloc[1:2]).summary["kind"].tolist() == ["period 2"]
    # rows of each part have the crossings of its orbits, from the least x on
    orbit = table.loc[2, ["x_end", "x_end_2", "x_end_3", "x_end_4"]].to_numpy(float)
    np.testing.assert_allclose(np.roll(orbit, -1), 3.5 * orbit * (1.0 - orbit), rtol=0, atol=1e-4)
    assert orbit.argmin() == 0
    assert table[["x_end_2", "x_end_3"]].notna().sum().tolist() == [2, 1]
    part = pq.read_schema(tmp_path / "out" / "table" / "part-00002.parquet")
    assert part.field("x_end_4").metadata[b"unit"] == b"N"
    assert "x_end_2" not in pq.read_schema(tmp_path / "out" / "table" / "part-00000.parquet").names


CYCLE = (2.1 + np.array([1.0, -1.0]) * np.sqrt(2.1**2 - 4.0)) / 2.0  # the squares of x


@pytest.fixture(scope="module")
def mirrored() -> pd.DataFrame:
    """Rows on two mirror cycles of period 2, which have y = 1 in common."""
    starts = np.linspace(-1.5, 1.5, 64)
    fields = {"run": gs.Settle(), "params": {"r": 2.1}, "numerics": {"dt": 1.0}, "verify": 0}
    return gs.sweep("plane_maps:MirrorCycles", x_0=starts, **fields).table


def test_two_cycles_of_period_2_are_two_attractors_whichever_crossing_ends_a_row(
    mirrored: pd.DataFrame,
) -> None:
    x = mirrored["x_0"].to_numpy()
    for _ in range(400):
        x = x**3 - 2.1 * x
    right = np.sign(np.where(np.abs(x) > 1.0, x, -x))  # the sign of the larger of the two x
    ends = mirrored[["x_end", "x_end_2"]].to_numpy()
    assert np.all(mirrored["attractor_period"] == 2)
    np.testing.assert_allclose(np.sort(ends**2, axis=1), CYCLE[None, ::-1].repeat(64, axis=0), rtol=1e-4)
    np.testing.assert_array_equal(np.sign(ends[np.arange(64), np.abs(ends).argmax(axis=1)]), right)
    # both crossings have a gait of their own, and all rows that of the least x
    assert np.all(ends[:, 0] < ends[:, 1])
    assert set(mirrored["gait"]) == {"low"}
    for columns in (["x_end", "y_end"], ["y_end"]):  # y is equal at one crossing of the cycles
        result = attractors(mirrored, columns)
        assert result.summary["rows"].tolist() == [32, 32]
        assert len(pd.crosstab(result.column, right).to_numpy().nonzero()[0]) == 2


def test_orbits_through_an_interrupt(tmp_path: Path) -> None:
    def stop(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        if note != "compiling" and 0 < done < total:
            raise KeyboardInterrupt

    settings = {"vary": {"r": np.linspace(2.8, 3.8, 64).tolist()}, "engine": {"block": 64, "lanes": 8}}
    run = gs.Job.model_validate(job(**settings))
    with pytest.raises(KeyboardInterrupt):
        gs.run(run, tmp_path / "stopped", on_progress=stop)
    assert 0 < Snapshot.of(tmp_path / "stopped").rows_open < 64
    table, whole = (gs.run(run, tmp_path / name).table for name in ("stopped", "whole"))
    pd.testing.assert_frame_equal(table, whole, check_exact=True)
    assert np.isfinite(whole["x_end_4"].to_numpy()).any()


def test_basins_of_two_cycles_of_period_2(mirrored: pd.DataFrame) -> None:
    shares = gs.basins(mirrored, label="attractor").fractions
    assert shares[["outcome", "fraction"]].to_numpy().tolist() == [["A1", 0.5], ["A2", 0.5]]
    figure = draw("basin_measures", mirrored, hue="attractor")
    assert legend_texts(figure.axes[0]) == ["A1", "A2"]


def test_cycles_keep_their_names_along_a_parameter() -> None:
    fields = {"run": gs.Settle(), "numerics": {"dt": 1.0}, "verify": 0}
    r = np.linspace(2.06, 2.16, 5)
    table = gs.sweep("plane_maps:MirrorCycles", x_0=np.linspace(-1.5, 1.5, 24), r=r, **fields).table
    followed = follow_attractors(table, "r")
    assert np.all(table["attractor_period"] == 2)
    assert len(np.unique(followed.column)) == 2
    of = pd.crosstab(followed.column, table["x_end_2"] > 1.0).to_numpy()
    assert np.sort(of.ravel()).tolist() == [0, 0, 60, 60]


def test_the_first_crossing_does_not_depend_on_where_an_orbit_is_read() -> None:
    """Orbits of up to 64 crossings, with angles at the seam, equal values and errors of 1e-6."""
    angle, number = Quantity("a", "rad", "angle", circular=True), Quantity("b", "1", "number")
    random = np.random.default_rng(2)
    for p in (2, 3, 4, 5, 8, 64):
        # few values, so that observables repeat along an orbit; the last one differs once
        a, b = random.choice([0.0, 0.5 * np.pi, np.pi], (50, p)), random.choice([0.3, -2.0], (50, p))
        b[:, -1] = 5.0
        orbits = np.stack([a, b], axis=2)
        firsts = []
        for turn in range(p):
            read = np.roll(orbits, turn, axis=1) + 1e-6 * random.normal(size=orbits.shape)
            read[:, :, 0] %= 2.0 * np.pi
            firsts.append((first_crossing([angle, number], read) - turn) % p)
        np.testing.assert_array_equal(firsts, np.tile(firsts[0], (p, 1)))
    # an observable that the section keeps at 0, such as the vertical speed at the apex, has rounding alone
    speed = Quantity("c", "m/s", "speed")
    orbits = np.stack([1e-12 * random.normal(size=(50, 2)), np.tile([0.3, 1.0], (50, 1))], axis=2)
    np.testing.assert_array_equal(first_crossing([speed, number], orbits), 0)


def test_longer_orbits_settle_with_max_period() -> None:
    """Period 16 ends at r = 3.5687 (May 1976); a table without `max_period` has the hash that it had."""
    fields = {"r": [3.5, 3.5665], "numerics": {"dt": 1.0}, "verify": 0}
    tables = [
        gs.sweep("plane_maps:Logistic", run=gs.Settle(max_cycles=400, max_period=p), **fields).table
        for p in (None, 16, 3)
    ]
    assert [table["attractor_period"].tolist() for table in tables] == [[4, 0], [4, 16], [0, 0]]
    assert [table["status"].tolist()[1] for table in tables] == ["cycle_limit", "settled", "cycle_limit"]
    orbit = tables[1].filter(regex=r"^x_end").to_numpy(float)[1]
    np.testing.assert_allclose(np.roll(orbit, -1), 3.5665 * orbit * (1.0 - orbit), rtol=0, atol=1e-4)
    assert len(orbit) == 16
    assert orbit[0] < orbit.min() + 0.01
    assert "max_period" not in gs.Settle().hashed({"max_period": None})
    with pytest.raises(JobError, match=r"run\.max_period is 40, .*max_cycles of 200"):
        gs.Job.model_validate(job(run={"kind": "settle", "max_period": 40}))


@pytest.mark.parametrize("longest", [8, 16])
def test_an_orbit_has_as_many_crossings_as_the_recorder_declares(longest: int) -> None:
    """Rows without an orbit, as at r = 2.5, and rows that have not ended have NaN in its place."""
    recorder = SettleRecorder(Logistic(), 400, max_period=longest)
    rows = run_rows(Logistic(), recorder, {"x_0": [0.3, 0.3]}, params={"r": [2.5, 3.5]}, numerics=ONE)
    others, k = max(10, longest) - 1, len(Logistic().observables)
    assert rows.numbers["orbit"].shape == (2, others * k)
    assert np.isfinite(rows.numbers["orbit"]).sum(axis=1).tolist() == [0, 3 * k]  # of period 4
    held = RowOutcome.empty(np.arange(3), recorder.numbers, observables=k)
    ended = rows.take(np.array([1])).numbers
    held.put(np.array([1]), ended)
    held.put(np.array([2]), ended)
    assert np.isfinite(held.numbers["orbit"]).sum(axis=1).tolist() == [0, 3 * k, 3 * k]
    assert (held.fired[0].tolist(), held.status[0]) == ([0] * held.fired.shape[1], Status.running)
    with pytest.raises(ValueError, match="orbit is declared with the shape"):
        held.put(np.array([0]), ended | {"orbit": np.zeros((1, 2))})


def test_a_tolerance_of_an_unknown_observable_is_refused() -> None:
    with pytest.raises(JobError, match=r"run\.tolerance\.xx is not an observable of map; did you mean x\?"):
        gs.Job.model_validate(job(run={"kind": "settle", "tolerance": {"xx": 1e-3}}))
    with pytest.raises(JobError, match=r"run\.tolerance has x, which is -1, but must be above 0"):
        gs.Job.model_validate(job(run={"kind": "settle", "tolerance": {"x": -1}}))
    with pytest.raises(JobError, match=r"run\.tolerance is an empty mapping"):
        gs.Job.model_validate(job(run={"kind": "settle", "tolerance": {}}))


@pytest.mark.slow
def test_names_that_a_tolerance_leaves_out_keep_the_default(tmp_path: Path) -> None:
    """.9^n (0.9^-10 - 1) y < 10 tolerance: each observable waits for its own."""

    def cycles(tolerance: Any) -> int:
        given = job(
            model="plane_maps:Spiral",
            vary={"x_0": {"values": [1.0]}},
            start={"y_0": 2.0},
            run={"kind": "settle", "tolerance": tolerance},
        )
        return int(gs.run(gs.Job.model_validate(given), tmp_path / str(tolerance)).table.loc[0, "cycles"])

    assert cycles({"x": 1e-9}) == cycles(1e-3) == cycles({"y": 1e-3})
    assert cycles({"y": 1e-4}) == cycles(1e-4) == cycles(1e-3) + round(np.log(0.1) / np.log(0.9))


@pytest.mark.slow
def test_a_row_of_period_1_ends_where_it_did(tmp_path: Path) -> None:
    """The rule for angles, written again in NumPy: |x_n - x_(n-j)| < 10 tolerance for j = 1 to 10."""

    class Angles(Spiral):
        @property
        def observables(self):
            return tuple(dataclasses.replace(q, circular=True, unit="rad") for q in super().observables)

    random = np.random.default_rng(5)
    n, model = 64, Angles()
    ratio, angle, x = random.uniform(0.5, 0.93, n), random.uniform(-3, 3, n), random.uniform(0.3, 1.7, n)
    result = run_rows(
        model,
        SettleRecorder(model),
        {"x_0": x, "y_0": 1.0},
        params={"ratio": ratio, "angle": angle},
        numerics=ONE,
    )
    assert np.all(result.numbers["period"] == 1)
    step = np.arange(151)
    at = (x - 1.0)[:, None] * ratio[:, None] ** step * np.exp(1j * angle[:, None] * step)
    points = np.stack([at.real, at.imag], axis=-1)
    for row in range(n):
        ends = [k for k in range(10, 151) if np.abs(points[row, k] - points[row, k - 10 : k]).max() < 1e-2]
        assert result.cycles[row] == ends[0]


def test_periods_are_found_in_float32() -> None:
    assert float(jnp.finfo(jnp.float32).eps) > 1e-8  # what the state can be told by
    model = Logistic()

    class Single(Logistic):
        @property
        def precisions(self) -> tuple[str, ...]:
            return ("float64", "float32")

    model = Single()
    numerics = Numerics(dt=1.0, precision="float32")
    result = run_rows(
        model,
        SettleRecorder(model),
        {"x_0": np.full(3, 0.3)},
        params={"r": [3.2, 3.5, 3.9]},
        numerics=numerics,
    )
    assert result.numbers["period"].tolist() == [2, 4, 0]


@pytest.mark.slow
def test_a_walker_on_a_slope_takes_two_steps_then_four_to_repeat() -> None:
    """Garcia et al. 1998: one step up to a slope of 0.0151 rad, then two, then four, chaos before 0.019.

    Each slope starts from where the one before settled: the basin of the gait is small.
    """
    model, numerics = SimplestWalker(), Numerics(method="rk4", dt=5e-3)
    names = [quantity.name for quantity in model.initial_conditions]
    kept = 1.0 - np.cos(2.0 * ANGLE)
    at = np.array([ANGLE, RATE, 2.0 * ANGLE, kept * RATE])
    results = {}
    for slope in (
        0.009,
        0.0105,
        0.012,
        0.013,
        0.014,
        0.0145,
        0.015,
        0.0155,
        0.016,
        0.017,
        0.0175,
        0.018,
        0.0185,
    ):
        starts = {name: [value] for name, value in zip(names, at, strict=True)}
        end = run_rows(
            model,
            SettleRecorder(model, 600),
            starts,
            params={"gamma": [slope]},
            numerics=numerics,
            engine="kernel",
        )
        results[slope] = int(end.numbers["period"][0])
        if slope == 0.009:
            # the paper's fixed point, printed to 15 digits
            np.testing.assert_allclose(end.last[0, :2], [ANGLE, RATE], rtol=0, atol=1e-9)
        if results[slope]:
            at = end.last[0]
    assert all(results[slope] == 1 for slope in results if slope <= 0.015)
    assert all(results[slope] == 2 for slope in results if 0.0155 <= slope <= 0.0175)
    assert (results[0.018], results[0.0185]) == (4, 0)
