"""Jobs: what YAML and Python say become the same rows, whole or in slices, and the same hash."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
import pickle
import tracemalloc
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import qmc

from gaitsweep import models
from gaitsweep.design import Design
from gaitsweep.expression import evaluate
from gaitsweep.job import Job, JobError, load_job, schema
from gaitsweep.job.numerics import rows_of_a_part
from gaitsweep.kinds.ramp import Ramp
from gaitsweep.kinds.settle import Settle
from tests.support import MODELS
from toy_model import Toy

TOY = "toy_model:Toy"
BASE: dict[str, Any] = {"name": "toy", "model": TOY, "run": {"kind": "settle"}}


def toy(**fields: Any) -> Job:
    return Job(**{**copy.deepcopy(BASE), **fields})


def rows_of(job: Job) -> dict[str, np.ndarray]:
    rows = job.design
    return rows.columns(0, rows.n_rows)


def written(folder: Path, text: str, name: str = "job.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


PINNED_RANDOM = [1.7545246278695097, 1.1632804305752058, 1.7360300467738945]
PINNED_SOBOL = [1.7545246281661093, 1.2545246281661093, 1.0045246281661093, 1.5045246281661093]
PINNED_HASH = "371eb7c151e5829939433e9b77d389a0c593cb9fa5b5bb78c225b27fe76654f1"

QUICK = """\
name: quick
model: toy_model:Toy
structure: {N: 2}
params:
  stiffness: 1e2
  mass: "4 / 1"
  kicking: true
vary:
  restitution: {linspace: [0, 0.5, 3]}
  launch_1: {values: [1, 2*pi, "sqrt(stiffness)", "1 + restitution"]}
run: {kind: settle, max_cycles: 2*50, tolerance: 1e-3, max_time: 3*2*pi/sqrt(stiffness/mass)}
numerics: {dt: 2.0e-3}
figures:
  - {kind: basin, x: restitution, y: launch_1, hue: launch_2_end}
"""


def test_a_file_becomes_rows(tmp_path: Path) -> None:
    job = load_job(written(tmp_path, QUICK))
    rows = job.design
    assert isinstance(rows, Design)
    assert rows.n_rows == 12
    assert [(axis.names, axis.length) for axis in rows.groups] == [(("restitution",), 3), (("launch_1",), 4)]
    columns = rows.columns(0, 12)
    assert list(columns) == ["restitution", "launch_1"]
    assert columns["restitution"].tolist() == [0.0] * 4 + [0.25] * 4 + [0.5] * 4
    assert columns["launch_1"].tolist() == [
        *(1.0, 2 * math.pi, 10.0, 1.0),
        *(1.0, 2 * math.pi, 10.0, 1.25),
        *(1.0, 2 * math.pi, 10.0, 1.5),
    ]
    params, start = rows.values(4, 6)
    assert list(params) == [quantity.name for quantity in rows.model.parameters]
    assert list(start) == ["launch_1", "launch_2"]
    assert params["kick"].tolist() == [1.25, 1.25]  # 0.25 sqrt(100/4)
    assert params["kicking"].dtype == np.float64
    assert start["launch_2"].tolist() == [1.0, 1.0]
    assert rows.derived == {"kick": "0.25*sqrt(stiffness/mass)"}
    assert isinstance(job.run, Settle)
    assert job.run.max_cycles == 100
    assert job.run.max_time == pytest.approx(6 * math.pi / 5, rel=1e-15)
    assert job.numerics.dt == 2e-3


def test_python_and_yaml_give_the_same_job(tmp_path: Path) -> None:
    fields = yaml.safe_load(QUICK)
    fields["vary"]["restitution"] = np.linspace(0, 0.5, 3)
    fields["vary"]["launch_1"] = [1, "2*pi", "sqrt(stiffness)", "1 + restitution"]
    ours, theirs = Job(**fields), load_job(written(tmp_path, QUICK))
    assert {name: list(each) for name, each in rows_of(ours).items()} == {
        name: list(each) for name, each in rows_of(theirs).items()
    }


def test_resolved_is_the_same_job_again(tmp_path: Path) -> None:
    job = load_job(written(tmp_path, QUICK))
    again = load_job(written(tmp_path, yaml.safe_dump(job.resolved(), sort_keys=False), "resolved.yaml"))
    assert again.resolved() == job.resolved()
    assert again.hash() == job.hash()
    assert job.resolved()["params"]["kick"] == "0.25*sqrt(stiffness/mass)"
    assert job.resolved()["start"] == {"launch_2": 1.0}
    assert job.resolved()["engine"]["name"] == "auto"
    assert job.resolved(engine="kernel")["engine"]["name"] == "kernel"


@pytest.mark.parametrize("name", ["waist_quadruped_basins", "multilegged_source_place"])
def test_a_resolved_job_has_the_same_hash(name: str) -> None:
    """Formulas among a model's defaults too, which are written with spaces."""
    job = load_job(Path(__file__).parents[2] / "sweeps" / f"{name}.yaml")
    assert any(isinstance(value, str) and " " in value for value in job.resolved()["params"].values())
    assert Job(**job.resolved()).hash() == job.hash()


