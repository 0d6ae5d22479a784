"""Searches for planted constants, of a model in closed form and of the chain; kills, and wrong jobs."""

from __future__ import annotations

import copy
import dataclasses
import errno
import inspect
import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
import pytest
import yaml
from pandas.testing import assert_frame_equal

import gaitsweep as gs
import toy_model
from gaitsweep.design.design import inside
from gaitsweep.errors import JobError
from gaitsweep.fitting import optimisers
from gaitsweep.fitting.figures import draw_search
from gaitsweep.fitting.free_parameters import FreeParameter, sets_at
from gaitsweep.fitting.identifiability import Identifiability, _constant
from gaitsweep.fitting.optimisers import Method, optimiser
from gaitsweep.fitting.population import Population
from gaitsweep.fitting.robustness import Robust, share_kept
from gaitsweep.fitting.row_measures import Share
from gaitsweep.fitting.search import FINALISTS, SearchResult, _depends_on_the_step, run_search
from gaitsweep.fitting.search_cost import estimate_search
from gaitsweep.fitting.search_job import SearchOptions, load_search, read_search
from gaitsweep.fitting.targets import FAILED_MISS, MISS
from gaitsweep.job import Job
from gaitsweep.runs.execute import run_job
from gaitsweep.schema.diagnostics import Diagnostic
from gaitsweep.schema.strict_model import plain
from gaitsweep.status import SetStatus
from gaitsweep.table import ResultDirectory, TableError, WriteError, load

SWEEPS = Path(__file__).parents[2] / "sweeps"

# What the search has to find: the launch speed tends to kick / (1 - restitution), 1.6 m/s.
KICK, RESTITUTION, STIFFNESS = 0.8, 0.5, 6.0
SPEED = KICK / (1.0 - RESTITUTION)
APEX = np.hypot(0.5, SPEED / np.sqrt(STIFFNESS)) - 0.5

TOY: dict[str, Any] = {
    "name": "toy_search",
    "model": "toy_model:Toy",
    "params": {"restitution": RESTITUTION},
    "start": {"launch_1": 1.0},
    "run": {"kind": "settle", "max_cycles": 60, "tolerance": 1e-9},
    "search": {
        "free": {"kick": [0.1, 3.0], "stiffness": {"low": 1.0, "high": 20.0, "log": True}},
        "targets": {
            "speed": {"kind": "value", "of": "launch_1", "at": {"mass": 1}, "wanted": SPEED, "error": 0.01},
            "apex": {"kind": "value", "of": "apex", "at": {"mass": 1}, "wanted": APEX, "error": 0.01},
        },
        "method": "cma",
        "budget": 400,
        "population": 16,
        "seed": 3,
    },
}


ROBUST = {"within": 0.02, "targets": ["speed"], "sets": 400, "wanted": [0.9, 1], "error": 0.1}
# the step follows `mass` by way of another parameter
FOLLOWING = {"params": {"restitution": "mass/10"}, "numerics": {"dt": "0.01*restitution"}}
EDGE = {"kind": "edge", "along": "mass", "gait": "hop", "at": {"mass": [1, 2]}}


def job(**search: Any) -> dict[str, Any]:
    """Return the toy's search with other fields of `search`."""
    changed = copy.deepcopy(TOY)
    changed["search"] |= search
    return changed


def searched(fields: dict[str, Any], out: Path) -> SearchResult:
    """Return the result of a search whose files of figures no test reads."""
    return run_search(read_search(fields, Path.cwd()), out, figures=False)


@pytest.mark.slow
def test_planted_constants_are_found_again(tmp_path: Path) -> None:
    result = gs.search(TOY, tmp_path / "out")
    best = result.identifiability.best.iloc[0]
    assert best["kick"] == pytest.approx(KICK, rel=0.01)
    assert best["stiffness"] == pytest.approx(STIFFNESS, rel=0.01)
    assert result.identifiability.fitting > 20
    assert {constant.verdict for constant in result.identifiability.constants} == {"pinned"}
    assert re.fullmatch(
        r"SearchResult\(400 sets: least score \S+, \d+ fit all targets; in .*/out\)", repr(result)
    )
    fitting = result.identifiability.fitting
    message = (
        rf"Identifiability: {fitting} sets fit\n  kick: best \S+, \S+ to \S+ \(pinned\)\n  stiffness: .*"
    )
    assert re.fullmatch(message, repr(result.identifiability))
    assert list(result.table["row"]) == list(range(400))
    assert result.finalists is not None
    # events are located, so that half the step changes nothing
    assert np.allclose(result.finalists["speed"], result.finalists["speed_half"], atol=1e-9)
    assert all(file.is_file() for file in result.figures)


def by_keywords(fields: dict[str, Any], **more: Any) -> Any:
    """Return the search of a job's fields, as keywords of `gs.search`."""
    values = {**fields.get("params", {}), **fields.get("start", {})}
    given = {"run": gs.Settle(max_cycles=60, tolerance=1e-9), **values, **fields["search"]}
    return gs.search(toy_model.Toy, **{**given, **more})


@pytest.mark.slow
def test_keywords_are_the_fields_of_a_job(tmp_path: Path) -> None:
    fields = job(budget=32, start=16)
    stored = gs.search(fields, tmp_path / "stored")
    memory = by_keywords(fields)
    assert_frame_equal(memory.table, stored.table, check_exact=True)
    assert memory.finalists is not None
    assert stored.finalists is not None
    assert_frame_equal(memory.finalists, stored.finalists, check_exact=True)
    assert memory.path is None
    assert memory.figures == ()
    assert len(memory.figure("constants").axes) == len(stored.figure("constants").axes) == 2
    with pytest.raises(gs.ArgumentError, match="mises is not a figure of a search; did you mean misses"):
        memory.figure("mises")
    kept = by_keywords(fields, out=tmp_path / "kept")
    assert_frame_equal(kept.table, stored.table, check_exact=True)
    file = tmp_path / "kept" / "job.yaml"
    short = gs.search(file, tmp_path / "short", overrides=["search.budget=16"]).table
    assert_frame_equal(short, stored.table.iloc[:16])


def test_a_job_may_have_runs_and_numbers_of_numpy() -> None:
    fields = job(free={"kick": (np.float64(0.1), np.float32(3.0))})
    fields["run"] = gs.Settle(max_cycles=60, tolerance=1e-9)
    fields["search"]["targets"]["speed"]["run"] = gs.FixedTime(duration=6.0)
    written = read_search(fields, Path()).written
    assert written == yaml.safe_load(yaml.safe_dump(written))
    assert written["run"]["kind"] == "settle"
    assert written["search"]["targets"]["speed"]["run"]["kind"] == "fixed_time"


