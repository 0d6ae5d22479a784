"""A short run of a model over the ranges of its parameters and starts, for `gaitsweep check-model`.

It reports outcomes, ends of the ranges at which the flow is stiff, and rates of the model's energies along
the flow. Such a rate is that of the flow at states of a trajectory, not a difference of two states, so it
includes neither events nor integration errors; it is relative to the power that the energy's terms exchange.
"""

from __future__ import annotations

import dataclasses
import functools
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
from gaitsweep.dynamics.declarations import Variable, mode, observable
from gaitsweep.dynamics.declared_model import DeclaredModel
from gaitsweep.dynamics.event_declarations import SingleEvent
from gaitsweep.engine.flow_spectrum import STIFF, fastest_rates
from gaitsweep.engine.stored_traces import shapes_of
from gaitsweep.errors import UserError
from gaitsweep.job import Job
from gaitsweep.kinds import Settle, Trace
from gaitsweep.kinds.columns import UNKNOWN_GAIT
from gaitsweep.models.conformity import remark_on_rates, variables_without_rate
from gaitsweep.models.sampled_points import sampled_points, written
from gaitsweep.models.starts import idle_starts, sets_starts, starts_in_ground
from gaitsweep.models.value_faults import surface_value
from gaitsweep.runs.execute import table_in_memory
from gaitsweep.runs.sentences import MISLABELLED, STARTS_BEYOND, remarks
from gaitsweep.status import Status

# An energy whose rate is below this share of the power that its terms exchange is kept.
KEPT = 1e-9
# Ends of the names of signals: the rate of an energy, and the power that its terms exchange.
_RATE = "_rate_of_change"
_POWER = "_power"


def with_rates(model_class: type[Model]) -> type[Model]:
    """A class whose signals include the rate of each energy, and the power that its terms exchange."""

    def signals(self: HybridModel) -> tuple[Quantity, ...]:
        params, state = shapes_of(self)
        names = jax.eval_shape(self.energies, params, state)
        more = (Quantity(name + end, "1", "rate of an energy") for name in names for end in (_RATE, _POWER))
        base: Any = super(watched, self)
        return (*base.signals, *more)

    def signal(self: HybridModel, params: Params, state: State) -> dict[str, jax.Array]:
        values = model_class.signal(self, params, state)
        rates = self.flow(params, state)
        at = {name: getattr(state, name) for name in rates}
        gradients = jax.jacrev(lambda x: self.energies(params, dataclasses.replace(state, **x)))(at)
        for name, gradient in gradients.items():
            terms = jnp.concatenate([jnp.ravel(gradient[key] * rate) for key, rate in rates.items()])
            values |= {name + _RATE: jnp.sum(terms), name + _POWER: jnp.sum(jnp.abs(terms))}
        return values

    members = {"signals": property(signals), "signal": signal, "name": model_class.name}
    watched: type[Any] = type(model_class.__name__, (model_class,), members)
    return watched


def _change_of_energy(table: pd.DataFrame, name: str) -> str:
    """A sentence about the rate of an energy, from traces of a class `with_rates`."""
    rates = table[name + _RATE].to_numpy(float)
    # a rate is finite only where the power is
    powers = table[name + _POWER].where(np.isfinite(rates))
    most = powers.groupby(table["row"]).transform("max").to_numpy(float)
    shares = np.divide(rates, most, out=np.zeros_like(rates), where=most > 0.0)[np.isfinite(rates)]
    if not shares.size:
        return f"The energy {name} has an infinite or NaN rate of change in all {len(table)} states."
    change = _direction_of_change(float(shares.min(initial=0.0)), float(shares.max(initial=0.0)))
    return f"The energy {name} {change} the power that its terms exchange ({shares.size} states)."


def _direction_of_change(low: float, high: float) -> str:
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


# A flow is stiff if its fastest rate times the nominal period is above `STIFF`; an end of a range is reported
# if that is also above `STIFFER` times its value at the defaults.
STIFFER = 10.0