def test_no_vary_is_one_row() -> None:
    rows = toy().design
    assert (rows.n_rows, rows.columns(0, 1), rows.groups) == (1, {}, ())
    assert rows.values(0, 1)[1]["launch_1"].tolist() == [1.0]
    with pytest.raises(IndexError):
        rows.columns(0, 2)


# Row expansion

LENGTHS = st.lists(st.integers(1, 5), min_size=1, max_size=4)
NAMES = ("mass", "stiffness", "preload", "launch_1")


@given(LENGTHS, st.data())
def test_rows_are_the_product(lengths: list[int], data: st.DataObject) -> None:
    number = st.floats(0.1, 10.0, allow_nan=False)
    axes = [data.draw(st.lists(number, min_size=length, max_size=length)) for length in lengths]
    columns = rows_of(toy(vary=dict(zip(NAMES, axes, strict=False))))
    found = list(zip(*(columns[name].tolist() for name in columns), strict=True))
    assert found == list(itertools.product(*axes))


EVERY_AXIS: dict[str, Any] = {
    "restitution": {"linspace": [0, 0.5, 4], "at": "centre"},
    "zip": {"mass": [1, 2, 3], "stiffness": {"logspace": [1, 100, 3]}},
    "launch_1": {"values": [1, "launch_2*2", "sqrt(stiffness) + restitution**1.5"]},
    "sample": {
        "n": 5,
        "seed": 3,
        "method": "sobol",
        "of": {"launch_2": [0.5, "1+mass"], "preload": [0.1, 1]},
    },
    "ceiling": {"random": [10, 20, 2], "seed": 1},
}
EVERY = toy(structure={"N": 2}, vary=EVERY_AXIS)


@given(st.integers(0, 360), st.integers(0, 360))
def test_slices_equal_the_whole(one: int, other: int) -> None:
    start, stop = sorted((one, other))
    rows = EVERY.design
    assert rows.n_rows == 4 * 3 * 3 * 5 * 2
    whole, part = rows.columns(0, 360), rows.columns(start, stop)
    assert list(part) == ["restitution", "mass", "stiffness", "launch_1", "launch_2", "preload", "ceiling"]
    assert all(np.array_equal(part[name], whole[name][start:stop]) for name in whole)
    for all_rows, some in zip(rows.values(0, 360), rows.values(start, stop), strict=True):
        assert all(np.array_equal(some[name], all_rows[name][start:stop]) for name in all_rows)


def test_a_zip_moves_together() -> None:
    columns = rows_of(toy(vary={"preload": [1, 2], "zip": {"mass": [1, 2, 3], "launch_1": [4, 5, 6]}}))
    assert columns["preload"].tolist() == [1, 1, 1, 2, 2, 2]
    assert columns["mass"].tolist() == [1, 2, 3] * 2
    assert columns["launch_1"].tolist() == [4, 5, 6] * 2


def test_lists_of_groups_multiply() -> None:
    zips = [{"mass": [1, 2]}, {"preload": [3, 4, 5], "launch_1": [6, 7, 8]}]
    rows = toy(vary={"zip": zips, "sample": [{"n": 2, "of": {"stiffness": [1, 2]}}]}).design
    assert [axis.length for axis in rows.groups] == [2, 3, 2]


