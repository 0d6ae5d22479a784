"""Python source of a scalar program, for one lane of a CPU; `llvm_code` compiles it to LLVM."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from gaitsweep.engine.kernel.operations import Operation
from gaitsweep.engine.kernel.program import Kind, Value


class Python:
    """Python as a `Language`."""

    def expression(self, operation: Operation, args: Sequence[str], bits: Literal[32, 64]) -> str:
        return operation.python.format(*args, bits=bits)

    def definition(self, kind: Kind, name: str, expression: str) -> str:
        return f"{name} = {expression}"

    def literal(self, value: Value, kind: Kind) -> str:
        if kind == "bool":
            return str(bool(value))
        number = float(value)
        if math.isnan(number):
            text = "nan"
        elif math.isinf(number):
            text = "inf" if number > 0 else "-inf"
        else:
            text = repr(number)
        if kind == "f32":
            return f"float32({text})"
        return f"({text})" if text.startswith("-") else text


def loaded(kind: Kind, place: str) -> str:
    """The expression that loads a value of a kind from memory, where all kinds are float64."""
    if kind == "bool":
        return f"{place} != 0.0"
    return f"float32({place})" if kind == "f32" else place


def stored(kind: Kind, value: str) -> str:
    """The expression that is stored in memory for a value of a kind."""
    return f"1.0 if {value} else 0.0" if kind == "bool" else value
