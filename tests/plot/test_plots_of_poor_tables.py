"""Figures of tables that lack columns, rows or numbers."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gaitsweep import plot
from gaitsweep.errors import UserError
from gaitsweep.plot import PlotError
from gaitsweep.status import Status
from tests.support import hysteresis_tables
from tests.support.plot_tables import AXES, crossing_table, rendered, settle_table, trace_table

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("kind", "spec", "sentence"),
    [
        ("basin", {"x": "psi1", "y": "psi_2"}, r"psi1 is not a column of this table; did you mean psi_1\?"),
        ("basin", {"x": "psi_1", "y": "psi_2", "hue": "gate"}, r"did you mean gait\?"),
        ("solution_set", {"axes": ["psi_1", "psi_2", "psj_3"]}, r"psj_3 .* did you mean psi_3\?"),
        ("cycles", {"y": ["psi_1"], "x": "cycle", "hue": "row"}, r"did you mean cycles\?"),
        ("footprints", {}, "t is not a column"),
        ("basins", {}, r"basins is not a kind of figure; did you mean basin\?"),
        ("basin", {"x": "psi_1", "y": "gait"}, "y is gait, which is not numeric and cannot be an axis"),
        ("gait_map", {"x": "psi_1", "y": "psi_1"}, "y is psi_1, like x: name another column"),
        ("orbit", {"x": "psi_1", "y": "gait"}, "y is gait, which is not numeric"),
        ("continuation", {"y": "psi_1"}, "job moves no parameter"),
        ("road_map", {}, "job moves no parameter"),
        ("cycles", {"y": []}, "y is empty: name at least one observable"),
    ],
)
def test_what_is_not_there_is_refused_with_the_near_miss(kind: str, spec: dict, sentence: str) -> None:
    with pytest.raises(PlotError, match=sentence):
        plot.draw(kind, settle_table(), **spec)
    with pytest.raises(PlotError, match="contact_1"):
        plot.footprints(crossing_table().assign(t=0.0))


@pytest.mark.slow
def test_figures_follow_neither_the_index_nor_the_order_of_a_table() -> None:
    """Repeated index values are those of pandas.concat, an order of its own that of a sort."""
    settle, ball = settle_table(), pd.read_parquet(ROOT / "docs/gallery/road_map.parquet")
    for kind, table, spec in (
        ("basin", settle, {"x": "psi_1", "y": "psi_2", "panels": "psi_3"}),
        ("road_map", ball, {"y": "phase"}),
        ("atlas", ball, {}),
    ):
        sorted_otherwise = table.sample(frac=1.0, random_state=1).set_axis(np.arange(len(table)) // 3)
        sorted_otherwise.attrs = table.attrs
        images = []
        for of_table in (table, sorted_otherwise):
            file = io.BytesIO()
            plot.draw(kind, of_table, **spec).savefig(file, format="rgba", dpi=60)
            images.append(file.getvalue())
        assert images[0] == images[1], kind


def test_refusals_name_the_loss_of_units_by_pandas() -> None:
    """A table with units is not blamed, nor a table of the user that is drawn."""
    table = settle_table()
    with pytest.raises(PlotError, match=r"psi1 is not a column.*pandas\.concat and merge drop.*gs\.concat"):
        plot.basin(table, x="psi1", y="psi_2")
    with pytest.raises(PlotError, match=r"stroll.*no gait of this table.*gs\.concat"):
        plot.draw("basin", table, x="psi_1", y="psi_2", panels="psi_3", colours={"stroll": "red"})
    table.attrs["quantities"] = {}
    with pytest.raises(PlotError) as refusal:
        plot.basin(table, x="psi1", y="psi_2")
    assert "concat" not in str(refusal.value)


def test_rows_that_would_share_a_cell_or_a_pass_are_refused_with_the_reason() -> None:
    table = settle_table()
    with pytest.raises(
        PlotError, match=r"since psi_3 varies too. Name psi_3 as `panels`, or .*\[\"psi_3\"\]"
    ):
        plot.basin(table, x="psi_1", y="psi_2")
    with pytest.raises(PlotError, match="the same start more than once"):
        plot.basin(pd.concat([table, table]), x="psi_1", y="psi_2", panels="psi_3")
    stairs = hysteresis_tables.staircase_table(stairs=9, hold=1)
    stairs.attrs["job"] = {"run": {"parameter": "f"}}
    with pytest.raises(UserError, match=r"Row 0 has several records of stair 0.*gs\.concat"):
        plot.hysteresis(pd.concat([stairs, stairs]), y="delta_13")


@pytest.mark.parametrize("wrong", [{"x": ["psi_1"]}, {"y": 3}, {"x": None}, {"hue": ["gait"]}, {"panels": 5}])
def test_what_is_no_name_of_a_column_is_refused(wrong: dict[str, Any]) -> None:
    ((field, value),) = wrong.items()
    sentence = f"{field} is {value!r}, but must be the name of a column"
    with pytest.raises(PlotError, match=re.escape(sentence)):
        plot.draw("basin", settle_table(), **({"x": "psi_1", "y": "psi_2"} | wrong))


def test_what_is_no_table_is_refused() -> None:
    basin: Any = plot.basin
    with pytest.raises(PlotError, match=r"table is a str, but must be a table: load it by gs\.load\('DIR'\)"):
        basin("DIR", x="psi_1", y="psi_2")


@pytest.mark.parametrize("spec", [{}, {"panels": "psi_3"}, {"hue": "cycles"}])
def test_basins_of_a_table_without_rows_say_so(spec: dict) -> None:
    (axes,) = plot.basin(settle_table().iloc[:0], x="psi_1", y="psi_2", **spec).axes
    assert [text.get_text() for text in axes.texts] == ["no rows yet"]


@pytest.mark.slow("failed")
@pytest.mark.parametrize("whole", ["none of its rows", "failed", "no numbers"])
def test_tables_of_little_use_do_not_crash(whole: str) -> None:
    settle, crossing, trace = settle_table(), crossing_table(), trace_table()
    settle["status"] = settle["status"].cat.add_categories(["diverged"])
    if whole == "none of its rows":
        settle, crossing, trace = settle.iloc[:0], crossing.iloc[:0], trace.iloc[:0]
    else:
        settle["status"], crossing["status"], trace["status"] = "diverged", "diverged", "fell"
    if whole == "no numbers":
        for table, pattern in ((settle, "_end"), (crossing, "_n"), (trace, "contact")):
            names = [name for name in table.columns if pattern in name]
            table[names] = np.nan
        settle["gait"] = np.nan
    rendered(plot.basin(settle, x="psi_1", y="psi_2", panels="psi_3"))
    rendered(plot.basin(settle, x="psi_1", y="psi_2", panels="psi_3", hue="cycles"))
    rendered(plot.solution_set(settle, axes=AXES))
    rendered(plot.cycles(crossing, y=["psi_1"]))
    rendered(plot.footprints(trace))


@pytest.mark.parametrize(
    ("kind", "spec", "sentence"),
    [
        (
            "hysteresis",
            {"y": "delta_31"},
            r"delta_31 is not a column of this table; did you mean delta_13_n\?",
        ),
        ("hysteresis", {"y": "delta_13", "parameter": "beta"}, "beta is not a column"),
        ("hysteresis", {"y": "delta_13", "panels": "mas"}, "mas is not a column"),
        ("return_map", {"y": "delta_13", "panels": "beta"}, "beta is not a column"),
        ("return_map", {"y": "delta_13", "form": "both"}, "form is both, but must be change or next"),
        ("branches", {"y": "delta_13", "x": "beta"}, "beta is not a column"),
        ("gait_map", {"x": "f", "y": "beta"}, "beta is not a column"),
        ("gait_map", {"x": "f", "y": "t", "hue": "gate"}, "gate is not a column"),
    ],
)
def test_missing_columns_of_slow_changes_and_maps_are_refused(kind: str, spec: dict, sentence: str) -> None:
    with pytest.raises(PlotError, match=sentence):
        plot.draw(kind, hysteresis_tables.ramp_table(steps=10), **spec)


@pytest.mark.parametrize("whole", ["none of its rows", "failed", "no numbers", "one record"])
def test_poor_tables_of_slow_changes_and_maps_do_not_crash(whole: str) -> None:
    tables = [
        hysteresis_tables.ramp_table(steps=60),
        hysteresis_tables.staircase_table(hold=5),
        hysteresis_tables.map_table(starts=5, crossings=5),
        hysteresis_tables.settle_table([0.0], [1.0]),
    ]
    for number, table in enumerate(tables):
        attributes = dict(table.attrs)
        if whole == "none of its rows":
            table = table.iloc[:0]
        elif whole == "failed":
            table["status"] = pd.Categorical(["fell"] * len(table))
        elif whole == "no numbers":
            values = [name for name in table.columns if name.startswith("delta_13_")]
            table = table.assign(**dict.fromkeys(values, np.nan), gait=np.nan)
        else:
            table = table.iloc[:1]
        table.attrs = attributes
        tables[number] = table
    ramp, stairs, crossings, settled = tables
    rendered(plot.hysteresis(ramp, y="delta_13", with_table=stairs))
    rendered(plot.return_map(crossings, y="delta_13", panels="f"))
    rendered(plot.return_map(crossings, y="delta_13", form="next"))
    rendered(plot.branches(crossings, y="delta_13", x="f"))
    rendered(plot.gait_map(settled, x="f", y="beta"))


@pytest.mark.parametrize("name", ["f", "crossing", "status", "delta_13_n"])
def test_a_value_that_pandas_calls_na_is_a_missing_one(name: str) -> None:
    """NumPy compares `pd.NA` with nothing: neither the values of panels, nor a status."""
    table = hysteresis_tables.map_table(starts=5, crossings=5)
    for dtype in ("nullable", object):
        values = table[name].astype(object)
        values[1] = pd.NA
        poor = table.assign(**{name: values.convert_dtypes() if dtype == "nullable" else values})
        poor.attrs = table.attrs
        rendered(plot.return_map(poor, y="delta_13", panels="f"))
        assert poor[name].array[1] is pd.NA
    statuses = np.array([pd.NA, None, np.nan, "fell", "settled"], object)
    assert Status.FAILED.among(statuses).tolist() == [False, False, False, True, False]


def test_axes_without_rows_have_their_range_or_no_ticks() -> None:
    """Ticks from 0 to 1 would be read as values."""
    table = settle_table()
    empty = plot.basin(table.head(0), x="psi_1", y="psi_2").axes[0]
    assert empty.get_xlabel()
    numbers = table.assign(lag=np.nan)
    numbers.attrs = table.attrs
    axes = plot.basin(numbers, x="psi_1", y="lag").axes[0]
    assert axes.get_xlim() == pytest.approx((0.0, 2.0 * np.pi))
    assert len(axes.get_xticks()) > 2
    assert not len(axes.get_yticks())
    # of panels that share their axes one with rows has the range of both
    numbers.loc[table["psi_3"] == table["psi_3"].max(), "lag"] = table["psi_2"]
    grid = plot.basin(numbers, x="psi_1", y="lag", panels="psi_3").axes
    assert [text.get_text() for text in grid[0].texts] == ["no rows yet"]
    assert len(grid[0].get_yticks())


def test_footprints_join_no_swing_twice() -> None:
    """The second leg swings half as often as the first: each of its swings belongs to one of the first."""
    t = np.arange(0.0, 60.0, 0.05)
    late = 0.4 * (t // 5.0 % 2.0)  # so that the second leg is the regular one, whose cycle counts
    first = (t % 5.0 < 3.6 + late) | (t % 5.0 >= 4.6 + late)
    contacts = {"contact_1": first.astype(float), "contact_2": ((t - 2.4) % 10.0 < 9.0).astype(float)}
    figure = plot.footprints(pd.DataFrame({"row": 0, "t": t, **contacts, "status": "complete"}))
    ends = [np.asarray(line.get_xdata())[1] for line in figure.axes[0].lines]
    assert len(ends) == len(set(ends)) > 0
