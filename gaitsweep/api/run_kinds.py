"""The run kinds as Python writes them: `gs.Settle(max_cycles=150)`, checked when they are made."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import ValidationError

from gaitsweep.errors import ArgumentError
from gaitsweep.kinds import runs as kinds
from gaitsweep.kinds.complaints import Owner, from_pydantic


class _Kind(kinds.Part):
    """Lets `kind` be left out, takes NumPy's arrays and numbers, and refuses by a sentence."""

    def __init__(self, **fields: Any) -> None:
        plain = {
            name: value.tolist() if hasattr(value, "tolist") else value for name, value in fields.items()
        }
        try:
            super().__init__(**plain)
        except ValidationError as error:
            kind = type(self).model_fields["kind"].default
            wrong = from_pydantic(error, {kind: Owner(f"run ({kind})", type(self), "run")}, kind, ("run",))
            raise ArgumentError("\n".join(map(str, wrong))) from None


class Settle(_Kind, kinds.Settle):
    """Runs each row until its section state stops moving or repeats."""

    kind: Literal["settle"] = "settle"


class FixedTime(_Kind, kinds.Hold):
    """Runs each row for a given time and reads it at its last section crossing."""

    kind: Literal["hold"] = "hold"


class Trace(_Kind, kinds.Trace):
    """Records the signals of each row at equal intervals of time."""

    kind: Literal["trace"] = "trace"


class Ramp(_Kind, kinds.Ramp):
    """Moves one parameter slowly along a path and records every section crossing."""

    kind: Literal["ramp"] = "ramp"


class ReturnMap(_Kind, kinds.ReturnMap):
    """Records successive section states of each row."""

    kind: Literal["return_map"] = "return_map"


class Staircase(_Kind, kinds.Staircase):
    """Moves one parameter in steps along a path and records the end of each step."""

    kind: Literal["staircase"] = "staircase"


class Continuation(_Kind, kinds.Continuation):
    """Follows the fixed points of each row's return map along one parameter."""

    kind: Literal["continuation"] = "continuation"
