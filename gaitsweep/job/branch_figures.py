"""The figures of continuations that a job may ask for."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from gaitsweep.job.figure_part import NAME, TITLE, FigurePart
from gaitsweep.kinds.numbers import Real, Stem, Text


class Continuation(FigurePart):
    """Branches of steady gaits over a parameter, stable and unstable, with their folds."""

    runs: ClassVar[tuple[str, ...]] = ("continuation",)
    column_fields: ClassVar[tuple[str, ...]] = ("hue",)
    observable_fields: ClassVar[tuple[str, ...]] = ("y",)
    kind: Literal["continuation"] = Field(
        description="continuation: branches of steady gaits, and their folds"
    )
    y: Text = Field(description="observable of the model")
    hue: Text | None = Field(
        default=None, description="column of another parameter, or of the gait, shown by colour"
    )
    intervals: dict[Text, Annotated[list[Real], Field(min_length=2, max_length=2)]] = Field(
        default_factory=dict, description="ranges of the parameter to show beside, by name, two numbers each"
    )
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)


class StableRanges(FigurePart):
    """Where each gait is stable along the parameter, over another that differs between branches."""

    runs: ClassVar[tuple[str, ...]] = ("continuation",)
    column_fields: ClassVar[tuple[str, ...]] = ("y", "hue")
    kind: Literal["stable_ranges"] = Field(
        description="stable_ranges: where gaits are stable, over two parameters"
    )
    y: Text = Field(description="column of the parameter that differs between branches")
    hue: Text = Field(default="gait", description="column of the gait")
    title: Text | None = Field(default=None, description=TITLE)
    name: Stem | None = Field(default=None, description=NAME)
