"""Figures of gait maps and of gait transitions, from small synthetic tables."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.colors import to_rgba

import gaitsweep as gs
from gaitsweep import plot
from gaitsweep.extension import gait_styles
from gaitsweep.job import JobError
from gaitsweep.plot.theme import COLOURS, HATCH
from tests.support.hysteresis_tables import (
    settle_table,
)
from tests.support.job_tables import table_of
from tests.support.plot_tables import legend_texts, rendered

SPRINGS = {"name": "springs", "model": "toy_model:Toy", "run": {"kind": "settle"}}
LOGARITHMIC = {"stiffness": {"logspace": [1.0, 256.0, 9]}, "launch_1": {"linspace": [1.0, 4.0, 7]}}


def test_gait_map_names_the_set_of_each_cell() -> None:
    table = settle_table(np.linspace(-0.8, 0.8, 9), [-1.0, 0.0, 1.0], others=[0.7, 0.75, 0.8])
    table.loc[table["beta"] == 0.8, "status"] = "fell"
    table.loc[(table["beta"] == 0.8) & (table["f"] == 0.8), "status"] = "cycle_limit"
    table.loc[(table["beta"] == 0.7) & (table["f"] == 0.8), "gait"] = "none"
    table.loc[(table["beta"] == 0.75) & (table["f"] == 0.8) & (table["delta_13"] < 2.5), "status"] = "fell"
    figure = plot.draw("gait_map", table, x="f", y="beta")
    rendered(figure)
    axes = figure.axes[0]
    names = ["trot only", "walk only", "trot and walk", "trot; another start failed"]
    names += ["another gait", "not settled", "failed"]
    assert [text.rsplit("  ")[0] for text in legend_texts(figure)] == names
    cells = np.asarray(axes.collections[0].get_facecolor()).reshape(3, 9, 4)
    # darker: its start from the walk fell
    assert max(cells[1, 8][:3]) < max(to_rgba(gait_styles()["trot"][0])[:3])
    assert tuple(cells[1, 0]) == to_rgba(gait_styles()["walk"][0])
    assert tuple(cells[1, 4]) == to_rgba(gait_styles()["trot"][0])
    (striped,) = [each for each in axes.patches if each.get_edgecolor() == to_rgba(gait_styles()["walk"][0])]
    assert striped.get_path().contains_point((0.0, 0.75))
    assert tuple(cells[0, 8]) == to_rgba(COLOURS["none"])
    assert len([patch for patch in axes.patches if patch.get_hatch() == HATCH]) == 2
    assert sum(int(text.split("  ")[1].split()[0]) for text in legend_texts(figure)) in (99, 100, 101)


def test_gait_map_of_starts_on_no_grid() -> None:
    table = settle_table([0.0], [-1.0, 1.0], others=np.sort(np.random.default_rng(0).uniform(0.6, 0.9, 12)))
    table["f"] = np.random.default_rng(1).uniform(-1, 1, 12).repeat(2)
    figure = plot.gait_map(table, x="f", y="beta")
    rendered(figure)
    assert sum(len(np.asarray(line.get_xdata())) for line in figure.axes[0].lines) == 12


def test_where_each_gait_is_lost() -> None:
    """Walk is lost as f rises through FOLD, trot as it falls through -FOLD; rows that fell are below."""
    table = settle_table(np.linspace(-0.8, 0.8, 81), [-1.0, 1.0], others=[0.75])
    table.loc[table.index[-2:], "status"] = ["fell", "cycle_limit"]
    figure = plot.draw("gait_transitions", table, x="f", y="delta_13", start="delta_13")
    rendered(figure)
    assert legend_texts(figure) == [
        "trot",
        "walk",
        "not settled",
        "failed",
        "trot lost as $f$ falls: -0.4 to -0.38 Hz",
        "walk lost as $f$ rises: 0.38 to 0.4 Hz",
    ]
    assert len(figure.axes[0].patches) == 2


@pytest.mark.parametrize("kind", ["basin", "gait_map"])
def test_cells_of_equal_ratios(kind: str) -> None:
    """Cells of a logspace axis have equal ratios, and cells without a row stay white."""
    table = table_of(gs.Job(**SPRINGS, vary=LOGARITHMIC))
    table = table.loc[table["stiffness"].round(6) != 16.0]
    figure = plot.draw(kind, table, x="stiffness", y="launch_1")
    rendered(figure)
    axes = figure.axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "linear")
    (cells,) = (part for part in axes.collections if isinstance(part, QuadMesh))
    across = np.asarray(cells.get_coordinates())[0, :, 0]
    np.testing.assert_allclose(across, 2.0 ** np.arange(-0.5, 9.0))
    drawn = np.asarray(cells.get_array())
    np.testing.assert_array_equal(drawn[:, :, 3].any(axis=0), np.arange(9) != 4)


def test_a_job_with_several_rows_in_a_cell_is_refused() -> None:
    figure = {"kind": "basin", "x": "stiffness", "y": "launch_1"}
    with pytest.raises(JobError, match="leaves out restitution"):
        gs.Job(**SPRINGS, vary={**LOGARITHMIC, "restitution": [0.2, 0.8]}, figures=[figure])


def test_gait_map_of_values_that_the_job_draws_has_points() -> None:
    """A Sobol sequence of 24 values lies on a grid of 32, of which 8 columns would be empty stripes."""
    drawn = (np.arange(32)[np.arange(32) % 4 > 0] + 0.5) / 32
    table = settle_table([0.7, 0.75, 0.8], [-1.0, 1.0], others=drawn).rename(
        columns={"f": "beta", "beta": "f"}
    )
    table.attrs["job"] = {"vary": {"f": {"sobol": [0, 1, 24]}, "beta": [0.7, 0.75, 0.8]}}
    axes = plot.gait_map(table, x="f", y="beta").axes[0]
    assert not axes.collections
    assert sum(len(np.asarray(line.get_xdata())) for line in axes.lines) == 3 * 24
