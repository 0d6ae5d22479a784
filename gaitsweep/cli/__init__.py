"""The command `gaitsweep`: what a user types, and nothing else."""

from __future__ import annotations

from gaitsweep.cli.main import main

__all__ = ["main"]
