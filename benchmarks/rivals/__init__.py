"""What gaitsweep is measured against: each module gives `measure() -> Row`, and `measure_all` calls them.

Nothing here imports gaitsweep; starts and true crossings come from tests/reference.
"""

from __future__ import annotations

from collections.abc import Iterator

from .starts import Row


def measure_all() -> Iterator[Row]:
    """Yields one row after another: NumPy batches, one `solve_ivp` at a time, diffrax."""
    from . import diffrax_events, numpy_batch, solve_ivp_single

    yield numpy_batch.measure(located=False)
    yield numpy_batch.measure(located=True)
    yield solve_ivp_single.measure()
    yield solve_ivp_single.measure(exact=True)
    yield diffrax_events.measure()
