"""The arguments that several kinds of figures have: their types, checks and descriptions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import pandas as pd
from pydantic import BeforeValidator, Field

from gaitsweep.schema.numbers import Positive, Real, Stem, Text, checked, read_text

# Types of arguments that name a column of the table, a numeric column along an axis, or an observable.
Column = Annotated[Text, "column_fields"]
AlongAxis = Annotated[Text, "column_fields", "axis_fields"]
Observable = Annotated[Text, "observable_fields"]

# Arguments that several figures have.
Horizontal = Annotated[AlongAxis, "column along the horizontal axis"]
Vertical = Annotated[AlongAxis, "column along the vertical axis"]
Observed = Annotated[Observable, "observable of the model"]
GaitColumn = Annotated[Column, "column of the gait"]
Hue = Annotated[Column, "column that colours the points"]
Panels = Annotated[Column | None, "column whose values have a panel each"]
Name = Annotated[
    Stem | None, Field(description="name of the figure's file without ending; by default its kind")
]
Title = Annotated[
    str | None,
    BeforeValidator(checked(lambda text: "" if text in ("", "none") else text and read_text(text))),
    'text above the figure; "" or none: no text there',
]
Bandwidth = Annotated[
    Positive | None,
    "half-width of the smoothing window, in the unit of y; by default 0.05 rad for an angle, and a twentieth "
    "of the range of other values",
]

# A table, or its name, which is all that a job can write.
if TYPE_CHECKING:
    TableOrName = Text | pd.DataFrame
else:
    TableOrName = Text

Window = Annotated[
    Sequence[Real] | None,
    Field(min_length=2, max_length=2),
    "beginning and end of the time that is shown, in s; by default all",
]

TEXT_COLUMNS = frozenset(
    {"status", "gait", "outcome", "special", "end", "slowest", "stalled_by", "recovery", "gait_before"}
)
