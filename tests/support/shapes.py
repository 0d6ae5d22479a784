"""Checks of arrays against the axes in their annotations, as by jaxtyping's import hook, for tests."""

from __future__ import annotations

import builtins
import sys
from collections.abc import Callable
from typing import Any, get_args

import beartype
import jaxtyping
from jax._src import tree_util

# The modules whose functions and dataclasses are checked, with those below them.
CHECKED = (
    "gaitsweep.analysis",
    "gaitsweep.angles",
    "gaitsweep.contract",
    "gaitsweep.design",
    "gaitsweep.engine",
    "gaitsweep.row_outcome",
    "gaitsweep.status",
)
# The names that modules on light paths import for type checkers alone.
KINDS = ("Bool", "Float", "Int", "Num", "Real")


def check_shapes() -> None:
    """Check the shapes in modules of `CHECKED` that are imported afterwards."""
    imported = [name for name in CHECKED if name in sys.modules]
    if imported:
        raise RuntimeError(f"{', '.join(imported)}: imported already, without checks")
    for name in KINDS:
        setattr(builtins, name, getattr(jaxtyping, name))
    jaxtyping.install_import_hook(CHECKED, f"{__name__}.checked")


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function whose arrays beartype checks; but JAX fills pytrees with objects and whole batches."""
    hints = function.__annotations__
    function.__annotations__ = {name: hint for name, hint in hints.items() if _has_axes(hint)}
    if not function.__annotations__:
        return function
    tested = beartype.beartype(function)
    if function.__name__ != "__init__":
        return tested

    def of_instance(self: Any, *args: Any, **named: Any) -> Any:
        return (function if _is_pytree(type(self)) else tested)(self, *args, **named)

    return of_instance


def _has_axes(hint: Any) -> bool:
    if isinstance(hint, type) and issubclass(hint, jaxtyping.AbstractArray):
        return True
    return any(_has_axes(part) for part in get_args(hint))


def _is_pytree(kind: type) -> bool:
    return kind in tree_util._registry
