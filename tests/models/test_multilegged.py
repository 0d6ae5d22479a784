"""The multi-legged model against SciPy's event solver, the paper's points, and its symmetry."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from reference import multilegged_scipy
from reference.multilegged_page import Parameters

from gaitsweep.contract import Params, State
from gaitsweep.engine.advance import advance
from gaitsweep.engine.carry import Halt, start
from gaitsweep.engine.numerics import Numerics, step_of
from gaitsweep.engine.poincare.poincare_return import MAX_PERIODS, crossing_of
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.papers.ambe2021.multilegged.model import GAITS, Multilegged
from gaitsweep.papers.ambe2021.multilegged.reduced import MultileggedReduced
from gaitsweep.papers.ambe2021.multilegged.state import leg_lengths
from gaitsweep.status import Status
from tests.support.multilegged_crossings import FILE, reference, simulated, wrapped
from tests.support.sweeping import run_rows, scalars


# The page allows grazing starts to differ: 95 % of the random starts of each set within 1e-6. The starts of
# `wraps` are no random ones, but those whose legs 1 to 3 swing together: 1e-5, and every wrap found.
@pytest.mark.slow("clamp", "legs10", "legs5", "wraps")
@pytest.mark.parametrize("name", ["base", "clamp", "legs5", "legs10", "masses", "beta", "kappa", "wraps"])
def test_crossings_agree_with_solve_ivp(name: str) -> None:
    """Times, psi and landings of the first crossings against DOP853 with terminal events, rtol 1e-11."""
    params, table = reference(name)
    rows, count = len(np.unique(table["start"])), int(np.max(table["crossing"]))
    columns = [c for c in table.columns if c.startswith("psi_") and np.all(table[c].notna())]
    exact = table[columns].to_numpy().reshape(rows, count + 1, -1)
    t, psi, landed = simulated(params, exact[:, 0], count)
    worst = wrapped(psi - exact).max(axis=(1, 2))
    bound = 1e-5 if name == "wraps" else 1e-6
    assert np.mean(worst < bound) >= 0.95, np.sort(worst)[-10:]
    assert np.median(worst) < 0.2 * bound
    close = worst < bound
    times = table["t"].to_numpy().reshape(rows, -1)
    assert np.abs(t - times)[close].max() < 10 * bound  # psi moves by omega times this
    np.testing.assert_array_equal(landed[close], table["landed"].to_numpy().reshape(rows, -1)[close])


# At beta = 0.7 an end leg lifts off at 2e-4 m/s, so slowly that the rounding of its gap is a few events long.
TIED = {
    "lift-offs": (np.pi, [(2.1, 0.9), (2.7, 1.8), (3.3, 0.6)], (-1e-7, 1e-7)),
    # The start is just before leg 1 touches down, so leg 4 has not touched down either: the limit from the
    # side on which it is the later one. Its computed load is 0 in one start, and above 0 in the other.
    "start": (None, [(1.1 * np.pi, 0.3 * np.pi), (0.9 * np.pi, 0.5 * np.pi)], (-1e-7,)),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", TIED)
def test_legs_in_phase_are_the_limit_of_legs_nearly_in_phase(case: str) -> None:
    """Legs 1 and 4 in phase have all events together. SciPy's solver gets them 1e-7 rad apart, one by one.

    The crossings have to agree to a few times these 1e-7 rad. Where rounding has a leg touch again the row
    stalls, and where it decides on a touchdown psi differs by a reset of 0.2 rad.
    """
    phi_1, pairs, offsets = TIED[case]
    psi = np.array([(*pair, -sum(pair) % (2.0 * np.pi)) for pair in pairs])
    starts = {f"psi_{i + 1}": psi[:, i] for i in range(3)}
    if phi_1 is not None:
        starts["phi_1"] = np.full(len(psi), phi_1)
    model = Multilegged()
    result = run_rows(model, CrossingRecorder(model, crossings=3), starts, params={"beta": 0.7})
    assert np.all(result.status == Status.complete)
    samples = result.samples.reshape(len(psi), 4, -1)
    for row, offset in itertools.product(range(len(psi)), offsets):
        apart = psi[row] + np.array([0.0, 0.0, offset])
        exact = multilegged_scipy.run(Parameters(beta=0.7), apart, 3, phi_1=phi_1).crossings
        for got, crossing in zip(samples[row, 1:], exact[1:], strict=True):
            assert wrapped(got[2:5] - crossing.psi).max() < 1e-6, (row, offset)
            assert abs(got[1] - crossing.t) < 1e-6


@pytest.mark.slow("point0-direct-end0")
@pytest.mark.parametrize(
    ("point", "gait", "end"),
    [
        ((1.13, 0.98, 1.50), "direct", (1.1301, 0.9842, 1.4960)),
        ((3.97, 5.29, 5.29), "retrograde", (3.959, 5.300, 5.291)),
        ((1.13, 1.10, 5.28), "source", (1.130, 1.102, 5.282)),
    ],
)
def test_points_of_the_paper(point, gait: str, end) -> None:
    """Points a, b, c of Fig. 4 are fixed to 0.01 rad, where the three gaits are 1 rad apart."""
    model = Multilegged()
    starts = {f"psi_{i + 1}": [value] for i, value in enumerate(point)}
    result = run_rows(model, SettleRecorder(model), starts)
    assert GAITS[result.labels["gait"][0]] == gait
    assert wrapped(result.last[0, :3] - np.array(end)).max() < 0.01
    assert wrapped(result.last[0, :3] - np.array(point)).max() < 0.02
    period = result.t_end[0] / result.cycles[0]
    assert abs(period - 15.3609) < 2e-3


@pytest.mark.slow
def test_settled_states_lie_on_the_analytic_sets() -> None:
    """Random starts settle in the three gaits, within 0.12 rad of (16)-(20), (24), (25) (the paper: 0.11)."""
    model = Multilegged()
    random = np.random.default_rng(11)
    starts = {f"psi_{i}": random.uniform(0, 2 * np.pi, 64) for i in (1, 2, 3)}
    result = run_rows(model, SettleRecorder(model), starts, lanes=32, devices=2)
    assert np.all(result.status == Status.settled)
    assert set(np.unique(result.labels["gait"])) == {0, 1, 2}
    assert result.labels["distance"].max() < 0.12
    assert 40 < np.median(result.cycles) < 60
    assert result.cycles.max() <= 100


@pytest.mark.slow
def test_labels_agree_with_the_exact_propagator() -> None:
    """Gaits of 200 random starts, settled by an independent exact propagator: equal in 97 % or more."""
    table = pd.read_csv(FILE.with_name("multilegged_settled.csv"), comment="#")
    model = Multilegged()
    starts = {f"psi_{i}": table[f"psi_{i}"].to_numpy() for i in (1, 2, 3)}
    result = run_rows(model, SettleRecorder(model), starts, lanes=64, devices=2)
    one = scalars(model)
    ends = jnp.asarray(table[["psi_1_end", "psi_2_end", "psi_3_end"]].to_numpy())
    label = jax.jit(jax.vmap(lambda x: model.label(one, {f"psi_{i + 1}": x[i] for i in range(3)})["gait"]))
    assert np.mean(result.labels["gait"] == np.asarray(label(ends))) >= 0.97
    # where both stop moving they stand at the same place: settled to 1e-3 a cycle leaves some 1e-2
    assert np.quantile(wrapped(result.last[:, :3] - np.asarray(ends)).max(axis=1), 0.95) < 0.03


@pytest.mark.slow
def test_traces_agree_with_solve_ivp() -> None:
    """Heights, phases and contacts at 50 times of three starts; x to 2e-7 m, phi to 1e-7 rad."""
    table = pd.read_csv(FILE.with_name("multilegged_traces.csv"), comment="#")
    model = Multilegged()
    params = scalars(model)
    numerics = Numerics(method="rk4", dt=2e-3)
    attempt = advance(model, numerics.resolve(model))

    @jax.jit
    def until(carry, stop):
        carry = dataclasses.replace(carry, stop=stop, halt=jnp.zeros_like(carry.halt))
        return jax.lax.while_loop(lambda c: c.halt == Halt.GOING, lambda c: attempt(params, c), carry)

    samples = []
    for _, part in table.groupby("start"):
        first = {f"psi_{i}": jnp.asarray(part[f"psi_{i}"].iloc[0]) for i in (1, 2, 3)}
        state = model.init(params, {**first, "phi_1": jnp.asarray(jnp.nan)})
        carry = start(model, params, state, dt=2e-3)
        for t in part["t"]:
            while float(carry.t) < t:  # crossings of the section halt it too
                carry = until(carry, jnp.asarray(t))
            samples.append({k: float(v) for k, v in model.signal(params, carry.state).items()})
    got = pd.DataFrame(samples)
    for i in range(1, 5):
        # the first sample stands in the shock of the start's own touchdown, where RK4 is at its worst
        assert np.abs(got[f"x_{i}"] - table[f"x_{i}"].to_numpy()).max() < 2e-7
        assert wrapped(got[f"phase_{i}"] - table[f"phi_{i}"].to_numpy()).max() < 1e-7
        np.testing.assert_array_equal(got[f"contact_{i}"], table[f"contact_{i}"].to_numpy().astype(float))


# parameters of a chain, and of the same chain with its legs in reversed order
REVERSED = {
    "ends": ({"m_1": 0.82, "m_end": 0.95}, {"m_1": 0.95, "m_end": 0.82}),
    "profile": (
        {"m_2": 1.1, "m_3": 0.95, "kappa_1": 96.0, "kappa_2": 108.0, "a_2": 0.38, "a_3": 0.42},
        {"m_2": 0.95, "m_3": 1.1, "kappa_end": 96.0, "kappa_2": 108.0, "a_2": 0.42, "a_3": 0.38},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", REVERSED)
def test_reversing_the_legs_reverses_the_motion(case: str) -> None:
    """Leg i of one chain does what leg N + 2 - i of the reversed one does: direct is retrograde reversed."""
    model = Multilegged(profile=case == "profile")
    random = np.random.default_rng(2)
    phi = random.uniform(0, 2 * np.pi, (6, 4))

    def times_of_events(phases, params):
        """State after 40 s, from phases that touch nothing by definition: no leg is kicked at the start."""
        ends = []
        for row in phases:
            one = scalars(model, **params)
            psi = {f"psi_{i + 1}": jnp.asarray(row[i + 1] - row[i]) for i in range(3)}
            state = model.init(one, {**psi, "phi_1": jnp.asarray(row[0])})
            for _ in range(6):
                t, state, chain = jump(one, state)
                assert int(chain) > 0
                ends.append([float(t), *np.asarray(state.x), *np.asarray(state.y)])
        return np.array(ends)

    attempt = advance(model, Numerics().resolve(model))

    @jax.jit
    def jump(params: Params, state: State) -> tuple[jax.Array, State, jax.Array]:
        """Up to the first event of any kind, not only at the section."""
        dt, stop = step_of(model, Numerics().resolve(model), params), MAX_PERIODS * model.period(params)
        carry = jax.lax.while_loop(
            lambda carry: (carry.halt == Halt.GOING) & (carry.chain == 0),
            lambda carry: attempt(params, carry),
            start(model, params, state, dt=dt, stop=stop),
        )
        return carry.t, carry.state, carry.chain

    one, other = REVERSED[case]
    forth = times_of_events(phi, one)
    back = times_of_events(phi[:, ::-1], other)
    np.testing.assert_allclose(forth[:, 0], back[:, 0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(forth[:, 1:5], back[:, 4:0:-1], rtol=0, atol=1e-8)
    np.testing.assert_allclose(forth[:, 5:9], back[:, 8:4:-1], rtol=0, atol=1e-7)


@pytest.mark.slow
def test_starts_are_angles() -> None:
    """Whole turns added to the start's relative phases change nothing but rounding."""
    model = Multilegged()
    psi = np.array([[1.3, 2.0, 4.0], [3.3, 5.0, 0.4]])
    one = simulated({}, psi, 2)[1]
    two = simulated({}, psi + 2 * np.pi * np.array([[1, -2, 3], [-1, 0, 2]]), 2)[1]
    assert wrapped(one - two).max() < 1e-8
    assert model.N == 3


