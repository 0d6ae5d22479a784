"""The figures that a job asks for, and the columns that they may name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from gaitsweep import nearmiss
from gaitsweep.contract import Model
from gaitsweep.job.complaints import Complaint
from gaitsweep.job.numbers import Flag, Real, Stem, Text
from gaitsweep.job.runs import Part, Ramp, Run, Settle, Trace

_TITLE = "text above the figure"
_NAME = "file stem of the figure; its kind if not given"
_HUE = "column that colours the points"


class Basin(Part):
    """Which gait each start leads to, over two varied quantities."""

    runs: ClassVar[tuple[str, ...]] = ("settle",)
    kind: Literal["basin"] = Field(description="basin: the gait that each start leads to")
    x: Text = Field(description="column along the horizontal axis")
    y: Text = Field(description="column along the vertical axis")
    hue: Text = Field(default="gait", description=_HUE)
    panels: Text | None = Field(default=None, description="column of which each value gets a panel")
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)

    def columns(self) -> dict[str, str]:
        """The columns that it names, by field."""
        named = {"x": self.x, "y": self.y, "hue": self.hue, "panels": self.panels}
        return {field: column for field, column in named.items() if column is not None}


class SolutionSet(Part):
    """The settled states in three dimensions, the analytic solutions over them."""

    runs: ClassVar[tuple[str, ...]] = ("settle",)
    kind: Literal["solution_set"] = Field(description="solution_set: settled states in three dimensions")
    axes: list[Text] = Field(min_length=3, max_length=3, description="three observables of the model")
    hue: Text = Field(default="gait", description=_HUE)
    theory: Flag = Field(default=True, description="whether the analytic solutions are drawn over it")
    points: dict[Text, Annotated[list[Real], Field(min_length=3, max_length=3)]] = Field(
        default_factory=dict, description="points to mark, by name, three numbers each"
    )
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)

    def columns(self) -> dict[str, str]:
        """The columns that it names, by field."""
        return {"hue": self.hue}


class Cycles(Part):
    """Section observables against the number of the crossing."""

    runs: ClassVar[tuple[str, ...]] = ("return_map", "ramp")
    kind: Literal["cycles"] = Field(description="cycles: observables against crossings")
    y: list[Text] = Field(min_length=1, description="observables of the model, a panel each")
    x: Text = Field(default="crossing", description="column along the horizontal axis")
    hue: Text = Field(default="row", description=_HUE)
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)

    def columns(self) -> dict[str, str]:
        """The columns that it names, by field."""
        return {"x": self.x, "hue": self.hue}


class Footprints(Part):
    """Which leg is on the ground when."""

    runs: ClassVar[tuple[str, ...]] = ("trace",)
    kind: Literal["footprints"] = Field(description="footprints: which leg is on the ground when")
    panels: Text | None = Field(default="row", description="column of which each value gets a panel")
    titles: list[Text] | None = Field(default=None, description="titles of the panels, in order")
    title: Text | None = Field(default=None, description=_TITLE)
    name: Stem | None = Field(default=None, description=_NAME)

    def columns(self) -> dict[str, str]:
        """The columns that it names, by field."""
        return {} if self.panels is None else {"panels": self.panels}


Figure = Annotated[Basin | SolutionSet | Cycles | Footprints, Field(discriminator="kind")]


def table_columns(model: Model, varied: Iterable[str], run: Run) -> list[str]:
    """The columns of the table that a run makes, in their order."""
    axes = list(varied)
    if isinstance(run, Settle):
        observed = [f"{quantity.name}_end" for quantity in model.observables]
        traits = [quantity.name for quantity in model.traits]
        return ["row", *axes, "status", "cycles", "t_end", *observed, "gait", *traits]
    if isinstance(run, Trace):
        return ["row", *axes, "t", *(quantity.name for quantity in model.signals), "status"]
    moving = ["pass", run.parameter] if isinstance(run, Ramp) else []
    observed = [f"{quantity.name}_n" for quantity in model.observables]
    return ["row", *axes, "crossing", *moving, "t", "status", *observed]


def check_figures(figures: list[Figure], model: Model, varied: Iterable[str], run: Run) -> list[Complaint]:
    """Complaints about figures that do not fit the run, name what is not there, or share a name."""
    columns = table_columns(model, varied, run)
    observables = [quantity.name for quantity in model.observables]
    complaints: list[Complaint] = []
    stems: dict[str, int] = {}
    for index, figure in enumerate(figures):
        path = ("figures", index)
        if run.kind not in figure.runs:
            text = f"is {figure.kind}, which needs a run of {' or '.join(figure.runs)}, not of {run.kind}."
            complaints.append(Complaint((*path, "kind"), text))
            continue
        for field, column in figure.columns().items():
            if column not in columns:
                near = nearmiss.suggestion(column, columns)
                text = f"is {column}, which is not a column of this job's table{near}"
                complaints.append(Complaint((*path, field), text))
        listed = {"axes": figure.axes} if isinstance(figure, SolutionSet) else {}
        listed = {"y": figure.y} if isinstance(figure, Cycles) else listed
        for field, names in listed.items():
            for number, name in enumerate(names):
                if name not in observables:
                    near = nearmiss.suggestion(name, observables)
                    text = f"is {name}, which is not an observable of {model.name}{near}"
                    complaints.append(Complaint((*path, field, number), text))
        stem = figure.name or figure.kind
        if stem in stems:
            text = f"is {stem}, the name of figures[{stems[stem]}] too: give each figure a name of its own."
            complaints.append(Complaint((*path, "name"), text))
        stems.setdefault(stem, index)
    return complaints
