"""Measures of ramps: a fold whose place under a slow ramp is known, orders of gaits, and wrong fields."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, ClassVar

import jax
import numpy as np
import pytest
from pandas.testing import assert_frame_equal

import gaitsweep as gs
from cusp_flow import CuspFlow, State
from gaitsweep.contract import Quantity
from gaitsweep.errors import JobError
from gaitsweep.fitting.ramp_measures import Crossings, GaitSequence, Transition
from gaitsweep.fitting.search_cost import estimate_search
from gaitsweep.fitting.search_job import read_search

RATE = 2e-3  # m/s2
RAMP = {"kind": "ramp", "parameter": "r", "path": [0.3, -0.9, 0.9], "rate": RATE, "initial_dwell": 3.0}
# the first zero of the Airy function Ai, by whose place a slow passage through a fold is late
AIRY = 2.338107410459767


class Falling(CuspFlow):
    """Model that counts as fallen left of a place."""

    name: ClassVar[str] = "falling_flow"

    def failed(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return state.x < -1.2


class Suffixed(CuspFlow):
    """Model with a parameter whose name ends as a column of an observable at a crossing does."""

    name: ClassVar[str] = "suffixed_flow"

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        push, growth = super().parameters
        return dataclasses.replace(push, name="r_n"), growth


def searched(model: Any = CuspFlow, **more: Any) -> Any:
    fields = {
        "free": {"a": [0.9, 1.1]},
        "method": "sobol",
        "budget": 4,
        "finalists": 0,
        "run": gs.Settle(max_cycles=100),
        "numerics": {"method": "rk4", "dt": 0.05},
    }
    return gs.search(model, **{**fields, **more})


def fold_under_a_ramp(a: float) -> float:
    """Value of r (m/s) at which a slow ramp leaves x > 0.

    The fold is at r = -2 (a/3)^(3/2). There y' = -b y^2 - rate t, b = sqrt(3 a), runs away after the time
    AIRY / (b rate)^(1/3).
    """
    return float(-2.0 * (a / 3.0) ** 1.5 - AIRY * RATE ** (2 / 3) / (3.0 * a) ** (1 / 6))


def transition(**fields: Any) -> dict[str, Any]:
    return {"kind": "transition", "run": RAMP, "gait": "right", "to": "left", "at": {"x_0": 1.0}, **fields}


@pytest.mark.slow
def test_a_ramp_leaves_a_gait_past_its_fold() -> None:
    """A search for a, by one transition and its mirror image, beside rows at rest.

    Two terms of the expansion in the rate are compared: the third, and the way from the fold to x = 0, are of
    the order of rate log(rate), 0.01 here.
    """
    wanted = fold_under_a_ramp(1.0)
    asked = {
        "down": {**transition(), "wanted": wanted, "error": 0.01},
        "up": {
            **transition(gait="left", to="right", **{"pass": 1}),
            "wanted": -wanted,
            "error": 0.01,
        },
        "there": {**transition(of="x**2"), "wanted": [0.0, 4.0], "error": 0.1, "held_back": True},
        "order": {
            "kind": "sequence",
            "run": RAMP,
            "gaits": ["right", "left", "right"],
            "at": {"x_0": [1.0, -1.0]},
            "wanted": 1.0,
            "error": 0.1,
            "held_back": True,
        },
        # it goes back to the right in the end, which counts against a list without it
        "only": {
            "kind": "sequence",
            "run": RAMP,
            "gaits": ["right", "left"],
            "only": True,
            "at": {"x_0": 1.0},
            "wanted": 1.0,
            "error": 0.1,
            "held_back": True,
        },
        # at rest, in the same batch of sets: where x = sqrt(a) for r = 0
        "rest": {"kind": "value", "of": "x", "at": {"x_0": 1.0, "r": 0.0}, "wanted": 1.0, "error": 0.05},
    }
    result = gs.search(
        CuspFlow,
        free={"a": [0.8, 1.2]},
        targets=asked,
        method="sobol",
        budget=32,
        population=16,
        finalists=2,
        run=gs.Settle(max_cycles=100),
        numerics={"method": "rk4", "dt": 0.05},
    )
    table = result.table
    assert np.all(table["status"] == "complete")
    expected = np.array([fold_under_a_ramp(a) for a in table["a"]])
    np.testing.assert_allclose(table["down"], expected, atol=0.012)
    np.testing.assert_allclose(table["up"], -table["down"], atol=2e-3 + 1e-9)  # a crossing's step of r
    np.testing.assert_allclose(table["rest"], np.sqrt(table["a"]), atol=1e-4)
    # the start at -1 is left of the fold at r = 2 (a/3)^(3/2), above 0.3 there: no right at first
    assert table.loc[table["a"] > 0.9, "order"].to_numpy() == pytest.approx(0.5 * (1.0 + 2.0 / 3.0))
    assert table["only"].to_numpy() == pytest.approx(2.0 / 3.0)
    assert result.identifiability.best["a"].iloc[0] == pytest.approx(1.0, abs=0.02)
    assert result.finalists is not None
    np.testing.assert_allclose(result.finalists["down_half"], result.finalists["down"], atol=1e-3)


def test_rows_that_fall_keep_their_status() -> None:
    """It falls after it has left `right`, so that the transition was there, but the row is not sound."""
    targets = {
        "down": {**transition(), "wanted": -0.4, "error": 0.1},
        "order": {
            "kind": "sequence",
            "run": RAMP,
            "gaits": ["right", "left"],
            "at": {"x_0": 1.0},
            "wanted": 1.0,
            "error": 0.1,
        },
    }
    table = searched(Falling, targets=targets).table
    assert (table["status"] == "failed").all()
    assert set(table["why"]) == {"down: fell"}
    assert (table["order"] == 0.0).all()


def test_sets_without_the_transition_are_reported() -> None:
    short = {**RAMP, "path": [0.3, 0.0]}
    table = searched(targets={"down": {**transition(run=short), "wanted": -0.4, "error": 0.1}}).table
    assert set(table["why"]) == {"down: no left after right"}


@pytest.mark.slow
def test_workers_of_a_client_measure_ramps_too(tmp_path: Path) -> None:
    """Rows whose conditions set different names go in several jobs."""
    distributed = pytest.importorskip("distributed")
    targets = {
        "down": {**transition(), "wanted": -0.4, "error": 0.1},
        "both": {**transition(at={"x_0": [1.0, 1.5]}), "wanted": -0.4, "error": 0.1},
        "set": {**transition(at={"a": 1.0, "x_0": 1.0}), "wanted": -0.4, "error": 0.1},
        "rest": {"kind": "value", "of": "x", "at": {"x_0": 1.0, "r": 0.0}, "wanted": 1.0, "error": 0.05},
    }
    alone = searched(targets=targets).table
    with (
        distributed.LocalCluster(1, threads_per_worker=1, processes=False, dashboard_address=None) as workers,
        distributed.Client(workers, set_as_default=False) as client,
    ):
        shared = searched(targets=targets, client=client).table
    assert_frame_equal(shared, alone, check_exact=True)
    assert alone["set"].nunique() == 1
    assert alone["down"].nunique() == 4


@pytest.mark.slow
def test_ramps_wait_for_the_targets_that_are_measured_first() -> None:
    targets = {
        "rest": {"kind": "value", "of": "x", "at": {"x_0": 1.0, "r": 0.0}, "wanted": 1.1, "error": 0.02},
        "down": {**transition(), "wanted": -0.4, "error": 0.1},
    }
    whole = searched(targets=targets).table
    turned = searched(targets=targets, first=["rest"], first_within=4.0).table
    near = np.abs(np.sqrt(whole["a"]) - 1.1) <= 4.0 * 0.02
    assert 0 < near.sum() < len(near)
    np.testing.assert_array_equal(turned["down"][near], whole["down"][near])
    assert set(turned["why"][~near]) == {"down: not measured"}


def test_a_ramp_reads_gaits_on_request() -> None:
    """A gait is read with the parameter's value at its crossing; without gaits the table is unchanged."""
    ramp = {name: value for name, value in RAMP.items() if name != "kind"}
    fields = {"x_0": 1.0, "a": 1.0, "numerics": {"method": "rk4", "dt": 0.05}, "verify": 0}
    table = gs.sweep(CuspFlow, **fields, run=gs.Ramp(**ramp, gaits=True)).table
    plain = gs.sweep(CuspFlow, **fields, run=gs.Ramp(**ramp))
    assert_frame_equal(table.drop(columns="gait"), plain.table, check_exact=True)
    assert "gait" not in plain.table
    read = table[table["crossing"] > 0]
    np.testing.assert_array_equal(read["gait"] == "right", read["x_n"] > 0)
    assert gs.Ramp(**ramp).hashed(gs.Ramp(**ramp).model_dump()).keys() == {"kind", *ramp}


