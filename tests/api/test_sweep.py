"""Runs from keywords give the tables of job files; allowed keywords; results in memory."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
from pandas.testing import assert_frame_equal

import gaitsweep as gs
import toy_model

AXES: dict[str, Any] = {"launch_1": np.linspace(1.0, 2.0, 4), "restitution": [0.2, 0.5]}
KINDS = {
    "settle": gs.Settle(max_cycles=40),
    "refined": gs.Settle(max_cycles=40, refine="boundary", coarse=2),
    "fixed_time": gs.FixedTime(duration=5.0),
    "trace": gs.Trace(duration=1.0, every=0.1),
    "ramp": gs.Ramp(parameter="stiffness", path=[4, 5], rate=0.5),
    "return_map": gs.ReturnMap(crossings=3),
    "continuation": gs.Continuation(parameter="kick", path=[0.2, 0.5]),
    "staircase": gs.Staircase(parameter="stiffness", path=[4, 5, 4], step=0.5, dwell=3.0),
}


class TwoToys(toy_model.Toy):
    """A class that no module gives, as those of a notebook's cells."""


TwoToys.__module__ = "__main__"


def run_of(kind: str) -> dict[str, Any]:
    """The fields of a run kind as a job file has them."""
    return {name: value for name, value in KINDS[kind].model_dump().items() if value is not None}


@pytest.mark.slow("continuation", "fixed_time", "ramp", "refined", "return_map", "staircase", "trace")
@pytest.mark.parametrize("kind", KINDS)
def test_memory_and_directory_give_one_table(kind: str, tmp_path: Path) -> None:
    """Value for value and with the same types, attributes and self-check; and so does `run.job()`.

    Two blocks, so that parts are joined; exact, since both are the same computation.
    """
    vary = {
        "launch_1": {"linspace": [1.0, 2.0, 5]} if kind == "refined" else AXES["launch_1"].tolist(),
        "restitution": [0.2, 0.5],
    }
    job = gs.Job(name="toy", model="toy_model:Toy", vary=vary, run=run_of(kind), engine={"block": 5})
    stored = gs.run(job, tmp_path / "stored")
    result = gs.sweep(toy_model.Toy(), **vary, run=KINDS[kind], engine={"block": 5})
    assert_frame_equal(result.table, stored.table, check_exact=True)
    for name in ("counts", "gaits", "self_check", "job_hash", "quantities"):
        assert result.manifest.get(name) == stored.manifest.get(name), name
    assert result.manifest["self_check"]["rows"] > 0
    file = tmp_path / "again.yaml"
    file.write_text(result.job())
    again = gs.run(file, tmp_path / "again")
    assert_frame_equal(again.table, result.table, check_exact=True)
    assert again.job() == result.job() == stored.job()


def test_a_directory_and_a_second_call(tmp_path: Path) -> None:
    """`out` keeps the result, and the same call reads it again."""
    run = gs.Settle(max_cycles=40)
    first = gs.sweep("toy_model:Toy", launch_1=[1.0, 2.0], run=run, out=tmp_path / "kept")
    second = gs.sweep(toy_model.Toy, launch_1=[1.0, 2.0], run=run, out=tmp_path / "kept")
    assert first.path == second.path == tmp_path / "kept"
    assert first.manifest["created"] == second.manifest["created"]
    assert_frame_equal(first.table, second.table, check_exact=True)


@pytest.mark.slow
def test_models_as_instances_classes_and_names() -> None:
    """N from the instance, or as a keyword beside a class or a name."""
    fields = {"launch_1": [1.0, 2.0], "launch_2": 1.5, "run": gs.Settle(max_cycles=40), "verify": 0}
    tables = [
        gs.sweep(toy_model.Toy(N=2), **fields).table,
        gs.sweep(toy_model.Toy, N=2, **fields).table,
        gs.sweep("toy_model:Toy", N=2, **fields).table,
    ]
    assert_frame_equal(tables[0], tables[1], check_exact=True)
    assert_frame_equal(tables[0], tables[2], check_exact=True)


def test_params_and_start_take_any_name() -> None:
    """Axes and constants, as keywords and in `params` and `start`."""
    run = {"kind": "settle", "max_cycles": 40}
    by_keyword = gs.sweep(toy_model.Toy(), mass=2.0, launch_1=[1.0, 2.0], run=run)
    by_mapping = gs.sweep(toy_model.Toy(), params={"mass": 2.0}, start={"launch_1": [1.0, 2.0]}, run=run)
    assert_frame_equal(by_keyword.table, by_mapping.table, check_exact=True)


