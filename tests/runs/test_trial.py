"""Findings of a short run over the ranges of a model, and remarks of a run about its own rows."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep import models
from gaitsweep.cli import show
from gaitsweep.design.design import Design
from gaitsweep.examples.compass_walker import CompassWalker
from gaitsweep.examples.slip_runner import STANCE, SlipRunner
from gaitsweep.job.row_remarks import _some_rows, remarks_on_rows
from gaitsweep.models.starts import idle_starts
from gaitsweep.models.value_faults import faults
from gaitsweep.runs.model_trial import _change_of_energy, _stiff_ranges, trial, with_rates
from tests.support.sweeping import scalars


class Swings(gs.DeclaredModel):
    """A spring without loss, whose gaits are told by its least position, and one of them off by one."""

    gaits = ("small", "large")
    w = gs.parameter("rad/s", "frequency", 2.0)
    x = gs.variable("m", "position", 1.0, scale=1.0)
    v = gs.variable("m/s", "velocity", 0.0, scale=1.0)

    def flow(self, p, s):
        return {"x": s.v, "v": -(p.w**2) * s.x}

    @gs.event("v rises", section=True)
    def turns(self, p, s):
        return s.v

    @gs.event("wall")
    def wall(self, p, s):
        return s.x - 10.0

    @wall.jump
    def rebound(self, p, s):
        return s.replace(v=-s.v)

    @gs.energy("J", "energy of 1 kg")
    def energy(self, p, s):
        return 0.5 * s.v**2 + 0.5 * p.w**2 * s.x**2

    def period(self, p):
        return 2 * jnp.pi / p.w

    def label(self, p, at):
        return {"gait": jnp.where(at["x"] < -1.5, 2, jnp.where(at["x"] < -0.75, -1, 0))}


@pytest.mark.slow
def test_a_run_reports_wrong_labels_and_starts_beyond_a_surface() -> None:
    with pytest.warns(UserWarning, match="label gave gait 2") as said:
        result = gs.sweep(Swings, x_0=[0.5, 1.0, 2.0, 12.0], run=gs.Settle(max_cycles=20), verify=0)
    assert result.table["gait"].astype(str).tolist()[:3] == ["small", "unknown (-1)", "unknown (2)"]
    assert result.manifest["mislabelled"]["unknown (-1)"] == {"rows": 1, "row": 1}
    assert result.manifest["mislabelled"]["unknown (2)"]["row"] == 2
    assert result.manifest["starts_beyond"] == {"wall": {"rows": 1, "row": 3}}
    message = " ".join(str(each.message) for each in said)
    assert "label gave gait 2" in message
    assert "label gave gait -1 in 1 row (row 1)" in message
    assert "'wall'" in message


class Unlabelled(Swings):
    gaits = ("none",)

    def label(self, p, at):
        return {"gait": jnp.asarray(0)}


@pytest.mark.slow
def test_a_model_without_labels_counts_no_gaits() -> None:
    result = gs.sweep(Unlabelled, x_0=[0.5, 1.0], run=gs.Settle(max_cycles=20), verify=0)
    assert result.manifest["counts"] == {"settled": 2}
    assert "gaits" not in result.manifest
    assert "starts_beyond" not in result.manifest
    assert "none" not in repr(result)


class Inside(Unlabelled):
    """The spring, which cannot begin beyond the wall."""

    def complete(self, p, s):
        return s.replace(v=jnp.where(s.x > 10.0, jnp.nan, s.v))

    def without_start(self, p, s):
        return {"it is outside": jnp.isnan(s.v)}


@pytest.mark.slow
def test_a_row_that_cannot_begin_is_beyond_no_surface() -> None:
    with pytest.warns(UserWarning, match="it is outside"):
        result = gs.sweep(Inside, x_0=[0.5, 12.0], run=gs.Settle(max_cycles=20), verify=0)
    assert result.manifest["without_start"] == {"it is outside": {"rows": 1, "row": 1}}
    assert "starts_beyond" not in result.manifest


class Walled(Unlabelled):
    """Its wall is at 0.8 m, and its start by default at 1 m."""

    @gs.event("wall")
    def wall(self, p, s):
        return s.x - 0.8

    @wall.jump
    def rebound(self, p, s):
        return s.replace(v=-s.v)


class Timed(Unlabelled):
    """Its nominal period is none for some frequencies: NaN, 0, below 0, infinite."""

    def period(self, p):
        return jnp.where(p.w > 4.0, jnp.inf, jnp.where(p.w > 3.0, 3.5 - p.w, 3.0 * jnp.sqrt(p.w - 1.0)))


@pytest.mark.slow
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_run_remarks_rows_without_a_period() -> None:
    """Such rows end at once, also where the first of a job is one; their steps are in no manifest."""
    sizes = [0.5, 0.7, 1.0, 2.0, 3.5, 3.7, 5.0]
    with pytest.warns(UserWarning, match="period gave NaN in 2 rows") as said:
        result = gs.sweep(Timed, w=sizes, run=gs.Settle(max_cycles=20))
    assert result.manifest["without_period"] == {
        "NaN": {"rows": 2, "row": 0},
        "0": {"rows": 2, "row": 2},
        "a number below 0": {"rows": 1, "row": 5},
        "infinity": {"rows": 1, "row": 6},
    }
    ends = result.table["status"].astype(str).tolist()
    assert ends[:4] == ["not_a_number"] * 3 + ["settled"]
    assert ends[6] == "not_a_number"
    message = " ".join(str(each.message) for each in said)
    assert "period gave a number below 0 in 1 row (row 5)" in message
    assert result.manifest["dt"] == [pytest.approx(3.0 / 32), pytest.approx(3.0 / 32)]


class Roots(Unlabelled):
    """Its wall is nowhere from x = 3 on, its flow from x = 5 on; from 4 on it jumps unasked."""

    def flow(self, p, s):
        return {"x": s.v, "v": -(p.w**2) * s.x + 0.0 * jnp.sqrt(5.0 - s.x)}

    @gs.event("wall")
    def wall(self, p, s):
        return jnp.log(3.0 - s.x) - 9.0

    @wall.jump
    def rebound(self, p, s):
        return s.replace(v=-s.v)

    def jump(self, p, s, fired):
        after = super().jump(p, s, fired)
        return after.replace(v=jnp.where(s.x > 4.0, 0.5, after.v))


class Tips(Unlabelled):
    """Its frequency decides whether its starts have fallen, or lie beyond an event that ends nothing."""

    @gs.event("tips", rising=False, during=lambda s: s.v < 9.0)
    def tips(self, p, s):
        return p.w - 5.0

    @tips.jump
    def tipped(self, p, s):
        return s.replace(v=1.1 * s.v)

    def failed(self, p, s):
        return p.w > 7.0


@pytest.mark.parametrize(
    ("kind", "axes", "words"),
    [
        (Swings, {"x_0": [1.0, 2.0, -2.0]}, ["label returns gait 2 at the start of row 2 (x_0 = -2)"]),
        (
            Swings,
            {"x_0": [1.0, 12.0]},
            ["surface of its event 'wall' at the start of row 1 (x_0 = 12), where its function is 2"],
        ),
        (
            Timed,
            {"w": [2.0, 3.7], "x_0": [0.5, 1.0]},
            ["period returns -0.2 at the start of row 2 (w = 3.7,"],
        ),
        (Roots, {"x_0": [1.0, 3.5]}, ["guards returns NaN for 'wall' at the start of row 1"]),
        (
            Roots,
            {"x_0": [1.0, 4.5, 6.0]},
            ["flow returns nan for v at the start of row 2", "jump changes v", "guards"],
        ),
        (Tips, {"w": [2.0, 6.0]}, ["event 'tips' is not ended by its jump", "row 1 (w = 6)"]),
        (Tips, {"w": [8.0, 9.0]}, ["failed returns True", "not ended"]),
        (Swings, {"x_0": [0.5, 0.6], "w": [1.0, 2.0]}, []),
    ],
)
def test_faults_of_a_model_at_the_rows_of_a_job(
    kind: type[gs.HybridModel], axes: dict, words: list[str]
) -> None:
    """`check-model` tries the declared ranges, which a job may leave."""
    message = " ".join(remarks_on_rows(design_of(kind, axes), "mine:Model"))
    assert [word for word in words if word not in message] == []
    assert bool(message) == bool(words)


def design_of(kind: type[gs.HybridModel], axes: dict) -> Design:
    return gs.Job(name="own", model=models.name_of(kind), vary=axes, run=gs.Settle()).design


@pytest.mark.slow
def test_a_run_reports_them_before_the_first_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise InterruptedError

    monkeypatch.setattr("gaitsweep.runs.execute._run_missing", stop)
    with (
        pytest.warns(UserWarning, match="surface of its event 'wall' at the start of row 1") as said,
        pytest.raises(InterruptedError),
    ):
        gs.sweep(Unlabelled, x_0=[1.0, 12.0], run=gs.Settle(max_cycles=20), verify=0)
    assert len(said) == 1


def test_check_model_names_a_guard_that_has_no_value_at_some_start() -> None:
    assert ["guards returns NaN for 'wall' at " in each for each in faults(Narrow)] == [True]


class Narrow(Roots):
    """Its wall is nowhere from x = 3 on."""

    x = gs.variable("m", "position", 1.0, scale=1.0, low=0.0, high=4.0)


def test_the_corners_of_a_large_job_are_examined() -> None:
    lines = {"x_0": {"linspace": [0.5, 1.0, 300]}, "w": {"linspace": [1.0, 3.5, 300]}, "v_0": [0.0, 0.1]}
    design = design_of(Timed, lines)
    rows = _some_rows(design)
    assert rows.min() == 0
    assert rows.max() == design.n_rows - 1
    ends = {(x, w, v) for x in (0.5, 1.0) for w in (1.0, 3.5) for v in (0.0, 0.1)}
    assert ends <= set(zip(*design.at(rows, ["x_0", "w", "v_0"]).values(), strict=True))
    (told,) = remarks_on_rows(design, "swing:Timed")
    assert told.startswith("The model is swing:Timed, but its function period returns")


class Stands(Swings):
    """Three feet, of which `complete` sets the first two."""

    down = gs.mode(0, "foot is down", count=3)

    def complete(self, p, s):
        return s.replace(down=s.down.at[:2].set(jnp.where(s.x > 0.0, 1, 0)))


class HalfWay(Swings):
    """`complete` sets its start, whose default is a formula."""

    x = gs.variable("m", "position", "1/2", scale=1.0)

    def complete(self, p, s):
        return s.replace(x=0.5)


def test_starts_that_complete_overwrites_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert idle_starts(Stands()) == ("down_1_0", "down_2_0")
    assert idle_starts(Swings()) == idle_starts(CompassWalker()) == ()
    (told,) = remarks_on_rows(design_of(Stands, {"down_2_0": [0, 1], "down_3_0": [0, 1]}), "mine:Stands")
    assert told == "down_2_0 has no effect: complete of mine:Stands sets it."
    fixed = gs.Job(name="own", model=models.name_of(Stands), start={"down_1_0": 1}, run=gs.Settle())
    assert ["down_1_0 has" in told for told in remarks_on_rows(fixed.design, "mine:Stands")] == [True]
    # one on which a start with an effect depends has one
    passed = gs.Job(name="own", model=models.name_of(Stands), vary={"down_2_0": [0, 1]},
                    start={"x_0": "1 + down_2_0"}, run=gs.Settle())  # fmt: skip
    assert remarks_on_rows(passed.design, "mine:Stands") == []
    # a default that is a formula of numbers is not set
    assert idle_starts(HalfWay()) == ("x_0",)
    assert remarks_on_rows(design_of(HalfWay, {"v_0": [0.0, 0.1]}), "mine:HalfWay") == []
    show.model("mine:Stands", Stands)
    shown = capsys.readouterr().out
    assert "down_3_0" in shown
    assert "down_2_0" not in shown


@pytest.mark.slow
def test_check_model_tries_the_ranges_and_the_energies() -> None:
    tried = trial(Swings)
    assert [("gives gait 2" in fault or "gives gait -1" in fault) for fault in tried.faults] == [True, True]
    stands = trial(Stands).remarks
    assert "These starts have no effect: down_1_0, down_2_0; complete sets them." in stands
    whole = trial(Unlabelled)
    assert not whole.faults
    assert any("energy is kept between events" in remark for remark in whole.remarks)
    (beyond,) = (remark for remark in trial(Walled).remarks if "does not happen" in remark)
    assert "the first one at the model's defaults (the function is 0.2), the event 'wall'" in beyond


class Careless(gs.DeclaredModel):
    """A phase that turns, beside which a spring of a wide range relaxes; two walls that nothing meets."""

    w = gs.parameter("rad/s", "frequency", 2.0, low=1.0, high=3.0)
    k = gs.parameter("1/s", "rate of relaxation", 2.0, low=0.1, high=1e5)
    phase = gs.variable("rad", "phase", 0.0, circular=True)
    x = gs.variable("1", "distance from rest", 1.0, low=0.5, high=2.0)

    def flow(self, p, s):
        return {"phase": p.w, "x": -p.k * s.x}

    @gs.event("turns", section=True)
    def turns(self, p, s):
        return s.phase - 2.0 * jnp.pi

    @turns.jump
    def turned(self, p, s):
        return s.replace(phase=s.phase - 2.0 * jnp.pi, x=1.0 + s.x)

    @gs.event("wall {} is met", count=2)
    def wall(self, p, s):
        return s.x * jnp.ones(2) - jnp.array([20.0, 30.0])

    @gs.event("x is small", direction="both")
    def small(self, p, s):
        return s.x - 0.4

    @gs.observable("1", "a constant", scale=1.0)
    def ten(self, p, s):
        return 10.0 + 0.0 * s.x

    def period(self, p):
        return 2.0 * jnp.pi / p.w


def test_ends_of_ranges_without_a_finite_derivative_are_named() -> None:
    class Divides(Careless):
        k = gs.parameter("s", "time of relaxation", 0.5, low=0.0, high=1.0)

        def flow(self, p, s):
            return {"phase": p.w, "x": -s.x / p.k}

    values = {"w": 2.0, "k": 0.5, "phase_0": 0.0, "x_0": 1.0}
    (message,) = _stiff_ranges(Divides(), {name: np.array([value]) for name, value in values.items()})
    assert message.startswith("k = 0 makes a derivative of the flow infinite or NaN")


def test_an_energy_without_a_finite_rate_is_not_kept() -> None:
    def said(rates: list[float], powers: list[float]) -> str:
        trace = {"row": [0, 0, 1, 1], "E_rate_of_change": rates, "E_power": powers}
        return _change_of_energy(pd.DataFrame(trace), "E")

    assert (
        said([np.nan] * 4, [np.nan] * 4)
        == "The energy E has an infinite or NaN rate of change in all 4 states."
    )
    # the first state loses all power that is exchanged, whatever the power is where it is infinite
    lost = said([-1.0, np.inf, np.nan, -np.inf], [1.0, np.inf, np.nan, np.inf])
    assert "it only falls, by up to 1 of" in lost
    assert "(1 states)" in lost


@pytest.mark.slow
def test_check_model_warnings() -> None:
    messages = [remark for remark in trial(Careless).remarks if remark.startswith("Warning: ")]
    assert len(messages) == 3
    assert "rows tried: phase (0), ten (10); observed=False" in messages[0]
    assert "no row that was tried: 'wall 1 is met', 'wall 2 is met';" in messages[1]
    assert (
        "k = 1e+05, far from its default 2, makes the flow stiff: its fastest rate is 1e+05 1/s"
        in messages[2]
    )


@pytest.mark.slow
def test_check_model_names_starts_beyond_an_event_with_its_function() -> None:
    class Far(Unlabelled):
        x = gs.variable("m", "position", 1.0, low=0.5, high=20.0, scale=1.0)

    (message,) = (remark for remark in trial(Far).remarks if "the event 'wall' does not happen" in remark)
    values = re.search(r"x_0 = ([\d.]+).*the function is ([\d.]+)\)", message)
    assert values is not None
    assert float(values[2]) == pytest.approx(float(values[1]) - 10.0, abs=0.05), "three digits are written"

    class Turned(Careless):
        """A phase without bounds, which is tried beyond a turn, and ten parameters beside it."""

        phase = gs.variable("rad", "phase", 4.0, circular=True)
        gain = gs.parameter("1", "without effect", 1.0, count=10)

    (message,) = (remark for remark in trial(Turned).remarks if "the event 'turns' does not happen" in remark)
    assert re.search(r"phase_0 = [\d.]+", message), "starts are named before parameters"
    assert "an angle is tried beyond a turn (phase_0): declare low=0.0, high=6.283" in message


@pytest.mark.slow
def test_check_model_does_not_miss_an_event_that_ends_rows() -> None:
    """The runner's mass hits the ground after the last apex, and so after the last crossing."""
    warnings = [remark for remark in trial(SlipRunner).remarks if remark.startswith("Warning: ")]
    assert [remark for remark in warnings if "could not begin: the height takes more" not in remark] == []