def _stiff_ranges(model: HybridModel, values: Mapping[str, Float[np.ndarray, " rows"]]) -> list[str]:
    """Return sentences about defaults, and ends of a parameter's range, with which the flow is stiff.

    There are sentences, too, about those with which its fastest rate is unknown.

    The range is that of the bounds, or of the values tried. Modes that are no flags have their values at the
    start.
    """
    defaults = {name: float(column[0]) for name, column in values.items()}
    ends: list[tuple[str, float]] = []
    for quantity in model.parameters:
        tried = values[quantity.name]
        for bound, end_of_tried in ((quantity.low, np.min(tried)), (quantity.high, np.max(tried))):
            is_bounded = math.isfinite(bound) and not quantity.open_ends
            ends.append((quantity.name, bound if is_bounded else float(end_of_tried)))
    rows = [defaults, *({**defaults, name: end} for name, end in ends)]
    of_rows = {name: np.array([row[name] for row in rows]) for name in defaults}
    rates, periods = fastest_rates(
        model,
        {q.name: of_rows[q.name] for q in model.parameters},
        {q.name: of_rows[q.name] for q in model.initial_conditions},
    )
    if np.isnan(rates[0]):
        return ["At the defaults a derivative of the flow is infinite or NaN, so its stiffness is unknown."]
    steps = rates * periods
    words = [
        f"its fastest rate is {rate:.2g} 1/s, and a cycle takes about {count:.2g} steps"
        for rate, count in zip(rates, steps, strict=True)
    ]
    sentences = [f"At the defaults the flow is stiff: {words[0]}."] if steps[0] > STIFF else []
    sentences += [
        f"{name} = {end:.4g}, far from its default {defaults[name]:.4g}, makes the flow stiff: {words[k]}. "
        "Bounds (low=, high=) keep rows from there."
        for k, (name, end) in enumerate(ends, start=1)
        if steps[k] > max(STIFF, STIFFER * steps[0])
    ]
    sentences += [
        f"{name} = {end:.4g} makes a derivative of the flow infinite or NaN, so its stiffness there is "
        "unknown. Bounds (low=, high=) keep rows from there."
        for (name, end), rate in zip(ends, rates[1:], strict=True)
        if np.isnan(rate)
    ]
    return sentences


ROWS = 32
CYCLES = 12
SAMPLES = 40  # of the rate of an energy in a cycle
# Ends of rows are the same within this share of the observable's size, which is at least `_LEAST_SIZE`.
_SAME = 1e-9
_LEAST_SIZE = 1e-3
Values = Mapping[str, Float[np.ndarray, " rows"]]
# The mode that counts the events of each kind, and the observables that show it.
_TIMES = "times_of_events"
_COUNT = "count_of_event"


@dataclasses.dataclass(frozen=True)
class Trial:
    """Result of a trial: `faults` continue a sentence after the model's name, `remarks` are sentences."""

    faults: list[str]
    remarks: list[str]


