"""Properties of each shipped example: the contract, a good job beside it, and equal rows by both engines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import yaml

import gaitsweep as gs
from gaitsweep import models
from gaitsweep.expression import resolve
from gaitsweep.kinds.columns import quantities_of
from gaitsweep.kinds.run_kind import table_columns
from gaitsweep.models.value_faults import faults
from gaitsweep.shipped import EXAMPLES

SWEEPS = Path(__file__).parents[2] / "sweeps"
NAMES = sorted(file.stem for file in EXAMPLES.glob("*.yaml"))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_an_example_keeps_the_contract(name: str) -> None:
    job = gs.load_job(EXAMPLES / f"{name}.yaml")
    assert job.name == name
    assert job.figures
    assert faults(models.find(job.model)) == []


@pytest.mark.slow
def test_every_column_of_a_shipped_job_has_a_meaning() -> None:
    without: dict[str, list[str]] = {}
    seen = set()
    for file in (*EXAMPLES.glob("*.yaml"), *SWEEPS.glob("*.yaml")):
        fields = yaml.safe_load(file.read_text(encoding="utf-8"))
        decides = str([fields.get("config"), fields.get("model"), fields.get("run", {}).get("kind")])
        if {"search", "sensitivity"} & set(fields) or (decides in seen and "fix" not in fields["run"]):
            continue
        seen.add(decides)
        job = gs.load_job(file)
        quantities = quantities_of(job.design.model, job.run.all_columns(job.design.model))
        _, *columns = table_columns(job.design, job.run)
        if lacking := [name for name in columns if not quantities.get(name, {}).get("meaning")]:
            without[file.name] = lacking
    assert without == {}


# XLA compiles four_legs for a minute, and tests/examples/test_four_legs.py compares it with theory;
# XLA compiles the mechanics of walkers for minutes; tests/dynamics/test_body_model.py compares such a body
_BODIES = ("mujoco_hopper", "boom_walker", "biped_walker", "quadruped_walker")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [name for name in NAMES if name not in _BODIES and "_atlas" not in name and "four_legs" not in name],
)
def test_both_engines_end_where_the_other_does(name: str) -> None:
    """Kernels and XLA round differently: after two crossings at tolerances of 1e-11 that is below 1e-8."""
    model = type(gs.load_job(EXAMPLES / f"{name}.yaml").design.model.original)()
    exact = isinstance(model, gs.MapModel)  # a map has no steps
    numerics = {} if exact else {"rtol": 1e-11, "atol": 1e-12}
    run = gs.ReturnMap(crossings=2)
    ends = [
        gs.sweep(model, run=run, numerics=numerics, engine=engine, verify=0).table
        for engine in ("xla", "kernel")
    ]
    for quantity in model.observables:
        one, other = (table[f"{quantity.name}_n"].to_numpy() for table in ends)
        size = max(1.0, float(abs(one).max()))
        assert one == pytest.approx(other, rel=0, abs=1e-8 * size), quantity.name


def _models() -> set[str]:
    """The registered models, and those of the shipped examples."""
    jobs = [yaml.safe_load(file.read_text(encoding="utf-8")) for file in EXAMPLES.glob("*.yaml")]
    return {*models.names(), *(job["model"] for job in jobs)}


@pytest.mark.parametrize("name", sorted(_models()))
def test_the_period_is_a_time_at_both_ends_of_each_range(name: str) -> None:
    """A parameter by which the period divides, or to which it is proportional, has open ends."""
    model = models.find(name, [EXAMPLES])()
    defaults: dict[str, Any] = {quantity.name: quantity.default for quantity in model.parameters}
    for quantity in model.parameters:
        ends = (
            [] if quantity.open_ends else [end for end in (quantity.low, quantity.high) if np.isfinite(end)]
        )
        for end in ends:
            values = resolve({**defaults, quantity.name: end}, {})
            params = model.params({key: jnp.asarray(value, float) for key, value in values.items()})
            period = float(model.period(params))
            assert 0.0 < period < np.inf, (quantity.name, end)