@pytest.mark.slow
def test_check_model_warns_of_a_section_that_is_not_crossed_and_of_stiff_defaults() -> None:
    class Stays(Careless):
        k = gs.parameter("1/s", "rate of relaxation", 1e4, low=0.9e4, high=1.1e4)

        @gs.event("turns", section=True)
        def turns(self, p, s):
            return -s.phase - 2.0 * jnp.pi

    message = " ".join(trial(Stays).remarks)
    assert "Warning: No row crossed the section" in message
    assert "Warning: At the defaults the flow is stiff: its fastest rate is 1e+04 1/s" in message
    assert "far from its default" not in message

    class Drains(Stays):
        """A derivative that is infinite at the default start."""

        def flow(self, p, s):
            return super().flow(p, s) | {"phase": jnp.sqrt(jnp.abs(s.phase)) + 1.0}

    assert "a derivative of the flow is infinite or NaN" in " ".join(trial(Drains).remarks)


class Rooted(Unlabelled):
    def flow(self, p, s):
        return {"x": s.v, "v": -1.0 - jnp.sqrt(s.x)}


@pytest.mark.slow
def test_a_model_of_which_no_row_runs_is_not_good(monkeypatch: pytest.MonkeyPatch) -> None:
    (told,) = trial(Rooted).faults
    assert told == "of which all 32 rows that were tried ended as not_a_number."

    def refuse(*_: object) -> None:
        raise gs.UserError("vary is refused.")

    monkeypatch.setattr("gaitsweep.runs.model_trial.table_in_memory", refuse)
    assert trial(Unlabelled).faults == ["of which no row can be run: vary is refused."]