@pytest.mark.slow
@given(st.floats(0.1, 10), st.floats(0.1, 10), st.integers(2, 40))
def test_spread_axes_are_numpys(low: float, high: float, count: int) -> None:
    def points(axis: dict[str, Any]) -> np.ndarray:
        return rows_of(toy(vary={"mass": axis}))["mass"]

    ends = points({"linspace": [low, high, count]})
    assert ends == pytest.approx(np.linspace(low, high, count), rel=1e-14)
    assert (ends[0], ends[-1]) == (low, high)
    edges = np.linspace(low, high, count + 1)
    centre = points({"linspace": [low, high, count], "at": "centre"})
    assert centre == pytest.approx((edges[1:] + edges[:-1]) / 2, rel=1e-14)
    ratios = points({"logspace": [low, high, count]})
    assert ratios == pytest.approx(np.geomspace(low, high, count), rel=1e-12)
    assert (ratios[0], ratios[-1]) == (low, high)


@pytest.mark.slow
@given(st.sampled_from(["random", "sobol"]), st.integers(0, 1000), st.integers(1, 300))
def test_drawn_points_fill_their_box(method: str, seed: int, count: int) -> None:
    of = {"mass": [1, 2], "preload": [3, 7]}
    columns = rows_of(toy(vary={"sample": {"n": count, "seed": seed, "method": method, "of": of}}))
    assert all(((low <= columns[name]) & (columns[name] < high)).all() for name, (low, high) in of.items())
    swapped = dict(reversed(of.items()))
    again = rows_of(toy(vary={"sample": {"n": count, "seed": seed, "method": method, "of": swapped}}))
    if method == "random":  # each name has a stream of its own, whatever stands beside it
        assert all(np.array_equal(columns[name], again[name]) for name in of)


def test_random_points_are_pinned() -> None:
    """The very numbers, so that another version of NumPy or SciPy cannot change a job's rows unseen."""
    random = rows_of(toy(vary={"mass": {"random": [1, 2, 3], "seed": 7}}))["mass"]
    sobol = rows_of(toy(vary={"mass": {"sobol": [1, 2, 4], "seed": 7}}))["mass"]
    assert random.tolist() == PINNED_RANDOM
    assert sobol.tolist() == PINNED_SOBOL


def test_names_and_seeds_draw_apart() -> None:
    def drawn(name: str, seed: int) -> list[float]:
        return rows_of(toy(vary={name: {"random": [0.1, 0.9, 4], "seed": seed}}))[name].tolist()

    assert drawn("mass", 0) != drawn("preload", 0)
    assert drawn("mass", 0) != drawn("mass", 1)


def test_sobol_is_more_even_than_random() -> None:
    def discrepancy(method: str) -> float:
        of = {"mass": [1, 2], "preload": [1, 2]}
        columns = rows_of(toy(vary={"sample": {"n": 256, "method": method, "of": of}}))
        return float(qmc.discrepancy(np.column_stack([columns["mass"] - 1, columns["preload"] - 1])))

    # About 4e-5 against 1e-3 at 256 points of a square: a broken shift would lose the factor of ten.
    assert discrepancy("sobol") < 0.1 * discrepancy("random")


def test_memory_does_not_grow_with_the_rows() -> None:
    vary = {name: {"linspace": [1, 2, 1000]} for name in ("mass", "stiffness", "launch_1")}
    tracemalloc.start()
    rows = toy(vary=vary).design
    part = rows.columns(10**9 - 3, 10**9)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert rows.n_rows == 10**9
    assert part["launch_1"].tolist() == pytest.approx([2 - 2 / 999, 2 - 1 / 999, 2])
    assert peak < 20e6  # bytes; the rows themselves would take 24e9


def test_large_formulas_are_checked_block_by_block() -> None:
    """Too many combinations to try beforehand: the block that holds the first bad row says so."""
    vary = {"mass": {"linspace": [1, 2, 2000]}, "launch_1": {"linspace": ["2-mass", 3, 2000]}}
    rows = toy(vary=vary).design
    rows.values(0, 10)
    with pytest.raises(JobError, match=r"launch_1 is 0 in row 3998000, but must be above 0"):
        rows.values(3_998_000, 4_000_000)


