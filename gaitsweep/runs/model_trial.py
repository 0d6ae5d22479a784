"""A short run of a model over the ranges of its parameters and starts, for `gaitsweep check-model`."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep import models
from gaitsweep.angles import wrapped_difference
from gaitsweep.contract import HybridModel, Model, Params, Quantity, State
from gaitsweep.dynamics.declarations import mode, observable
from gaitsweep.dynamics.declared_model import DeclaredModel
from gaitsweep.dynamics.event_declarations import SingleEvent
from gaitsweep.engine.flow_spectrum import STIFF, flow_eigenvalues
from gaitsweep.engine.leaves import shapes_of
from gaitsweep.errors import UserError
from gaitsweep.job import Job
from gaitsweep.kinds import Settle, Trace
from gaitsweep.kinds.columns import UNKNOWN_GAIT
from gaitsweep.models.conformity import idle_starts, sets_starts
from gaitsweep.models.value_faults import sample, surface_value, written
from gaitsweep.runs.execute import table_in_memory
from gaitsweep.runs.sentences import MISLABELLED, STARTS_BEYOND, remarks
from gaitsweep.status import Status

ROWS = 32
CYCLES = 12
SAMPLES = 40  # of the rate of an energy in a cycle
# Ends of rows are the same within this share of the observable's size, which is at least `_LEAST_SIZE`.
_SAME = 1e-9
_LEAST_SIZE = 1e-3
# An energy whose rate is below this share of the power that its terms exchange is kept.
KEPT = 1e-9
# A flow is stiff if its fastest rate times the nominal period is above `STIFF`; an end of a range is reported
# if that is also above `STIFFER` times its value at the defaults.
STIFFER = 10.0
Values = Mapping[str, Float[np.ndarray, " rows"]]
# Ends of the names of signals: the rate of an energy, and the power that its terms exchange.
_RATE = "_rate_of_change"
_POWER = "_power"
# The mode that counts the events of each kind, and the observables that show it.
_TIMES = "times_of_events"
_COUNT = "count_of_event"


@dataclasses.dataclass(frozen=True)
class Trial:
    """Result of a trial: `faults` continue a sentence after the model's name, `remarks` are sentences."""

    faults: list[str]
    remarks: list[str]


