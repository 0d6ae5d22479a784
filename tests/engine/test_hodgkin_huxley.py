"""The cell of Hodgkin and Huxley (1952): its spikes beside SciPy, and its published bifurcations."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import gaitsweep as gs

FINE = {"rtol": 1e-11, "atol": 1e-13}
SPIKE = 50.0  # mV above rest, which only spikes cross


def linoid(x: Any) -> Any:
    """The function x / (exp(x) - 1), whose limit at 0 is 1."""
    small = abs(x) < 1e-6
    nonzero = jnp.where(small, 1.0, x)
    return jnp.where(small, 1.0 - 0.5 * x, nonzero / (jnp.exp(nonzero) - 1.0))


def gate_rates(V: Any) -> dict[str, tuple[Any, Any]]:
    """The rates of opening and closing of each gate (1/ms) at V (mV above rest), at 6.3 degrees."""
    return {
        "m": (linoid((25.0 - V) / 10.0), 4.0 * jnp.exp(-V / 18.0)),
        "h": (0.07 * jnp.exp(-V / 20.0), 1.0 / (jnp.exp((30.0 - V) / 10.0) + 1.0)),
        "n": (0.1 * linoid((10.0 - V) / 10.0), 0.125 * jnp.exp(-V / 80.0)),
    }


class HodgkinHuxley(gs.DeclaredModel):
    """The membrane of the squid's giant axon; times in ms, voltages in mV above rest."""

    I = gs.parameter("uA/cm2", "current into the cell", 10.0)  # noqa: E741
    V = gs.variable("mV", "voltage above rest", 0.0)
    m = gs.variable("1", "activation of sodium", 0.05)
    h = gs.variable("1", "inactivation of sodium", 0.6)
    n = gs.variable("1", "activation of potassium", 0.32)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        sodium = 120.0 * s.m**3 * s.h * (s.V - 115.0)
        potassium = 36.0 * s.n**4 * (s.V + 12.0)
        leak = 0.3 * (s.V - 10.599)
        gates = {
            name: opens * (1.0 - getattr(s, name)) - closes * getattr(s, name)
            for name, (opens, closes) in gate_rates(s.V).items()
        }
        return {"V": p.I - sodium - potassium - leak, **gates}  # capacitance 1 uF/cm2

    @gs.event("spike", section=True)
    def spike(self, p: Any, s: Any) -> Any:
        return s.V - SPIKE

    def period(self, p: Any) -> Any:
        return 15.0


def rates(t: float, y: np.ndarray, current: float = 10.0) -> list[float]:
    """The same equations in NumPy, written again."""
    V, m, h, n = y
    am = 0.1 * (25.0 - V) / np.expm1((25.0 - V) / 10.0)
    an = 0.01 * (10.0 - V) / np.expm1((10.0 - V) / 10.0)
    ah, bh = 0.07 * np.exp(-V / 20.0), 1.0 / (np.exp((30.0 - V) / 10.0) + 1.0)
    bm, bn = 4.0 * np.exp(-V / 18.0), 0.125 * np.exp(-V / 80.0)
    ionic = 120.0 * m**3 * h * (V - 115.0) + 36.0 * n**4 * (V + 12.0) + 0.3 * (V - 10.599)
    return [current - ionic, am - (am + bm) * m, ah - (ah + bh) * h, an - (an + bn) * n]


def scipy_spikes(method: str, until: float) -> np.ndarray:
    """The times (ms) of the spikes from the model's own starts."""

    def spike(t: float, y: np.ndarray) -> float:
        return y[0] - SPIKE

    spike.direction = 1.0  # type: ignore[attr-defined]
    run: dict[str, Any] = {"method": method, "rtol": 1e-11, "atol": 1e-12, "events": spike}
    return solve_ivp(rates, (0.0, until), [0.0, 0.05, 0.6, 0.32], **run).t_events[0]


pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("method", "chosen"), [("rodas5p", "rodas5p"), ("auto", "tsit5"), ("taylor", "taylor")]
)
def test_spikes_come_when_those_of_scipy_come(method: str, chosen: str) -> None:
    """Within 1e-6 ms over 105 ms; `auto` finds no motion that decays 2 000 times a period."""
    run = {"kind": "return_map", "crossings": 8}
    result = gs.sweep(HodgkinHuxley(), run=run, numerics={"method": method, **FINE}, verify=0)
    assert result.manifest["job"]["numerics"]["method"] == chosen
    spikes = result.table["t"].to_numpy()[1:]  # the first record is the start
    reference = scipy_spikes("LSODA", 120.0)[: len(spikes)]
    np.testing.assert_allclose(spikes, reference, atol=1e-6)
    assert spikes[-1] - spikes[-2] == pytest.approx(reference[-1] - reference[-2], abs=1e-7)
    assert spikes[-1] - spikes[-2] == pytest.approx(14.638, abs=1e-3)


def largest_growth(V: float) -> tuple[float, float]:
    """The current at which the cell rests at V, and the largest real part of the eigenvalues there."""
    gates = [float(opens / (opens + closes)) for opens, closes in gate_rates(V).values()]
    rest = np.array([V, *gates])
    current = -rates(0.0, rest, 0.0)[0]
    columns = [np.imag(rates(0.0, rest + 1e-20j * direction, current)) / 1e-20 for direction in np.eye(4)]
    return current, float(np.max(np.linalg.eigvals(np.stack(columns, axis=1)).real))


def test_the_rest_loses_its_stability_where_rinzel_and_miller_found_it() -> None:
    """Hopf points at 9.78 (subcritical) and 154.5 uA/cm2 (1980, Math. Biosci. 49:27), and by eigenvalues."""
    cell = gs.stationary(HodgkinHuxley(), I=5.0)
    rest = cell.fixed_points([3.0, 0.08, 0.45, 0.38])
    branch = cell.continue_(rest, "I", (4.0, 160.0), towards=1)
    hopf = branch[branch["special"] == "hopf"]
    np.testing.assert_allclose(hopf["I"], [9.78, 154.5], atol=0.05)
    brackets = [(5.0, 6.0), (21.0, 23.0)]
    places: list[Any] = [brentq(lambda V: largest_growth(V)[1], *ends, xtol=1e-12) for ends in brackets]
    exact = [largest_growth(V)[0] for V in places]
    np.testing.assert_allclose(hopf["I"], exact, rtol=1e-8)
    assert (np.sign(hopf["coefficient"]) == [1.0, -1.0]).all()


def test_spikes_begin_at_a_fold_of_cycles() -> None:
    """At 6.26 uA/cm2 (Rinzel and Miller 1980); rest and spikes are both stable up to the Hopf point."""
    spikes = gs.return_map(HodgkinHuxley(), I=6.35, numerics={"rtol": 1e-10, "atol": 1e-12})
    branch = spikes.continue_(spikes.fixed_points(spikes.settled(cycles=30)), "I", (6.2, 6.36), towards=-1)
    fold = branch[branch["special"] == "fold"].iloc[0]
    assert fold["I"] == pytest.approx(6.26, abs=0.005)
    assert branch["stable"].iloc[0]
    assert not branch["stable"].iloc[-1]