# Names of files


@pytest.mark.parametrize("text", ["small\n", " small", "small\n\n"])
def test_a_name_has_no_space_around_it(text: str) -> None:
    assert toy(name=text).name == "small"


@pytest.mark.parametrize("text", ["small\nlarge", "sm all", "\n", "small/\n", "..\n"])
def test_a_name_that_names_no_file_is_refused(text: str) -> None:
    with pytest.raises(JobError, match="name is "):
        toy(name=text)


# Formulas


def test_formulas_follow_what_varies() -> None:
    rows = toy(params={"ceiling": "100*kick"}, vary={"stiffness": [4, 16]}).design
    params, _ = rows.values(0, 2)
    assert params["kick"].tolist() == [0.5, 1.0]
    assert params["ceiling"].tolist() == [50.0, 100.0]
    assert rows.derived == {"kick": "0.25*sqrt(stiffness/mass)", "ceiling": "100*kick"}


def test_what_follows_a_parameter_comes_after_what_it_uses() -> None:
    """Directly or through another formula; `ceiling` is asked for before the `kick` that it needs."""
    rows = toy(params={"ceiling": "100*kick", "preload": "mass/2", "restitution": 0.5}).design
    assert tuple(rows.following("stiffness")) == ("kick", "ceiling")
    assert set(rows.following("mass")) == {"kick", "ceiling", "preload"}
    assert tuple(rows.following("kick")) == ("ceiling",)
    assert not rows.following("restitution")


def test_formulas_may_use_the_structure() -> None:
    rows = toy(structure={"N": 2}, params={"mass": "N/4"}, start={"launch_1": "N*launch_2"}).design
    assert rows.values(0, 1)[0]["mass"].tolist() == [0.5]
    assert rows.values(0, 1)[1]["launch_1"].tolist() == [2.0]
    assert rows.derived["mass"] == "2.0/4"


@dataclasses.dataclass(frozen=True)
class Shifted(Toy):
    c: float = dataclasses.field(default=-2.0, metadata={"low": -9.0})


def test_a_negative_number_of_the_structure_keeps_its_sign_in_a_formula() -> None:
    rows = toy(model=f"{__name__}:Shifted", params={"ceiling": "-c**3*stiffness/2 - c"}).design
    ceiling = rows.values(0, 1)[0]["ceiling"].item()
    assert evaluate(rows.derived["ceiling"], {"stiffness": 4.0}) == ceiling == 18.0


def test_a_ramp_starts_at_its_path_and_takes_formulas_along() -> None:
    run = {"kind": "ramp", "parameter": "stiffness", "path": ["4*mass", 100, 4], "rate": 0.1}
    job = toy(run=run, vary={"launch_1": [1, 2]})
    assert isinstance(job.run, Ramp)
    assert job.run.path == [4.0, 100.0, 4.0]
    assert job.design.values(0, 1)[0]["stiffness"].tolist() == [4.0]
    assert "stiffness" not in job.resolved()["params"]
    assert Job(**job.resolved()).hash() == job.hash()
    with pytest.raises(
        JobError, match=r"params.kick is .*, but must be at least 0 .* the ramp has stiffness = 100"
    ):
        toy(run=run, params={"kick": "50-stiffness"})


# Where things are written


def test_structure_may_stand_in_params() -> None:
    assert toy(params={"N": 3}).structure == {"N": 3}
    assert toy(params={"N": 3}).hash() == toy(structure={"N": 3}).hash()


def test_a_config_gives_what_the_job_does_not_say(tmp_path: Path) -> None:
    (tmp_path / "configs").mkdir()
    (tmp_path / "sweeps").mkdir()
    config = "model: toy_model:Toy\nsource: a paper\nstructure: {N: 2}\n"
    config += "params: {mass: 2, stiffness: 9, preload: 1}\n"
    written(tmp_path / "configs", config, "paper.yaml")
    text = "name: a\nconfig: ../configs/paper.yaml\nparams: {mass: 5}\nvary: {preload: [1, 2]}\n"
    text += "run: {kind: settle}\n"
    job = load_job(written(tmp_path / "sweeps", text))
    assert job.model == TOY
    assert job.structure == {"N": 2}
    assert job.params == {"mass": 5.0, "stiffness": 9.0}
    assert "config" not in job.resolved()
    apart = toy(structure={"N": 2}, params={"mass": 5, "stiffness": 9}, vary={"preload": [1, 2]})
    assert job.hash() == apart.hash()


