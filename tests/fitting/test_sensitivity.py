"""`gaitsweep sensitivity` and `gs.sensitivity`: sets in a directory, resumed runs, failures, refusals."""

from __future__ import annotations

import importlib.util
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

import gaitsweep as gs
import response_model
from gaitsweep.cli import main
from gaitsweep.errors import ArgumentError
from gaitsweep.fitting.sensitivity import run_sensitivity
from gaitsweep.fitting.sensitivity_job import load_sensitivity, read_sensitivity
from gaitsweep.job import JobError
from gaitsweep.runs.cluster import task
from gaitsweep.runs.cluster.connection import UserClient
from gaitsweep.runs.cluster.dispatch import Cluster
from tests.support.job_files import FOREIGN, written

JOB = """\
name: response
model: response_model:Response
params: {x_1: 0.5, x_2: 1.0, x_3: 2.0}
start: {y_0: 0.0}
run: {kind: fixed_time, duration: 1.5}
engine: {block: 32}
sensitivity:
  parameters: {x_1: [-pi, pi], x_2: [-pi, pi], x_3: [-pi, pi]}
  outputs:
    curved: {kind: value, of: ishigami, at: {y_0: 1.0}}
    straight: {kind: value, of: linear, at: {y_0: [-1.0, 1.0]}}
  method: morris
  n: 10
"""


def refused(folder: Path, **changes: Any) -> str:
    """Return the message with which the job is refused, with fields of `sensitivity` changed."""
    data = yaml.safe_load(JOB)
    top = changes.pop("top", {})
    data["sensitivity"] |= changes
    file = written(folder, yaml.safe_dump({**data, **top}, sort_keys=False))
    with pytest.raises(JobError) as error:
        load_sensitivity(file)
    message = str(error.value)
    assert not FOREIGN.search(message), message
    assert "bad.yaml, line" in message, message
    return message


@pytest.mark.slow
def test_morris_of_simulated_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path, JOB, "job.yaml")
    assert main(["sensitivity", str(file), "--out", str(tmp_path / "out"), "--set", "sensitivity.n=6"]) == 0
    message = capsys.readouterr().out
    assert message.startswith("24 sets: 24 complete.")
    assert "straight (N), morris, 24 rows" in message
    table = gs.load(tmp_path / "out")
    assert list(table.columns) == ["row", "status", "x_1", "x_2", "x_3", "curved", "straight", "why"]
    x = table[["x_1", "x_2", "x_3"]].to_numpy()
    np.testing.assert_allclose(table["curved"], response_model.ishigami(x), atol=1e-8)
    np.testing.assert_allclose(table["straight"], x @ response_model.COEFFICIENTS, atol=1e-8)
    result = pd.read_parquet(tmp_path / "out" / "indices.parquet")
    mu = result[(result["output"] == "straight") & (result["index"] == "mu")].set_index("parameter")["value"]
    expected = 2.0 * np.pi * np.array(response_model.COEFFICIENTS)
    np.testing.assert_allclose(mu.loc[["x_1", "x_2", "x_3"]], expected, rtol=1e-7)
    assert (tmp_path / "out" / "figures" / "sensitivity.png").stat().st_size > 10_000
    # the directory's own job makes the same table
    again = load_sensitivity(tmp_path / "out" / "job.yaml")
    assert again.design.n_rows == 24
    assert main(["sensitivity", str(tmp_path / "out" / "job.yaml"), "--out", str(tmp_path / "out")]) == 0


def test_check_counts_sets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, bad = written(tmp_path, JOB, "good.yaml"), written(tmp_path, JOB.replace("x_1: [", "x_9: ["))
    assert main(["check", str(good), str(bad)]) == 2
    out, err = capsys.readouterr()
    assert out == f"{good}: valid, 40 sets\n"
    assert "sensitivity.parameters.x_9 is not a parameter" in err


