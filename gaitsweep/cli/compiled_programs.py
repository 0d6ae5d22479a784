"""A disk cache of XLA's compiled programs, which so are compiled once per machine and not once per run.

JAX manages the cache in the folder set here; its file names contain versions and instruction sets of
processors, so a home folder may be shared. Programs that cannot be read or written are compiled again
silently.
"""

from __future__ import annotations

import os
import sys
import warnings

from gaitsweep.cache_folder import cache_folder


def keep_compiled_programs() -> None:
    """Set JAX's cache folder, unless JAX has been imported or the user has set a folder."""
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