def test_overrides_are_laid_over_the_file(tmp_path: Path) -> None:
    path = written(tmp_path, QUICK)
    overrides = [
        "run.max_cycles=10",
        "engine.block=7",
        "params.preload=1e-1",
        "vary.launch_1=[1,2]",
        "figures=",
    ]
    job = load_job(path, overrides)
    assert isinstance(job.run, Settle)
    assert job.run.max_cycles == 10
    assert job.engine.block == 7
    assert job.params["preload"] == 0.1
    assert job.design.n_rows == 6
    assert job.figures == []


def test_a_model_beside_the_job(tmp_path: Path) -> None:
    source = (MODELS / "toy_model.py").read_text(encoding="utf-8")
    written(tmp_path, source, "my_own_bouncer.py")
    job = load_job(written(tmp_path, "name: a\nmodel: my_own_bouncer:Toy\nrun: {kind: settle}\n"))
    assert job.design.model.name == "toy"


def test_the_registry() -> None:
    assert "multilegged" in models.names()
    with pytest.raises(models.ModelError, match="did you mean multilegged"):
        models.find("multileged")


def test_yaml_as_it_is_meant(tmp_path: Path) -> None:
    """Anchors, hexadecimal and underscores are read; text that looks like YAML 1.1's booleans stays text."""
    text = """\
name: no
model: toy_model:Toy
params: {mass: &one 1_0, preload: *one, stiffness: 0x10, ceiling: +.5e3, kick: -0}
vary:
run: {kind: settle}
"""
    job = load_job(written(tmp_path, text))
    assert job.name == "no"
    assert job.params == {"mass": 10.0, "preload": 10.0, "stiffness": 16.0, "ceiling": 500.0, "kick": 0.0}
    assert math.copysign(1, float(job.params["kick"])) == 1.0


# The hash


def _shuffled(value: Any, data: st.DataObject, ordered: bool = False) -> Any:
    if isinstance(value, dict):
        keys = list(value) if ordered else data.draw(st.permutations(list(value)))
        return {key: _shuffled(value[key], data) if key != "vary" else value[key] for key in keys}
    return value


DECIDING = {
    **BASE,
    "structure": {"N": 2},
    "params": {"mass": 2, "stiffness": 9.0, "preload": "mass/4"},
    "start": {"launch_1": 1.5},
    "vary": {"launch_2": {"linspace": [1, 2, 5]}, "restitution": {"random": [0, 0.5, 3], "seed": 2}},
    "run": {"kind": "settle", "max_cycles": 50, "tolerance": 1e-4},
    "numerics": {"dt": 1e-3, "event_tolerance": 1e-11},
    "engine": {"block": 64, "lanes": 8},
}


@pytest.mark.slow
@given(st.data())
def test_hash_does_not_see_the_order_of_keys(data: st.DataObject) -> None:
    assert Job(**_shuffled(DECIDING, data)).hash() == Job(**DECIDING).hash()


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("structure.N", 3),
        ("params.mass", 2.0000000000000004),
        ("params.preload", "mass/5"),
        ("params.kick", 0.1),
        ("start.launch_1", 1.25),
        ("vary.launch_2.linspace", [1, 2, 6]),
        ("vary.launch_2.linspace", [1, 2.5, 5]),
        ("vary.launch_2.at", "centre"),
        ("vary.restitution.seed", 3),
        ("vary.restitution", {"sobol": [0, 0.5, 3], "seed": 2}),
        ("vary.ceiling", [10]),
        ("run.max_cycles", 51),
        ("run.tolerance", 2e-4),
        ("run.max_time", 1e3),
        ("run", {"kind": "return_map", "crossings": 5}),
        ("numerics.dt", 1.5e-3),
        ("numerics.precision", "float32"),
        ("numerics.event_tolerance", 1e-10),
        ("engine.block", 65),
        ("engine.lanes", 9),
        ("engine.contraction", False),
    ],
)
def test_hash_sees_what_decides_the_numbers(path: str, value: Any) -> None:
    changed = copy.deepcopy(DECIDING)
    *outer, last = path.split(".")
    inside: Any = changed
    for key in outer:
        inside = inside[key]
    inside[last] = value
    assert Job(**changed).hash() != Job(**DECIDING).hash()


