"""Matsuoka's half-centres: SciPy's solutions, when two of them oscillate, scalings, the quadruped's trot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gaitsweep as gs
from gaitsweep.dynamics.matsuoka import FLEXOR, Coupling, leg_feedback, links, rates
from gaitsweep.runs import unstable_rests
from tests.support.scalar_programs import outputs_of, source_of, traced_with

# Fukuoka et al. 2015, as completed from a citation of their supplement; legs LF, LH, RF, RH.
PAGE = {"s": 1.71, "Tr": 0.0473, "Ta": 0.6, "b": 3.0, "gamma": -2.0}
CONTRALATERAL, IPSILATERAL = links(4, [(0, 2), (1, 3)]), links(4, [(0, 1), (2, 3)])
TROT = (Coupling(-0.3, CONTRALATERAL), Coupling(-0.8, IPSILATERAL))


def _along(starts: np.ndarray, duration: float, dt: float, **network: Any) -> np.ndarray:
    """Potentials and fatigue (rows, steps, 2, 2, n) of RK4 from starts (rows, 2, 2, n)."""

    def rhs(x: jax.Array) -> jax.Array:
        return jnp.stack(rates(x[0], x[1], **network))

    def step(x: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        a = rhs(x)
        b = rhs(x + 0.5 * dt * a)
        c = rhs(x + 0.5 * dt * b)
        x = x + dt / 6.0 * (a + 2.0 * b + 2.0 * c + rhs(x + dt * c))
        return x, x

    count = round(duration / dt)
    return np.asarray(jax.jit(jax.vmap(lambda x: jax.lax.scan(step, x, None, length=count)[1]))(starts))


def _starts(random: np.random.Generator, rows: int, n: int) -> np.ndarray:
    return np.stack([random.uniform(-1, 1, (rows, 2, n)), random.uniform(0, 0.5, (rows, 2, n))], axis=1)


def _onsets(u: np.ndarray, dt: float) -> np.ndarray:
    at = np.flatnonzero((u[:-1] <= 0.0) & (u[1:] > 0.0))
    return dt * (at + 1.0 - u[at] / (u[at + 1] - u[at]))


@pytest.mark.slow("6")
@pytest.mark.parametrize("n", [1, 2, 4, 6])
def test_random_networks_agree_with_scipy(n: int) -> None:
    random = np.random.default_rng(n)
    Tr, Ta, b, gamma = random.uniform([0.03, 0.3, 1.0, -3.0], [0.1, 1.0, 4.0, -1.0])
    s, feedback = random.uniform(0.5, 2.0, (2, n)), random.normal(0.0, 0.2, (2, n))
    alike = random.normal(0.0, 0.3, (n, n)) * (random.random((n, n)) < 0.5)

    def rhs(t: float, x: np.ndarray) -> np.ndarray:
        u, f = x.reshape(2, 2, n)
        y = np.maximum(u, 0.0)
        received = gamma * y[::-1] + 0.7 * y @ alike.T
        return np.stack([(-u + received - b * f + s + feedback) / Tr, (y - f) / Ta]).ravel()

    start = _starts(random, 1, n)
    network = {"s": s, "Tr": Tr, "Ta": Ta, "b": b, "gamma": gamma, "feedback": feedback}
    mine = _along(start, 3.0, 2e-4, **network, couplings=(Coupling(0.7, alike),))[0, -1]
    theirs = solve_ivp(rhs, (0.0, 3.0), start.ravel(), method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    # RK4's steps over the kinks of max(0, u) leave some 1e-7
    np.testing.assert_allclose(mine.ravel(), theirs, atol=2e-6)


def _ends_still(a: float, b: float, ratio: float, starts: np.ndarray) -> np.ndarray:
    """For each start whether a pair of neurons with Tr = 0.25 s, Ta = 0.5 s comes to rest within 600 s.

    Args:
        a: geometric mean of the weights with which they inhibit each other, 1.3 a and a / 1.3.
        b: inhibition by fatigue.
        ratio: drive of the one over that of the other.
    """
    between, s = np.array([[0.0, 1.3], [1.0 / 1.3, 0.0]]), np.array([[ratio, 1.0], [ratio, 1.0]])
    u = _along(starts, 600.0, 0.02, s=s, Tr=0.25, Ta=0.5, b=b, gamma=0.0, couplings=(Coupling(-a, between),))
    still = np.ptp(u[:, -1500:, 0], axis=1).max(axis=2)  # of the extensors and of the flexors
    assert ((still < 1e-4) | (still > 0.01)).all()
    return still < 1e-4


# Two neurons have no stationary state that is stable, and so oscillate from almost any start, where
#   sqrt(a_12 a_21) > 1 + Tr/Ta    and    a_12/(1 + b) < s_1/s_2 < (1 + b)/a_21
# (Matsuoka 1985). The first: with both active the linear flow has, for one combination of the two, the trace
# (sqrt(a_12 a_21) - 1)/Tr - 1/Ta. Outside the second one neuron silences the other: u_1 = s_1/(1 + b) and
# s_2 - a_21 u_1 <= 0, or the same with 1 and 2 exchanged. Here Tr/Ta = 0.5, a_12 = 1.3 a and a_21 = a/1.3.
@pytest.mark.parametrize(
    ("a", "b", "ratio", "still"),
    [
        (1.5 * 0.98, 2.5, 1.0, True),
        (1.5 * 1.02, 2.5, 1.0, False),
        (3.5 / 1.3 * 0.98, 2.5, 1.0, False),
        (3.5 / 1.3 * 1.02, 2.5, 1.0, True),
        (2.0, 2.5, 2.6 / 3.5 * 0.98, True),
        (2.0, 2.5, 2.6 / 3.5 * 1.02, False),
        (2.0, 2.5, 3.5 * 1.3 / 2.0 * 0.98, False),
        (2.0, 2.5, 3.5 * 1.3 / 2.0 * 1.02, True),
        (1.4, 0.45, 1.3, True),  # a > 1 + b leaves no room
    ],
)
def test_a_pair_oscillates_under_matsuokas_conditions(a: float, b: float, ratio: float, still: bool) -> None:
    starts = _starts(np.random.default_rng(0), 4, 2) * 3.0
    assert (_ends_still(a, b, ratio, starts) == still).all()


@pytest.mark.parametrize("a", [0.5, 0.97, 1.03, 2.0, 8.0])
def test_without_adaptation_there_is_no_oscillation(a: float) -> None:
    assert _ends_still(a, 0.0, 1.0, _starts(np.random.default_rng(1), 4, 2)).all()


def test_time_scales_with_the_time_constants_and_size_with_the_drive() -> None:
    start = _starts(np.random.default_rng(2), 1, 4)
    plain = _along(start, 10.0, 2e-3, **PAGE, couplings=TROT)
    slow = PAGE | {"Tr": 3.0 * PAGE["Tr"], "Ta": 3.0 * PAGE["Ta"]}
    # the same steps in other units: rounding alone is left, which the onsets' kinks magnify little
    np.testing.assert_allclose(_along(start, 30.0, 6e-3, **slow, couplings=TROT), plain, atol=1e-10)
    large = _along(2.5 * start, 10.0, 2e-3, **PAGE | {"s": 2.5 * PAGE["s"]}, couplings=TROT)
    np.testing.assert_allclose(large, 2.5 * plain, atol=1e-10)
    # from one start, the period stays and the size of the output follows the drive
    large = _along(start, 60.0, 2e-3, **PAGE | {"s": 2.5 * PAGE["s"]}, couplings=TROT)[
        0, -10000:, 0, FLEXOR, 0
    ]
    plain = _along(start, 60.0, 2e-3, **PAGE, couplings=TROT)[0, -10000:, 0, FLEXOR, 0]
    assert large.max() / plain.max() == pytest.approx(2.5, rel=1e-4)
    periods = [np.diff(_onsets(u, 2e-3)).mean() for u in (large, plain)]
    assert periods[0] == pytest.approx(periods[1], rel=1e-4)


def _shifts(couplings: tuple[Coupling, ...], rows: int) -> np.ndarray:
    """Phases (rows, 4) of the flexors' onsets against that of leg LF, in cycles, after 50 s."""
    u = _along(_starts(np.random.default_rng(5), rows, 4), 60.0, 4e-3, **PAGE, couplings=couplings)
    shifts = []
    for row in u[:, :, 0, FLEXOR]:
        onsets = [t[t > 50.0] for t in (_onsets(row[:, leg], 4e-3) for leg in range(4))]
        period = np.diff(onsets[0]).mean()
        shifts.append([np.angle(np.exp(2j * np.pi * (t - onsets[0][0]) / period).mean()) for t in onsets])
    return np.array(shifts) / (2.0 * np.pi)


