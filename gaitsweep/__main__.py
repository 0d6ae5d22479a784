"""`python -m gaitsweep`, the same as the command `gaitsweep`."""

from __future__ import annotations

import sys

from gaitsweep.cli import main

sys.exit(main())
