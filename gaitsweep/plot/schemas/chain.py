"""Kinds of figures: the multi-legged chain."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from gaitsweep import near_miss
from gaitsweep.kinds.numbers import Flag, Real, Stem, Text, word
from gaitsweep.plot.chain.drift_law import drift_law
from gaitsweep.plot.chain.gait_shares import gait_shares_figure as gait_shares
from gaitsweep.plot.chain.solution_set import solution_set
from gaitsweep.plot.figure_kind import (
    HUE,
    NAME,
    TEXT_COLUMNS,
    TITLE,
    FigureKind,
    PlannedTable,
    Refusal,
)

_ENDS = {"m": ("m_1", "m_end"), "kappa": ("kappa_1", "kappa_end"), "a": ("a_1", "a_end")}


class SolutionSet(FigureKind):
    """The settled states in three dimensions, the analytic solutions over them."""

    draw: ClassVar = staticmethod(solution_set)
    runs: ClassVar[tuple[str, ...]] = ("settle",)
    column_fields: ClassVar[tuple[str, ...]] = ("hue",)
    observable_fields: ClassVar[tuple[str, ...]] = ("axes",)
    kind: Literal["solution_set"] = Field(description="solution_set: settled states in three dimensions")
    axes: list[Text] = Field(min_length=3, max_length=3, description="three observables of the model")
    hue: Text = Field(default="gait", description=HUE)
    theory: Flag = Field(default=True, description="whether the analytic solutions are drawn over it")
    points: dict[Text, Annotated[list[Real], Field(min_length=3, max_length=3)]] = Field(
        default_factory=dict, description="points to mark, by name, three numbers each"
    )
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)


class DriftLaw(FigureKind):
    """Cycles that chains with unequal ends take, against the law of their drift."""

    draw: ClassVar = staticmethod(drift_law)
    runs: ClassVar[tuple[str, ...]] = ("settle",)
    column_fields: ClassVar[tuple[str, ...]] = ("hue",)
    kind: Literal["drift_law"] = Field(description="drift_law: cycles until settled over unequal ends")
    of: Annotated[Literal["m", "kappa", "a", "ends"], word("m", "kappa", "a", "ends")] = Field(
        default="m",
        description="what differs between head and tail: masses, end springs, amplitudes; ends: any of these",
    )
    hue: Text = Field(default="gait", description="column of the gait")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        pairs = list(_ENDS.values()) if self.of == "ends" else [_ENDS[self.of]]
        if not any(table.missing(pair) is None for pair in pairs):
            told = ", or ".join(" and ".join(pair) for pair in pairs)
            yield ("of",), f"is {self.of}, for which {told} have to vary in this job."
        elif table.missing(["psi_1_end"]):
            yield self.needs(table, "the multi-legged chain's psi_1")


class GaitShares(FigureKind):
    """Shares of the three gaits over parameters, with the edges of the conditions for them."""

    draw: ClassVar = staticmethod(gait_shares)
    runs: ClassVar[tuple[str, ...]] = ("settle",)
    column_fields: ClassVar[tuple[str, ...]] = ("x", "y")
    axis_fields: ClassVar[tuple[str, ...]] = ("x", "y")
    kind: Literal["gait_shares"] = Field(description="gait_shares: the share of each gait over parameters")
    x: Text = Field(description="column along the horizontal axis")
    y: Text | None = Field(default=None, description="column along the vertical axis; curves over x without")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        if table.missing(["psi_1_end"]):
            yield self.needs(table, "the multi-legged chain's psi_1")
            return
        sets = [name for name in table.varied if not name.startswith(("psi_", "phi_"))]
        for field in ("x", "y"):
            column = getattr(self, field)
            if column is not None and column not in sets and column not in TEXT_COLUMNS:
                allowed = near_miss.allowing(sets)
                yield (field,), f"is {column}, which is no parameter that varies in this job. {allowed}"