def rate_and_power(
    kind: type[gs.HybridModel], move: Callable[..., Any], **start: float
) -> tuple[float, float]:
    """The rate of a model's energy at a start that is moved, and the power that its terms exchange."""
    model = with_rates(kind)()
    params = scalars(model)
    state = move(model.init(params, {name: jnp.asarray(value) for name, value in start.items()}))
    result = jax.jit(model.signal)(params, state)
    return float(result["energy_rate_of_change"]), float(result["energy_power"])


class WrongSign(CompassWalker):
    """A walker with the centrifugal term of the swing leg reversed."""

    def flow(self, p, s):
        rates = super().flow(p, s)
        return {**rates, "swing_rate": rates["swing_rate"] + 2.0 * s.stance_rate**2}


@pytest.mark.slow("CompassWalker")
@pytest.mark.parametrize("kind", [CompassWalker, WrongSign])
def test_the_energy_of_a_walker_shows_a_wrong_sign(kind: type[gs.HybridModel]) -> None:
    start = {"stance_0": -0.3, "stance_rate_0": 1.1, "swing_rate_0": 0.4}
    rate, power = rate_and_power(kind, lambda state: state, **start)
    if kind is CompassWalker:
        assert abs(rate) < 1e-13 * power
    else:
        assert abs(rate) > 1e-2 * power


@pytest.mark.slow
def test_the_energy_of_the_runner_is_kept_in_stance() -> None:
    def stands(state):
        return state.replace(x=-0.3, z=0.85, v_x=4.0, v_z=-1.0, phase=STANCE)

    rate, power = rate_and_power(SlipRunner, stands, z_0=1.0)
    assert abs(rate) < 1e-13 * power
    assert np.isfinite(power)
    assert power > 1000.0


class Constant(gs.DeclaredModel):
    """An oscillator whose bounds allow one set of parameters and starts."""

    w = gs.parameter("rad/s", "frequency", 1.0, low=1.0, high=1.0)
    x = gs.variable("m", "position", 1.0, low=1.0, high=1.0)
    v = gs.variable("m/s", "velocity", 0.0, low=0.0, high=0.0)

    def flow(self, p, s):
        return {"x": s.v, "v": -(p.w**2) * s.x}

    def period(self, p):
        return 2.0 * jnp.pi / p.w

    @gs.event("v rises", section=True)
    def turns(self, p, s):
        return s.v


def test_a_model_in_which_nothing_varies_is_run() -> None:
    assert trial(Constant).faults == []
