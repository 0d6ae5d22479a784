"""The command line of gaitsweep."""

from __future__ import annotations

from gaitsweep.cli.analyse import Directory, Kept, print_table
from gaitsweep.cli.main import main

__all__ = ["Directory", "Kept", "main", "print_table"]
