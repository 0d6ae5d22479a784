"""A result directory records the maker of each part, and is continued by the same program only."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from gaitsweep.runs import provenance
from gaitsweep.runs.prepare import RunError
from gaitsweep.runs.provenance import EARLIER, PROGRAM, continue_directory
from tests.support.toy_directories import block_frame, fill, open_toy

FUNCTIONS = {"flow": "a1", "period": "b2"}


def _continued(path: Path, program: Mapping[str, str] = FUNCTIONS, parts: int = 9) -> list[str]:
    """Open a directory, make so many of its parts, and return what was said."""
    messages: list[str] = []
    model = SimpleNamespace(source="", bibtex="")
    context: Any = SimpleNamespace(program=program, job=SimpleNamespace(model="own:Model"), model=model)
    with open_toy(path, rows=20) as directory:
        continue_directory(context, directory, messages.append)
        for number in directory.missing_blocks()[:parts]:
            directory.write_part(number, block_frame(*directory.layout.rows_of(number)))
    return messages


def _manifest(path: Path) -> dict[str, Any]:
    with open_toy(path, rows=20) as directory:
        return directory.manifest


def _elsewhere(patch: pytest.MonkeyPatch, **versions: str) -> None:
    here = provenance.versions()
    patch.setattr(provenance, "versions", lambda: here | versions)


def test_the_same_maker_is_not_spoken_of(tmp_path: Path) -> None:
    assert _continued(tmp_path / "a", parts=2) == []
    assert _continued(tmp_path / "a") == []
    manifest = _manifest(tmp_path / "a")
    assert EARLIER not in manifest
    assert manifest["versions"] == provenance.versions()
    assert manifest[PROGRAM] == FUNCTIONS


def test_other_versions_and_processors_are_warned_of_and_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a"
    with monkeypatch.context() as patch:
        _elsewhere(patch, jax="0.4.1")
        _continued(path, parts=2)
    with monkeypatch.context() as patch:
        patch.setattr(provenance, "machine", lambda: "Linux 5.4, another processor, 8 cores")
        (said,) = _continued(path, parts=1)
        assert "8 of the 20 rows" in said
        assert "jax 0.4.1" in said
    (said,) = _continued(path)
    assert "12 of the 20 rows" in said
    assert "another processor" in said
    manifest = _manifest(path)
    assert [maker["parts"] for maker in manifest[EARLIER]] == [[[0, 1]], [[2, 2]]]
    assert [maker["versions"]["jax"] == "0.4.1" for maker in manifest[EARLIER]] == [True, False]
    assert manifest["machine"] == provenance.machine()
    assert _continued(path) == []  # complete: nobody makes a part


@pytest.mark.parametrize(("first", "then"), [("0123+changes", None), (None, "0123")])
def test_a_known_commit_and_an_unknown_one_are_two_makers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: str | None, then: str | None
) -> None:
    """A directory that a checkout began and an installed package continues, or the reverse."""
    monkeypatch.setattr(provenance, "git_commit", lambda: first)
    _continued(tmp_path / "a", parts=2)
    monkeypatch.setattr(provenance, "git_commit", lambda: then)
    assert _continued(tmp_path / "a", parts=1) == []
    assert _continued(tmp_path / "a") == []
    manifest = _manifest(tmp_path / "a")
    (earlier,) = manifest[EARLIER]
    assert (earlier.get("git_commit"), earlier["parts"]) == (first, [[0, 1]])
    assert manifest.get("git_commit") == then


def test_parts_that_are_made_again_are_their_new_makers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a"
    with monkeypatch.context() as patch:
        _elsewhere(patch, numpy="1.26")
        _continued(path, parts=3)
    _continued(path, parts=1)
    (path / "table/part-00001.parquet").unlink()
    _continued(path)
    assert [maker["parts"] for maker in _manifest(path)[EARLIER]] == [[[0, 0], [2, 2]]]


def test_cores_and_kernels_of_the_system_decide_no_digit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provenance, "machine", lambda: "Linux 5.4, a processor, with a comma, 8 cores")
    _continued(tmp_path / "a", parts=2)
    monkeypatch.setattr(provenance, "machine", lambda: "Linux 6.1, a processor, with a comma, 2 cores")
    assert _continued(tmp_path / "a") == []


@pytest.mark.parametrize("parts", [2, 9])
def test_another_program_is_another_job(tmp_path: Path, parts: int) -> None:
    """Also of a complete table, which the same command would show."""
    _continued(tmp_path / "a", parts=parts)
    with pytest.raises(RunError, match="period of own:Model") as refused:
        _continued(tmp_path / "a", {**FUNCTIONS, "period": "c3"})
    assert refused.value.exit_code == 2
    assert "flow" not in str(refused.value)


def test_other_versions_may_trace_the_same_function_differently(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        _elsewhere(patch, jax="0.4.1")
        _continued(tmp_path / "a", parts=2)
    message = _continued(tmp_path / "a", {**FUNCTIONS, "flow": "c3"})
    assert len(message) == 2
    assert "flow of own:Model" in message[0]
    assert _manifest(tmp_path / "a")[PROGRAM]["flow"] == "c3"


def test_versions_that_are_not_known_are_no_other_versions(tmp_path: Path) -> None:
    """The warning of other versions named none of them."""
    _continued(tmp_path / "a", parts=2)
    with open_toy(tmp_path / "a", rows=20) as directory:
        directory.update_manifest(versions={})
    with pytest.raises(RunError, match="flow of own:Model"):
        _continued(tmp_path / "a", {**FUNCTIONS, "flow": "c3"})


def test_a_source_of_blanks_is_no_paper() -> None:
    model: Any = SimpleNamespace(source=" ", bibtex="\n")
    assert provenance.paper_of(model) is None


def test_directories_of_older_versions_are_continued(tmp_path: Path) -> None:
    with open_toy(tmp_path / "a", rows=20) as directory:
        fill(directory)
    (tmp_path / "a/table/part-00001.parquet").unlink()
    assert _continued(tmp_path / "a") == []