def test_hash_sees_neither_name_nor_figures() -> None:
    plain = toy(vary={"mass": [1, 2]})
    figure = {"kind": "basin", "x": "mass", "y": "launch_1_end"}
    assert toy(name="other", vary={"mass": [1, 2]}, figures=[figure]).hash() == plain.hash()
    other = toy(vary={"mass": {"values": [1.0, "4/2"]}}, engine={"name": "xla", "devices": 2})
    assert other.hash() == plain.hash(engine="xla")
    assert plain.hash(device="gpu") != plain.hash()
    assert plain.hash(lanes=256) != plain.hash(lanes=512)
    # as before there was a choice: directories of older runs can be resumed
    assert toy(vary={"mass": [1, 2]}, engine={"contraction": True}).hash() == plain.hash()


def test_contraction_reaches_the_engine() -> None:
    assert toy(vary={"mass": [1, 2]}).integration.contraction
    assert not toy(vary={"mass": [1, 2]}, engine={"contraction": False}).integration.contraction


def test_hash_sees_the_order_of_the_axes() -> None:
    assert toy(vary={"mass": [1], "preload": [2]}).hash() != toy(vary={"preload": [2], "mass": [1]}).hash()


def test_hash_is_pinned() -> None:
    """The same in every version of Python: a change of it must be meant (`_HASHED_FORM`)."""
    assert Job(**DECIDING).hash() == PINNED_HASH


# What else is built on jobs


def test_the_schema_takes_what_jobs_take(tmp_path: Path) -> None:
    described = schema()
    jsonschema.Draft202012Validator.check_schema(described)
    jsonschema.validate(yaml.safe_load(QUICK), described)
    jsonschema.validate(load_job(written(tmp_path, QUICK)).resolved(), described)
    jsonschema.validate({**BASE, "vary": EVERY_AXIS}, described)
    for wrong in (
        {"rum": 1},
        {"run": {"kind": "setle"}},
        {"vary": {"mass": {"linspcae": [0, 1, 2]}}},
        {"figures": 3},
    ):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**BASE, **wrong}, described)


def test_the_schema_describes_every_field() -> None:
    def parts(node: Any) -> list[dict[str, Any]]:
        if isinstance(node, list):
            return [part for item in node for part in parts(item)]
        if not isinstance(node, dict):
            return []
        inner = [part for value in node.values() for part in parts(value)]
        return [*node["properties"].values(), *inner] if isinstance(node.get("properties"), dict) else inner

    described = parts(schema())
    assert len(described) > 40
    assert all(part.get("description") or "$ref" in part for part in described)


def test_jobs_and_their_errors_travel_between_processes() -> None:
    again = pickle.loads(pickle.dumps(EVERY))
    assert again.hash() == EVERY.hash()
    assert again.design.columns(0, 5)["launch_2"].tolist() == EVERY.design.columns(0, 5)["launch_2"].tolist()
    with pytest.raises(JobError) as refused:
        toy(params={"mas": 1})
    assert str(pickle.loads(pickle.dumps(refused.value))) == str(refused.value)


def test_a_job_does_not_change() -> None:
    with pytest.raises(Exception, match="frozen"):
        EVERY.name = "other"


def test_a_large_table_has_at_most_500_parts() -> None:
    rows = {1: 1024, 65_536: 1024, 65_537: 2048, 2_097_152: 32_768, 16_384_001: 65_536, 10**8: 262_144}
    assert {n: rows_of_a_part("auto", n) for n in rows} == rows
    assert rows_of_a_part(7, 10**8) == 7