def trial(kind: type[Model], on_message: Callable[[str], None] = lambda _: None) -> Trial:
    """Run some rows of a model for a few cycles, with starts and parameters over their ranges.

    Args:
        kind: the class, in which `value_faults.faults` finds none; its structure takes its defaults.
        on_message: called with a sentence before each step that takes long.
    """
    model = kind()
    costly = model.host_parameters or not isinstance(model, HybridModel)
    parameters, starts = sample(model, ROWS // 8 if costly else ROWS)
    values = {**starts, **parameters}  # sentences name the first ones
    rows = np.size(next(iter(values.values()), 0))
    on_message(f"Compiling the model, and running {rows} rows for {CYCLES} cycles.")
    try:
        table = _run(_counting(model), values, Settle(max_cycles=CYCLES))
        on_message("Measuring how fast its energies change and how stiff its flow is.")
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
    tried = f"Tried {manifest['rows']} rows of {CYCLES} cycles over the ranges of parameters and starts:"
    begun = remarks({**manifest, MISLABELLED: {}, STARTS_BEYOND: {}})
    begun += [
        _beyond(model, name, about["rows"], about["row"], values)
        for name, about in manifest.get(STARTS_BEYOND, {}).items()
    ]
    crosses = table["cycles"].to_numpy(float).any()
    warned = [*(_constant(model, table) if crosses else ()), *_unmet(model, table, values)]
    if isinstance(model, HybridModel) and model.locates_events and not model.host_parameters:
        warned += _stiff(model, values)
    if idle := idle_starts(model):
        begun.append(f"These starts have no effect: {', '.join(idle)}; {sets_starts(model)} sets them.")
    sentences = [f"{tried} {counts}.", *begun, *energies]
    return Trial(faults, [*sentences, *(f"Warning: {warning}" for warning in warned)])


def _beyond(model: Model, name: str, rows: int, first: int, values: Values) -> str:
    """Return a sentence about starts at which the function of an event is not below zero."""
    value = surface_value(model, name, values, first)
    is_value = "" if value is None else f" (the function is {value:.3g})"
    beyond_a_turn = [
        quantity.name
        for quantity in model.initial_conditions
        if quantity.circular
        and not math.isfinite(quantity.high - quantity.low)
        and not 0.0 <= values[quantity.name][first] <= 2.0 * math.pi
    ]
    declare = (
        f" Without low= and high= an angle is tried beyond a turn ({', '.join(beyond_a_turn)}): declare "
        "low=0.0, high=6.283 if it begins within one."
        if beyond_a_turn
        else ""
    )
    return (
        f"At {rows} start{'s' * (rows != 1)} that {'were' if rows != 1 else 'was'} tried, the first one"
        f"{written(values, first)}{is_value}, the event {name!r} does not happen: its function is not below "
        "0, its limit. It happens once the function has been below 0 and rises through it. If it should "
        f"happen, keep such starts out by bounds (low=, high=), or begin in another mode (during=).{declare}"
    )


def _constant(model: Model, table: pd.DataFrame) -> list[str]:
    """Return a sentence about the observables that have one value at the end of all rows."""
    constant = []
    for quantity in model.observables:
        ends = table[f"{quantity.name}_end"].to_numpy(float)
        ends = ends[np.isfinite(ends)]
        if ends.size < 2:
            continue
        differences = ends - ends[0]
        if quantity.circular:
            differences = wrapped_difference(differences)
        size = max(abs(ends[0]), quantity.scale or _LEAST_SIZE)
        if math.isfinite(size) and np.max(np.abs(differences)) <= _SAME * size:
            constant.append(f"{quantity.name} ({ends[0].round(9) + 0.0:.6g})")
    if not constant:
        return []
    advice = "observed=False leaves out a variable that the section fixes"
    names = ", ".join(constant)
    return [f"These observables are the same at the end of all rows tried: {names}; {advice}."]


def _counted(model: Model) -> list[SingleEvent]:
    """The events of a model whose guards are all those of declared events, so that they can be counted."""
    if not isinstance(model, DeclaredModel) or type(model).guards is not DeclaredModel.guards:
        return []
    return model.single_events()


def _counting(model: Model) -> type[Model]:
    """The class of a model with observables that count how often each of its declared events happened."""
    kind: Any = type(model)
    if not (number := len(_counted(model))):
        return kind

    def jump(self: DeclaredModel, params: Params, state: State, fired: jax.Array) -> State:
        after = kind.jump(self, params, state, fired)
        happens = jnp.stack(list(self.happening(params, state, fired).values()))
        return after.replace(**{_TIMES: getattr(state, _TIMES) + happens.astype(int)})

    count = observable("1", "times of event", count=number, scale=math.inf)
    members = {
        _TIMES: mode((0,) * number, "times of event", count=number),
        _COUNT: count(lambda self, p, s: getattr(s, _TIMES)),
        "jump": jump,
        "name": kind.name,
    }
    return type(kind.__name__, (kind,), members)


def _unmet(model: Model, table: pd.DataFrame, values: Values) -> list[str]:
    """Return a sentence about the events that happened in no row, or about a section that none crossed."""
    if not table["cycles"].to_numpy(float).any():
        return ["No row crossed the section: look at the sign of its function, and at the starts."]
    known = {name: jnp.asarray(column[0]) for name, column in values.items()}
    params = model.params(known)
    start = model.init(params, known)
    never = [
        repr(event.name)
        for i, event in enumerate(_counted(model), 1)
        if not np.nan_to_num(table[f"{_COUNT}_{i}_end"].to_numpy(float)).any()
        # counts are read at crossings, and a fall has none after it
        and not (event.jumps and model.failed(params, event.jumped(model, params, start)))
    ]
    if not never:
        return []
    advice = "look at the signs of their functions, at during= and when=, and at ranges"
    return [f"These events happened in no row that was tried: {', '.join(dict.fromkeys(never))}; {advice}."]


def _stiff(model: HybridModel, values: Values) -> list[str]:
    """Return sentences about defaults, and ends of a parameter's range, with which the flow is stiff.

    The range is that of the bounds, or of the values tried. Modes that are no flags have their values at the
    start.
    """

    def fastest(changed: Mapping[str, float]) -> tuple[float, str]:
        known = {name: jnp.asarray(changed.get(name, column[0]), float) for name, column in values.items()}
        params = model.params(known)
        rates = np.abs(flow_eigenvalues(model, params, model.init(params, known)))
        rate, cycle = float(rates.max(initial=0.0)), float(model.period(params))
        return (
            rate * cycle,
            f"fastest rate is {rate:.2g} 1/s, and a cycle takes about {rate * cycle:.2g} steps",
        )

    share, words = fastest({})
    warnings_of_rates = [f"At the defaults the flow is stiff: its {words}."] if share > STIFF else []
    for quantity in model.parameters:
        name, column = quantity.name, values[quantity.name]
        for bound, tried in ((quantity.low, np.min(column)), (quantity.high, np.max(column))):
            end = float(tried) if quantity.open_ends or not math.isfinite(bound) else bound
            with contextlib.suppress(np.linalg.LinAlgError):  # rates that are no numbers
                more, words = fastest({name: end})
                if more > max(STIFF, STIFFER * share):
                    far = f"{name} = {end:.4g}, far from its default {column[0]:.4g}, makes the flow stiff"
                    text = f"{far}: its {words}. Bounds (low=, high=) keep rows from there."
                    warnings_of_rates.append(text)
    return warnings_of_rates


def _run(kind: type[Model], values: Values, run: Settle | Trace) -> pd.DataFrame:
    """Run rows with these values in memory, without a self-check."""
    varied = {name: column.tolist() for name, column in values.items() if np.ptp(column) > 0.0}
    job = Job(
        name="trial",
        model=models.name_of(kind),
        vary={"zip": varied},
        run=run,
        verify=0,
        numerics=_numerics(kind(), values),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the trial reports the remarks of its run itself
        return table_in_memory(job)


def _numerics(model: Model, values: Values) -> dict[str, float]:
    """The step of a flow with noise, which only a job gives: a hundredth of the shortest period tried."""
    scheme = model.fixed_step_scheme() if isinstance(model, HybridModel) else None
    if scheme is None or not scheme.stochastic:
        return {}
    names = {quantity.name for quantity in model.parameters}
    periods = jax.vmap(lambda row: jnp.asarray(model.period(model.params(row)), float))(
        {name: jnp.asarray(column) for name, column in values.items() if name in names}
    )
    return {"dt": 0.01 * float(jnp.min(periods))}


def _energies(model: HybridModel, kind: type[Model], values: Values) -> list[str]:
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
        sentences.append(
            f"The energy {name} {_change_of_energy(low, high)} the power that its terms exchange "
            f"({share.size} states)."
        )
    return sentences


def _change_of_energy(low: float, high: float) -> str:
    """Words for the lowest and the highest rate of an energy, shares of the power that its terms exchange."""
    largest = max(-low, high)
    if largest < KEPT:
        return f"is kept between events: its rate of change is at most {largest:.1e} of"
    if high < KEPT:
        direction = "only falls"
    elif -low < KEPT:
        direction = "only rises"
    else:
        direction = "rises and falls"
    return f"is not kept between events: it {direction}, by up to {largest:.2g} of"


def _with_rates(kind: type[Model]) -> type[Model]:
    """A class whose signals include the rate of each energy, and the power that its terms exchange."""

    def signals(self: HybridModel) -> tuple[Quantity, ...]:
        params, state = shapes_of(self)
        names = jax.eval_shape(self.energies, params, state)
        more = (Quantity(name + end, "1", "rate of an energy") for name in names for end in (_RATE, _POWER))
        base: Any = super(watched, self)
        return (*base.signals, *more)

    def signal(self: HybridModel, params: Params, state: State) -> dict[str, jax.Array]:
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