def row(gaits: str, status: str = "complete", t_0: float = 0.0) -> Crossings:
    """A row of crossings 1 s apart, whose gaits are letters; r rises by 1 each, in two equal passes."""
    t = t_0 + np.arange(len(gaits) + 1.0)
    columns = {
        "t": t,
        "crossing": np.arange(t.size),
        "pass": (np.arange(t.size) > len(gaits) / 2).astype(int),
        "r": np.arange(t.size) * 1.0,
        "gait": np.array(["", *gaits]),
    }
    return Crossings(columns, status)


def measured(of: type, seen: str, status: str = "complete", **fields: Any) -> tuple[float, str]:
    ramp = {**RAMP, "initial_dwell": 0.0}
    measure = of.model_validate({"run": ramp, "at": {"x_0": 1.0}, "least": 2, **fields})
    result = measure.of_rows([[row(seen, status)]], CuspFlow())
    return float(result.values[0]), str(result.why[0])


@pytest.mark.parametrize(
    ("gaits", "place"),
    [
        ("aabb....", 2.5),
        ("aaccbb........", 3.5),  # what stands between counts as neither
        ("aabaabb.......", 5.5),  # a single b is no bout
        ("bbaabb........", 4.5),
        ("aabbaabb........", 2.5),  # the first time
    ],
)
def test_the_place_of_a_transition(gaits: str, place: float) -> None:
    assert measured(Transition, gaits, kind="transition", gait="a", to="b") == (place, "")


