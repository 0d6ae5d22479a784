"""Joining of results: units, gaits, rows and constants of the joined table, and tables that do not fit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.records import axes_of
from gaitsweep.job.load import stored_job


def _table(gaits: list[str], mass: float = 1.0, unit: str = "m/s", kind: str = "settle") -> pd.DataFrame:
    """A settle table of starts x_0, as a run of a model with the constant `mass` returns it."""
    table = pd.DataFrame({"row": range(len(gaits)), "x_0": np.arange(len(gaits)) / 10})
    table["status"] = pd.Categorical(["settled"] * len(gaits))
    table["gait"] = pd.Categorical(gaits, [*dict.fromkeys(gaits), "none"])
    table["v_end"] = mass
    job = {"model": "lab:Walker", "params": {"mass": mass, "k": 2.0}, "run": {"kind": kind}}
    manifest = {"rows": len(gaits), "self_check": {"verdict": "passed"}}
    table.attrs = {"job": job, "manifest": manifest, "quantities": {"v_end": {"unit": unit}}, "path": "here"}
    return table


def test_joined_results_keep_units_gaits_and_the_constants_in_which_they_differ() -> None:
    slow, fast = _table(["trot", "walk"]), _table(["gallop", "trot"], mass=3.0)
    joined = gs.concat([slow, fast])
    assert joined["row"].tolist() == [0, 1, 2, 3] == joined.index.tolist()
    assert joined["mass"].tolist() == [1.0, 1.0, 3.0, 3.0]
    assert axes_of(joined) == ["mass", "x_0"]  # k, the same in both, is no axis
    assert joined["gait"].cat.categories.tolist() == ["trot", "walk", "gallop", "none"]
    assert joined.attrs["quantities"]["v_end"]["unit"] == "m/s"
    assert joined.attrs["manifest"]["rows"] == 4
    assert joined.attrs["job"]["params"] == {"k": 2.0}
    assert slow["row"].tolist() == [0, 1]
    assert slow.attrs["job"]["params"]["mass"] == 1.0  # the tables themselves are unchanged
    thrice = gs.concat(joined, _table(["walk"], mass=2.0))
    assert thrice["mass"].tolist() == [1.0, 1.0, 3.0, 3.0, 2.0]
    assert thrice["row"].is_unique
    with pytest.raises(gs.ArgumentError, match=r"joined of several results.*use one of the results"):
        stored_job(joined.attrs)  # rows of no single job cannot be simulated again


def test_a_joined_table_is_as_doubtful_and_as_incomplete_as_its_worst_part() -> None:
    one, other = _table(["trot", "walk"]), _table(["trot"])
    other.attrs |= {"complete": False, "rows_missing": 4}
    other.attrs["manifest"] = {"rows": 5, "self_check": {"verdict": "warned", "rows": 3}}
    attrs = gs.concat(one, other).attrs
    assert (attrs["complete"], attrs["rows_missing"], attrs["manifest"]["rows"]) == (False, 4, 7)
    assert attrs["manifest"]["self_check"]["verdict"] == "warned"


def test_a_start_that_settles_within_two_limits_does_not_count_twice() -> None:
    few, many = _table(["trot", "walk"]), _table(["trot"])
    for table, most in ((few, 3), (many, 100)):
        table.attrs["job"]["run"]["max_cycles"] = most
        table.attrs["quantities"] |= {key: {"unit": "1"} for key in ("x_0", "status", "gait")}
    with pytest.raises(gs.ArgumentError, match=r"differ only in run.max_cycles\..*table.assign\("):
        gs.concat(few, many)
    assert len(gs.concat(few.loc[few["row"] == 1], many)) == 2
    assert gs.concat(few.assign(most=3), many.assign(most=100))["most"].tolist() == [3, 3, 100]


def test_a_start_of_two_jobs_does_not_count_twice() -> None:
    """Of sweeps that share the end of an axis, one has to leave it out."""
    low, high = _table(["trot", "walk"]), _table(["walk", "run"])
    high["x_0"] += 0.1
    for table in (low, high):
        table.attrs["job"]["vary"] = {"x_0": table["x_0"].tolist()}
        table.attrs["quantities"] |= {key: {"unit": "1"} for key in ("x_0", "status", "gait")}
    with pytest.raises(gs.ArgumentError, match=r"count twice, such as x_0 = 0\.1: leave them out"):
        gs.concat(low, high)
    assert gs.concat(low, high.loc[high["row"] == 1])["x_0"].tolist() == [0.0, 0.1, 0.2]
    assert len(gs.concat(low.assign(run="first"), high.assign(run="second"))) == 4
    # without the column, the rows of a table are not told apart, so neither are those of two
    assert len(gs.concat(low.drop(columns="x_0"), high.drop(columns="x_0"))) == 4


@pytest.mark.parametrize(
    ("other", "sentence"),
    [
        (_table(["trot"], unit="cm/s"), r"v_end is in m/s in one table and in cm/s"),
        (_table(["trot"], kind="ramp"), r"different run kinds, settle and ramp, .* the same run kind\."),
        (
            pd.concat([_table(["trot"]), _table(["trot"], mass=2.0)]),
            r"Table 2 has no units .* pandas\.concat",
        ),
        ("results/hop", r"Table 2 is a str, .* gs\.load\('results/hop'\)"),
    ],
)
def test_tables_that_do_not_fit_are_refused(other: Any, sentence: str) -> None:
    with pytest.raises(gs.ArgumentError, match=sentence):
        gs.concat([_table(["trot"]), other])
    with pytest.raises(gs.ArgumentError, match="no table"):
        gs.concat([])


def test_rows_of_one_job_are_joined_once() -> None:
    """The same row of the same job would count twice; other rows of it, or of another job, are joined."""
    table = _table(["trot", "walk", "trot"])
    table.attrs["manifest"]["job_hash"] = "a"
    with pytest.raises(
        gs.ArgumentError, match=r"Tables 1 and 2 both have 2 rows of the same job, such as row 0"
    ):
        gs.concat([table, table.head(2)])
    joined = gs.concat([table.head(2), table.loc[~table["row"].isin(table.head(2)["row"])]])
    assert joined["gait"].tolist() == ["trot", "walk", "trot"]
    other = _table(["walk"], mass=2.0)
    other.attrs["manifest"]["job_hash"] = "b"
    both = gs.concat([other, table])
    assert len(both) == 4
    # of a joined table too: row 1 of the first job, and the one row of the other
    with pytest.raises(gs.ArgumentError, match=r"Tables 1 and 2 both have 1 row .* row 1 of that job"):
        gs.concat(gs.concat(both, _table(["run"])), table.loc[table["row"] == 1])
    with pytest.raises(gs.ArgumentError, match=r"Tables 1 and 2 both have 1 row .* row 0 of that job"):
        gs.concat(other, both)
    # of a selection of a joined table, the rows that were left out may be joined
    assert len(gs.concat(both.loc[both["mass"] == 1.0], other)) == 4
    assert len(gs.concat(both.loc[both["row"] != 2], table.loc[table["row"] == 1])) == 4
    # also after this selection has joined a third table, whose rows have the numbers of those left out
    third = _table(["run"], mass=3.0)
    third.attrs["manifest"]["job_hash"] = "c"
    assert len(gs.concat(gs.concat(third, both.loc[both["mass"] == 1.0]), other)) == 5


def test_fields_of_the_job_that_differ_are_left_out_of_a_joined_table() -> None:
    one, other = _table(["trot"]), _table(["trot"], mass=2.0)
    one.attrs["job"] |= {"name": "one", "numerics": {"dt": 0.01, "method": "rk4"}, "vary": {"x_0": [0.0]}}
    other.attrs["job"] |= {"name": "two", "numerics": {"dt": 0.02, "method": "rk4"}, "vary": {"x_0": [0.0]}}
    job = gs.concat(one, other).attrs["job"]
    assert job["numerics"] == {"method": "rk4"}
    assert job["vary"] == {"x_0": [0.0]}
    assert "name" not in job


def test_constants_that_cannot_be_filled_in_are_refused() -> None:
    swept, other = _table(["trot", "walk"]), _table(["trot"])
    swept.insert(1, "phase_0", [0.1, 0.2])
    swept.attrs["job"]["start"] = {"lag_0": 0.5}
    with pytest.raises(gs.ArgumentError, match=r"lag_0 is .* table 2 lacks it"):
        gs.concat(swept, other)
    other.attrs["job"]["start"] = {"lag_0": 0.5, "phase_0": "pi * stiffness + x_0"}
    other.attrs["job"]["params"]["stiffness"] = swept.attrs["job"]["params"]["stiffness"] = "2 * k"
    filled = gs.concat(swept, other)  # k is 2, and x_0 of the only row 0
    assert filled["phase_0"].tolist() == pytest.approx([0.1, 0.2, 4.0 * np.pi])
    other.attrs["job"]["start"] = {"lag_0": 0.5, "phase_0": 0.3}
    assert gs.concat(swept, other)["phase_0"].tolist() == [0.1, 0.2, 0.3]


def test_a_column_that_one_table_lacks_is_no_column_of_nan() -> None:
    """Of tables without a job any column, of others an axis; what one run alone has recorded may be NaN."""
    one, other = _table(["trot"]), _table(["trot"], mass=2.0).drop(columns="x_0")
    with pytest.raises(gs.ArgumentError, match=r"x_0 is a column of table 1, but table 2 lacks it"):
        gs.concat(one, other)
    assert np.isnan(gs.concat(one.assign(lyapunov_1=-0.5), _table(["trot"]))["lyapunov_1"][1])
    one.attrs = other.attrs = {"quantities": {"v_end": {"unit": "m/s"}}}
    with pytest.raises(gs.ArgumentError, match=r"speed is a column of table 2, but table 1 lacks it"):
        gs.concat(one.drop(columns="x_0"), other.assign(speed=1.0))


def test_joined_tables_keep_the_order_of_gaits() -> None:
    """Gaits of the second table follow those of the first; without, pandas makes text of both columns."""
    slow = pd.DataFrame({"v": [1, 2], "gait": pd.Categorical(["trot", "walk"], ["walk", "trot", "none"])})
    fast = pd.DataFrame({"v": [1, 3], "gait": pd.Categorical(["trot", "gallop"], ["trot", "gallop", "none"])})
    listed = pd.DataFrame({"gait": ["trot", "none", None], "share": [0.4, 0.1, 0.5]})
    slow.attrs["quantities"] = {"v": "m/s"}
    assert not isinstance(pd.concat([slow, fast])["gait"].dtype, pd.CategoricalDtype)
    order = ["walk", "trot", "gallop", "none"]
    joined = gs.same_categories([slow, fast, listed])
    assert joined[0].attrs == slow.attrs
    assert joined[2]["gait"].isna().tolist() == [False, False, True]
    both = pd.concat(joined[:2])
    assert both["gait"].cat.categories.tolist() == order
    assert both.groupby("gait", observed=True).size().index.tolist() == ["walk", "trot", "gallop"]
    assert pd.merge(joined[1], joined[2], on="gait")["gait"].cat.categories.tolist() == order
    pd.testing.assert_frame_equal(gs.same_categories(slow)[0], slow)


def test_branches_with_and_without_columns_of_their_run_are_joined() -> None:
    job = {"model": "m", "run": {"kind": "continuation", "parameter": "G"}, "params": {}}
    columns = {"row": [0], "point": [0], "branch": [0], "G": [1.0], "x_n": [1.0], "status": ["ok"]}
    table = pd.DataFrame(columns)
    other = table.drop(columns="branch")
    table.attrs = {"job": {**job, "run": {**job["run"], "crossing": True}}}
    other.attrs = {"job": job}
    assert gs.concat(table, other)["branch"].isna().tolist() == [False, True]
