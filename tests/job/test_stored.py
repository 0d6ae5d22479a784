"""The job of a table finds the user's model where the run found it."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import gaitsweep as gs
from gaitsweep.job.load import stored_job
from gaitsweep.runs import summary

MODEL = """\
from gaitsweep import DeclaredModel, event, parameter, variable


class Bouncer(DeclaredModel):
    g = parameter("m/s2", "gravitational acceleration", 9.81)
    height = variable("m", "height", 1.0)
    speed = variable("m/s", "speed upwards", observed=True)

    def flow(self, p, s):
        return {"height": s.speed, "speed": -p.g}

    @event("it lands", section=True)
    def landing(self, p, s):
        return -s.height

    @landing.jump
    def bounce(self, p, s):
        return s.replace(height=0.0, speed=4.0)

    def period(self, p):
        return 1.0 + 0.0 * p.g
"""
JOB = "name: bouncer\nmodel: a_bouncer:Bouncer\nrun: {kind: settle, max_cycles: 30}\nverify: 0\n"


@pytest.mark.slow
def test_a_model_is_found_from_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own, elsewhere = tmp_path / "own", tmp_path / "elsewhere"
    own.mkdir()
    elsewhere.mkdir()
    (own / "a_bouncer.py").write_text(MODEL)
    (own / "job.yaml").write_text(JOB)
    monkeypatch.chdir(elsewhere)
    table = gs.run(own / "job.yaml", elsewhere / "out").table
    assert table.attrs["manifest"]["model_folder"] == "../../own"  # tells nothing of the folders above
    # as a new process would see it
    del sys.modules["a_bouncer"]
    again = gs.load(elsewhere / "out")
    with pytest.raises(gs.JobError, match=r"own/a_bouncer\.py.*--trust"):
        stored_job(again.attrs)
    assert "a_bouncer" not in sys.modules
    assert stored_job(again.attrs, trust=True).design.model.name == "bouncer"
    del sys.modules["a_bouncer"]
    monkeypatch.chdir(own)
    assert stored_job(again.attrs).design.model.name == "bouncer"
    del sys.modules["a_bouncer"]
    shutil.rmtree(own)
    monkeypatch.chdir(elsewhere)
    with pytest.raises(gs.JobError, match="a_bouncer cannot be imported"):
        stored_job(again.attrs, trust=True)


@pytest.mark.parametrize("place", [".", "table"])
@pytest.mark.parametrize("inside", [True, False])
def test_no_code_in_a_result_directory_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str, inside: bool
) -> None:
    """Neither from elsewhere, nor where the working directory is the stranger's."""
    gift = tmp_path / "gift"
    (gift / "table").mkdir(parents=True)
    (gift / place / "a_gift.py").write_text("raise SystemExit('the code of the stranger ran')")
    monkeypatch.chdir(gift / place if inside else tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, str(Path.cwd())])
    attrs = {"path": str(gift), "job": {"model": "a_gift:Model"}, "manifest": {"model_folder": place}}
    with pytest.raises(gs.JobError, match="--trust"):
        stored_job(attrs)
    with pytest.raises(gs.JobError, match="the code of the stranger ran"):
        stored_job(attrs, trust=True)


@pytest.mark.slow
def test_the_papers_models_have_no_folder() -> None:
    table = gs.sweep(
        "multilegged", psi_1=[1.0], psi_2=1.0, psi_3=1.0, run=gs.FixedTime(duration=0.5), verify=0
    )
    assert "model_folder" not in table.table.attrs["manifest"]


@pytest.mark.parametrize(("project", "stored"), [("", {}), ("walkers/", {"model_folder": "../../models"})])
def test_a_folder_below_a_home_alone_is_not_stored(
    monkeypatch: pytest.MonkeyPatch, project: str, stored: dict[str, str]
) -> None:
    monkeypatch.setattr(summary, "folder_of_class", lambda _: Path(f"/home/user/{project}models"))
    context: Any = SimpleNamespace(
        job=SimpleNamespace(model="own:Model"), model=SimpleNamespace(original=object())
    )
    assert summary._model_folder(context, Path(f"/home/user/{project}results/run")) == stored


def test_a_field_that_had_no_effect_is_still_read() -> None:
    fields = {"name": "t", "model": "multilegged_reduced", "vary": {"psi_1": [0.1, 0.2]}}
    fields |= {"start": {"psi_2": 0.1, "psi_3": 0.1}, "run": {"kind": "settle", "coarse": 16}}
    assert (
        stored_job({"job": fields}).hash()
        == stored_job({"job": {**fields, "run": {"kind": "settle"}}}).hash()
    )
