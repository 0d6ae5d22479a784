"""What every figure that a job asks for says of itself."""

from __future__ import annotations

from typing import ClassVar

from gaitsweep.kinds.runs import Part

TITLE = "text above the figure"
NAME = "file stem of the figure; its kind if not given"


class FigurePart(Part):
    """What every figure says of itself: the runs that it suits, the columns and observables that it names."""

    runs: ClassVar[tuple[str, ...]]
    column_fields: ClassVar[tuple[str, ...]] = ()  # the fields that name columns of the table
    observable_fields: ClassVar[tuple[str, ...]] = ()  # those that name observables, one or a list

    def columns(self) -> dict[str, str]:
        """The columns that it names, by field."""
        named = {field: getattr(self, field) for field in self.column_fields}
        return {field: column for field, column in named.items() if column is not None}

    def observed(self) -> dict[tuple[str | int, ...], str]:
        """The observables that it names, by where in it they stand."""
        places: dict[tuple[str | int, ...], str] = {}
        for field in self.observable_fields:
            named = getattr(self, field)
            if isinstance(named, list):
                places |= {(field, number): name for number, name in enumerate(named)}
            else:
                places[field,] = named
        return places
