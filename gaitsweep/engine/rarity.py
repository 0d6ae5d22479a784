"""Marks on conditions that are seldom true, or nearly always, along a trajectory.

A kernel computes what depends on the exceptions only where there is one; XLA computes everything.
"""

from __future__ import annotations

from typing import cast

import jax
from jax.ad_checkpoint import checkpoint_name

from gaitsweep.engine.shapes import Flag

# What a marked condition nearly always is, by the mark's name.
USUAL = {"gaitsweep.unlikely": False, "gaitsweep.likely": True}


def unlikely(condition: Flag) -> Flag:
    """The condition itself, marked as seldom true."""
    return cast(jax.Array, checkpoint_name(condition, "gaitsweep.unlikely"))


def likely(condition: Flag) -> Flag:
    """The condition itself, marked as nearly always true."""
    return cast(jax.Array, checkpoint_name(condition, "gaitsweep.likely"))
