"""Random numbers of models: the generator's published vectors, equal on all engines, and their moments."""

from __future__ import annotations

import types
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import gaitsweep as gs
from gaitsweep.dynamics.random_numbers import fraction, philox_words
from gaitsweep.engine.kernel import cuda_lanes
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.examples.rimless_wheel import RimlessWheel
from tests.support.host_card import HostCard, compiler
from tests.support.sweeping import run_rows, same, scalars

# Of the file kat_vectors of Random123, the generator's own library: counter, key, words.
KNOWN = [
    ((0,) * 4, (0,) * 2, (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]
NUMBERS = [0.0, 1.0, -1.0, 2.0**31, 2.0**32 + 5.0, -(2.0**40), 2.0**53 - 1.0, 7.9, np.inf, np.nan]
ALL = [np.ravel(x) for x in np.meshgrid(NUMBERS, NUMBERS, [0.0, -3.0, 2.0**33], indexing="ij")]


@pytest.mark.parametrize(("counter", "key", "words"), KNOWN)
def test_the_words_are_those_published(counter: Any, key: Any, words: Any) -> None:
    given = [[np.uint64(word) for word in part] for part in (counter, key)]
    assert tuple(int(word) for word in philox_words(*given)) == words


@pytest.mark.slow
def test_numbers_are_equal_to_the_bit_in_numpy_xla_and_llvm() -> None:
    """Also of numbers that are no seeds, which count as 0."""
    expected = [fraction(ALL[0], ALL[1], ALL[2], half) for half in (0, 1)]
    by_xla = jax.jit(jax.vmap(gs.uniform))(*ALL)
    by_kernel = over_rows(lambda s, c, t: gs.uniform(s, c, t), all_rows=True)(*ALL)
    by_numpy = over_rows(lambda s, c, t: gs.uniform(s, c, t))(*ALL)
    for numbers in (
        by_xla,
        by_kernel,
        by_numpy,
        [float(gs.uniform(s, c, t)) for s, c, t in zip(*ALL, strict=True)],
    ):
        np.testing.assert_array_equal(numbers, expected[0])
    assert gs.uniform(7.0, 3.0) == gs.uniform(7.9, 3.2) != gs.uniform(8.0, 3.0)
    assert gs.uniform(7.0, 3.0) != gs.uniform(7.0, -3.0) != gs.uniform(7.0, 3.0, 1.0)
    assert expected[0].min() > 0.0
    assert expected[0].max() < 1.0


def test_a_seed_is_shared_by_a_batch_of_counters() -> None:
    """Within a row, one seed is drawn from at several places at once."""
    counters = np.arange(5.0)
    drawn = jax.jit(lambda seed: jax.vmap(lambda counter: gs.uniform(seed, counter))(counters))(3.0)
    np.testing.assert_array_equal(drawn, [gs.uniform(3.0, counter) for counter in counters])


@pytest.mark.slow
def test_numbers_have_no_derivative_and_fit_single_precision() -> None:
    assert jax.jacfwd(lambda x: x * gs.normal(1.0, x))(2.0) == gs.normal(1.0, 2.0)
    single = gs.uniform(jnp.float32(3.0), jnp.arange(1000, dtype=jnp.float32))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, gs.uniform(3.0, np.arange(1000.0)), rtol=1e-7)


@pytest.mark.slow
def test_numbers_are_uniform_normal_and_independent() -> None:
    """100 000 numbers: tests whose p-values were fixed with the generator; 1e-3 would show a broken one."""
    counters = np.arange(100_000.0)
    uniform, normal = np.asarray(gs.uniform(5.0, counters)), np.asarray(gs.normal(5.0, counters))
    assert stats.kstest(uniform, "uniform").pvalue > 1e-3
    assert stats.kstest(normal, "norm").pvalue > 1e-3
    others = [gs.uniform(6.0, counters), gs.uniform(5.0, counters, 1.0), gs.uniform(5.0, counters + 1.0)]
    for other in others:
        assert abs(np.corrcoef(uniform, other)[0, 1]) < 4.0 / np.sqrt(counters.size)


def chain(seed: int, rate: float, roughness: float, most: int) -> list[float]:
    """The rates after the impacts of a rimless wheel, by the Markov chain of its energies."""
    keeps, energy, rates = np.cos(0.8) ** 2, rate**2 / 2.0 + np.cos(0.08 - 0.4), [rate]
    for step in range(1, most + 1):
        if energy < 1.0:
            break
        slope = 0.08 + roughness * float(gs.normal(seed, step))
        rates.append(np.sqrt(2.0 * keeps * (energy - np.cos(slope + 0.4))))
        energy = rates[-1] ** 2 / 2.0 + np.cos(slope - 0.4)
    return rates


ROUGH = {"seed": np.arange(12.0), "roughness": np.full(12, 0.02), "slope": np.full(12, 0.08)}
FINE = Numerics(rtol=1e-11, atol=1e-12)


@pytest.mark.slow
def test_a_wheel_on_rough_ground_follows_its_markov_chain_on_each_engine() -> None:
    """Rates follow from the energies to the tolerance of the integration; both engines fall at one step."""
    recorder, starts = CrossingRecorder(RimlessWheel(), crossings=40), {"rate_0": np.full(12, 0.9)}
    rows = {
        engine: run_rows(RimlessWheel(), recorder, starts, params=ROUGH, numerics=FINE, engine=engine)
        for engine in ("kernel", "xla")
    }
    for outcome in rows.values():
        for row in range(12):
            rates = outcome.samples[outcome.owner == row, 2]
            expected = chain(row, 0.9, 0.02, 40)
            assert len(rates) == len(expected)
            np.testing.assert_allclose(rates, expected, atol=1e-9)
    others = run_rows(
        RimlessWheel(), recorder, starts, params=ROUGH, numerics=FINE, engine="kernel", lanes=3, block=5
    )
    same(rows["kernel"], others)


@pytest.mark.slow
def test_a_wheel_that_starts_after_some_impacts_goes_on_with_the_slopes_after_them() -> None:
    """It began with the slope of foothold 1, and then left out the one of foothold 6."""
    wheel, p = RimlessWheel(), scalars(RimlessWheel(), roughness=0.05, seed=3.0)
    for steps in (0.0, 5.0):
        start = wheel.init(p, {"rate_0": jnp.asarray(0.5), "steps_0": jnp.asarray(steps)})
        assert start.ahead == wheel.ground(p, steps + 1.0)


@pytest.mark.slow
@pytest.mark.skipif(compiler() is None, reason="no C++ compiler")
def test_the_program_for_a_card_draws_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class CudaDevice(HostCard):
        folder = tmp_path

    monkeypatch.setattr(cuda_lanes, "CudaDevice", CudaDevice)
    device = types.SimpleNamespace(platform="gpu")
    monkeypatch.setattr("tests.support.sweeping.devices_on", lambda platform, engine: [device])
    recorder, starts = CrossingRecorder(RimlessWheel(), crossings=40), {"rate_0": np.full(12, 0.9)}
    on_card = partial(
        run_rows, RimlessWheel(), recorder, starts, params=ROUGH, numerics=FINE, engine="kernel"
    )
    outcome = on_card(lanes=5)
    for row in range(12):
        np.testing.assert_allclose(
            outcome.samples[outcome.owner == row, 2], chain(row, 0.9, 0.02, 40), atol=1e-9
        )
    same(outcome, on_card(lanes=3, block=7))
