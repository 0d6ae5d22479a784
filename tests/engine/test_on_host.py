"""Values that a model computes on the host for its rows reach their lanes, for all blocks and devices."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import pytest

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.engine.sweep.engine_choice import EngineError, choose
from tests.support.sweeping import run_rows
from tests.support.toy_jobs import toy
from toy_model import Params, Toy

LAUNCH = np.linspace(0.1, 4.0, 7)
KICK = np.linspace(0.1, 0.9, 7)


class Prepared(Toy):
    """The toy, its kick and its preload worked out on the host as one array."""

    @property
    def host_parameters(self) -> tuple[str, ...]:
        return ("kick", "preload")

    def on_host(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {**values, "both": np.stack([values["kick"], values["preload"]], axis=1)}

    def params(self, values: Mapping[str, jax.Array]) -> Params:
        assert values["both"].shape == (2,)
        kick, preload = values["both"]
        return dataclasses.replace(super().params(values), kick=kick, preload=preload)


@pytest.mark.slow
@pytest.mark.parametrize(("block", "devices"), [(7, 1), (3, 1), (2, 2)])
def test_arrays_of_rows_reach_their_lanes(block: int, devices: int) -> None:
    def found(model: Toy, recorder: type, **how: Any):
        return run_rows(
            model,
            recorder(model, 12),
            {"launch_1": LAUNCH},
            params={"kick": KICK, "preload": 0.5 + 0.1 * LAUNCH},
            numerics=Numerics(dt=1e-2),
            lanes=2,
            engine="xla",
            **how,
        )

    for recorder in (SettleRecorder, CrossingRecorder):
        one, other = found(Toy(), recorder), found(Prepared(), recorder, block=block, devices=devices)
        np.testing.assert_allclose(one.last, other.last, rtol=1e-12)
        np.testing.assert_allclose(one.samples, other.samples, rtol=1e-12)
        for name in one.labels:
            np.testing.assert_allclose(one.labels[name], other.labels[name], rtol=1e-12)


def test_a_model_may_change_its_values_in_place() -> None:
    class Doubled(Prepared):
        def on_host(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
            values["kick"][:] *= 2.0
            values["preload"][0] = 1.0  # the same in all rows of the job
            return super().on_host(values)

    design = dataclasses.replace(toy(vary={"kick": KICK.tolist()}).design, model=Doubled())
    for _ in range(2):
        values = design.model.on_host(design.values(0, KICK.size).parameters)
        np.testing.assert_array_equal(values["both"][:, 0], 2.0 * KICK)
        assert values["both"][:, 1].tolist() == [1.0, *[0.5] * (KICK.size - 1)]


def test_such_a_model_is_left_to_xla() -> None:
    model, device = Prepared(), jax.local_devices()[0]
    engine, reason = choose("auto", device, model, SettleRecorder(model), Numerics().resolve(model), None)
    assert engine == "xla"
    assert reason == "toy computes on the host with kick, preload"
    with pytest.raises(EngineError, match="on the host"):
        choose("kernel", device, model, SettleRecorder(model), Numerics().resolve(model), None)