def test_the_start_is_the_section() -> None:
    """Leg 1 touches by definition: flag set and kicked, wherever rounding puts it; all loads are borne."""
    model = Multilegged()
    params = scalars(model)
    random = np.random.default_rng(8)
    for psi in random.uniform(0, 2 * np.pi, (20, 3)):
        start = {f"psi_{i + 1}": jnp.asarray(psi[i]) for i in range(3)}
        state = model.init(params, {**start, "phi_1": jnp.asarray(jnp.nan)})
        assert bool(state.contact[0])
        assert bool(state.landed)
        b = 0.2 * 9.8 * np.pi / (100 * 0.4)
        assert abs(float(state.phi[0]) - (2 * np.pi - 0.9 * b)) < 1e-12
        np.testing.assert_allclose(np.asarray(state.y), [0.9 * b / 0.5, 0, 0, 0], atol=1e-12)
        # what the ground bears is the whole weight
        length, _ = leg_lengths(params, state.phi, state.segment)
        load = np.where(state.contact, 1e5 * (length - state.x), 0.0)
        assert abs(load.sum() - (2 * 0.9 + 2 * 1.0) * 9.8) < 1e-3


@pytest.mark.slow
def test_jacobian_of_a_gait_cycle_against_central_differences() -> None:
    """All of the state after one gait cycle, and its duration, over psi, x, v and y: about 33 located events.

    x_1 is left out: on section 1 leg 1 just touches, and the way up is another branch.
    """
    model = Multilegged()
    params = scalars(model)
    run = crossing_of(model, Numerics().resolve(model), "xla")

    def cycle(z: jax.Array) -> jax.Array:
        start = {f"psi_{i + 1}": z[i] for i in range(3)}
        state = model.init(params, {**start, "phi_1": jnp.asarray(jnp.nan)})
        shifted = dataclasses.replace(
            state, x=state.x.at[1:].add(z[3:6]), v=state.v + z[6:10], y=state.y + z[10:14]
        )
        t, after, _ = run(params, shifted)
        return jnp.concatenate([t[None], after.x, after.v, after.phi, after.y])

    z = jnp.concatenate([jnp.array([1.9, 2.7, 4.5]), jnp.zeros(11)])
    value = jax.jit(cycle)
    jacobian = np.asarray(jax.jit(jax.jacfwd(cycle))(z))
    step = 1e-5
    columns = [(value(z.at[i].add(step)) - value(z.at[i].add(-step))) / (2 * step) for i in range(z.size)]
    differences = np.stack([np.asarray(c) for c in columns], axis=1)
    # selects alone would leave errors of the size of the matrix itself
    assert np.abs(jacobian - differences).max() < 1e-6 * np.linalg.norm(jacobian, 2)
    assert abs(jacobian[0, 10] + 1.25) < 1e-6  # y_1 early by tau dy: t moves by -tau/omega dy_1


@pytest.mark.parametrize("model", [Multilegged(N=3), MultileggedReduced(N=3)], ids=lambda model: model.name)
@pytest.mark.parametrize(("m_1", "touches_down"), [(0.5, True), (5.0, False)])
def test_a_chain_whose_first_leg_does_not_touch_down_says_that_it_has_no_start(
    model: Any, m_1: float, touches_down: bool
) -> None:
    params = scalars(model, m_1=m_1)
    begun = {f"psi_{i}": jnp.asarray(1.0) for i in (1, 2, 3)} | {"phi_1": jnp.asarray(jnp.nan)}
    (without,) = model.without_start(params, model.init(params, begun)).values()
    assert bool(without) is not touches_down
