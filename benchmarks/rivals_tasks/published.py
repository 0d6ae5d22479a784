"""Published times of rivals that do not run here, with sources, hardware and tasks: quoted, not divided.

Attractors.jl: pyBasin's own comparison, file benchmarks/end_to_end/results/end_to_end_comparison_all.csv of
github.com/adrianwix/pyBasin (commit 5eaa6855), mean of five runs of its pendulum on its author's machine. Its
other rows there are pyBasin's. MuJoCo Warp's humanoid and our quadruped are other bodies, in other precision.
"""

from __future__ import annotations

from collections.abc import Iterator

from .measured import Line, Options

PENDULUM = "published by pyBasin: its pendulum, 50 000 starts"


def lines(options: Options) -> Iterator[Line]:
    """The lines of published numbers."""
    note = "no resets in a flow; needs Julia, which is not installed here"
    yield Line(f"{PENDULUM}, Attractors.jl, CPU", clock_s=86.4, note=note)
    yield Line(f"{PENDULUM}, pyBasin (diffrax), CPU", clock_s=30.1)
    yield Line(f"{PENDULUM}, pyBasin (diffrax), GPU", clock_s=12.4)
    yield Line(f"{PENDULUM}, pynamicalsys, CPU", clock_s=56.0)
    yield Line(
        "MuJoCo Warp: humanoid, 5.7e6 steps/s on an RTX 6000 Ada",
        note="steps of fixed length, contacts softened, no located events; float32. Ours, a quadruped with a "
        "waist in float64: python -m benchmarks.card_alone",
    )
