"""Speed of kernels on an NVIDIA GPU without the host: `python -m benchmarks.card_alone`.

Prints attempts (of all lanes together) a second, registers and bytes in memory of a thread, and the seconds
until all lanes were filled; with an empty GAITSWEEP_CACHE kernels are compiled in that time. The trajectories
start at random and are neither collected nor replaced.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from gaitsweep.contract import Model
from gaitsweep.engine.devices import local_devices
from gaitsweep.engine.kernel.cuda_lanes import CudaLanes
from gaitsweep.engine.numerics import STEP_FACTOR, Numerics
from gaitsweep.engine.recorders.recorder import Recorder
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.engine.sweep.sweep_spec import SweepSpec
from gaitsweep.expression import evaluate
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped

CROSSINGS = 30  # below a buffer's length, so that no lane waits for the host


@dataclasses.dataclass(frozen=True)
class Case:
    """A model and how it is run; `ranges` of parameters and starts, polls in one launch, what is kept."""

    name: str
    model: Model
    numerics: Numerics
    ranges: Mapping[str, tuple[float, float]]
    polls: int
    settling: bool = False

    @property
    def recorder(self) -> Recorder:
        """Of settling rows, or of each crossing."""
        return SettleRecorder(self.model) if self.settling else CrossingRecorder(self.model, CROSSINGS)


_PHASES = {f"psi_{i}": (0.0, 2.0 * np.pi) for i in (1, 2, 3)}
_LOADS = {"f": (2.0, 3.2), "delta_13": (2.0, 3.2)}
_SMALL_STEPS = Numerics(dt=2e-4, method="semi_implicit")
SETTLING = Case(
    "chain settling", Multilegged(), Numerics(dt=32e-3, method="propagator6"), _PHASES, 64, settling=True
)
CASES = [
    Case("chain, rk4", Multilegged(), Numerics(dt=4e-3, method="rk4"), _PHASES, 32),
    Case("chain, propagator6", Multilegged(), Numerics(dt=32e-3, method="propagator6"), _PHASES, 8),
    SETTLING,
    Case("quadruped with a waist", WaistQuadruped(), _SMALL_STEPS, _LOADS, 16),
    Case(
        "the same, mixed", WaistQuadruped(), dataclasses.replace(_SMALL_STEPS, precision="mixed"), _LOADS, 16
    ),
]


def rows_of(case: Case, lanes: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Parameters and starts of all lanes, (lanes,) each."""
    random = np.random.default_rng(0)
    params: dict[str, Any] = {}
    starts: dict[str, Any] = {STEP_FACTOR: np.ones(lanes)}
    for quantity in case.model.parameters:
        setting = quantity.default
        if quantity.name in case.ranges:
            setting = random.uniform(*case.ranges[quantity.name], lanes)
        number = evaluate(setting, params) if isinstance(setting, str) else setting
        params[quantity.name] = np.broadcast_to(np.asarray(number, float), (lanes,))
    for quantity in case.model.initial_conditions:
        setting = np.nan if quantity.default is None else quantity.default
        if quantity.name in case.ranges:
            setting = random.uniform(*case.ranges[quantity.name], lanes)
        starts[quantity.name] = np.broadcast_to(np.asarray(setting, float), (lanes,))
    return params, starts


class Measured(NamedTuple):
    """Attempts a second; registers and bytes in memory of a thread; s until all lanes were filled."""

    rate: float
    registers: int
    spilled: int
    ready: float


def measure(case: Case, lanes: int = 131072, contraction: bool = True) -> Measured:
    """The kernel of a case, the fastest of three launches."""
    params, starts = rows_of(case, lanes)
    spec = SweepSpec(
        model=case.model,
        recorder=case.recorder,
        numerics=dataclasses.replace(case.numerics, contraction=contraction).resolve(case.model),
        n_rows=lanes,
        block=lanes,
        lanes=lanes,
        devices=local_devices(1),
        values=lambda first, last: (params, starts),
        engine="kernel",
    )
    began = time.perf_counter()
    on_card = CudaLanes(spec, spec.devices[0])
    opened = np.arange(on_card.size)  # fewer than `lanes` if their numbers take too much memory
    values, initial = ({name: column[opened] for name, column in c.items()} for c in (params, starts))
    on_card.fill(values, initial, opened)
    ready = time.perf_counter() - began
    attempts, rates = int(on_card.run_chunk(0).numbers["attempts"].sum()), []
    for _ in range(3):
        began = time.perf_counter()
        on_card.advance(case.polls)
        on_card.card.wait()
        seconds = time.perf_counter() - began
        now = int(on_card.run_chunk(0).numbers["attempts"].sum())
        rates.append((now - attempts) / seconds)
        attempts = now
    thread = on_card.run.attributes
    return Measured(max(rates), thread.num_regs, thread.local_size_bytes, ready)


def main() -> None:
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.card_alone",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--lanes", type=int, default=131072)
    options.add_argument("--no-contraction", action="store_true")
    chosen = options.parse_args()
    jax.config.update("jax_enable_x64", True)
    print(f"{'':24} {'attempts/s':>12} {'registers':>10} {'bytes in memory':>16} {'ready in, s':>12}")
    for case in CASES:
        result = measure(case, chosen.lanes, not chosen.no_contraction)
        numbers = f"{result.rate:12.3g} {result.registers:10} {result.spilled:16} {result.ready:12.1f}"
        print(f"{case.name:24} {numbers}", flush=True)


if __name__ == "__main__":
    main()