def test_the_network_of_the_quadruped_trots_from_any_start() -> None:
    """The hard-wired network by itself produces a trot (Fukuoka et al. 2015): no body, no feedback."""
    shifts = _shifts(TROT, 32)
    np.testing.assert_allclose(np.abs(shifts), np.broadcast_to([0.0, 0.5, 0.5, 0.0], (32, 4)), atol=2e-3)


def test_without_ipsilateral_links_fore_and_hind_legs_are_independent() -> None:
    shifts = _shifts(TROT[:1], 16)
    np.testing.assert_allclose(np.abs(shifts[:, 2]), 0.5, atol=2e-3)
    assert np.ptp(np.mod(shifts[:, 1], 1.0)) > 0.5


def test_feedback_of_hip_and_load() -> None:
    theta, F = jnp.array([0.1, -0.4]), jnp.array([0.0, 20.0])
    message = leg_feedback(theta, F, theta0=-0.262, k1=3.0, k2=0.08)
    np.testing.assert_allclose(message, [[1.086, -0.414], [-1.086, 0.414 - 1.6]], atol=1e-12)
    # a load holds the leg in its stance for longer
    stance = []
    for load in (0.0, 3.0):
        message = leg_feedback(jnp.full(1, -0.262), jnp.full(1, load), theta0=-0.262, k1=3.0, k2=0.08)
        u = _along(_starts(np.random.default_rng(0), 1, 1), 40.0, 2e-3, **PAGE, feedback=message)
        stance.append(np.mean(u[0, -10000:, 0, FLEXOR] <= 0.0))
    assert stance[1] > stance[0] + 0.02


