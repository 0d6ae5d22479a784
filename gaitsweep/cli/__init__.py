"""The command line of gaitsweep.

`main.py` runs a command and returns the exit codes of `gaitsweep/errors.py`; `commands.py` has all commands
or names their files: `run.py` (run, atlas), `fits.py` (search, sensitivity), `analyse.py`, `examples.py`,
`models.py` (models, check-model, new-model, new-paper), `reproduce.py`, `views.py` (animate, explore).
`show.py` and `show_fits.py` format what they print, `options.py` has their common options, `progress.py` the
bar and stops by Ctrl-C, `new_files.py` writes templates and copies, and `stored_output.py` has what complete
jobs print again. `gaitsweep.job.load.read_with_overrides` applies `--set`.
"""

from __future__ import annotations

from gaitsweep.cli.analyse import GroupColumns, print_table
from gaitsweep.cli.main import main
from gaitsweep.cli.options import Directory

__all__ = ["Directory", "GroupColumns", "main", "print_table"]
