"""The on-disk cache of kernels, so that a kernel is compiled once for a machine and not once for a run.

A file is named by the digest of the kernel's source and of the versions that compile it, and carries the
digest of its own content: machine code for a CPU, or of a kernel for an NVIDIA GPU. What is damaged is
compiled again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence

from gaitsweep.cache_folder import cache_folder, load_cached, store_cached


def binary_of(suffix: str, key: Sequence[str], compile_: Callable[[], bytes]) -> bytes:
    """The machine code that `compile_` makes, or that it has made before with the same key.

    Args:
        suffix: the ending of the file's name, without the dot.
        key: all that determines the code: the source, the options, the compiler's version.
        compile_: compiles the source.
    """
    folder = cache_folder("kernels")
    if folder is None:
        return compile_()
    digest = hashlib.sha256("\n".join(key).encode()).hexdigest()
    file = folder / f"gaitsweep_kernel_{digest[:24]}.{suffix}"
    code = load_cached(file)
    if code is None:
        code = compile_()
        store_cached(file, code)
    return code
