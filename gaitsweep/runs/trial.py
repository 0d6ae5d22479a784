"""A short run of a model over the ranges of its parameters and starts, for `gaitsweep check-model`."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from gaitsweep import models
from gaitsweep.contract import HybridModel, Model, Quantity, State, Status
from gaitsweep.errors import UserError
from gaitsweep.job import Job
from gaitsweep.kinds import FixedTime, ReturnMap, Settle, Trace
from gaitsweep.kinds.columns import UNKNOWN_GAIT
from gaitsweep.models.conformity import sample, written
from gaitsweep.runs.execute import table_in_memory
from gaitsweep.runs.sentences import MISLABELLED, remarks

# Rows and cycles of the trial, and samples a cycle of the rate of an energy.
ROWS, CYCLES, SAMPLES = 32, 12, 40
# An energy whose rate is below this share of the power that its terms exchange is kept.
KEPT = 1e-9
_RATE, _POWER = "_rate_of_change", "_power"


@dataclasses.dataclass(frozen=True)
class Trial:
    """Result of a trial: `faults` continue a sentence after the model's name, `remarks` are sentences."""

    faults: list[str]
    remarks: list[str]


def trial(kind: type[Model]) -> Trial:
    """Run some rows of a model for a few cycles, with starts and parameters over their ranges.

    Args:
        kind: the class, in which `conformity.faults` finds none; its structure takes its defaults.
    """
    model = kind()
    if clashing := _clashing_columns(model):
        return Trial(clashing, [])
    costly = model.host_parameters or not isinstance(model, HybridModel)
    parameters, starts = sample(model, ROWS // 8 if costly else ROWS)
    values = {**parameters, **starts}
    try:
        table = _run(kind, values, Settle(max_cycles=CYCLES))
        energies = _energies(model, kind, values) if isinstance(model, HybridModel) else []
    except UserError as error:
        return Trial([f"of which no row can be run: {error}"], [])
    manifest = table.attrs["manifest"]
    faults = [
        f"but its function label gives gait {name.removeprefix(UNKNOWN_GAIT).strip(' ()')}"
        f"{written(values, about['row'])}, which is not an index of its gaits: "
        f"allowed are 0 to {len(model.gaits) - 1}."
        for name, about in manifest.get(MISLABELLED, {}).items()
    ]
    if set(manifest["counts"]) == {Status.not_a_number.name}:
        faults.append(f"of which all {manifest['rows']} rows that were tried ended as not_a_number.")
    counts = ", ".join(f"{number} {status}" for status, number in manifest["counts"].items())
    rows = manifest["rows"]
    tried = f"Tried {rows} rows of {CYCLES} cycles over the ranges of parameters and starts: {counts}."
    begun = remarks({**manifest, MISLABELLED: {}})
    return Trial(faults, [tried, *begun, *energies])


def _clashing_columns(model: Model) -> list[str]:
    """Return a fault for each quantity whose name is another column in a table of some run kind."""
    runs = (Settle(), FixedTime(duration=1.0), ReturnMap(crossings=1), Trace(duration=1.0, every=1.0))
    settable = [q.name for q in (*model.parameters, *model.initial_conditions)]
    clashes: dict[str, str] = {}
    for run in runs:
        columns = ["row", *settable, *(column.name for column in run.all_columns(model))]
        clashes |= {
            name: run.kind_name for name in columns if columns.count(name) > 1 and name not in clashes
        }
    return [
        f"which has a quantity {name}, but a table of {run} has a column of that name: rename the quantity."
        for name, run in clashes.items()
    ]


def _run(kind: type[Model], values: Mapping[str, np.ndarray], run: Settle | Trace) -> pd.DataFrame:
    """Run rows with these values in memory, without a self-check."""
    varied = {name: column.tolist() for name, column in values.items() if np.ptp(column) > 0.0}
    job = Job(name="trial", model=models.name_of(kind), vary={"zip": varied}, run=run, verify=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the trial reports the remarks of its run itself
        return table_in_memory(job)


def _energies(model: HybridModel, kind: type[Model], values: Mapping[str, np.ndarray]) -> list[str]:
    """Return a sentence for each energy of a model: its rate of change along the flow, between events.

    The rate is that of the flow at states of a trajectory, not a difference of two states, so it includes
    neither events nor integration errors. It is relative to the power that the energy's terms exchange: the
    sum of the magnitudes of their rates, at its largest along the row.
    """
    watched = _with_rates(kind)
    names = [q.name.removesuffix(_RATE) for q in watched().signals if q.name.endswith(_RATE)]
    if not names:
        return []
    known = {q.name: float(values[q.name][0]) for q in model.parameters}
    cycle = float(model.period(model.params({k: jnp.asarray(v) for k, v in known.items()})))
    table = _run(watched, values, Trace(duration=3 * cycle, every=cycle / SAMPLES))
    sentences = []
    for name in names:
        rates = table[name + _RATE].to_numpy(float)
        most = table.groupby("row")[name + _POWER].transform("max").to_numpy(float)
        share = np.where(most > 0.0, rates / np.where(most > 0.0, most, 1.0), 0.0)[np.isfinite(rates)]
        low, high = (float(share.min()), float(share.max())) if share.size else (0.0, 0.0)
        largest = max(-low, high)
        if largest < KEPT:
            how = f"is kept between events: its rate of change is at most {largest:.1e} of"
        else:
            falls = "only falls" if high < KEPT else "only rises" if -low < KEPT else "rises and falls"
            how = f"is not kept between events: it {falls}, by up to {largest:.2g} of"
        sentences.append(f"The energy {name} {how} the power that its terms exchange ({share.size} states).")
    return sentences


def _with_rates(kind: type[Model]) -> type[Model]:
    """A class whose signals include the rate of each energy, and the power that its terms exchange."""

    def signals(self: HybridModel) -> tuple[Quantity, ...]:
        params, state = _shapes(self)
        names = jax.eval_shape(self.energies, params, state)
        more = (Quantity(name + end, "1", "rate of an energy") for name in names for end in (_RATE, _POWER))
        base: Any = super(watched, self)
        return (*base.signals, *more)

    def signal(self: HybridModel, params: Any, state: State) -> dict[str, jax.Array]:
        with_rates = kind.signal(self, params, state)
        rates = self.flow(params, state)
        at = {name: getattr(state, name) for name in rates}
        gradients = jax.jacrev(lambda x: self.energies(params, dataclasses.replace(state, **x)))(at)
        for name, gradient in gradients.items():
            terms = jnp.concatenate([jnp.ravel(gradient[key] * rate) for key, rate in rates.items()])
            with_rates |= {name + _RATE: jnp.sum(terms), name + _POWER: jnp.sum(jnp.abs(terms))}
        return with_rates

    members = {"signals": property(signals), "signal": signal, "name": kind.name}
    watched: type[Any] = type(kind.__name__, (kind,), members)
    return watched


def _shapes(model: Model) -> tuple[Any, Any]:
    """The shapes of a model's parameters and of its state."""
    number = jax.ShapeDtypeStruct((), float)
    params = jax.eval_shape(model.params, {q.name: number for q in model.parameters})
    return params, jax.eval_shape(model.init, params, {q.name: number for q in model.initial_conditions})
