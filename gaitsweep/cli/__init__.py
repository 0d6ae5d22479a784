"""The command line of gaitsweep."""

from __future__ import annotations

from gaitsweep.cli.analyse import GroupColumns, print_table
from gaitsweep.cli.main import main
from gaitsweep.cli.options import Directory

__all__ = ["Directory", "GroupColumns", "main", "print_table"]
