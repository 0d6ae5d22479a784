"""Extensions: the papers, other packages, and refusals with their messages."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import gaitsweep as gs
from gaitsweep import extension, shipped
from gaitsweep.extension import Extension, ExtensionError, extensions

OTHER = Extension(models={"skipper": "other.model:Skipper"})
TEXT = Extension(measures="other.measures")  # type: ignore[arg-type]
WAVES = Extension(functions={"multilegged_theory": "other.waves:theory"})
HIDDEN = Extension(functions={"attractors": "other.waves:attractors"})
TAKEN = Extension(models={"multilegged": "other.model:Multilegged"})


def entry(name: str, value: str) -> tuple[importlib.metadata.EntryPoint, str]:
    return importlib.metadata.EntryPoint(name, f"{__name__}:{value}", extension.GROUP), "other"


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """A function that installs extensions of another package."""

    def install(*entries: tuple[importlib.metadata.EntryPoint, str]) -> None:
        monkeypatch.setattr(extension, "_installed", lambda: list(entries))
        extensions.cache_clear()

    yield install
    extensions.cache_clear()


def test_the_papers_are_extensions() -> None:
    assert {"ambe2021", "aoi2011", "fukuoka2015"} <= set(extensions())


def test_another_package_adds_a_model(installed) -> None:
    installed(entry("other", "OTHER"))
    assert extension.model_paths()["skipper"] == "other.model:Skipper"


def test_a_mistyped_job_of_an_extension_is_named_with_it(installed, tmp_path: Path) -> None:
    (tmp_path / "skipping.yaml").touch()
    globals()["WITH_JOBS"] = Extension(jobs=tmp_path)
    installed(entry("other", "WITH_JOBS"))
    with pytest.raises(gs.JobError, match="builtin:skipping, which comes with the extension other"):
        gs.load_job("builtin:skiping")


def test_a_shipped_job_is_named_as_its_file_without_the_ending(installed, tmp_path: Path) -> None:
    (tmp_path / "skip_0.5.yaml").touch()
    globals()["WITH_JOBS"] = Extension(jobs=tmp_path)
    installed(entry("other", "WITH_JOBS"))
    assert shipped.job_file("builtin:skip_0.5") == shipped.job_file("builtin:skip_0.5.yaml")
    assert shipped.job_file("builtin:skip_0.5").is_file()
    assert not shipped.job_file("builtin:quick_basins.v2").is_file()
    assert not shipped.job_file("builtin:../examples/lorenz").is_file()


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("other", "NOT_THERE", r"The extension other of other cannot be imported \(AttributeError: "),
        ("other", "__doc__", "which is not a gaitsweep.Extension"),
        ("other", "TAKEN", "ambe2021 and other both have a model multilegged: uninstall other"),
        ("other", "TEXT", r"has measures='other.measures', but must have a tuple of modules: \('other.m"),
        ("other", "HIDDEN", "has a function attractors, but gaitsweep.analyses has its own attractors"),
        ("other", "WAVES", "ambe2021 and other both have a function multilegged_theory: uninstall other"),
        ("ambe2021", "OTHER", "two extensions named ambe2021: uninstall other"),
    ],
)
def test_an_extension_that_cannot_be_used_is_refused(installed, name: str, value: str, sentence: str) -> None:
    installed(entry(name, value))
    with pytest.raises(ExtensionError, match=sentence):
        extensions()
