"""Rows through the engine without a job or a directory, for tests of the engine."""

from __future__ import annotations

import dataclasses
import functools
import types
from collections.abc import Callable, Mapping
from typing import Any, cast

import jax
import numpy as np

from gaitsweep.contract import Model
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recorder import Recorder
from gaitsweep.engine.sweep.sweep import sweep
from gaitsweep.engine.sweep.sweep_spec import EngineName, SweepSpec
from gaitsweep.expression import evaluate
from gaitsweep.row_outcome import RowOutcome


def complete(model: Model, params: Mapping[str, Any], n: int) -> dict[str, np.ndarray]:
    """All parameters of a model, (n,) each: those given, then the defaults."""
    values: dict[str, Any] = {}
    for quantity in model.parameters:
        given = params.get(quantity.name, quantity.default)
        values[quantity.name] = evaluate(given, values) if isinstance(given, str) else given
    return {name: np.broadcast_to(np.asarray(v, np.float64), (n,)).copy() for name, v in values.items()}


def scalars(model: Model, **params: Any) -> Any:
    """The model's own parameters of one trajectory."""
    values = {k: jax.numpy.asarray(v[0]) for k, v in complete(model, params, 1).items()}
    return _params_of(model)(values)


@functools.cache
def _params_of(model: Model) -> Callable[[Mapping[str, Any]], Any]:
    """`model.params` as one program: operation by operation, each would be compiled by itself."""
    values = {quantity.name: jax.ShapeDtypeStruct((), np.float64) for quantity in model.parameters}
    # XLA's optimizations would take longer than they save
    return jax.jit(model.params).lower(values).compile({"xla_backend_optimization_level": "0"})


def devices_on(platform: str | None, engine: str) -> list[Any]:
    """The devices of a platform; the kernels of a CPU need none of JAX's, which JAX_PLATFORMS may hide."""
    if platform == "cpu" and engine == "kernel":
        return [types.SimpleNamespace(platform="cpu")]
    return jax.local_devices(backend=platform)


@dataclasses.dataclass(frozen=True)
class Drive:
    """The parameters at a time by a function of a test, with one step length for the whole row."""

    params: Callable[[Any, Any], Any]
    times: tuple[float, ...] = ()

    def __call__(self, values: Mapping[str, Any], t: Any, /) -> Any:
        return self.params(values, t)


def run_rows(
    model: Model,
    recorder: Recorder,
    starts: Mapping[str, Any],
    *,
    params: Mapping[str, Any] | None = None,
    numerics: Numerics | None = None,
    lanes: int = 8,
    devices: int = 1,
    block: int | None = None,
    drive: Callable[[Any, Any], Any] | None = None,
    engine: str = "kernel",
    on: str | None = None,
    varied: frozenset[str] = frozenset(),
    quick: bool = False,
) -> RowOutcome:
    """Run one row for each element of the starts; the results of all blocks as one."""
    n = max(np.size(v) for v in starts.values())
    held = complete(model, params or {}, n)
    defaults = {q.name: q.default for q in model.initial_conditions if q.default is not None}
    begin = {
        q.name: np.broadcast_to(np.asarray(starts.get(q.name, defaults.get(q.name)), np.float64), (n,))
        for q in model.initial_conditions
    }
    spec = SweepSpec(
        model=model,
        recorder=recorder,
        numerics=(numerics or Numerics()).resolve(model),
        n_rows=n,
        block=block or n,
        lanes=lanes,
        devices=devices_on(on, engine)[:devices],
        values=lambda a, b: ({k: v[a:b] for k, v in held.items()}, {k: v[a:b] for k, v in begin.items()}),
        drive=None if drive is None else Drive(drive),
        engine=cast(EngineName, engine),
        varied=varied,
        quick=quick,
    )
    blocks: dict[int, RowOutcome] = {}
    sweep(spec, range(-(-n // spec.block)), blocks.__setitem__)
    return RowOutcome.concat([blocks[number] for number in sorted(blocks)])


def same(one: RowOutcome, other: RowOutcome) -> None:
    """Assert that two results of a sweep are equal to the last bit."""
    for field in ("status", "cycles", "attempts", "t_end", "last", "owner", "samples"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field), err_msg=field)
    for kind in ("labels", "sample_labels"):
        for name, values in getattr(one, kind).items():
            np.testing.assert_array_equal(values, getattr(other, kind)[name])