def test_a_stopped_run_continues_to_the_same_bytes(tmp_path: Path) -> None:
    """Parts of 32 sets, a row each, since both outputs have the same conditions."""
    job = load_sensitivity(written(tmp_path, JOB, "job.yaml"), ["sensitivity.outputs.straight.at.y_0=1.0"])
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    run_sensitivity(job, whole)

    def stop(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        if done > 32:  # in the second part
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_sensitivity(job, stopped, on_progress=stop)
    assert [file.name for file in sorted((stopped / "table").iterdir())] == ["part-00000.parquet"]
    assert not (stopped / "indices.parquet").exists()
    reports: list[int] = []
    run_sensitivity(job, stopped, on_progress=lambda done, *_: reports.append(done))
    assert reports[0] == 32
    for name in ("table/part-00000.parquet", "table/part-00001.parquet", "indices.parquet"):
        assert (stopped / name).read_bytes() == (whole / name).read_bytes(), name


def same_files(shared: Path, alone: Path) -> None:
    """Both directories have the same parts and indices, to the byte."""
    files = [*sorted((alone / "table").iterdir()), alone / "indices.parquet"]
    assert len(files) > 2
    for file in files:
        assert (shared / file.relative_to(alone)).read_bytes() == file.read_bytes(), file
    assert not (shared / "batch").exists()


@pytest.mark.slow
def test_workers_of_a_cluster_measure_the_same(tmp_path: Path) -> None:
    """Sets that fall are among them, and outputs whose conditions set different names."""
    text = JOB.replace("x_3: [-pi, pi]", "x_3: [-pi, pi], limit: [-2, 3]").replace("block: 32", "block: 16")
    text = text.replace("at: {y_0: 1.0}", "at: {x_2: 0.5, y_0: 1.0}")
    file = written(tmp_path, text, "job.yaml")
    assert main(["sensitivity", str(file), "--out", str(tmp_path / "alone")]) == 0
    assert main(["sensitivity", str(file), "--out", str(tmp_path / "shared"), "--cluster", "local:2"]) == 0
    same_files(tmp_path / "shared", tmp_path / "alone")
    assert set(gs.load(tmp_path / "shared")["status"]) == {"complete", "failed"}


@pytest.mark.slow
def test_a_cluster_continues_a_stopped_batch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    job = load_sensitivity(written(tmp_path, JOB, "job.yaml"))
    run_sensitivity(job, tmp_path / "alone")

    def stop(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        if fraction > 0.1:
            raise KeyboardInterrupt

    shared, computed = tmp_path / "shared", task._compute
    kept: list[int] = []
    monkeypatch.setattr(task, "_compute", lambda *given: (kept.append(given[2]), computed(*given))[1])
    with (
        distributed.LocalCluster(1, threads_per_worker=1, processes=False, dashboard_address=None) as workers,
        distributed.Client(workers, set_as_default=False) as client,
    ):
        with pytest.raises(KeyboardInterrupt):
            run_sensitivity(job, shared, on_progress=stop, cluster=Cluster(UserClient(client)))
        before = len(kept)
        assert before > 0
        run_sensitivity(job, shared, cluster=Cluster(UserClient(client)))
    assert sorted(set(kept)) == list(range(len(set(kept))))
    assert len(kept) <= len(set(kept)) + 1  # a block that was under way may be computed again
    same_files(shared, tmp_path / "alone")


def test_a_mapping_of_fields_is_a_job(tmp_path: Path) -> None:
    result = gs.sensitivity(yaml.safe_load(JOB), out=tmp_path / "fields")
    complete = int(np.count_nonzero(result.table["status"] == "complete"))
    assert repr(result).startswith(f"Sensitivity({len(result.table)} sets, {complete} complete: ")
    assert repr(result).endswith(f"; in {tmp_path / 'fields'})")
    assert len(repr(result)) < 300
    mapping = result.table
    alone = gs.sensitivity(written(tmp_path, JOB), out=tmp_path / "file").table
    pd.testing.assert_frame_equal(mapping, alone, check_exact=True)


def test_a_mapping_may_have_arrays_and_runs() -> None:
    fields = yaml.safe_load(JOB)
    own = read_sensitivity(fields, Path())
    fields["run"] = gs.FixedTime(duration=1.5)
    fields["sensitivity"]["parameters"] = {f"x_{i}": np.array([-np.pi, np.pi]) for i in (1, 2, 3)}
    fields["sensitivity"]["outputs"]["straight"]["at"]["y_0"] = np.linspace(-1.0, 1.0, 2)
    other = read_sensitivity(fields, Path())
    assert other.hash("", 32) == own.hash("", 32)
    assert other.written == yaml.safe_load(yaml.safe_dump(other.written))


@pytest.mark.slow
def test_sets_do_not_depend_on_their_part(tmp_path: Path) -> None:
    file = written(tmp_path, JOB, "job.yaml")
    tables = []
    for block in (6, 1024):
        job = load_sensitivity(file, [f"engine.block={block}"])
        tables.append(run_sensitivity(job, tmp_path / str(block)).table)
    assert len(list((tmp_path / "6" / "table").iterdir())) == 14  # three sets of two rows each
    pd.testing.assert_frame_equal(*tables, check_exact=True)


def test_failed_sets_are_reported_and_counted() -> None:
    result = gs.sensitivity(
        response_model.Response,
        parameters={"x_1": [-1.0, 1.0], "x_2": {"low": -1.0, "high": 1.0}, "limit": [-2.0, 3.0]},
        outputs={"straight": {"kind": "value", "of": "linear", "at": {"y_0": 0.0}}},
        method="sobol",
        n=64,
        run=gs.FixedTime(duration=1.5),
        x_3=2.0,
    )
    table = result.table
    fell = table["x_1"] > table["limit"]
    assert np.all((table["status"] == "failed") == fell)
    assert set(table["why"][fell]) == {"straight: fell"}
    assert table["straight"].isna().equals(fell)
    methods = result.indices.groupby("output")["method"].first()
    assert dict(methods) == {"straight": "rbd_fast", "failures": "sobol"}
    # of uniform x_1 and limit, the variance of the share of failures by hand: P = 0.4, P(.|x_1), P(.|limit)
    x, limit = np.linspace(-1, 1, 20_001), np.linspace(-2, 3, 20_001)
    by_x, by_limit = (x + 2.0) / 5.0, np.clip((1.0 - limit) / 2.0, 0.0, 1.0)
    p = by_x.mean()
    failures = result.indices[result.indices["output"] == "failures"].set_index(["parameter", "index"])
    for name, given in (("x_1", by_x), ("limit", by_limit)):
        first = failures.loc[(name, "S1")]
        assert abs(first["value"] - given.var() / (p * (1.0 - p))) < 1.5 * first["confidence"]
    assert failures.loc[("x_2", "ST"), "value"] == 0.0
    assert result.path is None
    assert len(result.figure().axes) == 2


def test_shares_of_the_jobs_values_and_formulas(tmp_path: Path) -> None:
    """`twice` is 2 x_1 in this job; while x_1 is moved alone it keeps its value."""
    text = JOB.replace("{x_1: [-pi, pi], x_2: [-pi, pi], x_3: [-pi, pi]}", "{x_1: 10%, twice: 50 %}")
    text = text.replace("method: morris\n  n: 10", "method: one_at_a_time")
    job = load_sensitivity(written(tmp_path, text))
    assert job.base == {"x_1": 0.5, "twice": 1.0}
    np.testing.assert_allclose(job.design.sets["x_1"], [0.5, 0.45, 0.55, 0.5, 0.5])
    np.testing.assert_allclose(job.design.sets["twice"], [1.0, 1.0, 1.0, 0.5, 1.5])


def test_a_start_may_be_a_parameter_without_a_value_in_the_job(tmp_path: Path) -> None:
    text = JOB.replace("start: {y_0: 0.0}\n", "").replace("x_1: [-pi, pi]", "y_0: [0, 2]")
    text = text.replace("at: {y_0: 1.0}", "at: {x_1: 1.0}").replace(
        "at: {y_0: [-1.0, 1.0]}", "at: {x_1: 2.0}"
    )
    text = text.replace("params: {x_1: 0.5, ", "params: {")
    assert load_sensitivity(written(tmp_path, text)).base["y_0"] == 1.0


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "near miss of a parameter": (
        {"parameters": {"x_4": [0, 1]}},
        "sensitivity.parameters.x_4 is not a parameter or start value of response; did you mean x_3?",
    ),
    "the same, as a share": ({"parameters": {"limits": "10%"}}, "did you mean limit?"),
    "no range": ({"parameters": {"x_1": 3}}, "x_1 is 3, but takes [low, high], or a share"),
    "a range upside down": ({"parameters": {"x_1": [2, 1]}}, "x_1 goes from 2 to 1: low is below high."),
    "out of bounds": ({"parameters": {"x_1": [0, 5]}}, "x_1 goes to 5, but must be from -4 to 4"),
    "a share of 0": ({"parameters": {"nothing": "10%"}}, "nothing is 0 in this job"),
    "no share": ({"parameters": {"x_1": "0%"}}, 'x_1 is "0%", but must be above 0% and at most 100%.'),
    "a share out of bounds": (
        {"parameters": {"x_3": "100%"}, "top": {"params": {"x_3": 3}}},
        "x_3 goes to 6",
    ),
    "choices": ({"parameters": {"x_1": {"choices": [1, 2]}}}, "x_1 has choices, but takes a range"),
    "nothing varies": ({"parameters": {}}, "parameters is an empty mapping, but takes ranges by name"),
    "whole numbers of morris": (
        {"parameters": {"x_1": {"low": 0, "high": 3, "whole": True}}},
        "x_1 is whole, but the steps of morris are shares of a range",
    ),
    "no output": ({"outputs": None}, "outputs is missing: it takes measures by name"),
    "an output's kind": (
        {"outputs": {"a": {"kind": "valeu", "of": "linear", "at": {"y_0": 1}}}},
        'a.kind: "valeu" is not an allowed kind; did you mean value?',
    ),
    "an output's column": (
        {"outputs": {"a": {"kind": "value", "of": "lineal", "at": {"y_0": 1}}}},
        "a.of is lineal, which is unknown; did you mean linear",
    ),
    "an output's name": (
        {"outputs": {"failures": {"kind": "value", "of": "linear", "at": {"y_0": 1}}}},
        "failures is the name of another column of the table",
    ),
    "an output that sets a parameter": (
        {"outputs": {"a": {"kind": "value", "of": "linear", "at": {"x_1": 1}}}},
        "a.at.x_1 is free, but every measure sets it: leave it to one of them.",
    ),
    "a share of what outputs set": (
        {
            "parameters": {"twice": "10%"},
            "outputs": {"a": {"kind": "value", "of": "linear", "at": {"x_1": 1}}},
        },
        "twice follows x_1, which outputs set: give it a number under params.",
    ),
    "a method": ({"method": "moris"}, 'method is "moris"; did you mean morris?'),
    "no n": ({"n": None}, "n is missing: the number of trajectories."),
    "few": ({"n": 2}, "n is 2, but morris takes at least 4 trajectories."),
    "no power of two": ({"method": "sobol", "n": 100}, "n is 100, but sobol takes a power of two"),
    "too many": ({"n": 10**8}, "n is 100000000, which makes 400000000 sets; there are at most 10000000."),
    "n without a use": ({"method": "one_at_a_time"}, "n has no place with one_at_a_time"),
    "a field": ({"outptus": {}}, "outptus is not a field of sensitivity; did you mean outputs?"),
    "an axis": ({"top": {"vary": {"x_1": [1, 2]}}}, "vary has no place beside sensitivity"),
    "a run of many records": (
        {"top": {"run": {"kind": "return_map", "crossings": 3}}},
        "run.kind is return_map",
    ),
    "a duration that follows a parameter": (
        {"top": {"run": {"kind": "fixed_time", "duration": "4 + x_1"}}},
        'sensitivity.parameters.x_1 differs between rows, but the job has the expression "4+x_1"',
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_jobs_are_refused(case: str, tmp_path: Path) -> None:
    changes, sentence = WRONG[case]
    assert sentence in refused(tmp_path, **changes)


def test_a_share_of_a_whole_number_is_refused() -> None:
    of_wheel = {"parameters": {"seed": "10%"}, "params": {"seed": 100}, "method": "one_at_a_time"}
    outputs = {"end": {"kind": "value", "of": "margin", "at": {"rate_0": 0.6}}}
    with pytest.raises(gs.JobError, match="seed takes whole numbers only and cannot change by a share"):
        gs.sensitivity("gaitsweep.examples.rimless_wheel:RimlessWheel", outputs=outputs, **of_wheel)


def test_wrong_jobs_leave_no_directory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path, JOB.replace("morris", "sobool"))
    assert main(["sensitivity", str(file), "--out", str(tmp_path / "out")]) == 2
    assert "did you mean sobol?" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    file = written(tmp_path, JOB.split("sensitivity:")[0])
    assert main(["sensitivity", str(file), "--out", str(tmp_path / "out")]) == 2
    assert "sensitivity is missing" in capsys.readouterr().err


def test_another_design_does_not_go_on_in_the_same_directory(tmp_path: Path) -> None:
    file = written(tmp_path, JOB)
    run_sensitivity(load_sensitivity(file, ["sensitivity.n=4"]), tmp_path / "out")
    for change in ("sensitivity.seed=1", "sensitivity.outputs.curved.of=linear", "run.duration=2.5"):
        with pytest.raises(gs.TableError, match="table of another job"):
            run_sensitivity(load_sensitivity(file, ["sensitivity.n=4", change]), tmp_path / "out")


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "SALib" else find(name))
    with pytest.raises(
        ArgumentError, match=r"method morris needs the package SALib: pip install 'gaitsweep\[s"
    ):
        load_sensitivity(written(tmp_path, JOB))


def test_keywords_are_checked(tmp_path: Path) -> None:
    file = written(tmp_path, JOB)
    with pytest.raises(ArgumentError, match="n is a field of the job file"):
        gs.sensitivity(file, n=8)
    with pytest.raises(ArgumentError, match="method is a field of the job file"):
        gs.sensitivity(file, method="sobol")
    with pytest.raises(ArgumentError, match="n is one of the job's fields"):
        gs.sensitivity(yaml.safe_load(JOB), n=8)
    with pytest.raises(ArgumentError, match="overrides are for a job file: change the mapping"):
        gs.sensitivity(yaml.safe_load(JOB), overrides=["sensitivity.n=8"])
    with pytest.raises(ArgumentError, match="x_1 is an axis, but takes a number"):
        gs.sensitivity(response_model.Response, x_1=[1.0, 2.0], y_0=0.0)
    with pytest.raises(ArgumentError, match="overrides are for a job file"):
        gs.sensitivity(response_model.Response, overrides=["a=1"])


@pytest.mark.parametrize(
    "change",
    [
        {"parameters": {"x_9": [0.0, 1.0]}},
        {"parameters": None},
        {"outputs": {"straight": {"kind": "value", "of": "lin", "at": {"y_0": 0.0}}}},
        {"outputs": None},
        {"method": "moris"},
        {"n": None},
        {"n": 3},
    ],
)
def test_keywords_are_refused_as_fields_are(change: dict[str, Any]) -> None:
    fields = yaml.safe_load(JOB)
    asked = {**fields.pop("sensitivity"), **change}
    asked = {key: each for key, each in asked.items() if each is not None}
    with pytest.raises(JobError) as written_so:
        read_sensitivity({**fields, "sensitivity": asked}, Path.cwd())
    values = {**fields["params"], **fields["start"], "run": fields["run"]}
    with pytest.raises(JobError) as given:
        gs.sensitivity(response_model.Response, **values, **asked)
    assert str(given.value) == str(written_so.value)


def test_a_ramp_is_refused_by_keywords_too() -> None:
    ramp = gs.Ramp(parameter="x_3", path=[0.0, 1.0], rate=1.0)
    outputs = {"straight": {"kind": "value", "of": "linear", "at": {"y_0": 0.0}}}
    with pytest.raises(JobError, match=r"run\.kind is ramp, but sensitivity takes settle or fixed_time"):
        gs.sensitivity(response_model.Response, parameters={"x_1": [0, 1]}, outputs=outputs, n=8, run=ramp)


def test_workers_of_a_client_return_the_rows() -> None:
    distributed = pytest.importorskip("distributed")
    job = yaml.safe_load(JOB)
    asked = {**job.pop("sensitivity"), "n": 4, "x_1": 0.5, "x_2": 1.0, "x_3": 2.0, "y_0": 0.0}
    with (
        distributed.LocalCluster(1, threads_per_worker=1, processes=False, dashboard_address=None) as workers,
        distributed.Client(workers, set_as_default=False) as client,
    ):
        result = gs.sensitivity(response_model.Response, run=job["run"], client=client, **asked)
    alone = gs.sensitivity(response_model.Response, run=job["run"], **asked)
    pd.testing.assert_frame_equal(result.table, alone.table, check_exact=True)
    pd.testing.assert_frame_equal(result.indices, alone.indices, check_exact=True)
    assert result.path is None


@pytest.mark.parametrize(("far", "differ"), [(0.0, 0), (1.0e8, 8)])
def test_sets_are_measured_again_at_half_the_step(far: float, differ: int) -> None:
    """Steps of 50 ms leave 5e-12 of the start after a second, so 5e-4 of 1e8, and half the steps 1e-5."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = gs.sensitivity(
            response_model.Response,
            parameters={"x_1": [0.0, 1.0e-3], "x_2": [0.0, 1.0e-3]},
            outputs={"straight": {"kind": "value", "of": "linear", "at": {"y_0": far}}},
            method="morris",
            n=8,
            run=gs.FixedTime(duration=1.0),
            numerics={"method": "rk4", "dt": 0.05},
            verify=8,
            x_3=0.0,
        )
    assert result.half_step is not None
    assert (result.half_step.sets, result.half_step.differ) == (8, {"straight": differ})
    assert 1e-12 * far <= result.half_step.largest["straight"] <= 1e-11 * far + 1e-9
    assert ["At half the step, of 8 sets" in str(each.message) for each in caught] == [True] * (differ > 0)


@pytest.mark.slow
def test_effects_on_the_chains_lag_are_those_of_the_papers_formula() -> None:
    """Ambe 2021, eq. (17): the lag between inner legs is (1 - beta) pi (2 - (3 m_B - m) g / (kappa a))."""
    result = gs.sensitivity(
        gs.models.MultileggedReduced(N=3),
        parameters={"m_B": "5%", "kappa": "5%", "beta": "2%", "omega": "20%"},
        outputs={
            "lag": {"kind": "value", "of": "psi_2", "at": {"psi_1": 1.0, "psi_2": 1.0, "psi_3": 1.0}},
        },
        method="morris",
        n=4,
        run=gs.Settle(max_cycles=300, tolerance=1.0e-9),
        verify=0,
    )
    x = result.table
    exact = (1.0 - x["beta"]) * np.pi * (2.0 - (3.0 * x["m_B"] - 1.0) * 9.8 / (x["kappa"] * 0.4))
    np.testing.assert_allclose(x["lag"], exact, atol=1e-8)
    mu = result.indices.loc[result.indices["index"] == "mu"].set_index("parameter")["value"]
    assert list(mu.index) == ["beta", "m_B", "kappa", "omega"]
    # the effect of the range of beta, 0.032, with the others anywhere in theirs
    steepest = (
        -0.032 * np.pi * (2.0 - (3.0 * np.array([0.855, 0.945]) - 1.0) * 9.8 / (np.array([105, 95]) * 0.4))
    )
    assert steepest[0] < mu["beta"] < steepest[1]
    assert abs(mu["omega"]) < 1e-8


@pytest.mark.slow
def test_a_fixed_point_is_an_output_too() -> None:
    """It takes no row of the run; the linear function there has its coefficients as effects."""
    result = gs.sensitivity(
        response_model.Response,
        parameters={"x_1": [-1.0, 1.0], "x_2": [-1.0, 1.0]},
        outputs={"there": {"kind": "fixed_point", "of": "linear", "at": {"y_0": 0.0}, "settle": 1}},
        method="one_at_a_time",
        run=gs.FixedTime(duration=1.5),
        verify=2,
        x_1=0.5,
        x_2=0.0,
        x_3=0.0,
    )
    assert list(result.table["why"]) == [""] * 6
    high = result.indices[result.indices["index"] == "change_high"].set_index("parameter")["value"]
    np.testing.assert_allclose(high.loc[["x_1", "x_2"]], [0.5, 2.0], rtol=1e-7)
    assert result.half_step is not None
    assert result.half_step.differ == {"there": 0}
