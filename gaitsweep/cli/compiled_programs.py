"""XLA's compiled programs, kept on disk, so that a program is compiled once for a machine and not once a run.

JAX does so itself, if it is told where; the names of its files tell versions and the instruction sets of
processors apart, so a home folder may be shared. Programs that cannot be read or written are compiled again,
without a word.
"""

from __future__ import annotations

import os
import sys
import warnings

from gaitsweep.cache_folder import cache_folder


def keep_compiled_programs() -> None:
    """Let JAX keep its programs in our cache, unless it has been imported or the user has set a folder."""
    if "jax" in sys.modules or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    folder = cache_folder("xla")
    if folder is None:
        return
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
    # also those that compile fast, since a run has many of them
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "0")
    # programs only: no choices that XLA makes by timing
    os.environ.setdefault("JAX_PERSISTENT_CACHE_ENABLE_XLA_CACHES", "none")
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache", UserWarning)
