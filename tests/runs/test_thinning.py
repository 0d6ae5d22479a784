"""Figures of very large tables show an even selection of rows, with a remark on it."""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import gaitsweep as gs
from gaitsweep.runs import figures
from gaitsweep.runs.figures import thinned

JOB = """
name: hops
model: toy_model:Toy
params: {restitution: 0.6}
vary:
  launch_1: {values: [0.2, 0.4]}
  stiffness: {linspace: [2, 8, 9], at: centre}
  mass: {linspace: [0.8, 1.2, 12], at: centre}
run: {kind: settle, max_cycles: 400, tolerance: 1.0e-6}
numerics: {dt: 5.0e-4}
figures: [{kind: basin, x: stiffness, y: mass, panels: launch_1}]
"""


def manifest(**lengths: int) -> dict[str, Any]:
    """A table over a grid; names that end with _drawn are samples."""
    axes = [
        {"names": [name], "length": length, "drawn": name.endswith("_drawn")}
        for name, length in lengths.items()
    ]
    return {"rows": math.prod(lengths.values()), "axes": axes}


def test_a_grid_keeps_every_nth_point_of_its_longest_axes() -> None:
    shown = thinned(manifest(psi_3=3, psi_2=1826, psi_1=1826))
    assert shown is not None
    assert shown.remark == "1112643 of 10002828 rows: every 3rd psi_2, psi_1"
    assert shown.rows.size == 3 * 609**2
    assert np.all(np.diff(shown.rows) > 0)
    psi_3, psi_2, psi_1 = np.unravel_index(shown.rows, (3, 1826, 1826))
    assert np.unique(psi_3).tolist() == [0, 1, 2]
    for points in (psi_2, psi_1):
        # the middles of cells of three, so that the figure's cells fill the same square
        assert np.array_equal(np.unique(points), np.arange(1, 1826, 3))


def test_a_sample_keeps_its_first_points() -> None:
    shown = thinned(manifest(sets_drawn=4096, starts_drawn=64), most=10_000)
    assert shown is not None
    sets, starts = np.unravel_index(shown.rows, (4096, 64))
    count = shown.rows.size // 64
    assert 5_000 < shown.rows.size <= 10_000
    assert np.array_equal(np.unique(sets), np.arange(count))
    assert np.unique(starts).size == 64
    assert f"the first {count} of sets_drawn" in shown.remark


@pytest.mark.parametrize("rows", [1, 17, 1000])
def test_at_most_the_requested_rows_are_shown(rows: int) -> None:
    shown = thinned(manifest(a=7, b_drawn=30, c=11), most=rows)
    assert shown is not None
    assert 0 < shown.rows.size <= rows
    assert shown.rows.max() < 7 * 30 * 11


def test_small_tables_and_those_of_unknown_axes_are_shown_whole() -> None:
    assert thinned(manifest(a=1000, b=2000)) is None
    assert thinned({"rows": 10**8}) is None
    assert thinned({**manifest(a=2), "rows": 10**8}) is None


@pytest.mark.parametrize("kind", ["bassin", ["basin"]])
def test_a_field_of_figures_leaves_an_unknown_kind_to_be_refused_by_name(kind: Any) -> None:
    asked = {"figures": [{"kind": kind}]}
    assert figures._with_fields(asked, ["title=none"]) == asked


@pytest.mark.slow
def test_the_figure_of_a_thinned_table_has_a_remark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "hops.yaml").write_text(JOB)
    path = gs.run(tmp_path / "hops.yaml", tmp_path / "out").path
    whole, drawn = gs.load(path), []

    draw_whole = gs.plot.draw

    def draw(kind: str, table: pd.DataFrame, **spec: Any) -> Figure:
        drawn.append((table, draw_whole(kind, table, **spec)))
        return drawn[-1][1]

    monkeypatch.setattr(gs.plot, "draw", draw)
    monkeypatch.setattr(figures, "thinned", functools.partial(thinned, most=50))
    figures.draw_figures(path)
    table, figure = drawn[0]
    kept = (whole["row"] // 12 % 9 % 3 == 1) & (whole["row"] % 12 % 3 == 1)
    pd.testing.assert_frame_equal(table, whole.loc[kept].reset_index(drop=True), check_exact=True)
    remark = "24 of 216 rows: every 3rd stiffness, mass"
    assert remark in [text.get_text() for text in figure.texts]