@pytest.mark.slow
def test_axes_of_every_form() -> None:
    """Lists, arrays, series, ranges, rules of a job file, groups; scalars of NumPy; formulas."""
    toy = toy_model.Toy()
    run = gs.Settle(max_cycles=40)
    expected = gs.sweep(toy, launch_1=[1, 2, 3], stiffness=4.0, run=run).table
    forms = [np.array([1, 2, 3]), pd.Series([1.0, 2.0, 3.0]), range(1, 4), (1, 2, 3), {"linspace": [1, 3, 3]}]
    for form in forms:
        assert_frame_equal(gs.sweep(toy, launch_1=form, stiffness=np.float64(4), run=run).table, expected)
    zipped = gs.sweep(toy, zip={"launch_1": [1, 2], "mass": np.array([1, 2])}, kick="0.1*mass", run=run).table
    assert zipped[["launch_1", "mass"]].to_numpy().tolist() == [[1, 1], [2, 2]]


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({"lanch_1": 1.0}, "lanch_1 is neither a parameter nor a start value of toy; did you mean launch_1?"),
        ({"N": 2}, "N shapes the model: give it to Toy, not here."),
        ({"mass": np.ones((2, 2))}, "mass has 2 dimensions, but an axis is a list of numbers."),
        ({"mass": 1.0, "params": {"mass": 2.0}}, "mass is given twice, once in params."),
        ({"params": ["mass"]}, "params is a list, but must be a mapping of names to values."),
    ],
)
def test_refusals(keywords: dict[str, Any], sentence: str) -> None:
    for function in (gs.sweep, gs.return_map):
        with pytest.raises(gs.ArgumentError, match=re.escape(sentence)):
            function(toy_model.Toy(), **keywords)
    with pytest.raises(gs.ArgumentError, match=re.escape(sentence)):
        gs.simulate(toy_model.Toy(), duration=1.0, **keywords)


def test_a_reserved_keyword() -> None:
    sentence = "client is a reserved keyword, which this function does not take."
    with pytest.raises(gs.ArgumentError, match=re.escape(sentence)):
        gs.return_map(toy_model.Toy(), client=1)
    with pytest.raises(gs.ArgumentError, match=re.escape(sentence)):
        gs.simulate(toy_model.Toy(), duration=1.0, client=1)


def test_refusals_of_jobs_and_run_kinds() -> None:
    with pytest.raises(gs.JobError, match=r"restitution is 2, but must be from 0 to 0\.99"):
        gs.sweep(toy_model.Toy(), restitution=2.0)
    with pytest.raises(gs.ArgumentError, match=r"max_cycle is not a field .* did you mean max_cycles"):
        gs.Settle(max_cycle=1)  # pyright: ignore[reportCallIssue]
    with pytest.raises(gs.ArgumentError, match="multileged, which is not a known model; did you mean"):
        gs.sweep("multileged")
    with pytest.raises(gs.ArgumentError, match="A model is an instance, a class or a name, not int"):
        gs.sweep(1)  # pyright: ignore[reportArgumentType]


def test_tables_of_two_classes_of_one_name_have_a_model_each() -> None:
    """As of a cell that is edited and run again; without an edit its class is the same model."""
    edits = [{"__module__": "__main__", "grip": grip} for grip in (1.0, 2.0, 1.0)]
    classes = [type("OfCell", (toy_model.Toy,), edit) for edit in edits]
    names = [gs.models.name_of(model_class) for model_class in classes]
    assert [gs.models.find(name) for name in names[1:]] == classes[1:]
    assert names[0] == names[2] != names[1]
    assert gs.models.name_of(classes[1]) == names[1]
    with pytest.raises(gs.models.ModelError, match="a class that this Python process does not have"):
        gs.models.find("session:Nowhere")


@pytest.mark.slow
def test_a_class_of_this_session(tmp_path: Path) -> None:
    """It runs as its module's class does; no file can name it, so it has no job and no directory."""
    fields: dict[str, Any] = {"launch_1": [1.0, 2.0], "run": gs.Settle(max_cycles=40)}
    result = gs.sweep(TwoToys(), **fields)
    assert_frame_equal(result.table, gs.sweep(toy_model.Toy(), **fields).table, check_exact=True)
    with pytest.raises(gs.ArgumentError, match="TwoToys is a class of this session, which a job file cannot"):
        result.job()
    with pytest.raises(gs.ArgumentError, match="a result directory needs a model that a file gives"):
        gs.sweep(TwoToys, out=tmp_path / "out", **fields)
    assert len(gs.simulate(TwoToys, launch_1=1.0, duration=1.0))

    @dataclasses.dataclass(frozen=True)
    class TwoToys2(toy_model.Toy):
        name = "other"

    assert gs.sweep(TwoToys2(), **fields).manifest["job"]["model"] == "session:TwoToys2"


