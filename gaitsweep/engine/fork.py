"""Forks of a process that has computed with JAX, in which a computation would never end."""

from __future__ import annotations

import os

from jax._src import xla_bridge

from gaitsweep.errors import UnsupportedSystem

_computed_before = False  # whether JAX had computed when this process was forked


def _note_fork() -> None:
    global _computed_before
    _computed_before |= xla_bridge.backends_are_initialized()


os.register_at_fork(after_in_child=_note_fork)


def refuse_fork() -> None:
    """Refuse to compute in a fork of a process that has computed with JAX, whose threads it lacks.

    Raises:
        UnsupportedSystem: this process is such a fork.
    """
    if _computed_before:
        raise UnsupportedSystem(
            "This process is a fork of one that has computed with JAX, and lacks the threads of JAX, so the "
            "computation would never end. Use one call with all values, which uses all cores; or start "
            "processes by multiprocessing.get_context('spawn'), or pass a Dask client as client=."
        )
