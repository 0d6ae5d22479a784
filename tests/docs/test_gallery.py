"""The gallery has a small stored table and a picture of each kind of figure."""

from __future__ import annotations

import runpy

import pandas as pd
import pytest

from gaitsweep.plot import FIGURES, draw
from tests.support import ROOT
from tests.support.text_boxes import text_problems

SCRIPT = "docs/extensions/gallery.py"
GALLERY = runpy.run_path(str(ROOT / SCRIPT))
OURS = {kind for kind, part in FIGURES.items() if part.__module__.startswith("gaitsweep.")}


def test_each_kind_of_figure_has_an_entry_and_a_small_table() -> None:
    assert set(GALLERY["ENTRIES"]) == OURS, f"add the kind to {SCRIPT}, and run it"
    stored = {file.stem: file.stat().st_size for file in GALLERY["TABLES"].iterdir()}
    assert set(stored) == {GALLERY["table_of"](kind).stem for kind in OURS}, f"run python {SCRIPT} KIND"
    assert sum(stored.values()) < 1_550_000


@pytest.mark.parametrize("kind", sorted(OURS))
def test_tables_are_made_by_their_commands(kind: str) -> None:
    """So that a picture is what its command draws."""
    stored = pd.read_parquet(GALLERY["table_of"](kind), columns=[])
    assert stored.attrs["command"] == GALLERY["command"](kind), f"run python {SCRIPT} {kind}"


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(OURS))
@pytest.mark.parametrize("width", ["column", "page"])
def test_no_text_of_a_figure_is_cut_overlaps_or_is_small(kind: str, width: str) -> None:
    table = pd.read_parquet(GALLERY["table_of"](kind))
    spec = {key: value for key, value in GALLERY["fields"](kind).items() if key not in ("kind", "name")}
    assert text_problems(draw(kind, table, **spec, width=width, panel_letters=True)) == []