def test_a_transition_without_a_number_has_a_reason() -> None:
    crossings = row("aabb....")
    unknown = Crossings({**crossings.columns, "r": np.full(9, np.nan)}, crossings.status)
    fields = {"kind": "transition", "run": {**RAMP, "initial_dwell": 0.0}, "at": {"x_0": 1.0}, "least": 2}
    measure = Transition.model_validate({**fields, "gait": "a", "to": "b"})
    result = measure.of_rows([[unknown], [crossings]], CuspFlow())
    assert np.isnan(result.values).tolist() == [True, False]
    assert result.why.tolist() == ["r is missing", ""]


@pytest.mark.parametrize(
    ("of", "unit", "value"), [("r_n", "m/s", 2.5), ("2*r_n", "", 5.0), ("x", "m", 25.0), ("a", "1/s", 3.0)]
)
def test_only_observables_lose_their_suffix(of: str, unit: str, value: float) -> None:
    """A parameter r_n is read by its whole name, and an observable x, whose column is x_n, by its own."""
    model, columns = Suffixed(), dict(row("aabb....").columns)
    columns["r_n"] = columns.pop("r")
    columns |= {"x_n": 10.0 * columns["r_n"], "a": 0.0 * columns["r_n"] + 3.0}
    columns["status"] = np.full(columns["t"].size, "complete")
    ramp = {**RAMP, "parameter": "r_n", "initial_dwell": 0.0}
    fields = {"kind": "transition", "run": ramp, "gait": "a", "to": "b", "at": {"x_0": 1.0}, "least": 2}
    measure = Transition.model_validate({**fields, "of": of})
    named = measure.model_copy(update={"gait": ("right",), "to": ("left",)})
    assert named.field_error([*columns], model) is None
    assert measure.unit(model) == unit
    assert measure.of_rows([[Crossings(columns, "complete")]], model).values[0] == value
    field, error = named.model_copy(update={"of_": "r"}).field_error([*columns], model) or ("", "")
    assert field == "of"
    assert error.startswith("is r, which is unknown. Allowed: ")
    assert "r_n, x, a" in error


@pytest.mark.parametrize(
    ("gaits", "status", "why"),
    [
        ("abab....", "complete", "no b after a"),
        ("bbaa....", "complete", "no b after a"),
        ("aaaa.bbb", "complete", "no b after a"),  # in the other pass
        ("aabb....", "diverged", "diverged"),
    ],
)
def test_why_there_is_no_transition(gaits: str, status: str, why: str) -> None:
    value, said = measured(Transition, gaits, status, kind="transition", gait="a", to="b")
    assert np.isnan(value)
    assert said == why