def test_measures_may_have_a_run_of_their_own(tmp_path: Path) -> None:
    """Early launches are those of the toy's geometric series; late ones have come to rest."""
    short = {"run": {"kind": "fixed_time", "duration": 6.0}, "at": {"mass": 1, "launch_1": 1.0}, "error": 1}
    targets = {
        "early": {"kind": "value", "of": "launch_1", "wanted": SPEED, **short},
        "launches": {"kind": "value", "of": "cycles", "wanted": 3, **short},
        "hops": {"kind": "share", "gait": "hop", "wanted": 1, **short},
        **TOY["search"]["targets"],
    }
    found = searched(job(targets=targets, method="sobol", budget=16), tmp_path / "out").table
    last = found["kick"] / (1.0 - RESTITUTION)
    assert len(found["launches"].value_counts()) > 2
    early = last + RESTITUTION ** found["launches"] * (1.0 - last)
    np.testing.assert_allclose(found["early"], early, rtol=1e-9)
    np.testing.assert_allclose(found["speed"], last, rtol=1e-6)


def test_workers_of_a_client_return_the_rows() -> None:
    distributed = pytest.importorskip("distributed")
    fields = job(budget=32, finalists=0)
    with (
        distributed.LocalCluster(1, threads_per_worker=1, processes=False, dashboard_address=None) as workers,
        distributed.Client(workers, set_as_default=False) as client,
    ):
        table = by_keywords(fields, client=client).table
    assert_frame_equal(table, by_keywords(fields).table, check_exact=True)


@pytest.mark.parametrize(
    "change",
    [
        {"free": {"kik": [0.1, 3.0]}},
        {"free": None},
        {"free": {"restitution": [0.1, 0.9]}},
        {"targets": {"speed": {"kind": "value", "of": "launch", "at": {"mass": 1}, "wanted": 1, "error": 1}}},
        {"targets": [{"kind": "value"}]},
        {"targets": None},
        {"method": "cmaes"},
        {"budget": None},
        {"budget": 0},
        {"population": 1.5},
        {"first": ["sped"]},
        {"first_within": 2.0},
        {"start": -1},
        {"seed": "a"},
    ],
)
def test_keywords_are_refused_as_fields_are(change: dict[str, Any]) -> None:
    fields = job()
    fields["search"] = {key: each for key, each in {**fields["search"], **change}.items() if each is not None}
    with pytest.raises(JobError) as written:
        read_search(fields, Path.cwd())
    with pytest.raises(JobError) as given:
        by_keywords(fields)
    assert str(given.value) == str(written.value)


def test_keywords_that_have_no_place_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "job.yaml"
    file.write_text(yaml.safe_dump(plain(TOY)))
    with pytest.raises(
        gs.ArgumentError, match=r"^budget is a field of the job file .*change it there, or by o"
    ):
        gs.search(file, budget=8)
    with pytest.raises(gs.ArgumentError, match=r"^mass is one of the job's fields: change it there"):
        gs.search(TOY, mass=2.0)
    with pytest.raises(gs.ArgumentError, match=r"^overrides are for a job file: change the mapping"):
        gs.search(TOY, overrides=["search.budget=8"])
    with pytest.raises(gs.ArgumentError, match=r"^overrides are for a job file: give the values as keywords"):
        by_keywords(TOY, overrides=["search.budget=8"])
    with pytest.raises(gs.ArgumentError, match=r"^mass is an axis, but takes a number: give ranges as free="):
        by_keywords(TOY, mass=[1.0, 2.0])
    with pytest.raises(gs.ArgumentError, match="masss is neither a parameter nor a start value"):
        by_keywords(TOY, masss=1.0)
    with pytest.raises(JobError, match=r"run\.kind is ramp, but search takes settle or fixed_time"):
        by_keywords(TOY, run=gs.Ramp(parameter="mass", path=[1.0, 2.0], rate=1.0))

    class Own(toy_model.Toy):
        """A class of this session."""

    with pytest.raises(gs.ArgumentError, match="Own is a class of this session, and a result directory ne"):
        gs.search(Own, tmp_path / "out", launch_1=1.0, restitution=0.5, **TOY["search"])


def test_words_have_no_order_that_pins_them() -> None:
    """Two of six words leave a constant free wherever they stand among the choices; one alone pins it."""
    words = ["tripod", "ripple", "wave", "trot", "pace", "bound"]
    both = pd.DataFrame({"gait": ["tripod", "ripple"] * 20, "score": np.linspace(0.1, 0.9, 40)})
    for choices in (words, [*words[2:], *words[:2]], [words[0], *words[2:], words[1]]):
        constant = _constant("gait", FreeParameter(choices=choices), both, both)
        assert (constant.verdict, constant.spread) == ("free", 0.2)
        assert constant.words == ("tripod", "tripod, ripple")
    one = both.iloc[::2]
    constant = _constant("gait", FreeParameter(choices=words), both, one)
    assert (constant.verdict, constant.words) == ("pinned", ("tripod", "tripod"))


def test_choices_that_are_numbers_are_in_order() -> None:
    """Of the choices 2, 8, 1 and 4 the near-best sets have 1 and 2, which are neighbours."""
    near_best = pd.DataFrame({"n": [2, 1] * 20, "score": np.linspace(0.1, 0.9, 40)})
    complete = pd.concat([near_best, pd.DataFrame({"n": [8, 4], "score": [5.0, 6.0]})])
    constant = _constant("n", FreeParameter(choices=[2, 8, 1, 4]), complete, near_best)
    assert (constant.words, constant.spread) == (("2", "1 to 2"), 0.25)
    scores = constant.profile[~np.isnan(constant.profile)]
    assert scores[2:].tolist() == [6.0, 5.0]


def test_the_repr_of_one_set_has_the_singular() -> None:
    near_best = pd.DataFrame({"n": [2], "score": [0.1]})
    assert repr(Identifiability(near_best, 1, ())) == "Identifiability: 1 set fits"
    assert repr(Identifiability(near_best, 0, ())) == "Identifiability: no set fits; 1 near-best one"


def test_a_constant_that_the_targets_do_not_see_is_free(tmp_path: Path) -> None:
    speed = {"speed": TOY["search"]["targets"]["speed"]}
    found = searched(job(targets=speed, method="sobol", budget=1024, population=256), tmp_path / "out")
    verdicts = {each.name: each.verdict for each in found.identifiability.constants}
    assert verdicts == {"kick": "too few sets to say", "stiffness": "free"}


@pytest.mark.slow
def test_multipliers_and_points_of_the_return_map(tmp_path: Path) -> None:
    # launch speeds are u_n+1 = restitution u_n + kick: the multiplier is the restitution
    targets = {
        "slope": {"kind": "fixed_point", "of": "multiplier", "at": {"mass": 1}, "wanted": 0.5, "error": 0.01},
        "speed": {"kind": "fixed_point", "of": "launch_1", "at": {"mass": 1}, "wanted": 1.6, "error": 0.01},
        "unstable": {"kind": "fixed_point", "of": "unstable", "at": {"mass": 1}, "wanted": 0, "error": 1},
    }
    free = {"kick": [0.1, 3.0], "restitution": [0.1, 0.9]}
    asked = job(free=free, targets=targets, method="sobol", budget=32, finalists=1)
    del asked["params"]
    table = searched(asked, tmp_path / "out").table
    assert np.allclose(table["slope"], table["restitution"], atol=1e-6)
    assert np.allclose(table["speed"], table["kick"] / (1.0 - table["restitution"]), rtol=1e-6)
    assert np.all(table["unstable"] == 0)


