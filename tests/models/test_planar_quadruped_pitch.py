"""Shares of the pitch's variance once and twice a stride: of signals in closed form, and of a trace's FFT."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

import gaitsweep as gs
from gaitsweep.papers.fukuoka2015.planar_quadruped import cycle

CONFIGS = Path(__file__).parents[2] / "configs"
DT, PERIOD = 1e-3, 0.3173  # s; strides are no whole number of steps


@jax.jit
def shares_of(signal: jax.Array, memory: float = 1e6) -> jax.Array:
    """The shares (2,) of a pitch (n,) rad, sampled at each step, of legs that swing half of each stride."""
    zero = jnp.zeros(())

    def potentials(t: jax.Array) -> jax.Array:
        return jnp.tile(jnp.sin(2.0 * jnp.pi * t / PERIOD), (2, 4))

    def step(read: cycle.Cycle, pitch: jax.Array) -> tuple[cycle.Cycle, None]:
        u, load, work = (potentials(read.clock), potentials(read.clock + DT)), jnp.zeros(4), jnp.zeros(2)
        return cycle.after_step(read, u, load, zero, pitch, work, jnp.asarray(memory), jnp.asarray(DT)), None

    read, _ = jax.lax.scan(step, cycle.initial_cycle(zero, zero), signal)
    return read.average.pitch_shares()


@pytest.mark.parametrize(
    ("parts", "once", "twice"),
    [
        ({1: 1e-3}, 1.0, 0.0),
        ({2: 1e-3}, 0.0, 1.0),
        ({1: 2e-3, 2: 1e-3}, 0.8, 0.2),
        ({1: 1e-3, 3: 2e-3}, 0.2, 0.0),
        ({0.5: 1e-3, 1: 1e-3}, 0.5, 0.0),  # the phase of what goes round in two strides alternates
        ({2 / 3: 3e-3, 1: 1e-3, 2: 1e-3}, 1 / 11, 1 / 11),  # in three
        ({0.5: 1e-3}, 0.0, 0.0),
        ({1.1: 1e-3}, 0.0, 0.0),  # not locked to the strides
        ({}, 0.0, 0.0),
    ],
)
@pytest.mark.parametrize("mean", [0.0, -0.1])
def test_shares_of_known_oscillations(
    parts: dict[float, float], once: float, twice: float, mean: float
) -> None:
    """301 strides, of which the first is left out. A stride ends within a step, 0.3 % of it."""
    t = DT * np.arange(round(301.2 * PERIOD / DT))
    waves = [a * np.cos(2 * np.pi * part * t / PERIOD + part) for part, a in parts.items()]
    result = shares_of(jnp.asarray(mean + sum(waves, np.zeros(t.size))))
    np.testing.assert_allclose(result, [once, twice], atol=0.005)


def test_the_average_forgets() -> None:
    """After ten times the memory the signal of before counts e^-10."""
    t = DT * np.arange(round(200 * PERIOD / DT))
    part = np.where(t < 100 * PERIOD, 1, 2)
    result = shares_of(jnp.asarray(0.01 * np.cos(2 * np.pi * part * t / PERIOD)), 10.0)
    np.testing.assert_allclose(result, [0.0, 1.0], atol=0.005)


@pytest.mark.slow
def test_shares_are_those_of_a_traces_fft() -> None:
    """Of the trot that goes twice a stride when slow and once when fast, without load feedback.

    After 60 s it has settled but for a coefficient of variation of 0.5 % in the slow one's period, by which
    the phase in a stride is not known.
    """
    params = yaml.safe_load((CONFIGS / "fukuoka2015_body_oscillation.yaml").read_text())["params"]
    values = {"sigma": [0.0, 0.5, 0.7], "seed": 100, "pair": 0, "params": {**params, "k2": 0.0}}
    ends = gs.sweep(gs.models.PlanarQuadruped(), **values, run=gs.FixedTime(duration=60), verify=0).table
    trace = gs.sweep(gs.models.PlanarQuadruped(), **values, run=gs.Trace(duration=60, every=DT), verify=0)
    seen, strides = [], 20
    for _, row in trace.table.groupby("row"):
        flexor, pitch = row["u_f_LF"].to_numpy(), row["pitch"].to_numpy()
        onsets = 1 + np.flatnonzero((flexor[:-1] <= 0.0) & (flexor[1:] > 0.0))
        power = np.abs(np.fft.rfft(pitch[onsets[-1 - strides] : onsets[-1]])) ** 2
        seen.append(power[[strides, 2 * strides]] / power[1:].sum())
    result = ends[["pitch_once_end", "pitch_twice_end"]].to_numpy()
    np.testing.assert_allclose(result, seen, atol=0.01)
    np.testing.assert_allclose(result[1:], seen[1:], atol=0.002)
    assert result[0, 1] > 0.9
    assert result[2, 0] > 0.9
