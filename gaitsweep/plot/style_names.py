"""Names of gaits and columns in a style, and those that name nothing in a table or in its model."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, Self

import pandas as pd

from gaitsweep import near_miss
from gaitsweep.contract import Model
from gaitsweep.extension import gait_styles
from gaitsweep.plot.column_labels import observable_in
from gaitsweep.plot.columns import OTHER
from gaitsweep.plot.figure_style import FigureStyle
from gaitsweep.status import Outcome, Status

Unknown = tuple[tuple[str | int, ...], str]  # where in the style, and the end of the sentence
_PERIODS = 65  # numbers of crossings that a gait of an atlas may have before there is a table


def period_names(periods: Iterable[int]) -> tuple[str, ...]:
    """The names of gaits without a name in figures of an atlas."""
    return tuple(f"period {period}" for period in periods)


@dataclasses.dataclass(frozen=True)
class StyleNames:
    """The names that a style may use: gaits, columns, and other texts that columns hold."""

    gaits: Collection[str]
    columns: Collection[str]
    texts: Collection[str]
    periods: Collection[str] = ()  # of an atlas, which stand for gaits without a name

    @classmethod
    def of_model(cls, model: Model | None, columns: Collection[str]) -> Self:
        """The names of a model, and of columns; of an unknown model the gaits of all extensions."""
        outcomes = (*map(str, Outcome), OTHER)
        periods = period_names(range(1, _PERIODS)) if {"begins", "period"} <= set(columns) else ()
        if model is None:
            return cls((*gait_styles(), *outcomes), columns, (), periods)
        known = (*model.parameters, *model.initial_conditions, *model.observables, *model.signals)
        names = (*columns, *(quantity.name for quantity in known))
        observed = (quantity.name for quantity in model.observables)  # what settled last may colour rows
        texts = (*observed, *(status.name for status in Status))
        return cls((*model.gaits, *outcomes), names, texts, periods)

    @classmethod
    def of_table(cls, table: pd.DataFrame, model: Model | None) -> Self:
        """The names of a table and of its model."""
        columns = [*map(str, table.columns), *table.attrs.get("quantities", {})]
        names = cls.of_model(model, [*columns, *(observable_in(table, name) for name in columns)])
        texts: list[str] = []
        for _, values in table.select_dtypes(["category", "object", "string"]).items():
            categorical = isinstance(values.dtype, pd.CategoricalDtype)
            texts += map(str, values.cat.categories if categorical else values.unique())
        periods = table["period"].unique() if names.periods else ()
        gaits = names.gaits
        if model is None and "gait" in table.columns:  # the gaits of all extensions would say little
            gaits = (*dict.fromkeys([*map(str, table["gait"].dropna().unique()), *map(str, Outcome), OTHER]),)
        return cls(gaits, names.columns, (*names.texts, *texts), period_names(sorted(periods)))

    def unknown(
        self, style: FigureStyle, hue: str | None = None, *, shared: bool = False
    ) -> Iterator[Unknown]:
        """The names in a style's colours, order and labels that name nothing.

        Args:
            style: the style.
            hue: the column that the figure colours, if it has one.
            shared: whether the style is that of several tables, in which a name is wrong only if it is nearly
                one of this table's, and no gait of an extension.
        """
        # rows with these statuses are shown as failed or not settled, but for a figure of the statuses
        lost = Status.FAILED | Status.UNDECIDED
        texts = set(self.texts) - (set() if hue == "status" or "recovery" in self.columns else lost)
        gaits = list(dict.fromkeys((*self.gaits, *(text for text in self.texts if text in gait_styles()))))
        for field, allowed, what in (
            ("colours", [*gaits, *self.periods], "gait"),
            ("order", [*gaits, *self.periods], "gait"),
            ("labels", [*gaits, *dict.fromkeys(self.columns)], "column or gait"),
        ):
            names: Any = getattr(style, field) or ()
            keys = names if isinstance(names, Mapping) else range(len(names))
            for key, name in zip(keys, names, strict=True):
                if name in allowed or name in texts:
                    continue
                if shared and (name in gait_styles() or near_miss.nearest(name, allowed) is None):
                    continue
                near = near_miss.suggestion(name, allowed)
                if name in lost:
                    outcome = Outcome.FAILED if name in Status.FAILED else Outcome.NOT_SETTLED
                    near = f"; did you mean {outcome}? {near_miss.allowing(allowed)}"
                unknown = f"no {what} of this table or of its model"
                text = f"is {name}, which is {unknown}" if isinstance(key, int) else f"names {unknown}"
                yield (field, key), f"{text}{near}"