@pytest.mark.slow
def test_one_trajectory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its samples equal those of a trace to the last bit, and no file remains."""
    monkeypatch.chdir(tmp_path)
    one = gs.simulate(toy_model.Toy(), launch_1=1.5, duration=1.0, every=0.1)
    trace = gs.sweep(toy_model.Toy(), launch_1=1.5, run=gs.Trace(duration=1.0, every=0.1), verify=0).table
    assert_frame_equal(one, trace.loc[:, one.columns.tolist()], check_exact=True)
    assert one.attrs["units"] == {"t": "s", "height_1": "m", "speed_1": "m/s"}
    assert one.attrs["status"] == "complete"
    assert len(gs.simulate(toy_model.Toy(), duration=1.0)) > 20  # samples of a hundredth of a cycle
    with pytest.raises(gs.ArgumentError, match="launch_1 is an axis, but one trajectory takes a number"):
        gs.simulate(toy_model.Toy(), launch_1=[1.0, 2.0], duration=1.0)
    with pytest.warns(
        UserWarning, match="ended as fell: .* It tests whether a mass is above the ceiling"
    ) as warned:
        gs.simulate(toy_model.Toy(), launch_1=5.0, ceiling=0.1, duration=50.0)
    assert {each.filename for each in warned} == {__file__}  # the line of the user, not one of the package
    assert not list(tmp_path.iterdir())


class Rotor(gs.DeclaredModel):
    """It turns back before it meets its section."""

    rate = gs.parameter("rad/s", "speed", 1.0)
    turned = gs.variable("rad", "angle turned through", 0.0)

    @gs.event("a turn ends", section=True)
    def turn(self, p, s):
        return s.turned - 2.0

    def flow(self, p, s):
        return {"turned": p.rate * (1.0 - s.turned)}

    def period(self, p):
        return 1.0 + 0.0 * p.rate


@pytest.mark.slow
def test_a_trajectory_that_is_not_recorded_warns() -> None:
    with pytest.warns(UserWarning, match="ended as time_limit: .* that begins after 1 section crossings"):
        gs.simulate(Rotor(), duration=1.0, after_cycles=1)


def test_a_result_shows_itself() -> None:
    result = gs.sweep(toy_model.Toy(), **AXES, run=gs.Settle(max_cycles=40))
    for text in (repr(result), result._repr_html_()):
        assert "rows: 8" in text
        assert "Self-check: 4 of 8 rows" in text
    assert "in memory" in repr(result)
    assert result._repr_html_().count("<tr>") == 5  # the first records
    assert result.figures == []
    with pytest.raises(gs.ArgumentError, match="give path or table"):
        type(result)()
    with pytest.raises(gs.ArgumentError, match="in memory, without a directory"):
        _ = result.path
    with pytest.raises(AttributeError, match=r"has no attrs; its table has: give \.table"):
        gs.hysteresis(cast(Any, result), "launch_1")
    with pytest.raises(TypeError, match=r"give \.table"):
        gs.analyses.basins(cast(Any, result))


def test_every_figure_is_a_method_of_a_result() -> None:
    result = gs.sweep(toy_model.Toy(), **AXES, run=gs.Settle(max_cycles=40))
    shown = {name for name in dir(result.plot) if not name.startswith("_")} - {"table"}
    assert shown == set(gs.plot.FIGURES)
    figure = result.plot.basin(x="launch_1", y="restitution")
    assert len(figure.axes) == len(gs.plot.basin(result.table, x="launch_1", y="restitution").axes)


@pytest.mark.slow
def test_run_is_called_twice(tmp_path: Path) -> None:
    """No module that a run imports takes the function's place."""
    job = gs.Job(name="toy", model="toy_model:Toy", vary={"launch_1": [1.0]}, run={"kind": "settle"})
    first = gs.run(job, tmp_path / "a")
    assert_frame_equal(gs.run(job, tmp_path / "b").table, first.table, check_exact=True)
