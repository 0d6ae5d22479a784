"""A table as an xarray dataset: numbers at the values of their axes, names as flags."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import gaitsweep as gs
import toy_model
from gaitsweep.runs.dataset import dataset_of

TOY = toy_model.Toy()
SETTLE = gs.Settle(max_cycles=40)


@pytest.mark.slow
def test_without_xarray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    result = gs.sweep(TOY, launch_1=[1.0, 2.0], run=SETTLE, verify=0)
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(gs.UserError, match=r"pip install 'gaitsweep\[xarray\]'"):
        result.to_xarray()


def test_a_grid() -> None:
    """Looked up by its coordinates, a value is the table's; units and meanings of names come along."""
    pytest.importorskip("xarray")
    result = gs.sweep(TOY, launch_1=np.linspace(1, 2, 3), restitution=[0.2, 0.5], run=SETTLE)
    table, found = result.table, result.to_xarray()
    assert dict(found.sizes) == {"launch_1": 3, "restitution": 2}
    for record in table.to_dict("records"):
        here = found.sel(launch_1=record["launch_1"], restitution=record["restitution"])
        assert float(here["launch_1_end"]) == record["launch_1_end"]
        meanings = found["gait"].attrs["flag_meanings"].split()
        assert meanings[list(found["gait"].attrs["flag_values"]).index(int(here["gait"]))] == record["gait"]
    assert found["launch_1"].attrs["units"] == "m/s"
    assert found["status"].attrs["flag_meanings"].split() == list(table["status"].cat.categories)
    assert found["cycles"].dtype == np.int64
    assert found.attrs["model"] == "toy_model:Toy"


def test_records_groups_and_dependent_axes() -> None:
    """Rows with several records get a dimension more; a zip is one; an axis may follow another one."""
    pytest.importorskip("xarray")
    run = gs.ReturnMap(crossings=3)
    zipped = gs.sweep(
        TOY, mass=[1.0, 2.0], zip={"launch_1": [1.0, 1.5, 2.0], "kick": [0.1, 0.2, 0.3]}, run=run
    )
    result = zipped.to_xarray()
    assert dict(result.sizes) == {"mass": 2, "point": 3, "record": 4}
    assert result["kick"].dims == ("point",)
    np.testing.assert_array_equal(result["launch_1_n"].to_numpy().ravel(), zipped.table["launch_1_n"])
    table = gs.sweep(TOY, mass=[1.0, 2.0], kick=["0.1*mass", 0.5], run=SETTLE).table
    for follows in (dataset_of(table), dataset_of(table.iloc[1:])):
        assert follows["kick_value"].dims == ("mass", "kick")
        np.testing.assert_array_equal(follows["kick_value"], [[0.1, 0.5], [0.2, 0.5]])
        follows["kick_value"] *= 10.0  # which xarray does in place


def test_rows_of_different_lengths() -> None:
    """A row that fell has fewer crossings; missing ones are NaN, or -1 for names."""
    pytest.importorskip("xarray")
    run = gs.ReturnMap(crossings=4)
    result = gs.sweep(TOY, ceiling=[0.3, 1000.0], launch_1=1.0, kick=3.0, run=run, verify=0)
    lengths = result.table["row"].value_counts()
    assert lengths.loc[0] < lengths.loc[1]
    found = result.to_xarray()
    missing = np.isnan(found["launch_1_n"].to_numpy())
    assert missing[0].sum() >= lengths[1] - lengths[0]
    assert not missing[1].any()
    assert (found["status"].to_numpy()[0, lengths[0] :] == -1).all()


def test_a_point_without_records_keeps_its_coordinate() -> None:
    pytest.importorskip("xarray")
    table = gs.sweep(TOY, launch_1=[1.0, 1.5, 2.0], restitution=[0.2, 0.5], run=SETTLE, verify=0).table
    found = dataset_of(table.query("launch_1 != 1.5"))
    np.testing.assert_array_equal(found["launch_1"], [1.0, 1.5, 2.0])
    assert np.isnan(found["t_end"].sel(launch_1=1.5)).all()
    assert np.isfinite(found["t_end"].sel(launch_1=[1.0, 2.0])).all()
    with pytest.raises(gs.UserError, match="needs the column launch_1"):
        dataset_of(table.drop(columns="launch_1"))


def test_a_table_without_its_job_is_refused() -> None:
    pytest.importorskip("xarray")
    table = gs.sweep(TOY, launch_1=[1.0, 1.5], run=SETTLE, verify=0).table
    table.attrs.clear()
    with pytest.raises(gs.UserError, match="no job"):
        dataset_of(table)