@pytest.mark.parametrize(
    ("gaits", "share"),
    [
        ("aabbcc", 1.0),
        ("aaccbb", 2 / 3),
        ("ccbbaa", 1 / 3),
        ("aabaacc", 2 / 3),
        ("abc", 0.0),
        ("aaddcc", 1.0),
    ],
)
def test_the_share_of_a_sequence(gaits: str, share: float) -> None:
    wanted = ["a", ["b", "d"], "c"]
    assert measured(GaitSequence, gaits, kind="sequence", gaits=wanted) == (pytest.approx(share), "")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"run": None}, "run is missing: the ramp of its rows"),
        ({"run": "ramp"}, 'run is "ramp", but takes fields, kind among them: ramp.'),
        (
            {"run": {**RAMP, "kind": "settle"}},
            'run.kind is "settle", but the run of a measure (transition) is ramp.',
        ),
        ({"run": {**RAMP, "rat": 1.0}}, "run.rat is not a field of run; did you mean rate?"),
        ({"run": {**RAMP, "rate": -1.0}}, "run.rate is -1, but must be above 0"),
        ({"run": {"kind": "ramp", "parameter": "r", "rate": 1.0}}, "run.path is missing: values between"),
        ({"run": {**RAMP, "parameter": "s"}}, "run.parameter is s, which is not a parameter"),
        ({"run": {**RAMP, "parameter": "a"}}, "run.parameter is a, which is free"),
        (
            {"run": {**RAMP, "parameter": "a", "path": [1, 20]}, "free": {"r": [0, 1]}},
            "run.path[1] is 20, but",
        ),
        ({"at": {"x_0": 1.0, "r": 0.0}}, "at sets r, which the ramp moves: take it out"),
        ({"pass": 2}, "pass is 2, but the path has 2 passes, of which the first is 0"),
        ({"gait": "rigth"}, "gait is rigth, which is unknown; did you mean right?"),
        ({"to": ["left", "right"]}, "to has right, which is in gait too"),
        ({"of": "y"}, "of is y, which is unknown"),
        ({"least": 0}, "least is 0, but must be a whole number from 1"),
        ({"too": "left"}, "too is not a field of a measure (transition); did you mean to?"),
    ],
)
def test_wrong_fields_are_refused(change: dict[str, Any], sentence: str) -> None:
    change = dict(change)
    free = change.pop("free", {"a": [0.9, 1.1]})
    target = {**transition(wanted=0.0, error=1.0), **change}
    fields = {
        "name": "ramps",
        "model": "cusp_flow:CuspFlow",
        "run": {"kind": "settle"},
        "search": {
            "free": free,
            "targets": {"down": {k: v for k, v in target.items() if v is not None}},
            "budget": 4,
        },
    }
    with pytest.raises(JobError) as error:
        read_search(fields, Path.cwd())
    assert f"search.targets.down.{sentence}" in str(error.value)


@pytest.mark.slow
def test_the_estimate_counts_ramps() -> None:
    """The ramp lasts 1503 s, the rows at rest 10 s."""
    fields: dict[str, Any] = {
        "name": "ramps",
        "model": "cusp_flow:CuspFlow",
        "run": {"kind": "fixed_time", "duration": 10.0},
        "numerics": {"method": "rk4", "dt": 0.05},
        "search": {"free": {"a": [0.9, 1.1]}, "budget": 64, "method": "sobol"},
    }
    rest = {"kind": "value", "of": "x", "at": {"x_0": 1.0}, "wanted": 1.0, "error": 0.05}
    down = {**transition(), "wanted": 0.0, "error": 1.0}
    needs = {}
    for name, targets in {"rest": {"rest": rest}, "both": {"rest": rest, "down": down}}.items():
        asked = {**fields, "search": {**fields["search"], "targets": targets}}
        needs[name] = estimate_search(read_search(asked, Path.cwd()))
    assert needs["both"].rows_of_a_set == 2
    alone = needs["rest"].steps
    assert 0.8 < (needs["both"].steps - alone) / (alone * 1503.0 / 10.0) < 1.25


@pytest.mark.slow
def test_a_sensitivity_takes_ramps() -> None:
    result = gs.sensitivity(
        CuspFlow,
        parameters={"a": [0.9, 1.1]},
        outputs={"down": transition()},
        method="one_at_a_time",
        numerics={"method": "rk4", "dt": 0.05},
        verify=1,
    )
    expected = [fold_under_a_ramp(a) for a in result.table["a"]]
    np.testing.assert_allclose(result.table["down"], expected, atol=0.012)
    assert result.half_step is not None
    assert result.half_step.largest["down"] < 1e-3
