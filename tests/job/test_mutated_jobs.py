"""Damaged and oversized jobs are read or refused with a message, within limits of time and memory."""

from __future__ import annotations

import os
import resource
import time
from itertools import pairwise
from pathlib import Path

import pytest

from benchmarks.reliability.mutated_jobs import Mutant
from benchmarks.reliability.mutations import LATEST, MOST_MEMORY, check_all, check_one
from gaitsweep.design.axes import MAX_LISTED
from gaitsweep.design.vary import MAX_DRAWN
from gaitsweep.job import Job, JobError, load_job

HEAD = "name: a\nmodel: multilegged\nrun: {kind: settle}\nstart: {psi_1: 1, psi_2: 1, psi_3: 1}\n"


@pytest.mark.slow
def test_damaged_jobs_are_read_or_refused(tmp_path: Path) -> None:
    # the peak is that of the whole process, in which other tests have run
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000.0
    for answer in check_all(40, seed=7, folder=tmp_path):
        assert not answer.fault, f"{answer.path}: {answer.fault}"
        assert answer.processor < LATEST, answer.path
        assert answer.memory < max(MOST_MEMORY, before + 0.5 * MOST_MEMORY), answer.path


def listed(form: str, count: int = 6_000) -> str:
    return ", ".join(form.format(number) for number in range(count))


OVERSIZED = {
    "fields of a job": listed('"key{}": 1').join(("{", "}")),
    "parameters": HEAD + "params: {" + listed("bet{}: 1") + "}\n",
    "axes": HEAD + "vary: {" + listed("psi_{}x: [1]") + "}\n",
    "fields of a run": HEAD.replace("settle}", "settle, " + listed("m{}: 1") + "}"),
    "expressions": HEAD + "vary: {beta: {values: [" + listed("'{}*pi/1e6'", 20_000) + "]}}\n",
    "nested aliases": "a: &a [1]\n"
    + "".join(f"{b}: &{b} [{f'*{a}, ' * 9}]\n" for a, b in pairwise("abcdefg")),
    "aliases of fields": "x: &x {" + listed("k{}: 1", 375) + "}\ny: [" + "*x, " * 375 + "]\n",
    "brackets": "a: " + "[" * 100_000,
    "a key": "? " + "x" * 1_000_000 + "\n: 1\n" + HEAD,
    "sobol points": HEAD
    + "vary: {sample: {n: 1e7, method: sobol, of: {beta: [0.6, 0.7], kappa: [1, 2], m_B: [0.8, 0.9]}}}",
    "groups": HEAD + "vary: {sample: [" + "{n: 1e7, of: {beta: [0, 1]}}, " * 1000 + "]}\n",
}


@pytest.mark.slow("axes", "expressions")
@pytest.mark.parametrize("name", OVERSIZED)
def test_oversized_jobs_are_refused_quickly(name: str, tmp_path: Path) -> None:
    path = tmp_path / "job.yaml"
    path.write_text(OVERSIZED[name])
    answer = check_one(Mutant(name, path))
    assert not answer.good
    assert not answer.fault
    assert answer.processor < LATEST
    with pytest.raises(JobError) as error:
        load_job(path)
    assert len(str(error.value)) < 5_000


@pytest.mark.parametrize("asked", ["job", "config"])
def test_only_regular_files_are_read(asked: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    with open(tmp_path / "sparse", "wb") as sparse:
        sparse.truncate(2**33)
    reasons = {
        "fifo": "a named pipe",
        "zero": "a device",
        "folder": "a directory",
        "loop": "cannot be read",
        "sparse": "larger than",
    }
    for name, reason in reasons.items():
        path = tmp_path / name
        if asked == "config":
            path = tmp_path / "job.yaml"
            path.write_text(f"config: {name}\n" + HEAD)
        began = time.process_time()
        with pytest.raises(JobError, match=reason):
            load_job(path)
        assert time.process_time() - began < 2.0


def test_a_file_that_becomes_a_pipe_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file may be replaced between the check of its type and its opening, which are two system calls."""
    path = tmp_path / "job.yaml"
    path.write_text(HEAD)
    regular = os.stat(path)
    path.unlink()
    os.mkfifo(path)
    monkeypatch.setattr("gaitsweep.schema.yaml_document.os.stat", lambda *_, **__: regular)
    with pytest.raises(JobError, match="a named pipe"):
        load_job(path)


FIELDS = {"name": "a", "model": "multilegged", "run": {"kind": "settle"}, "start": {"psi_3": 1.0}}
BOX = {"psi_1": [0, 1], "psi_2": [0, 1]}
PARAMETERS = ("psi_1", "psi_2", "beta", "kappa", "m_B")


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        (
            {"sample": {"n": 10**7, "of": {**BOX, "beta": [0.6, 0.7]}}},
            rf"draws 30000000 numbers .*at most {MAX_DRAWN}",
        ),
        (
            {"psi_1": [0.5] * (MAX_LISTED + 1), "psi_2": [1]},
            rf"has {MAX_LISTED + 1} points; .* at most {MAX_LISTED}",
        ),
        ({name: {"linspace": [0.6, 0.7, 10**7]} for name in PARAMETERS}, "more than 1e30 rows"),
    ],
    ids=["sample", "list", "product"],
)
def test_too_many_points_are_refused_before_they_are_drawn(vary: dict, message: str) -> None:
    began = time.process_time()
    with pytest.raises(JobError, match=message):
        Job(**FIELDS, vary=vary)
    assert time.process_time() - began < LATEST


def test_a_large_sample_is_not_drawn_with_its_job() -> None:
    began = time.process_time()
    job = Job(**FIELDS, vary={"sample": {"n": 10**7, "of": BOX}})
    assert time.process_time() - began < LATEST
    assert job.design.n_rows == 10**7


def test_control_characters_of_a_path_are_escaped(tmp_path: Path) -> None:
    with pytest.raises(JobError) as error:
        load_job(tmp_path / "\x1b[31mred\nmissing.yaml")
    assert "\x1b" not in str(error.value)
    assert r"\x1b[31mred missing.yaml: does not exist." in str(error.value)
    with pytest.raises(JobError, match="cannot be read"):
        load_job(tmp_path / "nul\0.yaml")
