"""The run kinds as Python writes them: `gs.Settle(max_cycles=150)`, checked when they are made."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import ValidationError

from gaitsweep.api.keywords import plain
from gaitsweep.errors import ArgumentError
from gaitsweep.kinds import continuation, fixed_time, ramp, return_map, settle, staircase, trace
from gaitsweep.kinds.diagnostics import Owner, from_pydantic
from gaitsweep.kinds.part import Part, kind_of


class _Kind(Part):
    """Lets `kind` be left out, takes NumPy's arrays and numbers, and refuses by a sentence."""

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**plain(fields))
        except ValidationError as error:
            kind = kind_of(type(self))
            wrong = from_pydantic(error, {kind: Owner(f"run ({kind})", type(self), "run")}, kind, ("run",))
            raise ArgumentError("\n".join(map(str, wrong))) from None


class Settle(_Kind, settle.Settle):
    """Runs each row until its section state stops moving or repeats."""

    kind: Literal["settle"] = "settle"


class FixedTime(_Kind, fixed_time.FixedTime):
    """Runs each row for a given time and reads it at its last section crossing."""

    kind: Literal["fixed_time"] = "fixed_time"


class Trace(_Kind, trace.Trace):
    """Records the signals of each row at equal intervals of time."""

    kind: Literal["trace"] = "trace"


class Ramp(_Kind, ramp.Ramp):
    """Moves one parameter slowly along a path and records every section crossing."""

    kind: Literal["ramp"] = "ramp"


class ReturnMap(_Kind, return_map.ReturnMap):
    """Records successive section states of each row."""

    kind: Literal["return_map"] = "return_map"


class Staircase(_Kind, staircase.Staircase):
    """Moves one parameter in steps along a path and records the end of each step."""

    kind: Literal["staircase"] = "staircase"


class Continuation(_Kind, continuation.Continuation):
    """Follows the fixed points of each row's return map along one parameter."""

    kind: Literal["continuation"] = "continuation"
