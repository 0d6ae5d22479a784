"""A run kind and a figure from outside the package: registered, run, drawn, and removed again."""

from __future__ import annotations

import pydoc
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from pydantic import Field

import gaitsweep as gs
from gaitsweep import kinds, plot
from gaitsweep.contract import Model
from gaitsweep.design import Design
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.job import Job, JobError, schema
from gaitsweep.kinds.columns import CROSSING, STATUS, Column, observed_at_crossings
from gaitsweep.kinds.run_kind import Cost
from gaitsweep.runs.estimate import estimate
from gaitsweep.schema.numbers import Count, Text


class Doublings(kinds.RunKind):
    """Record crossings, and the time of each twice over."""

    figures: ClassVar[tuple[str, ...]] = ("cycles",)
    kind: Literal["doublings"] = Field(description="doublings: crossings, and twice their times")
    crossings: Count = Field(default=3, description="section crossings to record")

    def recorder(self, model: Model) -> CrossingRecorder:
        return CrossingRecorder(model, self.crossings)

    def columns(self, model: Model) -> list[Column]:
        twice = Column("twice", lambda records: 2.0 * records["t"], repeats=False)
        return [CROSSING, Column("t", repeats=False), twice, STATUS, *observed_at_crossings(model)]

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        return Cost(self.crossings * cycle, self.crossings * cycle, self.crossings)


class Times(plot.FigureKind):
    """The time of each crossing."""

    runs: ClassVar[tuple[str, ...]] = ("doublings", "return_map")
    column_fields: ClassVar[tuple[str, ...]] = ("y",)
    kind: Literal["times"] = Field(description="times: the time of each crossing")
    y: Text = Field(default="t", description="column along the vertical axis")

    @staticmethod
    def draw(table: pd.DataFrame, y: str = "t") -> Figure:
        figure = Figure()
        figure.subplots().plot(table["crossing"], table[y])
        return figure


@pytest.fixture
def registered() -> Iterator[None]:
    kinds.register(Doublings)
    plot.register(Times)
    yield
    kinds.unregister("doublings")
    plot.unregister("times")


def job(figures: list[dict[str, Any]] | None = None, **run: Any) -> Job:
    run = {"kind": "doublings", **run}
    vary = {"launch_1": [1.0, 1.5]}
    return Job(name="x", model="toy_model:Toy", vary=vary, run=run, verify=2, figures=figures or [])


@pytest.mark.slow
@pytest.mark.usefixtures("registered")
def test_a_kind_and_a_figure_from_outside_run(tmp_path: Path) -> None:
    figures = [{"kind": "times", "y": "twice"}, {"kind": "cycles", "y": ["launch_1"]}]
    asked = job(figures, crossings=4)
    result = gs.run(asked, tmp_path / "out")
    table = result.table
    assert list(table.columns) == ["row", "launch_1", "crossing", "t", "twice", "status", "launch_1_n"]
    np.testing.assert_array_equal(table["twice"], 2.0 * table["t"])
    assert len(table) == 2 * 5  # the start is crossing 0
    assert [path.stem for path in result.figures] == ["cycles", "times"]
    assert result.manifest["self_check"]["verdict"] == "passed"
    assert estimate(asked).records == 2 * 4
    assert asked.resolved()["run"] == {"kind": "doublings", "crossings": 4}
    assert Job(**asked.resolved()).hash() == asked.hash() != job(figures, crossings=5).hash()


@pytest.mark.usefixtures("registered")
def test_the_schema_and_the_refusals_name_them() -> None:
    described = schema()
    assert "doublings" in described["properties"]["run"]["discriminator"]["mapping"]
    assert "times" in described["properties"]["figures"]["items"]["discriminator"]["mapping"]
    with pytest.raises(JobError, match=r"run\.crosings is not a field of run \(doublings\)"):
        job(crosings=3)
    with pytest.raises(JobError, match="did you mean doublings"):
        job(kind="doubling")
    with pytest.raises(JobError, match=r"figures\[0\]\.y is tt, which is not a column of this job's table"):
        job([{"kind": "times", "y": "tt"}])
    with pytest.raises(JobError, match="doublings or return_map, not settle"):
        job([{"kind": "times"}], kind="settle")
    with pytest.raises(JobError, match="return_map or ramp or doublings, not settle"):
        job([{"kind": "cycles", "y": ["launch_1"]}], kind="settle")


def test_unregistered_kinds_are_refused() -> None:
    with pytest.raises(JobError, match=r"run\.kind: \"doublings\" is not"):
        job()
    with pytest.raises(JobError, match=r"figures\[0\]\.kind: \"times\" is not"):
        job([{"kind": "times"}], kind="return_map", crossings=3)


@pytest.mark.usefixtures("registered")
def test_a_name_is_given_once() -> None:
    class Another(Doublings):
        """Another kind with the same name."""

    assert kinds.register(Doublings) is Doublings
    with pytest.raises(ValueError, match="kind of run named doublings"):
        kinds.register(Another)

    class Nameless(kinds.RunKind):
        """A kind without a name."""

    with pytest.raises(TypeError, match="Nameless needs a field kind"):
        kinds.register(Nameless)


@pytest.mark.parametrize("name", ["limbs", "draw"])
def test_a_figure_has_no_name_of_a_module_or_function_of_plot(name: str) -> None:
    """`gs.plot.NAME` would be something else than the figure."""

    def figure(table: pd.DataFrame) -> Figure:
        """A figure."""
        return Figure()

    figure.__name__ = name
    with pytest.raises(ValueError, match=rf"gaitsweep\.plot\.{name} is no figure: choose another name"):
        plot.figure_kind("settle")(figure)
    assert name not in plot.FIGURES


@pytest.mark.parametrize("kind", list(kinds.RUN_KINDS))
def test_every_kind_describes_itself(kind: str) -> None:
    part = kinds.RUN_KINDS[kind]
    assert str(part.model_fields["kind"].description).startswith(f"{kind}: ")
    assert part.__doc__


def test_the_interface_names_its_optional_members() -> None:
    described = kinds.RunKind.__doc__ or ""
    members = [getattr(member, "fget", member) for member in vars(kinds.RunKind).values()]
    members = [getattr(member, "__func__", member) for member in members]
    own = [m for m in members if getattr(m, "__module__", "") == kinds.RunKind.__module__]
    optional = {m.__name__ for m in own if not hasattr(m, "__final__")} - {"__init__"}
    assert optional >= {"recorder", "check", "findings", "model_of", "movements"}
    assert optional <= set(re.findall(r"`(\w+)`", described))


def test_help_of_a_kind_is_its_fields_and_not_pydantics_methods() -> None:
    shown = pydoc.plain(pydoc.render_doc(kinds.RUN_KINDS["staircase"]))
    assert "Staircase(*, parameter, path, step, dwell, first_dwell=None, tolerance=0.001)" in shown
    assert re.search(r"dwell: time on each stair, in s\n", shown)
    assert "model_dump" not in shown
    assert len(shown.splitlines()) < 80