def test_the_scalar_kernel_agrees_and_omits_absent_links() -> None:
    random = np.random.default_rng(3)
    start, told = _starts(random, 1, 4)[0], random.normal(0.0, 0.2, (2, 4))
    weights = {"alpha": -0.3, "beta_w": -0.8}

    def moving(x: jax.Array, p: Mapping[str, Any], told: jax.Array, *more: Coupling) -> Any:
        pairs = Coupling(p["alpha"], CONTRALATERAL), Coupling(p["beta_w"], IPSILATERAL)
        rest = {name: p[name] for name in PAGE}
        return rates(x[0], x[1], **rest, couplings=(*pairs, *more), feedback=told)

    args = start, {name: jnp.asarray(value) for name, value in (PAGE | weights).items()}, told
    expected = jax.tree.leaves(jax.jit(moving)(*args))
    for mine, theirs in zip(outputs_of(moving, *args), expected, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-13, atol=1e-13)
    sources = [
        source_of(traced_with(lambda x, p, told, more=more: moving(x, p, told, *more), *args))
        for more in ((), (Coupling(2.0, np.zeros((4, 4))),))
    ]
    # gamma, alpha, beta_w and b once for each of eight half-centres; links of 1 and 0 multiply nothing
    assert [source.count(" * ") for source in sources] == [32, 32]
    assert sources[0].count(" + ") == sources[1].count(" + ")


@pytest.mark.slow
def test_steps_over_kinks_are_of_second_order() -> None:
    start = _starts(np.random.default_rng(4), 32, 4)
    ends = {
        dt: _along(start, 4.0, dt, **PAGE, couplings=TROT)[:, -1] for dt in (8e-3, 4e-3, 2e-3, 1e-3, 2e-4)
    }
    *steps, finest = ends
    errors = [np.sqrt(np.mean((ends[dt] - ends[finest]) ** 2)) for dt in steps]
    assert abs(np.polyfit(np.log(steps), np.log(errors), 1)[0] - 2.0) < 0.4  # over few steps: it scatters


def test_links_that_are_none() -> None:
    u = jnp.zeros((2, 3))
    with pytest.raises(ValueError, match=r"\(3, 3\), not \(4, 4\)"):
        rates(u, u, **PAGE, couplings=(Coupling(1.0, np.zeros((4, 4))),))
    with pytest.raises(TypeError, match="NumPy"):
        rates(u, u, **PAGE, couplings=(Coupling(1.0, cast(Any, jnp.zeros((3, 3)))),))
    for pair in ((0, 3), (1, 1), (-1, 0)):
        with pytest.raises(ValueError, match=r"not a pair of 3 legs.*0 to 2"):
            links(3, [pair])


