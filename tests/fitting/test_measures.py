"""Measures of sets of constants, from rows written by hand and from a model in closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError

import toy_model
from gaitsweep.analysis.continuation.plain_map import PlainMap
from gaitsweep.contract import Quantity
from gaitsweep.engine.poincare.maps import Points
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.errors import JobError
from gaitsweep.fitting.fit_fields import MEASURES
from gaitsweep.fitting.measure import RowMeasure
from gaitsweep.fitting.row_measures import FixedPoint
from gaitsweep.fitting.search import run_search
from gaitsweep.fitting.search_job import read_search

TOY = toy_model.Toy()


class Turning(toy_model.Toy):
    """The toy with an angle among its labels."""

    @property
    def label_fields(self) -> tuple[Quantity, ...]:
        return (Quantity("turn", "rad", "an angle", circular=True),)


def measure(kind: str, **fields: Any) -> RowMeasure:
    made = MEASURES[kind].model_validate({"kind": kind, "at": {"mass": [1, 2, 3, 4]}, **fields})
    assert isinstance(made, RowMeasure)
    return made


def rows(**columns: list[list[Any]]) -> dict[str, np.ndarray]:
    """Columns of sets of four rows, complete where nothing else is said."""
    n = len(next(iter(columns.values())))
    return {"status": np.full((n, 4), "complete"), **{k: np.array(v) for k, v in columns.items()}}


def test_a_formula_takes_the_values_at_the_end() -> None:
    seen = rows(apex=[[9.0] * 4], apex_end=[[1.0, 2.0, 3.0, 6.0]], period=[[2.0] * 4])
    result = measure("value", of="sqrt(apex*apex)/period").of_sets(seen, TOY)
    assert result.values == pytest.approx([1.5])


def test_an_angle_that_the_label_gives_is_averaged_on_the_circle() -> None:
    seen = rows(turn=[[3.1, -3.1, 3.1, -3.1]])
    result = measure("value", of="turn").of_sets(seen, Turning())
    assert abs(result.values[0]) == pytest.approx(np.pi)
    for kind, fields in (("order", {"gaits": ["hop", "rest"]}), ("prominence", {"along": "mass"})):
        for formula in ("turn", "turn - 1.0", "-turn"):
            refusal = measure(kind, of=formula, **fields).field_error(["turn"], Turning())
            assert f"is {formula}, an angle" in str(refusal)
        assert measure(kind, of="cos(turn)", **fields).field_error(["turn"], Turning()) is None


def test_angles_that_cancel_have_no_value() -> None:
    seen = rows(turn=[[0.3, 0.3 + np.pi, 0.3, 0.3 - np.pi]], apex=[[1.0] * 4])
    for among in (None, {"apex": [0.0, 2.0]}):
        result = measure("value", of="turn", among=among).of_sets(seen, Turning())
        assert np.isnan(result.values[0])
        assert "cancel" in result.why[0]


def test_differences_of_angles_are_angles_and_their_ranges_are_arcs() -> None:
    seen = rows(turn=[[0.1, 6.2, 0.1, 6.2]], apex=[[1.0, 2.0, 3.0, 4.0]])
    for formula, middle in (("turn - 1.0", -1.0), ("pi + (0.5 - turn)", np.pi + 0.5)):
        result = measure("value", of=formula).of_sets(seen, Turning())
        assert np.cos(result.values - middle) == pytest.approx([1.0], abs=2e-3)
    for formula in ("2*turn", "abs(turn)", "apex - 1.0", "cos(turn) - turn"):
        assert not measure("value", of=formula).circular(Turning())
    for arc, mean in (([-0.2, 0.2], 2.5), ([6.0, 6.25], 3.0), ([0.0, 1.0], 2.0)):
        among = measure("value", of="apex", among={"turn": arc}).of_sets(seen, Turning())
        assert among.values.tolist() == [mean]


def test_a_formula_that_is_not_finite_is_missing() -> None:
    seen = rows(apex=[[0.0, 1.0, 1.0, 1.0], [1.0] * 4])
    result = measure("value", of="log(apex)").of_sets(seen, TOY)
    assert np.isnan(result.values[0])
    assert result.why[0] == "log(apex) is missing"
    assert result.values[1] == 0.0


def test_only_rows_within_a_range_count() -> None:
    seen = rows(apex=[[1.0, 2.0, 3.0, 4.0], [7.0] * 4], gait=[["hop", "hop", "rest", "hop"]] * 2)
    result = measure("value", of="apex", among={"apex": [1.5, 3]}).of_sets(seen, TOY)
    assert result.values[0] == 2.5
    assert np.isnan(result.values[1])
    assert result.why[1] == "no row has apex in 1.5 to 3"
    share = measure("share", gait="hop", among={"apex": [1.5, 3]}).of_sets(seen, TOY)
    assert share.values[0] == 0.5
    assert share.why[1] == "no row has apex in 1.5 to 3"


def test_rows_outside_the_range_may_fail() -> None:
    seen = rows(apex=[[1.0, 2.0, 3.0, 4.0]])
    seen["status"] = np.array([["fell", "complete", "complete", "fell"]])
    assert measure("value", of="apex", among={"apex": [1.5, 3]}).of_sets(seen, TOY).values == [2.5]
    assert measure("value", of="apex", among={"apex": [0, 3]}).of_sets(seen, TOY).why == ["fell"]


def test_a_share_of_several_gaits() -> None:
    seen = rows(gait=[["rest", "hop", "", "rest"]])
    assert measure("share", gait=["rest", "hop"]).of_sets(seen, TOY).values == [0.75]


def test_rows_that_did_not_settle_have_no_gait() -> None:
    seen = rows(gait=[["hop"] * 4])
    seen["status"] = np.array([["complete", "complete", "cycle_limit", "time_limit"]])
    assert measure("share", gait="hop").of_sets(seen, TOY).values == [0.5]
    assert measure("edge", along="mass", gait="hop").of_sets(seen, TOY).values == [2.5]
    both = measure("coexistence", along="mass", gaits=["hop", "hop"]).of_sets(seen, TOY)
    assert both.values == pytest.approx([1.5])


def test_a_coexistence_is_the_length_of_the_range_with_all_gaits() -> None:
    at = {"launch_1": [0.0, 1.0], "mass": [1.0, 2.0, 4.0]}
    gaits = [["rest", "rest", "rest", "hop", "hop", "rest"], ["hop"] * 6]
    status = [["complete"] * 6, ["complete"] * 6]
    seen = {"gait": np.array(gaits), "status": np.array(status)}
    both = measure("coexistence", at=at, along="mass", gaits=["rest", "hop"])
    # masses 1 and 2 stand for 1 to 1.5 and 1.5 to 3
    assert both.of_sets(seen, TOY).values == pytest.approx([2.0, 0.0])
    seen["status"][0, 3] = "fell"
    assert both.of_sets(seen, TOY).values == pytest.approx([1.5, 0.0])


def test_the_order_of_gaits_is_the_least_step_of_their_medians() -> None:
    gaits = [["rest", "hop", "hop", "rest"], ["hop", "hop", "rest", "rest"], ["rest"] * 4]
    seen = rows(gait=gaits, apex=[[1.0, 2.0, 4.0, 2.0]] * 3)
    result = measure("order", of="apex", gaits=["rest", ["hop"]]).of_sets(seen, TOY)
    assert result.values[:2] == pytest.approx([1.5, -1.5])
    assert np.isnan(result.values[2])
    assert result.why[2] == "no hop"


def test_the_order_leaves_failed_rows_out() -> None:
    seen = rows(gait=[["rest", "hop", "hop", "rest"]], apex=[[1.0, 2.0, 4.0, 9.0]])
    seen["status"] = np.array([["complete", "complete", "complete", "fell"]])
    assert measure("order", of="apex", gaits=["rest", "hop"]).of_sets(seen, TOY).values == [2.0]


@pytest.mark.parametrize(
    ("curve", "depth"),
    [([5.0, 1.0, 2.0, 4.0], 3.0), ([1.0, 3.0, 2.0, 1.0], -1.0), ([1.0, 2.0, 3.0, 4.0], -1.0)],
)
def test_prominence_is_the_depth_of_the_least_inner_value(curve: list[float], depth: float) -> None:
    from scipy.signal import peak_prominences

    result = measure("prominence", of="apex", along="mass").of_sets(rows(apex=[curve]), TOY)
    assert result.values == [depth]
    if depth > 0.0:
        least = 1 + int(np.argmin(curve[1:-1]))
        assert peak_prominences(-np.array(curve), [least])[0] == pytest.approx(result.values)


@pytest.mark.parametrize(
    ("kind", "fields", "sentence"),
    [
        ("value", {"of": "apex", "among": {"apex": [2, 1]}}, "has apex from 2 to 1: low is below high"),
        ("value", {"of": "apex", "among": {"apex": 1}}, "has apex, which takes [low, high]"),
        ("share", {"gait": []}, "is an empty list, but takes a gait or several"),
        ("order", {"of": "apex", "gaits": ["hop"]}, "at least 2 items"),
    ],
)
def test_wrong_fields_are_refused(kind: str, fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValidationError) as refused:
        measure(kind, **fields)
    assert sentence in str(refused.value)


@pytest.mark.parametrize(
    ("kind", "fields", "sentence"),
    [
        ("value", {"of": "apxe + 1"}, "has apxe, which is unknown; did you mean apex?"),
        ("value", {"of": "2 +"}, "is neither a column nor a formula: "),
        ("value", {"of": "2 + 1"}, "has no column"),
        ("value", {"of": "outcome"}, "is outcome, which is unknown"),
        ("value", {"of": "apex", "among": {"outcome": [0, 1]}}, "has outcome, which is unknown"),
        (
            "value",
            {"of": "apex", "among": {"apxe": [1, 2]}},
            "has apxe, which is unknown; did you mean apex?",
        ),
        ("share", {"gait": ["hop", "rset"]}, "is rset, which is unknown; did you mean rest?"),
        ("order", {"of": "apex", "gaits": ["hop", "rset"]}, "is rset, which is unknown; did you mean rest?"),
        ("order", {"of": "apex", "gaits": ["hop", ["rest", "hop"]]}, "has hop twice"),
        ("prominence", {"of": "apex", "along": "mas"}, "is mas, which is unknown; did you mean mass?"),
        ("prominence", {"of": "apex", "along": "mass", "at": {"mass": [1, 2]}}, "has fewer than three"),
        (
            "prominence",
            {"of": "apex", "along": "mass", "at": {"mass": [1, 3, 2]}},
            "has mass, which a prominence takes as a list that rises or falls",
        ),
    ],
)
def test_names_that_the_model_lacks_are_refused(kind: str, fields: dict[str, Any], sentence: str) -> None:
    result = measure(kind, **fields).field_error(["status", "gait", "outcome", "apex_end", "cycles"], TOY)
    assert result is not None
    assert sentence in " ".join(result)


class SettledMap(PlainMap):
    """A map whose starts are points after their cycles; below x = 0 they have fallen."""

    def settled(self, starts: Any, values: Any, cycles: int) -> tuple[Points, np.ndarray]:
        fell = starts["x"] < 0.0
        return self.points(np.stack([starts["x"], starts["y"]], axis=1)), np.where(
            fell, ReturnStatus.fell, ReturnStatus.crossed
        )


def test_a_fixed_point_on_a_line_of_them_is_measured() -> None:
    # x + y is conserved, and named by no one: Newton's equations are singular at each fixed point
    def image(values: Any, x: Any) -> Any:
        pull = 0.45 * (x[1] - x[0] ** 2)
        return jnp.stack([x[0] + pull, x[1] - pull + values["leak"]])

    mapping = SettledMap(image, ("x", "y"), (("leak", 0.0),))
    starts = {"x": np.array([0.9, 0.9, -1.0]), "y": np.array([0.8, 0.8, 1.0])}
    values = {"leak": np.array([0.0, 0.01, 0.0])}
    fields = {"kind": "fixed_point", "at": {"mass": 1}}
    speed = FixedPoint.model_validate({**fields, "of": "x"}).of_starts(mapping, values, starts, 3)  # type: ignore[arg-type]
    assert speed.values[0] == pytest.approx(-0.5 + np.sqrt(1.95))
    assert np.isnan(speed.values[1:]).all()
    assert speed.why[0] == ""
    assert "constrain what the map conserves" in speed.why[1]
    assert "fell" in speed.why[2]
    # multipliers are 1, to rounding, and 0.55 - 0.9 x
    start = np.linspace(0.2, 0.8, 50)
    starts, values = {"x": start, "y": start}, {"leak": np.zeros(50)}
    for of, expected in (("multiplier", 1.0), ("unstable", 0.0)):
        measure = FixedPoint.model_validate({**fields, "of": of})
        result = measure.of_starts(mapping, values, starts, 50)  # type: ignore[arg-type]
        assert result.values == pytest.approx(expected)


@pytest.mark.parametrize("of", ["multiplier", "unstable"])
def test_a_fixed_point_without_a_derivative_has_no_multipliers(of: str) -> None:
    mapping = SettledMap(lambda values, x: 0.3 * jnp.sqrt(jnp.abs(x)), ("x", "y"))
    starts = {"x": np.zeros(1), "y": np.zeros(1)}
    measure = FixedPoint.model_validate({"kind": "fixed_point", "at": {"mass": 1}, "of": of})
    result = measure.of_starts(mapping, {}, starts, 1)  # type: ignore[arg-type]
    assert np.isnan(result.values).all()
    assert result.why.tolist() == [f"no {of} at the fixed point"]


def search(**targets: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": "conditions",
        "model": "toy_model:Toy",
        "start": {"launch_1": 1.0},
        "run": {"kind": "settle", "max_cycles": 60, "tolerance": 1e-9},
        "search": {
            "free": {"kick": [0.5, 1.5], "restitution": [0.2, 0.6]},
            "targets": {
                name: {"kind": "value", "of": "launch_1", "wanted": 1.0, "error": 0.1, **each}
                for name, each in targets.items()
            },
            "method": "sobol",
            "budget": 8,
            "finalists": 0,
        },
    }


def test_a_measure_may_set_a_free_constant(tmp_path: Path) -> None:
    job = search(all={"at": {"mass": 1}}, unkicked={"at": {"kick": 0.25}})
    found = run_search(read_search(job, Path()), tmp_path / "out", figures=False)
    kick, restitution = (found.table[name].to_numpy(float) for name in ("kick", "restitution"))
    assert found.table["all"].to_numpy(float) == pytest.approx(kick / (1.0 - restitution), rel=1e-6)
    assert found.table["unkicked"].to_numpy(float) == pytest.approx(0.25 / (1.0 - restitution), rel=1e-6)


def test_a_set_in_which_a_formula_has_no_value_has_none(tmp_path: Path) -> None:
    job = search(all={"at": {"mass": 1}}) | {"params": {"stiffness": "400 + sqrt(kick - 0.8)"}}
    found = run_search(read_search(job, Path()), tmp_path / "out", figures=False).table
    kick, restitution = (found[name].to_numpy(float) for name in ("kick", "restitution"))
    expected = np.where(kick < 0.8, np.nan, kick / (1.0 - restitution))
    np.testing.assert_allclose(found["all"].to_numpy(float), expected, rtol=1e-6)
    assert set(found["why"][kick < 0.8]) == {"all: a formula has no value"}


def test_a_measure_may_set_all_free_constants(tmp_path: Path) -> None:
    fixed = {"at": {"kick": 0.5, "restitution": 0.5}}
    job = search(all={"at": {"mass": 1}}, fixed=fixed)
    found = run_search(read_search(job, Path()), tmp_path / "out", figures=False)
    assert found.table["fixed"].to_numpy(float) == pytest.approx(np.ones(8), rel=1e-6)


def test_a_constant_that_every_measure_sets_cannot_be_free() -> None:
    job = search(one={"at": {"kick": 1.0}}, two={"at": {"kick": 0.5}})
    with pytest.raises(JobError, match=r"one\.at\.kick is free, but every measure sets it"):
        read_search(job, Path())


def test_the_unit_along_a_start_is_that_of_the_start() -> None:
    """The unit of what is read is that of a parameter, a start, a column or a time; of shares it is 1."""
    start, parameter = TOY.initial_conditions[0], TOY.parameters[0]
    assert start.unit != "1"
    for quantity in (start, parameter):
        edge = measure("edge", along=quantity.name, gait="hop", at={quantity.name: [1, 2, 3, 4]})
        assert edge.unit(TOY) == quantity.unit
    assert measure("value", of="t").unit(TOY) == measure("value", of="t_end").unit(TOY) == "s"
    assert measure("share", gait="hop").unit(TOY) == "1"
    assert measure("value", of="2*apex").unit(TOY) == ""