def test_misses_are_the_distance_from_what_is_wanted(tmp_path: Path) -> None:
    table = searched(job(method="sobol", budget=64), tmp_path / "out").table
    speed = table["kick"] / (1.0 - RESTITUTION)
    assert np.allclose(table["speed"], speed, rtol=1e-6)
    assert np.allclose(table[f"{MISS}speed"], (speed - SPEED) / 0.01, atol=1e-4)
    assert np.allclose(table["score"], np.sqrt((table[f"{MISS}speed"] ** 2 + table[f"{MISS}apex"] ** 2) / 2))


@pytest.mark.slow("cma-3", "nsga3-3", "sobol-1")
@pytest.mark.parametrize("side_by_side", [1, 3])
@pytest.mark.parametrize("method", get_args(Method))
def test_a_stopped_search_continues_to_the_same_bits(
    method: str, side_by_side: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = job(method=method, budget=120, population=24, side_by_side=side_by_side)
    whole = searched(asked, tmp_path / "whole").table
    measure, calls = Population.measure, []

    def stops(self: Population, *given: Any, **more: Any) -> Any:
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return measure(self, *given, **more)

    monkeypatch.setattr(Population, "measure", stops)
    with pytest.raises(KeyboardInterrupt):
        searched(asked, tmp_path / "parts")
    # side by side any of the first three batches may be the one that stops, and what follows it is lost
    parts = len(list((tmp_path / "parts" / "table").glob("part-*.parquet")))
    assert parts == 2 if side_by_side == 1 else parts <= 2
    calls.append(1)
    resumed = searched(asked, tmp_path / "parts").table
    assert_frame_equal(resumed, whole, check_exact=True)


def test_a_front_has_the_nondominated_sets(tmp_path: Path) -> None:
    # a kick that gives twice the speed: the two targets exclude each other
    targets = copy.deepcopy(TOY["search"]["targets"])
    targets["apex"] |= {"wanted": np.hypot(0.5, 2 * SPEED / np.sqrt(20.0)) - 0.5 + 1.0}
    found = searched(job(method="nsga3", targets=targets, budget=400, population=40), tmp_path / "out")
    misses = found.table[[f"{MISS}speed", f"{MISS}apex"]].abs().to_numpy()
    late = misses[-80:]
    assert np.min(misses[:, 0]) < 5.0  # each alone can be met
    beaten = [(misses < each).all(axis=1).any() for each in late]
    assert np.mean(beaten) < np.mean([(misses < each).all(axis=1).any() for each in misses[:80]])


@pytest.mark.slow
def test_structure_is_chosen_too(tmp_path: Path) -> None:
    free = {**TOY["search"]["free"], "N": {"choices": [1, 2]}}
    table = searched(job(free=free, method="sobol", budget=32, population=16), tmp_path / "out").table
    assert set(table["N"].astype(str)) == {"1", "2"}
    # masses do not touch each other
    assert np.allclose(table["speed"], table["kick"] / (1.0 - RESTITUTION), rtol=1e-6)


def test_failed_sets_stay_in_the_table(tmp_path: Path) -> None:
    asked = job(method="sobol", budget=64)
    asked["params"]["ceiling"] = 0.5
    table = searched(asked, tmp_path / "out").table
    fell = table["apex"].isna()
    assert 0 < np.sum(fell) < 64
    assert list(table["status"].cat.categories) == list(SetStatus)
    for read in (table, table.astype({"status": "str"})):  # of a file with other types of text
        assert np.array_equal(SetStatus.FAILED.among(read), fell)
        assert np.array_equal(SetStatus.COMPLETE.among(read), ~fell)
    assert table.loc[fell, "why"].str.contains("fell").all()
    assert (table.loc[fell, f"{MISS}speed"] == FAILED_MISS).all()


@pytest.mark.slow
def test_sets_that_fail_first_are_not_measured_further(tmp_path: Path) -> None:
    asked = job(method="sobol", budget=64)
    asked["params"]["ceiling"] = 0.5
    low = {**TOY["search"]["targets"]["speed"], "at": {"ceiling": 1000.0}}
    asked["search"]["targets"]["low"] = low
    del asked["params"]["ceiling"]
    asked["search"]["targets"]["apex"]["at"] = {"ceiling": 0.5}
    whole = searched(asked, tmp_path / "whole").table
    asked["search"]["first"] = ["apex"]
    turned = searched(asked, tmp_path / "turned").table
    fell = turned["apex"].isna()
    assert 0 < np.sum(fell) < 64
    assert turned.loc[fell, "low"].isna().all()
    assert turned.loc[fell, "why"].str.contains("low: not measured").all()
    assert_frame_equal(turned.loc[~fell], whole.loc[~fell], check_exact=True)
    asked["search"]["first_within"] = 20.0
    near = searched(asked, tmp_path / "near").table
    far = fell | (near[f"{MISS}apex"].abs() > 20.0)
    assert np.sum(fell) < np.sum(far) < 64
    assert near.loc[far, "low"].isna().all()
    assert_frame_equal(near.loc[~far], whole.loc[~far], check_exact=True)


def test_robustness_is_the_share_of_neighbours_that_keep_a_target(tmp_path: Path) -> None:
    # the speed is kick / (1 - restitution), read to 1 %, and keeps if both change together by less than that
    kick, restitution = np.random.default_rng(0).uniform(-0.02, 0.02, (2, 10**6))
    speed = (1.0 + kick) * (1.0 - RESTITUTION) / (1.0 - RESTITUTION * (1.0 + restitution))
    share = np.mean(np.abs(speed - 1.0) < 0.01)
    assert 0.4 < share < 0.5
    asked = job(robust={**ROBUST, "constants": ["restitution"]}, budget=2, method="sobol", finalists=1)
    asked["search"]["targets"]["speed"]["error"] = 0.01 * SPEED
    asked["search"]["known"] = [{"kick": KICK, "stiffness": 5.0}, {"kick": 2.0 * KICK}]
    found = searched(asked, tmp_path / "out")
    assert found.table.loc[0, "robust"] == pytest.approx(share, abs=0.08)  # three standard errors of 400
    assert np.isnan(found.table.loc[1, "robust"])
    assert found.table.loc[1, "why"] == "robust: the set itself does not keep the targets"
    assert found.finalists is not None
    assert found.finalists.loc[0, "robust_half"] == found.table.loc[0, "robust"]
    asked["search"]["robust"]["within"] = 0.001
    assert searched(asked, tmp_path / "near").table.loc[0, "robust"] == 1.0


def test_neighbours_stay_inside_bounds_that_are_excluded() -> None:
    asked = Robust(within=0.5, targets=["speed"], wanted=(0.9, 1.0), error=0.1)
    duty = gs.Quantity("duty", "1", "duty factor", low=0.9, high=1.0, open_ends=True)
    share = share_kept(
        asked,
        {"duty": np.array([0.95])},
        own={},
        free={"duty": FreeParameter(low=0.91, high=0.99)},
        quantities={"duty": duty},
        keeps=lambda sets: inside(sets["duty"], duty),
    )
    assert share == 1.0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"first": ["speeed"]}, "search.first[0] is speeed, which is not a target; did you mean speed?"),
        ({"free": {}}, "search.free is an empty mapping"),
        ({"free": {"kicks": [0, 1]}}, "search.free.kicks is not a parameter or start value of toy; did you"),
        ({"free": {"kick": [2, 1]}}, "goes from 2 to 1: low is below high"),
        ({"free": {"kick": [-1, 1]}}, "search.free.kick goes to -1, but must be at least 0"),
        ({"free": {"restitution": [0, 0.5]}}, "is free, but params.restitution fixes it"),
        ({"free": {"kick": {"low": 0.0, "high": 1.0, "log": True}}}, "equal ratios need a value above 0"),
        ({"free": {"kick": {"low": 1e-300, "high": 1e300, "log": True}}}, "1e+300, whose ratio is no finite"),
        ({"free": {"kick": [-1e308, 1e308]}}, "goes from -1e+308 to 1e+308, whose difference is no finite"),
        ({"free": {"kick": {"low": 1, "high": 9, "log": True, "whole": True}}}, "has log and whole"),
        ({"free": {"kick": [1, 2, 3]}}, "search.free.kick is a list (1, 2, 3), but takes [low, high]"),
        ({"free": {"kick": {"choices": [True, False]}}}, "has the choice true, but takes numbers"),
        ({"free": {"kick": {"choices": [0.5, 0.5]}}}, "search.free.kick has the choice 0.5 twice"),
        (
            {"free": {"N": {"choices": [1, 99]}}},
            "search.free.N is 99, but must be a whole number from 1 to 8",
        ),
        ({"first_within": 2.0}, "search.first_within has no meaning without search.first"),
        ({"method": "nsga3", "population": 1}, "search.population is 1, but nsga3 takes as many sets"),
        ({"targets": {}}, "search.targets is an empty mapping"),
        ({"robust": ROBUST | {"within": 2}}, "search.robust.within is 2, but is a share below 1"),
        (
            {"robust": ROBUST | {"targets": ["speeed"]}},
            "search.robust.targets[0] is speeed, which is not a target",
        ),
        ({"robust": ROBUST | {"constants": ["kick"]}}, "search.robust.constants[0] is kick, which is free"),
        (
            {"robust": ROBUST | {"constants": ["masss"]}},
            "is masss, which is not a parameter",
        ),
        ({"robust": {}}, "search.robust.within is missing: largest change"),
        ({"robust": ROBUST | {"set": 3}}, "search.robust.set is not a field of robust; did you mean sets?"),
        ({"robust": ROBUST, "first": ["robust"]}, "search.first[0] is robust, which is not a target"),
        ({"method": "annealing"}, "search.method"),
        ({"budgett": 5}, "search.budgett is not a field of search; did you mean budget?"),
    ],
)
def test_wrong_searches_are_refused(change: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    with pytest.raises(JobError) as refused:
        searched(job(**change), tmp_path / "out")
    assert sentence in str(refused.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("values", [5, "x", [[1]]])
@pytest.mark.parametrize("field", ["params", "start"])
def test_constants_that_are_no_mapping_are_refused(field: str, values: Any) -> None:
    with pytest.raises(JobError, match=f"{field} is .*, but must be a mapping"):
        read_search({**TOY, field: values}, Path())


def test_a_constant_of_zero_has_no_share_to_change_by(tmp_path: Path) -> None:
    asked = job(robust={**ROBUST, "constants": ["kicking"]})
    asked["params"] = {**asked["params"], "kicking": 0.0}
    with pytest.raises(JobError, match=r"constants\[0\] is kicking, whose value is 0.*other than 0"):
        searched(asked, tmp_path / "out")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("run", "same"), [({"kind": "settle"}, False), ({"kind": "fixed_time", "duration": 5}, True)]
)
def test_a_search_of_an_older_rule_is_not_continued(
    run: dict[str, Any], same: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows that did not settle had a gait, and their sets another score."""
    fields = {"device": "cpu", "engine": "kernel", "population": 1, "side_by_side": 1, "versions": {}}
    targets = {"hop": {"kind": "share", "gait": "hop", "at": {"mass": [1, 2]}, "wanted": 1, "error": 0.1}}
    asked = read_search({**job(targets=targets), "run": run}, Path.cwd())
    present = asked.hash(**fields)
    monkeypatch.setattr(Share, "rule_of_settling", 1)
    assert (asked.hash(**fields) == present) == same


def test_a_structure_is_either_fixed_or_free() -> None:
    asked = {**job(free={**TOY["search"]["free"], "N": {"choices": [1, 2]}}), "structure": {"N": 1}}
    with pytest.raises(JobError, match=r"search.free.N is free, but structure.N fixes it"):
        read_search(asked, Path.cwd())


@pytest.mark.slow
def test_the_structure_of_an_instance_may_be_free() -> None:
    fields = job(free={"N": {"choices": [1, 2]}}, method="sobol", budget=2)["search"] | {"finalists": 0}
    assert sorted(gs.search(toy_model.Toy(), **fields, run=gs.Settle()).table["N"].astype(str)) == ["1", "2"]


class Counted(toy_model.Toy):
    @property
    def parameters(self) -> tuple[gs.Quantity, ...]:
        return tuple(dataclasses.replace(q, whole=q.name == "mass") for q in super().parameters)


def test_a_range_of_a_constant_of_whole_numbers_is_whole() -> None:
    free = {"mass": [1, 8], "kick": [0.1, 3.0]}
    targets = {"speed": {**TOY["search"]["targets"]["speed"], "at": {"kicking": 1}}}
    asked = {**job(free=free, targets=targets), "model": f"{__name__}:Counted"}
    with pytest.raises(JobError, match=r"mass is a range of all numbers, .* {low: 1, high: 8, whole: true}"):
        read_search(asked, Path.cwd())


def test_a_constant_of_whole_numbers_has_no_neighbours(tmp_path: Path) -> None:
    asked = {**job(robust={**ROBUST, "constants": ["mass"]}), "model": f"{__name__}:Counted"}
    with pytest.raises(JobError, match=r"constants\[0\] is mass, which takes whole numbers only"):
        searched(asked, tmp_path / "out")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"kind": "valu"}, 'search.targets.speed.kind: "valu" is not an allowed kind; did you mean value?'),
        ({"of": "launch_2"}, "search.targets.speed.of is launch_2, which is unknown; did you mean launch_1"),
        ({"error": 0}, "search.targets.speed.error is 0, but must be above 0"),
        ({"at": {"mas": 1}}, "search.targets.speed.at.mas is not"),
        ({"at": {"kick": 1}}, "at.kick is free, but every measure sets it"),
        ({"at": {"mass": -1}}, "search.targets.speed.at.mass is -1, but must be above 0"),
        ({"held_back": True}, "are all held back"),
        ({"kind": ["value"]}, "search.targets.speed.kind: a list"),
        ({"of": "status"}, "search.targets.speed.of is status, which is unknown. Allowed: cycles"),
        ({"weight": 2}, "search.targets.speed.weight is not a field of a measure (value)"),
        ({"at": {"mass": {"linspace": "123"}}}, "has mass, which takes a number, a list, or {linspace: ["),
        ({"at": {"mass": {"linspace": [1, 2, 20000]}}}, "a linspace of 20000 points, but takes 2 to 10000"),
        (
            {"at": {"mass": {"linspace": [1, 2, 200]}, "preload": {"linspace": [1, 2, 200]}}},
            "search.targets.speed.at makes 40000 rows of a set, but a measure takes 10000 at most",
        ),
        ({"run": "settle"}, 'run is "settle", but takes fields, kind among them: settle or fixed_time.'),
        (
            {"run": {"duration": 1}},
            "run.kind is missing, but the run of a measure (value) is settle or fixed",
        ),
        (
            {"run": {"kind": "ramp"}},
            'run.kind is "ramp", but the run of a measure (value) is settle or fixed_',
        ),
        ({"run": {"kind": "fixed_time", "duraton": 1}}, "duraton is not a field of run; did you mean dura"),
        (
            {"run": {"kind": "settle", "refine": "boundary"}},
            "run.refine has no place in the run of a measure",
        ),
        (EDGE | {"at": {"mass": 1}}, "search.targets.speed.at has mass, which an edge takes as a list"),
        (EDGE | {"at": {"mass": [1, 3, 2]}}, "has mass, which an edge takes as a list that rises or falls"),
        (EDGE | {"at": {"mass": [1, 2], "preload": [1, 2]}}, "at has a list of preload too"),
        (EDGE | {"along": "mas"}, "search.targets.speed.along is mas, which is unknown; did you mean mass?"),
        (EDGE | {"gait": "trot"}, "search.targets.speed.gait is trot, which is unknown. Allowed: rest, hop"),
    ],
)
def test_wrong_targets_are_refused(change: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    speed = {**TOY["search"]["targets"]["speed"], **change}
    if speed["kind"] == "edge":
        del speed["of"]
    with pytest.raises(JobError) as refused:
        searched(job(targets={"speed": speed}), tmp_path / "out")
    assert sentence in str(refused.value)


@pytest.mark.parametrize(
    ("change", "path"),
    [
        ({"run": {"kind": "fixed_time", "duration": "2*kick"}}, "search.free.kick"),
        (FOLLOWING, "search.targets.speed.at.mass"),
    ],
)
def test_expressions_that_sets_would_leave_behind_are_refused(change: dict[str, Any], path: str) -> None:
    """Their fields have one value for all rows: all sets would have the number of one of them."""
    speed = {**TOY["search"]["targets"]["speed"], "at": {"mass": 2.0}}
    fields = job(targets={"speed": speed}) | change
    with pytest.raises(JobError, match=f"{path} differs between rows, but .* one value for all rows"):
        read_search(fields, Path.cwd())
    around = job(
        targets={"speed": speed | {"at": {"preload": 0.5}}}, robust={**ROBUST, "constants": ["mass"]}
    )
    own_mass = {**FOLLOWING, "params": {**FOLLOWING["params"], "mass": 2.0}}
    with pytest.raises(JobError, match=r"search.robust.constants\[0\] differs between rows"):
        read_search(around | own_mass, Path.cwd())
    # a measure that sets the job's own value is right
    read_search({**fields, **own_mass, "run": TOY["run"]}, Path.cwd())


def test_a_model_beside_the_job_is_found_again_from_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The job of a batch of sets is read anew, and a model in YAML with it."""
    (tmp_path / "toy_beside_its_job.py").write_text("from toy_model import Toy\n")
    population = read_search(job() | {"model": "toy_beside_its_job:Toy"}, tmp_path).fit.population()
    constants = {"kick": 1.0, "stiffness": 5.0}
    population.prepared({})
    monkeypatch.delitem(sys.modules, "toy_beside_its_job")
    batch = population.middle_job({}, constants, 3)
    assert batch is not None
    assert (batch.design.n_rows, batch.folder) == (3, tmp_path)


@pytest.mark.parametrize("name", ["kick", "why", "miss_speed", "speed_half", "1st"])
def test_targets_do_not_take_the_names_of_other_columns(name: str, tmp_path: Path) -> None:
    with pytest.raises(JobError, match=f"search.targets.{name} is "):
        searched(job(targets={name: TOY["search"]["targets"]["speed"]}), tmp_path / "out")


@pytest.mark.parametrize(
    ("run", "sentence"),
    [
        ({"kind": "ramp"}, "run.kind is ramp, but search takes settle or fixed_time"),
        ({"kind": "trace"}, "run.kind is trace, but search takes"),
        ({"kind": "settle", "refine": "boundary"}, "run.refine has no place beside search"),
    ],
)
def test_runs_without_one_record_a_row_are_refused(
    run: dict[str, Any], sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(JobError) as refused:
        searched({**TOY, "run": run}, tmp_path / "out")
    assert sentence in str(refused.value)


def test_a_measure_has_no_part_of_another_ones_conditions(tmp_path: Path) -> None:
    # the second does not set the mass, so it has the model's default, 1 kg
    apex = {"kind": "value", "of": "apex", "wanted": APEX, "error": 0.01}
    targets = {"heavy": {**apex, "at": {"mass": 4.0}}, "light": {**apex, "at": {"preload": 0.5}}}
    table = searched(job(targets=targets, method="sobol", budget=16), tmp_path / "out").table
    speed, stiffness = table["kick"] / (1.0 - RESTITUTION), table["stiffness"]
    for name, mass in (("heavy", 4.0), ("light", 1.0)):
        assert np.allclose(table[name], np.hypot(0.5, speed * np.sqrt(mass / stiffness)) - 0.5, rtol=1e-6)


def test_a_start_without_default_is_required_of_every_measure(tmp_path: Path) -> None:
    psi = {"kind": "value", "of": "psi_1", "wanted": 1.0, "error": 0.1}
    asked = {
        "name": "chain",
        "model": "multilegged",
        "start": {"psi_3": 3.1},
        "run": {"kind": "settle"},
        "search": {
            "free": {"beta": [0.72, 0.88]},
            "targets": {
                "both": {**psi, "at": {"psi_1": 1.8, "psi_2": 1.8}},
                "one": {**psi, "at": {"psi_1": 1.8}},
            },
            "budget": 4,
        },
    }
    with pytest.raises(JobError, match=r"search\.targets\.one\.at does not set psi_2"):
        searched(asked, tmp_path / "out")


@pytest.mark.parametrize("method", get_args(Method))
def test_one_constant_is_enough(method: str, tmp_path: Path) -> None:
    free = {"kick": [0.1, 3.0]}
    asked = job(free=free, method=method, budget=300)
    asked["params"]["stiffness"] = STIFFNESS
    best = searched(asked, tmp_path / "out").identifiability.best.iloc[0]
    assert best["kick"] == pytest.approx(KICK, rel=0.02)


@pytest.mark.parametrize("method", get_args(Method))
def test_a_search_whose_sets_all_fail_completes(method: str, tmp_path: Path) -> None:
    asked = job(method=method, budget=64)
    asked["params"]["ceiling"] = 1e-3
    found = run_search(read_search(asked, Path.cwd()), tmp_path / "out", figures=method == "sobol")
    assert set(found.table["status"].astype(str)) == {"failed"}
    assert len(found.identifiability.best) == 0
    assert all(file.is_file() for file in found.figures)
    assert len(found.figures) == (3 if method == "sobol" else 0)


@pytest.mark.slow
def test_a_front_of_twelve_targets(tmp_path: Path) -> None:
    apex = {"kind": "value", "of": "apex", "wanted": APEX, "error": 0.01}
    targets = {f"mass_{i}": {**apex, "at": {"mass": 1.0 + 0.2 * i}} for i in range(12)}
    result = gs.search(job(method="nsga3", targets=targets, budget=96, population=32), tmp_path / "out")
    assert set(result.table["status"].astype(str)) == {"complete"}
    assert all(file.is_file() for file in result.figures)


def test_choices_that_the_model_refuses_together_have_no_values() -> None:
    asked = read_search(job(free={**TOY["search"]["free"], "N": {"choices": [1, 2]}}), Path())

    def job_of(structure: Any) -> Any:
        if structure["N"] == 2:
            raise JobError([Diagnostic(("structure", "N"), "is 2, which does not go with the rest.")])
        return asked.fit.job_of(structure)

    sets = {"kick": np.full(2, 0.8), "stiffness": np.full(2, 6.0), "N": np.array([1, 2])}
    speed = Population(job_of, ["N"], asked.fit.measures).measure(sets)["speed"]
    assert speed.values[0] == pytest.approx(SPEED)
    assert np.isnan(speed.values[1])
    assert speed.why[1] == "refused: structure.N is 2, which does not go with the rest."


def test_choices_of_structure_alone_are_measured_elsewhere(tmp_path: Path) -> None:
    asked = read_search(job(free={"N": {"choices": [1, 2]}}), Path())
    population = asked.fit.population()
    numbers = iter(range(9))

    def elsewhere(job: Job, _on_progress: object) -> pd.DataFrame:
        return load(run_job(job, tmp_path / str(next(numbers)), figures=False))

    population.run_elsewhere = elsewhere
    speed = population.measure({"N": np.array([1, 1, 2])})["speed"]
    # the default of `kick` is a quarter of the angular frequency
    np.testing.assert_allclose(speed.values, 0.25 * np.sqrt(4.0) / (1.0 - RESTITUTION), rtol=1e-6)


def test_figures_that_cannot_be_written_are_refused_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = read_search(job(method="sobol", budget=16), Path())
    found = run_search(asked, tmp_path / "out", figures=False)
    (tmp_path / "out" / "figures").write_text("")
    with pytest.raises(TableError, match="figures is a file but must be a folder"):
        draw_search(tmp_path / "out", asked, found.table, found.identifiability)
    (tmp_path / "out" / "figures").unlink()

    def full(*_arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("gaitsweep.fitting.figures.replace_file", full)
    with pytest.raises(WriteError, match=r"convergence\.png could not be written: the disk is full"):
        draw_search(tmp_path / "out", asked, found.table, found.identifiability)


def test_half_the_step_moves_an_angle_by_the_shorter_way() -> None:
    starts = dict.fromkeys(("psi_1", "psi_2", "psi_3"), 0.5)
    psi = {"kind": "value", "of": "psi_1", "at": starts, "wanted": 0.0, "error": 0.1}
    fields = job(free={"m_B": [1.0, 2.0]}, targets={"psi": psi}, method="sobol")
    for field in ("params", "start"):
        del fields[field]
    asked = read_search({**fields, "model": "multilegged_reduced"}, Path())
    model = asked.fit.job_of({}).design.model
    finalists = pd.DataFrame({"psi": [3.14, 3.0], "psi_half": [-3.14, -3.0]})
    warning = _depends_on_the_step(asked, model, finalists)
    assert warning is not None
    assert "psi of 1, of 2 finalists" in warning


def test_a_full_disk_loses_one_batch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = job(method="sobol", budget=48)
    whole = searched(asked, tmp_path / "whole").table
    write, calls = ResultDirectory.write_part, []

    def full(*_arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    def writes(self: ResultDirectory, *given: Any) -> Any:
        calls.append(1)
        if len(calls) == 2:
            monkeypatch.setattr(os, "fsync", full)
        return write(self, *given)

    monkeypatch.setattr(ResultDirectory, "write_part", writes)
    with pytest.raises(WriteError, match="the disk is full; 16 of 48 rows are safe"):
        searched(asked, tmp_path / "parts")
    monkeypatch.undo()
    assert_frame_equal(searched(asked, tmp_path / "parts").table, whole, check_exact=True)


@pytest.mark.slow
def test_the_targets_of_the_shipped_search_are_those_of_its_constants() -> None:
    """The targets are the results of the chain at kappa = 100, beta = 0.8."""
    shipped = load_search(SWEEPS / "multilegged_search.yaml")
    values = {"kappa": np.array([100.0]), "beta": np.array([0.8])}
    for name, measured in shipped.fit.population().measure(values).items():
        assert measured.values % (2 * np.pi) == pytest.approx(shipped.targets[name].value.wanted[0], abs=1e-4)


@pytest.mark.slow
def test_the_estimate_counts_sets_and_rows() -> None:
    needs = estimate_search(load_search(SWEEPS / "multilegged_search.yaml"))
    assert (needs.sets, needs.together, needs.rows_of_a_set) == (1280, 32, 2)
    assert 0.0 < needs.seconds <= needs.seconds_most
    assert needs.steps > 1e6
    front = load_search(SWEEPS / "waist_quadruped_robust.yaml").fit.population()
    assert front.of(["bistable"]).rows_of_a_set == 18


def test_a_search_has_no_axes_and_no_figures(tmp_path: Path) -> None:
    with pytest.raises(JobError, match="vary has no place beside search"):
        read_search({**TOY, "vary": {"mass": [1, 2]}}, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["cma", "nsga3"])
def test_batches_side_by_side_learn_too(method: str, tmp_path: Path) -> None:
    start = {"start": 40} if method == "cma" else {}
    asked = job(method=method, budget=400, population=20, side_by_side=4, **start)
    found = searched(asked, tmp_path / "out").table
    assert found["score"].iloc[-100:].median() < 0.5 * found["score"].iloc[:100].median()
    # each batch was chosen before the three before it were known
    alone = searched(job(method=method, budget=400, population=20, **start), tmp_path / "alone").table
    chosen = ["kick", "stiffness"]
    assert not found[chosen].equals(alone[chosen])


@pytest.mark.parametrize("method", get_args(Method))
def test_optimisers_stay_in_their_ranges_and_repeat(method: Method) -> None:
    def points(seed: int) -> np.ndarray:
        made = optimiser(method, dimension=3, targets=2, start=16, together=16, seed=seed)
        asked = []
        for n in (16, 16, 16, 5):
            shares = made.ask(n)
            assert shares.shape == (n, 3)
            misses = np.stack([np.sum((shares - 0.2) ** 2, axis=1), np.abs(shares[:, 0] - 0.7)], axis=1)
            made.tell(np.sqrt(np.mean(misses**2, axis=1)), misses)
            asked.append(shares)
        return np.concatenate(asked)

    first = points(1)
    assert ((first >= 0.0) & (first <= 1.0)).all()
    assert np.array_equal(first, points(1))
    assert not np.array_equal(first, points(2))


@pytest.mark.parametrize("method", get_args(Method))
def test_known_points_come_first_even_if_a_batch_has_fewer(method: Method) -> None:
    known = np.random.default_rng(1).random((6, 2))
    made = optimiser(method, dimension=2, targets=2, start=0, together=4, seed=0, known_points=known)
    asked = []
    for _ in range(3):
        shares = made.ask(4)
        made.tell(shares.sum(axis=1), shares)
        asked.append(shares)
    assert np.array_equal(np.concatenate(asked)[:6], known)


def test_small_and_large_strategies_have_equal_budgets(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hansen 2009: a strategy begins as a large one unless the large ones have had more points so far.

    The points are counted here where CMA-ES gives them, and a large strategy is known by its width.
    """
    begun: list[tuple[bool, int, int, int]] = []  # whether large, size, points before of large and small
    asked = {True: 0, False: 0}

    class Counted(optimisers._Strategy):
        def __init__(self, middle: Any, width: float, size: int, seed: int) -> None:
            super().__init__(middle, width, size, seed)
            self.is_large = width == 0.2
            begun.append((self.is_large, size, asked[True], asked[False]))

        def ask(self) -> Any:
            points = super().ask()
            asked[self.is_large] += len(points)
            return points

    monkeypatch.setattr(optimisers, "_Strategy", Counted)
    search = optimiser("cma", dimension=3, targets=1, start=32, together=16, seed=0)
    for _ in range(400):
        points = search.ask(16)
        search.tell(np.sum((points - 0.3) ** 2, axis=1) + 0.1 * np.sin(40 * points).sum(1), np.zeros((16, 1)))
    assert len(begun) > 8
    large_sizes = [size for is_large, size, *_ in begun if is_large]
    assert large_sizes == [16 * 2 ** min(k, 3) for k in range(len(large_sizes))]
    for number, (is_large, size, of_large, of_small) in enumerate(begun):
        assert is_large == (of_large <= of_small)
        latest = [other for was_large, other, *_ in begun[:number] if was_large]
        assert is_large or 7 <= size <= max(latest[-1] / 2, 7)


def test_finalists_that_depend_on_the_step_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure = Population.measure

    def shifted(self: Population, *given: Any, share: float = 1.0, **more: Any) -> Any:
        result = measure(self, *given, share=share, **more)
        if share != 1.0:
            result["speed"].values[0] += 0.02
        return result

    messages: list[str] = []
    asked = read_search(job(budget=64), Path.cwd())
    run_search(asked, tmp_path / "sound", figures=False, on_message=messages.append)
    assert messages == []
    monkeypatch.setattr(Population, "measure", shifted)
    run_search(asked, tmp_path / "shifted", figures=False, on_message=messages.append)
    assert len(messages) == 1
    assert "half the step moves targets by more than their reading errors (speed of 1, of" in messages[0]


def test_finalists_are_kept(tmp_path: Path) -> None:
    asked = job(budget=50, finalists=3)
    found = searched(asked, tmp_path / "out")
    known = pd.read_parquet(tmp_path / "out" / FINALISTS)
    assert len(known) == min(3, len(found.identifiability.best))
    known.assign(score=-1.0).to_parquet(tmp_path / "out" / FINALISTS, index=False)
    assert found.finalists is not None
    again = searched(asked, tmp_path / "out").finalists
    assert again is not None
    assert_frame_equal(again, found.finalists, check_exact=True)
    assert toy_model.Toy.name == "toy"


@pytest.mark.slow
def test_the_shipped_search_finds_its_planted_constants(tmp_path: Path) -> None:
    result = gs.search(SWEEPS / "multilegged_search.yaml", tmp_path / "out")
    best = result.identifiability.best.iloc[0]
    assert best["kappa"] == pytest.approx(100.0, rel=0.01)
    assert best["beta"] == pytest.approx(0.8, rel=0.01)
    assert abs(best["miss_retrograde_psi_3"]) < 1.0  # held back
    assert {constant.verdict for constant in result.identifiability.constants} == {"pinned"}


@pytest.mark.slow
def test_constants_of_the_chain_are_found_again(tmp_path: Path) -> None:
    kappa, beta = 100.0, 0.8
    chain = gs.models.Multilegged(N=3)
    run = gs.Settle(max_cycles=300, tolerance=1e-6)
    starts = {"direct": 4.5, "retrograde": 1.8}
    truth = {
        name: gs.sweep(chain, kappa=kappa, beta=beta, psi_1=s, psi_2=s, psi_3=3.1, run=run, verify=0).table
        for name, s in starts.items()
    }
    targets = {
        f"{name}_{of}": {
            "kind": "value",
            "of": of,
            "at": {"psi_1": s, "psi_2": s},
            "wanted": float(truth[name][f"{of}_end"].iloc[0]),
            "error": 1e-3,
        }
        for name, s in starts.items()
        for of in ("psi_1", "psi_2", "psi_3")
    }
    asked = {
        "name": "planted",
        "model": "multilegged",
        "start": {"psi_3": 3.1},
        "run": run.model_dump(),
        "search": {
            "free": {"kappa": {"low": 60, "high": 240, "log": True}, "beta": [0.72, 0.88]},
            "targets": targets,
            "method": "cma",
            "budget": 640,
            "population": 32,
            "seed": 1,
        },
    }
    best = searched(asked, tmp_path / "out").identifiability.best.iloc[0]
    assert best["beta"] == pytest.approx(beta, rel=0.01)
    assert best["kappa"] == pytest.approx(kappa, rel=0.01)


@pytest.mark.slow
def test_workers_of_a_cluster_measure_the_same(tmp_path: Path) -> None:
    from gaitsweep.runs.cluster.connection import connection_to
    from gaitsweep.runs.cluster.dispatch import Cluster

    asked = read_search(job(budget=48, population=16), Path.cwd())
    alone = run_search(asked, tmp_path / "alone", figures=False)
    with Cluster(connection_to("local:2")) as workers:
        shared = run_search(asked, tmp_path / "shared", cluster=workers, figures=False)
    assert_frame_equal(shared.table, alone.table, check_exact=True)
    parts = sorted((tmp_path / "alone" / "table").glob("*.parquet"))
    assert [part.read_bytes() for part in parts] == [
        (tmp_path / "shared" / "table" / part.name).read_bytes() for part in parts
    ]
    assert not (tmp_path / "shared" / "batch").exists()


def test_the_shipped_phases_are_a_set_of_the_shipped_search() -> None:
    result = load_search(SWEEPS / "waist_quadruped_phases_search.yaml")
    points = optimiser(
        "sobol", dimension=len(result.free), targets=1, start=0, together=64, seed=result.options.seed
    ).ask(8501)
    shipped = yaml.safe_load((SWEEPS.parent / "configs" / "aoi2011_phases.yaml").read_text())["params"]
    for name, column in sets_at(result.free, points[-1:]).items():
        assert float(column[0]) == pytest.approx(shipped.get(name, 0), rel=1e-4), name


@pytest.mark.slow
def test_known_sets_are_measured_first(tmp_path: Path) -> None:
    """From a set near the planted one a strategy needs fewer sets than from Sobol points alone."""
    known = [{"kick": 0.79, "stiffness": 6.1}, {"kick": KICK}]
    for method in get_args(Method):
        few = job(method=method, budget=32, known=known, **({"start": 0} if method == "cma" else {}))
        table = searched(few, tmp_path / method).table
        assert table["kick"].tolist()[:2] == pytest.approx([0.79, KICK], rel=1e-12)
        # a constant that a known set does not name has the model's default
        default = next(q.default for q in toy_model.Toy().parameters if q.name == "stiffness")
        assert table["stiffness"].tolist()[:2] == pytest.approx([6.1, default], rel=1e-12)
        again = searched(few, tmp_path / f"{method}_again").table
        assert_frame_equal(table, again)


def test_every_field_of_a_search_is_a_keyword() -> None:
    assert {"free", "targets", *SearchOptions.model_fields} <= set(inspect.signature(gs.search).parameters)


def test_a_known_set_needs_no_start_that_the_measures_set(tmp_path: Path) -> None:
    fields = yaml.safe_load((SWEEPS / "multilegged_search.yaml").read_text())
    fields["search"]["known"] = [{"kappa": 100}]
    (known,) = read_search(fields, SWEEPS).known
    assert known["kappa"] == 100.0
    assert 0.72 <= known["beta"] <= 0.88


@pytest.mark.parametrize("file", sorted(SWEEPS.glob("*_front.yaml")), ids=lambda file: file.stem)
def test_known_sets_of_the_shipped_fronts_lie_in_their_ranges(file: Path) -> None:
    search = load_search(file)
    assert len(search.known) == len(search.options.known)


def test_a_known_set_may_be_a_config(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text("model: toy_model:Toy\nparams: {kick: 0.7, stiffness: 5}\n")
    search = read_search(job(known=["own.yaml"]), tmp_path)
    assert search.known == ({"kick": 0.7, "stiffness": 5.0},)
    # another content is another search
    (tmp_path / "own.yaml").write_text("model: toy_model:Toy\nparams: {kick: 0.7, stiffness: 7}\n")
    assert read_search(job(known=["own.yaml"]), tmp_path).written != search.written


def test_a_known_config_does_not_change_the_structure() -> None:
    """Constants that its structure lacks have the model's default; common ones have the config's value."""
    fields = yaml.safe_load((SWEEPS / "waist_quadruped_front.yaml").read_text())
    fields["search"]["known"] = ["builtin:aoi2011_ellipse"]
    del fields["structure"]
    fields["config"] = "builtin:aoi2011_three_gaits"  # its heights are given
    (known,) = read_search(fields, SWEEPS).known
    other = yaml.safe_load((SWEEPS.parent / "configs" / "aoi2011_ellipse.yaml").read_text())
    assert other["structure"].get("heights", "level") == "level"
    assert known["kappa_2"] == other["params"]["kappa_2"]
    assert (known["front_hip_z"], known["rear_height"]) == (0.0, 0.05)


@pytest.mark.slow
def test_known_sets_may_be_the_best_of_an_earlier_search(tmp_path: Path) -> None:
    earlier = searched(job(method="sobol", budget=32), tmp_path / "earlier").table
    search = read_search(job(known=["earlier"], known_best=3, width=0.02), tmp_path)
    best = earlier.sort_values("score").head(3)
    names = list(search.free)
    assert [[each[name] for name in names] for each in search.known] == best[names].to_numpy().tolist()
    # a narrow strategy stays near the best of them
    after = run_search(search, tmp_path / "after", figures=False).table["kick"][48:64]
    low, high = search.free["kick"].ends
    assert np.std(after) / (high - low) < 0.04
    # what it takes is part of the job: the earlier search may go
    shutil.rmtree(tmp_path / "earlier")
    written = yaml.safe_load((tmp_path / "after" / "job.yaml").read_text())
    assert read_search(written, tmp_path).known == search.known


def test_a_width_and_a_start_are_of_cma_and_a_width_is_a_share(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"search.start has no meaning for the method nsga3: it is cma's"):
        read_search(job(method="nsga3", start=16), tmp_path)
    with pytest.raises(JobError, match=r"search.width has no meaning for the method sobol: it is cma's"):
        read_search(job(method="sobol", width=0.1), tmp_path)
    with pytest.raises(JobError, match=r"search.width is 2, but is a share of the ranges, at most 1"):
        read_search(job(width=2), tmp_path)


@pytest.mark.parametrize(
    ("known", "sentence"),
    [
        ([{"kick": 5.0}], r"search.known\[0\] has kick at 5.0, outside of its range, 0.1 to 3."),
        ([{"kic": 1.0}], r"search.known\[0\] is refused: kic is not free here; did you mean kick\?"),
        (["none.yaml"], r"search.known\[0\] is refused: config names .*none.yaml"),
        ([3], "search.known"),
        (["."], r"search.known\[0\] is refused: .* is not a result directory"),
        ([{"kick": 1.0}] * 3, "search.known has 3 sets, but the budget is 2."),
    ],
)
def test_known_sets_that_do_not_fit_are_refused(known: list[Any], sentence: str, tmp_path: Path) -> None:
    with pytest.raises(JobError, match=sentence):
        read_search(job(known=known, budget=2), tmp_path)
