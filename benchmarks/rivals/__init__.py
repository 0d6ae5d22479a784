"""Programs with which gaitsweep is compared; each module defines `measure() -> Row`.

Nothing here imports gaitsweep; starts and true crossings come from tests/reference.
"""

from __future__ import annotations

from collections.abc import Iterator

from .starts import Row

# Starts of a timing on the CPU: with 20 cycles, seconds for each of the rivals by hand.
STARTS = 1024


def written_by_hand(crossings: int) -> Iterator[tuple[str, Row]]:
    """Yields cpu or gpu, and the row: Numba, C with SIMD, and CUDA where there is a device."""
    from . import c_simd, cuda_by_hand
    from .by_hand import missing

    try:
        from . import numba_by_hand
    except ImportError as error:
        yield "cpu", missing("Numba by hand, one trajectory at a time", f"not measured: {error}")
    else:
        yield "cpu", numba_by_hand.measure(STARTS, crossings)
    yield "cpu", c_simd.measure(STARTS, crossings)
    if cuda_by_hand.driver() is not None:
        yield "gpu", cuda_by_hand.measure(crossings=crossings)


def general() -> Iterator[Row]:
    """Yields the rows of what others would reach for first, minutes in all.

    NumPy over many lanes, one `solve_ivp` and one exact propagation at a time, and diffrax.
    """
    from . import diffrax_events, numpy_batch, solve_ivp_single

    yield numpy_batch.measure(located=False)
    yield numpy_batch.measure(located=True)
    yield solve_ivp_single.measure()
    yield solve_ivp_single.measure(exact=True)
    yield diffrax_events.measure()