class HalfCentres(gs.DeclaredModel):
    """Two half-centres, their section where one takes over from the other, and the pace of the last cycle."""

    Tr = gs.parameter("s", "time constant of the rise", 0.25)
    Ta = gs.parameter("s", "time constant of the adaptation", 0.5)
    b = gs.parameter("1", "gain of the fatigue", 2.5)
    u = gs.variable("1", "potential of half-centre", (0.1, 1.0), count=2, scale=1.0)
    f = gs.variable("1", "fatigue of half-centre", 0.0, count=2, scale=1.0)
    clock = gs.variable("s", "time since the section", observed=False)
    pace = gs.variable("1/s", "cycles per second, of the last cycle", observed=True, scale=1.0, held=True)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        u, f = rates(s.u[:, None], s.f[:, None], s=1.0, Tr=p.Tr, Ta=p.Ta, b=p.b, gamma=-2.0)
        return {"u": u[:, 0], "f": f[:, 0], "clock": 1.0}

    @gs.event("the first takes over", section=True)
    def turn(self, p: Any, s: Any) -> Any:
        return s.u[0] - s.u[1]

    @turn.jump
    def begin(self, p: Any, s: Any) -> Any:
        return s.replace(pace=1.0 / s.clock, clock=0.0)

    def period(self, p: Any) -> Any:
        return 6.0 * p.Ta


@pytest.mark.slow
def test_multipliers_are_those_of_the_monodromy_matrix() -> None:
    """SciPy integrates the variational equations over a period; max(0, u) is continuous, so no jumps occur.

    The section is where two variables are equal: points displaced to its other side return as their
    neighbours do.
    """
    section = gs.return_map(HalfCentres(), numerics={"rtol": 1e-11, "atol": 1e-13})
    near = section.settled({}, cycles=6)
    fixed = section.fixed_points(near)
    assert fixed.converged.all()
    names = section.coordinates
    places = [names.index(name) for name in ("u_1", "u_2", "f_1", "f_2")]
    start = fixed.points.at[0, places]

    def rhs(t: float, x: np.ndarray) -> np.ndarray:
        u, f = x[:2], x[2:4]
        active = np.diag((u > 0.0).astype(float))
        crossed = active[::-1]
        jacobian = np.block(
            [[(-np.eye(2) - 2.0 * crossed) / 0.25, -2.5 * np.eye(2) / 0.25], [active / 0.5, -np.eye(2) / 0.5]]
        )
        y = np.maximum(u, 0.0)
        own = [(-u - 2.0 * y[::-1] - 2.5 * f + 1.0) / 0.25, (y - f) / 0.5]
        return np.concatenate([*own, (jacobian @ x[4:].reshape(4, 4)).ravel()])

    span = (0.0, fixed.images.observed["time"][0])
    begin = np.r_[start, np.eye(4).ravel()]
    end = solve_ivp(rhs, span, begin, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(end[:4], start, atol=1e-8)
    theirs = np.linalg.eigvals(end[4:].reshape(4, 4))
    theirs = np.delete(theirs, np.argmin(np.abs(theirs - 1.0)))
    mine = np.ravel(section.multipliers(fixed))
    np.testing.assert_allclose(np.sort(np.abs(mine))[-3:], np.sort(np.abs(theirs)), atol=1e-6)


@pytest.mark.slow
def test_a_stable_gait_is_not_called_unstable_and_a_push_back_over_the_section_is_small(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The self-check follows displaced states where the two halves are alike, here by the section.

    A push by 1e-4 to either side of the section moves the crossings by as much; the pace of the short cycle
    that a push back over the section would close is 1e4.
    """
    monkeypatch.setattr(unstable_rests._StatesOfRows, "_signs_by_the_section", lambda *_: np.False_)
    run = gs.Settle(max_cycles=60, tolerance=1e-6)
    check = gs.sweep(HalfCentres(), run=run, verify=2, u_1_0=[0.1, 0.2]).manifest["self_check"]
    assert check["verdict"] == "passed"
    pushes = {"push_u_1": [-1e-4, 1e-4], "run": {"tolerance": 1e-6}}
    table = gs.perturb(HalfCentres(), ["u_1"], **pushes, verify=0).table
    assert table["cycles_back"].tolist() == [0.0, 0.0]
    assert table["excursion"].to_numpy(float).max() < 1e-4
    np.testing.assert_allclose(table["phase_shift"][0], -table["phase_shift"][1], rtol=0.05)
