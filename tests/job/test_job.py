"""Jobs: YAML and Python give the same fields and rows; names, configs, overrides, resolved form, schema."""

from __future__ import annotations

import json
import math
import pickle
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml

from gaitsweep import models
from gaitsweep.design import Design
from gaitsweep.engine.sweep.blocks_of_rows import rows_of_a_block
from gaitsweep.job import Job, JobError, load_job, schema
from gaitsweep.kinds.settle import Settle
from gaitsweep.kinds.trace_and_ramp import Ramp
from tests.support import MODELS
from tests.support.toy_jobs import BASE, EVERY, EVERY_AXIS, TOY, columns_of, toy, written

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
    design = job.design
    assert isinstance(design, Design)
    assert design.n_rows == 12
    assert [(axis.names, axis.length) for axis in design.groups] == [
        (("restitution",), 3),
        (("launch_1",), 4),
    ]
    columns = design.at(np.arange(12), design.names)
    assert list(columns) == ["restitution", "launch_1"]
    assert columns["restitution"].tolist() == [0.0] * 4 + [0.25] * 4 + [0.5] * 4
    assert columns["launch_1"].tolist() == [
        *(1.0, 2 * math.pi, 10.0, 1.0),
        *(1.0, 2 * math.pi, 10.0, 1.25),
        *(1.0, 2 * math.pi, 10.0, 1.5),
    ]
    params, start = design.values(4, 6)
    assert list(params) == [quantity.name for quantity in design.model.parameters]
    assert list(start) == ["launch_1", "launch_2"]
    assert params["kick"].tolist() == [1.25, 1.25]  # 0.25 sqrt(100/4)
    assert params["kicking"].dtype == np.float64
    assert start["launch_2"].tolist() == [1.0, 1.0]
    assert design.derived == {"kick": "0.25*sqrt(stiffness/mass)"}
    assert isinstance(job.run, Settle)
    assert job.run.max_cycles == 100
    assert job.run.max_time == pytest.approx(6 * math.pi / 5, rel=1e-15)
    assert job.numerics.dt == 2e-3


