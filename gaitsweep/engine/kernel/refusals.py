"""Refusals of the kernel: operations that a scalar program does not have, with their place in a source."""

from __future__ import annotations

from jax.extend.core import JaxprEqn


class UnsupportedError(Exception):
    """A model uses an operation that the scalar kernel does not have; the message names it and its place."""


class Refusal(UnsupportedError):
    """A rule cannot translate an equation, whose place in the source it does not know; see `refuse`."""


def refuse(reason: str) -> Refusal:
    """The error to raise if a rule cannot translate its equation; the tracer adds the place in the source."""
    return Refusal(reason)


def place_of(equation: JaxprEqn) -> str:
    """The line of the model's source that an equation comes from, if JAX knows it."""
    try:
        from jax._src import source_info_util

        frame = source_info_util.user_frame(equation.source_info.traceback)
    except (ImportError, AttributeError, TypeError):
        return ""
    return "" if frame is None else f" ({frame.file_name}, line {frame.start_line})"
