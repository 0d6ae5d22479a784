"""The contract of a model, checked for every registered model and for the tests' own."""

from __future__ import annotations

import dataclasses
import typing as t
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from matplotlib.mathtext import MathTextParser

from double_well import DoubleWell
from firing_neuron import Neuron
from gaitsweep import models
from gaitsweep.contract import (
    FixedStepDynamics,
    HybridModel,
    Model,
    Params,
    Simultaneous,
    State,
    SteppedModel,
)
from gaitsweep.kinds.columns import STATUSES
from gaitsweep.models.value_faults import _unread_structure, faults
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.papers.ambe2021.multilegged.reduced import MultileggedReduced
from gaitsweep.status import Status
from tests.support.sweeping import scalars
from toy_model import Toy

ALL = [*(models.find(name) for name in models.names()), Toy, Neuron]


@pytest.fixture(params=ALL, ids=lambda kind: kind.name)
def model(request: pytest.FixtureRequest) -> Model:
    return request.param()


def begun(model: Model) -> tuple[Params, State]:
    params = scalars(model)
    random = np.random.default_rng(1)
    start = {}
    for quantity in model.initial_conditions:
        value = quantity.default if quantity.default is not None else random.uniform(0.1, 6.0)
        start[quantity.name] = jnp.asarray(float(value))
    return params, model.init(params, start)


def test_each_status_is_a_number_with_a_sentence() -> None:
    assert [Status(number).name for number in (0, 1, 3, 9)] == ["running", "settled", "fell", "inferred"]
    names = "running settled cycle_limit fell diverged not_a_number event_stall time_limit complete inferred"
    kept = [*names.split(), "step_limit", "no_fixed_point", "at_rest"]
    assert [Status(number).name for number in range(13)] == kept, "tables keep these numbers' names"
    assert [int(status) for status in Status] == list(range(len(Status)))
    assert len({status.sentence for status in Status}) == len(Status)
    assert all(status.sentence.endswith(".") for status in Status)


def test_each_status_has_one_verdict() -> None:
    assert {"fell", "diverged", "not_a_number", "event_stall"} == Status.FAILED
    assert {"settled", "complete", "inferred", "at_rest", "chaotic", "quasi_periodic"} == Status.SOUND
    assert set(STATUSES) | {"running"} == Status.SOUND | Status.UNDECIDED | Status.FAILED
    of_rows = [Status.settled, Status.fell, Status.cycle_limit]
    for kind in (int, float):  # a kernel's numbers are floats
        np.testing.assert_array_equal(Status.FAILED.among(np.array(of_rows, kind)), [False, True, False])
    beyond = np.array([-(2**31), -1, len(Status), 2**31 - 1], np.int32)
    assert not any(names.among(beyond).any() for names in (Status.SOUND, Status.FAILED, Status.UNDECIDED))
    names = pd.Categorical([status.name for status in of_rows])
    np.testing.assert_array_equal(Status.FAILED.among(names), [False, True, False])
    column = pd.Series(pd.Categorical(["fell", None, "settled"]))
    np.testing.assert_array_equal(Status.FAILED.among(column), [True, False, False])
    np.testing.assert_array_equal(Status.FAILED.among(pd.Categorical(of_rows)), [False, True, False])


def test_a_stepped_model_is_its_own_steps() -> None:
    assert FixedStepDynamics.__abstractmethods__ == {"step", "events", "longest_step", "jump", "section"}
    optional = {"recommended", "longest_step"}
    asked = Model.__abstractmethods__ | FixedStepDynamics.__abstractmethods__
    assert SteppedModel.__abstractmethods__ == asked - optional


def test_names_are_distinct_and_described(model: Model) -> None:
    assert isinstance(model, HybridModel) != isinstance(model, SteppedModel)
    settable = [q.name for q in (*model.parameters, *model.initial_conditions)]
    assert len(set(settable)) == len(settable)
    settable_or_read = (*model.parameters, *model.initial_conditions, *model.observables, *model.signals)
    for quantity in (*settable_or_read, *model.label_fields):
        assert quantity.name.isidentifier(), quantity
        assert quantity.unit, quantity
        assert quantity.meaning, quantity
    assert len(set(model.gaits)) == len(model.gaits) > 0
    assert model.source


@pytest.mark.parametrize("name", models.names())
def test_seeds_and_choices_are_whole(name: str) -> None:
    model = models.find(name)()
    for quantity in (*model.parameters, *model.initial_conditions):
        is_choice = {"0:", "1:"} <= set(quantity.meaning.split()) and (quantity.low, quantity.high) == (0, 1)
        if is_choice or quantity.name.endswith("seed"):
            assert quantity.whole, quantity


def test_symbols_can_be_drawn(model: Model) -> None:
    read = MathTextParser("agg")
    quantities = (*model.parameters, *model.initial_conditions, *model.observables, *model.signals)
    for quantity in (*quantities, *model.label_fields):
        if quantity.symbol:
            read.parse(f"${quantity.symbol}$")


