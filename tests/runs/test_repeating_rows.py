"""Rows that errors of the integration keep from settling, as the self-check of their run finds them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import pytest

import gaitsweep as gs
from gaitsweep import DeclaredModel, event, parameter, variable
from gaitsweep.cli import main
from gaitsweep.runs.sentences import repeating


class Pendulum(DeclaredModel):
    """A pendulum without damping, a variable y beside x**2, and a sign that changes where it turns."""

    rise = parameter("1/s", "rate at which y drifts", 0.0)
    growth = parameter("1/s", "rate at which y leaves x**2", 0.0)
    x = variable("1", "angle", 1.0, scale=1.0)
    v = variable("1/s", "rate", -0.1, scale=1.0)
    y = variable("1", "a variable that begins at x**2", 1.0, scale=1.0)
    sign = variable("1", "sign that changes at each crossing", 1.0, scale=1.0)

    def flow(self, p: Any, s: Any) -> dict[str, jax.Array]:
        y_rate = 2.0 * s.x * s.v + p.rise + p.growth * (s.y - s.x**2)
        return {"x": s.v, "v": -jnp.sin(s.x), "y": y_rate, "sign": 0.0 * s.x}

    @event("turns", section=True, direction="falling", during=lambda s: s.x > 0.0)
    def turns(self, p: Any, s: Any) -> jax.Array:
        return s.v

    @turns.jump
    def change_sign(self, p: Any, s: Any) -> Any:
        return s.replace(sign=-s.sign)

    def period(self, p: Any) -> jax.Array:
        return 6.7 + 0.0 * p.rise


def check_of(model: str, tolerance: float, out: Path, cycles: int = 80, **fields: Any) -> gs.Result:
    """The result of rows that end at their limit of cycles."""
    fields = {"numerics": {"method": "tsit5", "rtol": 1e-8, "atol": 1e-10}, **fields}
    run = {"kind": "settle", "max_cycles": cycles, "tolerance": tolerance, **fields.pop("run", {})}
    job = gs.Job.model_validate({"name": "rows", "model": model, "run": run, **fields})
    result = gs.run(job, out)
    assert set(result.table["status"]) == {"cycle_limit"}
    return result


PENDULUM = "test_repeating_rows:Pendulum"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the self-check
def test_rows_that_repeat_to_within_the_errors_of_the_integration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pendulum repeats; a tolerance far below the drift that tsit5 gives it does not let it settle."""
    vary = {"x_0": [1.0, 1.1]}
    result = check_of(PENDULUM, 1e-11, tmp_path / "out", vary=vary)
    about = result.manifest["self_check"]["repeating"]
    assert (about["rows"], about["of"], about["period"]) == (2, 2, 2)
    assert about["finer_motion"] < 0.1 * about["motion"] < 1e-7  # the tolerances are 130 times finer
    assert about["observable"] != "sign"  # which repeats after two crossings
    assert "sign" not in set(result.table["slowest"])
    main(["info", str(tmp_path / "out")])
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("unsettled"))
    assert "2 of 2 such rows that were rerun repeat within 2 crossings" in line
    assert "a finer numerics.rtol may let them settle" in line


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the self-check
def test_rows_that_do_not_settle_before_their_push(tmp_path: Path) -> None:
    vary, params = {"x_0": [1.0, 1.1]}, {"push_v": 0.1}
    run = {"kind": "perturb", "push": ["v"]}
    result = check_of(PENDULUM, 1e-11, tmp_path, run=run, vary=vary, params=params)
    assert set(result.table["recovery"]) == {"not pushed"}
    about = result.manifest["self_check"]["repeating"]
    assert (about["rows"], about["of"], about["period"]) == (2, 2, 2)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("model", "tolerance", "cycles", "params"),
    [
        (PENDULUM, 1e-11, 80, {"rise": 1e-8}),  # a drift that is no error
        (PENDULUM, 1e-11, 80, {"growth": 0.01}),  # a row that leaves an unstable orbit
        (PENDULUM, 1e-3, 30, {}),  # an orbit that is confirmed after 40 crossings
        ("gaitsweep.examples.lorenz:Lorenz", 1e-6, 80, {}),  # chaos
    ],
    ids=["drift", "leaves", "few cycles", "chaos"],
)
def test_nothing_is_said_of_rows_that_move_for_another_reason(
    model: str, tolerance: float, cycles: int, params: dict[str, float], tmp_path: Path
) -> None:
    result = check_of(model, tolerance, tmp_path, cycles, params=params, vary={"x_0": [1.0]})
    assert result.manifest["slowest"]
    assert result.manifest["self_check"]["repeating"] == {}
    assert repeating(result.manifest) == ""
