"""The figures of the multi-legged chain that a job may ask for, beyond those of any model."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from gaitsweep.job.figure_part import NAME, TITLE, FigurePart
from gaitsweep.kinds.numbers import Stem, Text, word


class DriftLaw(FigurePart):
    """Cycles that chains with unequal ends take, against the law of their drift."""

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


class GaitShares(FigurePart):
    """Shares of the three gaits over parameters, with the edges of the conditions for them."""

    runs: ClassVar[tuple[str, ...]] = ("settle",)
    column_fields: ClassVar[tuple[str, ...]] = ("x", "y")
    kind: Literal["gait_shares"] = Field(description="gait_shares: the share of each gait over parameters")
    x: Text = Field(description="column along the horizontal axis")
    y: Text | None = Field(default=None, description="column along the vertical axis; curves over x without")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)