def test_models_are_values(model: Model) -> None:
    """Frozen, hashable, and equal where their structure is: compiled programs are kept by model."""
    assert hash(model) == hash(type(model)())
    assert model == type(model)()
    with pytest.raises(dataclasses.FrozenInstanceError):
        model.anything = 1  # type: ignore[attr-defined]


@pytest.mark.slow("multilegged", "multilegged_reduced", "planar_quadruped", "waist_quadruped")
def test_functions_have_the_declared_results(model: Model) -> None:
    params, state = begun(model)
    observed = model.observe(params, state)
    assert set(observed) == {q.name for q in model.observables}
    signals = model.signal(params, state)
    assert set(signals) == {q.name for q in model.signals}
    for value in (*observed.values(), *signals.values(), model.period(params)):
        assert value.shape == ()
        assert value.dtype == jnp.float64
    labels = model.label(params, observed)
    assert set(labels) == {"gait", *(q.name for q in model.label_fields)}
    assert 0 <= int(labels["gait"]) < len(model.gaits)
    assert not bool(model.failed(params, state))
    assert float(model.period(params)) > 0.0


@pytest.mark.slow("multilegged", "multilegged_reduced", "planar_quadruped", "waist_quadruped")
def test_dynamics_keep_shapes_and_modes(model: Model) -> None:
    """`flow` gives rates of the state's fields; `jump` keeps shapes, types and, without events, values."""
    params, state = begun(model)
    if isinstance(model, HybridModel):
        rates = jax.jit(model.flow)(params, state)
        for name, rate in rates.items():
            field = getattr(state, name)
            assert (field.shape, field.dtype) == (rate.shape, rate.dtype), name
        guards = jax.jit(model.guards)(params, state)
        assert bool(jnp.all(jnp.isfinite(guards)))
    else:
        assert isinstance(model, SteppedModel)
        after = model.step(params, state, jnp.asarray(1e-3))
        for old, new in zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True):
            assert (old.shape, old.dtype) == (new.shape, new.dtype)
        guards = model.events(params, state, after)
        assert guards.dtype == bool
    assert guards.ndim == 1
    jump = jax.jit(model.jump)
    still = jump(params, state, jnp.zeros(guards.shape, bool))
    jumped = jump(params, state, jnp.ones(guards.shape, bool))
    for before, after, quiet in zip(*(jax.tree.leaves(each) for each in (state, jumped, still)), strict=True):
        assert (before.shape, before.dtype) == (after.shape, after.dtype)
        np.testing.assert_array_equal(before, quiet)
    assert not bool(model.section(params, state, jnp.zeros(guards.shape, bool)))


@pytest.mark.slow("multilegged", "planar_quadruped", "waist_quadruped")
def test_functions_are_pure_and_batchable(model: Model) -> None:
    """Under jit and vmap they give the same results: no Python branch on a value, no hidden state."""
    params, state = begun(model)

    def moved(params, state):
        if isinstance(model, HybridModel):
            return model.flow(params, state)
        assert isinstance(model, SteppedModel)
        return model.step(params, state, jnp.asarray(1e-3))

    alone = moved(params, state)
    batched = jax.jit(jax.vmap(moved, in_axes=(None, 0)))(
        params, jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), state)
    )
    for one, of_two in zip(jax.tree.leaves(alone), jax.tree.leaves(batched), strict=True):
        np.testing.assert_allclose(of_two[1], one, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_check_model_finds_no_fault(model: Model) -> None:
    assert faults(type(model)) == []


class _NotIndependent(MultileggedReduced):
    """Touchdowns that share a load, so that the order of simultaneous ones decides."""

    simultaneous: ClassVar[Simultaneous] = "independent"


@pytest.mark.slow
def test_only_jumps_that_commute_are_independent() -> None:
    """Those of the chain commute; those of the reduced chain, where neighbours share a load, do not."""
    assert faults(Multilegged) == []
    wrong = faults(_NotIndependent)
    assert wrong
    assert all("in two jumps and in one" in each for each in wrong)


class _Scattered(DoubleWell):
    """Steps with the fourth argument of a model whose steps draw random numbers."""

    stochastic: ClassVar[bool] = True

    def step(self, params, state, dt, factor):  # type: ignore[override]
        return super().step(params, state, dt * factor)


def test_a_stochastic_step_has_the_factor_on_its_length() -> None:
    assert faults(_Scattered) == []


def test_class_variables_are_no_structure() -> None:
    """A class variable under another name of `typing` is not taken for structure that no job can set."""

    class Plain(Multilegged):
        colour: t.ClassVar[str] = "red"

    class Sized(Multilegged):
        legs: t.Final[int] = 3

    assert _unread_structure(Plain) is None
    assert "annotates legs" in (_unread_structure(Sized) or "")
