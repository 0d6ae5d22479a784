"""The examples in docstrings give the results that they show."""

from __future__ import annotations

import doctest
import importlib

import pytest

from tests.support import ROOT

MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in (ROOT / "gaitsweep").rglob("*.py")
    if ">>>" in path.read_text(encoding="utf-8")
)
SHOWN = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def examples(module: str) -> list[doctest.DocTest]:
    """The examples of each object of a module, which import what they use, as a reader does."""
    documented = doctest.DocTestFinder().find(importlib.import_module(module), globs={"__name__": module})
    return [each for each in documented if each.examples]


@pytest.mark.slow(
    "gaitsweep.api.atlas",
    "gaitsweep.api.fixed_points",
    "gaitsweep.api.return_map",
    "gaitsweep.dynamics.gaits_by_footfalls",
    "gaitsweep.dynamics.sliding",
)
@pytest.mark.parametrize("module", MODULES)
def test_examples_print_their_output(module: str) -> None:
    runner = doctest.DocTestRunner(optionflags=SHOWN)
    for test in examples(module):
        report: list[str] = []
        failed, _ = runner.run(test, out=report.append)
        assert not failed, "".join(report)


def test_public_names_have_examples() -> None:
    assert sum(len(examples(module)) for module in MODULES) >= 12