def test_python_and_yaml_give_the_same_job(tmp_path: Path) -> None:
    fields = yaml.safe_load(QUICK)
    fields["vary"]["restitution"] = np.linspace(0, 0.5, 3)
    fields["vary"]["launch_1"] = [1, "2*pi", "sqrt(stiffness)", "1 + restitution"]
    ours, theirs = Job(**fields), load_job(written(tmp_path, QUICK))
    assert {name: list(each) for name, each in columns_of(ours).items()} == {
        name: list(each) for name, each in columns_of(theirs).items()
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


@pytest.mark.parametrize(
    ("name", "formulas"),
    [
        ("waist_quadruped_basins", True),
        ("multilegged_source_place", True),
        ("planar_quadruped_ramp", True),
        ("lorenz", False),  # b is "8/3" by default, which names nothing
        ("ring_hopper", False),
        ("compass_walker_pushes", False),
        ("henon_atlas", False),
    ],
)
def test_a_resolved_job_has_the_same_hash(name: str, formulas: bool) -> None:
    """Formulas among a model's defaults too, which are written with spaces."""
    job = load_job(f"builtin:{name}")
    params = job.resolved()["params"]
    assert any(isinstance(value, str) and " " in value for value in params.values()) == formulas
    assert Job(**json.loads(json.dumps(job.resolved()))).hash() == job.hash()


def test_a_default_and_the_same_value_in_the_job_give_the_same_hash() -> None:
    fields = {"name": "lorenz", "model": "gaitsweep.examples.lorenz:Lorenz", "run": {"kind": "settle"}}
    assert Job(**fields, params={"b": 8.0 / 3.0}).hash() == Job(**fields).hash()


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


@pytest.mark.parametrize("text", ["small\n", " small", "small\n\n"])
def test_a_name_has_no_space_around_it(text: str) -> None:
    assert toy(name=text).name == "small"


@pytest.mark.parametrize("text", ["small\nlarge", "sm all", "\n", "small/\n", "..\n"])
def test_a_name_that_names_no_file_is_refused(text: str) -> None:
    with pytest.raises(JobError, match="name is "):
        toy(name=text)


def test_params_may_contain_the_structure() -> None:
    assert toy(params={"N": 3}).structure == {"N": 3}
    assert toy(params={"N": 3}).hash() == toy(structure={"N": 3}).hash()


def test_a_config_completes_a_job(tmp_path: Path) -> None:
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
    # -0.0 gives the same rows, so it is the same job, as a number and as text
    as_text = [toy(params={"kick": text}) for text in ("-0.0", "0*-1")]
    for same in (job, *as_text):
        zero = float(same.params["kick"])
        assert zero == 0.0
        assert math.copysign(1, zero) == 1.0


def test_contraction_reaches_the_engine() -> None:
    assert toy(vary={"mass": [1, 2]}).integration.contraction
    assert not toy(vary={"mass": [1, 2]}, engine={"contraction": False}).integration.contraction


def test_the_schema_accepts_valid_jobs(tmp_path: Path) -> None:
    described = schema()
    jsonschema.Draft202012Validator.check_schema(described)
    reader = jsonschema.Draft202012Validator(described)
    reader.validate(yaml.safe_load(QUICK))
    reader.validate(load_job(written(tmp_path, QUICK)).resolved())
    reader.validate({**BASE, "vary": EVERY_AXIS})
    reader.validate({**BASE, "run": {"kind": "settle", "max_period": "4*2", "coarse": "8"}})  # arithmetic
    for wrong in (
        {"rum": 1},
        {"run": {"kind": "setle"}},
        {"vary": {"mass": {"linspcae": [0, 1, 2]}}},
        {"figures": 3},
    ):
        with pytest.raises(jsonschema.ValidationError):
            reader.validate({**BASE, **wrong})


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
    one, other = (job.design.at(np.arange(5), ["launch_2"])["launch_2"] for job in (again, EVERY))
    assert one.tolist() == other.tolist()
    with pytest.raises(JobError) as refused:
        toy(params={"mas": 1})
    assert str(pickle.loads(pickle.dumps(refused.value))) == str(refused.value)


def test_a_job_does_not_change() -> None:
    with pytest.raises(Exception, match="frozen"):
        EVERY.name = "other"


def test_a_large_table_has_at_most_500_parts() -> None:
    rows = {1: 1024, 65_536: 1024, 65_537: 2048, 2_097_152: 32_768, 16_384_001: 65_536, 10**8: 262_144}
    assert {n: rows_of_a_block("auto", n) for n in rows} == rows
    assert rows_of_a_block(7, 10**8) == 7
    in_memory = {1000: 1024, 65_536: 8192, 10**6: 131_072, 10**7: 262_144}
    assert {n: rows_of_a_block("auto", n, in_memory=True) for n in in_memory} == in_memory


def test_a_copy_with_other_fields_is_read_anew() -> None:
    """Rows, numerics and expressions follow the fields; what is not replaced keeps its expressions."""
    job = toy(run={"kind": "fixed_time", "duration": "2*mass"}, numerics={"dt": "1e-3*preload"})
    other_run = job.model_copy(update={"run": Settle(max_cycles=7)})
    assert other_run.run == Settle(max_cycles=7)
    assert other_run.expressions_of("mass") == []
    assert other_run.expressions_of("preload") == job.expressions_of("preload") == ["1e-3*preload"]
    one_device = job.model_copy(update={"engine": {"devices": 1}})
    assert one_device.expressions_of("mass") == ["2*mass"]
    assert one_device.hash() == job.hash()
    rows = job.model_copy(update={"vary": {"restitution": [0.1, 0.2, 0.3]}})
    assert rows.design.n_rows == 3
    assert rows.hash() != job.hash()
    assert job.model_copy() == job
    with pytest.raises(JobError, match="did you mean restitution"):
        job.model_copy(update={"vary": {"restitutio": [0.1]}})