def trial(model_class: type[Model], on_message: Callable[[str], None] = lambda _: None) -> Trial:
    """Run some rows of a model for a few cycles, with starts and parameters over their ranges.

    Args:
        model_class: the class, in which `value_faults.faults` finds none; its structure takes its defaults.
        on_message: called with a sentence before each step that takes long.
    """
    model = model_class()
    costly = model.host_parameters or not isinstance(model, HybridModel)
    parameters, starts = sampled_points(model, ROWS // 8 if costly else ROWS)
    values = {**starts, **parameters}  # sentences name the first ones
    rows = np.size(next(iter(values.values()), 0))
    on_message(f"Compiling the model, and running {rows} rows for {CYCLES} cycles.")
    try:
        table = _run(_counting(model), values, Settle(max_cycles=CYCLES))
        on_message("Measuring how fast its energies change and how stiff its flow is.")
        energies = _energies(model, model_class, values) if isinstance(model, HybridModel) else []
    except UserError as error:
        return Trial([f"of which no row can be run: {error}"], [])
    tried = _TriedRows(model, values, table)
    warned = [f"Warning: {text}" for text in tried.warnings()]
    return Trial(tried.faults(), [*tried.outcomes(), *energies, *warned])


@dataclasses.dataclass(frozen=True)
class _TriedRows:
    """Rows of a model that were run, with their parameters and starts (rows,) by name."""

    model: Model
    values: Values
    table: pd.DataFrame

    @property
    def _manifest(self) -> Mapping[str, Any]:
        return self.table.attrs["manifest"]

    @property
    def _crossed_section(self) -> bool:
        """Whether any row crossed the section."""
        return bool(self.table["cycles"].to_numpy(float).any())

    def faults(self) -> list[str]:
        """Ends of sentences about wrong gaits, and about rows that all failed."""
        faults = [
            f"but its function label gives gait {name.removeprefix(UNKNOWN_GAIT).strip(' ()')}"
            f"{written(self.values, about['row'])}, which is not an index of its gaits: "
            f"allowed are 0 to {len(self.model.gaits) - 1}."
            for name, about in self._manifest.get(MISLABELLED, {}).items()
        ]
        if set(self._manifest["counts"]) == {Status.not_a_number.name}:
            rows = self._manifest["rows"]
            faults.append(f"of which all {rows} rows that were tried ended as not_a_number.")
        return faults

    def outcomes(self) -> list[str]:
        """Sentences about the ends of the rows, and about their starts."""
        counts = self._manifest["counts"]
        listed = ", ".join(f"{number} {status}" for status, number in counts.items())
        hint = f" cycle_limit is no failure: {CYCLES} cycles are too few for most models to settle."
        sentences = [
            f"Tried {self._manifest['rows']} rows of {CYCLES} cycles over the ranges of parameters and "
            f"starts: {listed}.{hint if Status.cycle_limit.name in counts else ''}",
            # wrong gaits are faults, and starts beyond a surface have a longer sentence
            *remarks({**self._manifest, MISLABELLED: {}, STARTS_BEYOND: {}}),
        ]
        for name, about in self._manifest.get(STARTS_BEYOND, {}).items():
            sentences.append(self._start_beyond(name, about["rows"], about["row"]))
        if idle := idle_starts(self.model):
            setter = sets_starts(self.model)
            sentences.append(f"These starts have no effect: {', '.join(idle)}; {setter} sets them.")
        return sentences

    def warnings(self) -> list[str]:
        """Sentences about what the author of a model hardly wants."""
        sentences = self._constant_observables() if self._crossed_section else []
        if without_rate := variables_without_rate(self.model):
            sentences.append(f"The function {remark_on_rates(without_rate)}")
        if not self.model.host_parameters:
            defaults = {name: column[:1] for name, column in self.values.items()}
            in_ground = starts_in_ground(self.model, defaults, defaults, lambda _: " at the default start")
            sentences += [f"{text[0].upper()}{text[1:]}" for text in in_ground]
        sentences += self._events_that_never_happened()
        model = self.model
        if isinstance(model, HybridModel) and model.locates_events and not model.host_parameters:
            sentences += _stiff_ranges(model, self.values)
        return sentences

    def _start_beyond(self, event: str, rows: int, first: int) -> str:
        """Return a sentence about starts at which the function of an event is not below zero."""
        value = surface_value(self.model, event, self.values, first)
        is_value = "" if value is None else f" (the function is {value:.3g})"
        return (
            f"At {rows} start{'s' * (rows != 1)} that {'were' if rows != 1 else 'was'} tried, the first one"
            f"{written(self.values, first)}{is_value}, the event {event!r} does not happen: its function is "
            "not below 0, its limit. It happens once the function has been below 0 and rises through it. If "
            "it should happen, keep such starts out by bounds (low=, high=), or begin in another mode "
            f"(during=).{self._angles_beyond_a_turn(first)}"
        )

    def _angles_beyond_a_turn(self, row: int) -> str:
        """Return advice on starts of a row that are angles without bounds and beyond a turn, or ''."""
        names = [
            quantity.name
            for quantity in self.model.initial_conditions
            if quantity.circular
            and not math.isfinite(quantity.high - quantity.low)
            and not 0.0 <= self.values[quantity.name][row] <= 2.0 * math.pi
        ]
        if not names:
            return ""
        return (
            f" Without low= and high= an angle is tried beyond a turn ({', '.join(names)}): declare low=0.0, "
            "high=6.283 if it begins within one."
        )

    def _constant_observables(self) -> list[str]:
        """Return a sentence about the observables that have one value at the end of all rows."""
        constant = []
        for quantity in self.model.observables:
            ends = self.table[f"{quantity.name}_end"].to_numpy(float)
            ends = ends[np.isfinite(ends)]
            if ends.size < 2:
                continue
            differences = ends - ends[0]
            if quantity.circular:
                differences = wrapped_difference(differences)
            size = max(abs(ends[0]), quantity.scale or _LEAST_SIZE)
            if math.isfinite(size) and np.max(np.abs(differences)) <= _SAME * size:
                constant.append(f"{quantity.name} ({ends[0].round(9) + 0.0:.6g})")
        text = f"These observables are the same at the end of all rows tried: {', '.join(constant)}; "
        return [f"{text}observed=False leaves out a variable that the section fixes."] if constant else []

    def _events_that_never_happened(self) -> list[str]:
        """Return a sentence about the events that happened in no row, or about an uncrossed section."""
        model = self.model
        if not self._crossed_section:
            advice = "look at the sign of its function, and at the starts"
            declared = model.declarations.items() if isinstance(model, DeclaredModel) else ()
            rates = jax.eval_shape(model.flow, *shapes_of(model)) if isinstance(model, DeclaredModel) else {}
            variables = [name for name, quantity in declared if isinstance(quantity, Variable)]
            if at_rest := [name for name in variables if name not in rates]:
                advice += f"; flow returns no rate of {', '.join(at_rest)}"
            return [f"No row crossed the section: {advice}."]
        never = []
        for number, event in enumerate(_counted_events(model), 1):
            counts = self.table[f"{_COUNT}_{number}_end"].to_numpy(float)
            if np.nan_to_num(counts).any():
                continue
            # counts are read at crossings, and a fall has none after it
            if not (event.jumps and self._falls_by(event)):
                never.append(repr(event.name))
        text = f"These events happened in no row that was tried: {', '.join(dict.fromkeys(never))}; look at "
        advice = "the signs of their functions, at during= and when=, and at ranges."
        return [f"{text}{advice}"] if never else []

    @functools.cached_property
    def _first_start(self) -> tuple[Params, State]:
        """The parameters and the state at the start of the first row."""
        first_row = {name: jnp.asarray(column[0]) for name, column in self.values.items()}
        params = self.model.params(first_row)
        return params, self.model.init(params, first_row)

    def _falls_by(self, event: SingleEvent) -> bool:
        """Whether the body has fallen after the jump of an event from the first row's start."""
        params, start = self._first_start
        return bool(self.model.failed(params, event.jumped(self.model, params, start)))


def _counted_events(model: Model) -> list[SingleEvent]:
    """The events of a model whose guards are all those of declared events, so that they can be counted."""
    if not isinstance(model, DeclaredModel) or type(model).guards is not DeclaredModel.guards:
        return []
    return model.single_events()


def _counting(model: Model) -> type[Model]:
    """The class of a model with observables that count how often each of its declared events happened."""
    model_class: Any = type(model)
    if not (number := len(_counted_events(model))):
        return model_class

    def jump(self: DeclaredModel, params: Params, state: State, fired: jax.Array) -> State:
        after = model_class.jump(self, params, state, fired)
        happens = jnp.stack(list(self.happening(params, state, fired).values()))
        return after.replace(**{_TIMES: getattr(state, _TIMES) + happens.astype(int)})

    count = observable("1", "times of event", count=number, scale=math.inf)
    members = {
        _TIMES: mode((0,) * number, "times of event", count=number),
        _COUNT: count(lambda self, p, s: getattr(s, _TIMES)),
        "jump": jump,
        "name": model_class.name,
    }
    return type(model_class.__name__, (model_class,), members)


def _run(model_class: type[Model], values: Values, run: Settle | Trace) -> pd.DataFrame:
    """Run rows with these values in memory, without a self-check."""
    varied = {name: column.tolist() for name, column in values.items() if np.ptp(column) > 0.0}
    job = Job(
        name="trial",
        model=models.name_of(model_class),
        vary={"zip": varied} if varied else {},
        run=run,
        verify=0,
        numerics=_numerics(model_class(), values),
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


def _energies(model: HybridModel, model_class: type[Model], values: Values) -> list[str]:
    """Return a sentence for each energy of a model, from traces of the rows tried."""
    watched = with_rates(model_class)
    names = [q.name.removesuffix(_RATE) for q in watched().signals if q.name.endswith(_RATE)]
    if not names:
        return []
    defaults = {q.name: jnp.asarray(float(values[q.name][0])) for q in model.parameters}
    cycle = float(model.period(model.params(defaults)))
    table = _run(watched, values, Trace(duration=3 * cycle, every=cycle / SAMPLES))
    return [_change_of_energy(table, name) for name in names]
