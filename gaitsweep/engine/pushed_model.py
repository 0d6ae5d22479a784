"""A model with pushes of its variables and a step of a parameter, which a recorder switches on and off.

The amounts are parameters of the model beside its own, so that they vary between rows as any other. What acts
at present is a mode of the state; the recorder that settles a row changes these modes (`pushed`, `released`).
"""

# `_of_model` redefines properties of `Model`:
# pyright: reportIncompatibleMethodOverride=false

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

from gaitsweep.contract import HybridModel, Params, Quantity, Rates, Recommended, State
from gaitsweep.engine.carry import Flag, Number, select
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.leaves import element_names, extended, names_of_numbers, split_like
from gaitsweep.engine.solver.methods import METHODS
from gaitsweep.engine.stored_traces import shapes_of

if TYPE_CHECKING:
    from gaitsweep.skeleton import Skeleton

# The names of the parameters that are added: `push_` and the name of a variable or parameter, and these.
PREFIX = "push_"
PHASE = "push_phase"
DURATION = "push_duration"
CYCLES = "push_cycles"
# The names of the numbers of a state begin with this.
STATE = "state_"
# The modes that are added to a state: a force or step acts now; the next event of the push's kind is awaited;
# that event has come; the section has been crossed since the latest poll of the recorder.
MODES = ("push_acts", "push_awaited", "push_due", "push_crossed")

# A variable of the flow: the field of a state, and the place in its array.
Place = tuple[str, tuple[int, ...]]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PushedParams:
    """The parameters of a model and of the push.

    Attributes:
        plain: the model's own parameters.
        stepped: the same with the step of a parameter; () without one.
        amounts: the changes (n,) of the pushed variables.
        phase: the phase of the push, a share of the gait's period.
        duration: the duration of the push (s).
        cycles: the section crossings until the stepped parameter has its old value again.
    """

    plain: Params
    stepped: Params
    amounts: Float[Array, " pushes"]
    phase: Number
    duration: Number
    cycles: Number


def _of_model(name: str) -> Any:
    """A property that is the class attribute or the method of this name of the model itself."""
    return property(operator.attrgetter(f"model.{name}"))


@final
@dataclasses.dataclass(frozen=True)
class PushedModel(HybridModel):
    """The model of rows that are pushed once.

    Args:
        model: the model itself.
        variables: the variables that are pushed, by their names in `flow_places`.
        forced: whether a push adds to the rates of the variables for some time; else to their values at once.
        stepped: the parameter that has another value for some cycles, or None.
        event: the event after whose jump the push comes; None: at a phase.
        resumes: whether rows start from whole states of the model, modes included, as settled rows ended.
    """

    model: HybridModel
    variables: tuple[str, ...]
    forced: bool = False
    stepped: str | None = None
    event: str | None = None
    resumes: bool = False

    # descriptions of the model are those of the model itself
    name = _of_model("name")
    source = _of_model("source")
    bibtex = _of_model("bibtex")
    gaits = _of_model("gaits")
    linear = _of_model("linear")
    simultaneous = _of_model("simultaneous")
    caveats = _of_model("caveats")
    free_link = _of_model("free_link")
    analytic_distance = _of_model("analytic_distance")
    original = _of_model("original")
    precisions = _of_model("precisions")
    observables = _of_model("observables")
    signals = _of_model("signals")
    label_fields = _of_model("label_fields")
    host_parameters = _of_model("host_parameters")
    locates_events = _of_model("locates_events")
    longest_chain = _of_model("longest_chain")
    guard_names = _of_model("guard_names")
    data_digest = _of_model("data_digest")
    limbs = _of_model("limbs")
    caveats_notice = _of_model("caveats_notice")

    @property
    def added(self) -> tuple[Quantity, ...]:
        """The parameters of the push."""
        known = {q.name: q for q in (*self.model.signals, *self.model.observables)}
        known |= {q.name: q for q in (*self.model.initial_conditions, *self.model.parameters)}
        names = list(self.variables)
        if self.stepped is not None:
            names.append(self.stepped)
        added = []
        for name in names:
            quantity = known.get(name, Quantity(name, "", ""))
            symbol = rf"\Delta {quantity.symbol}" if quantity.symbol else ""
            meaning = f"change of {name} by the push"
            added.append(Quantity(f"{PREFIX}{name}", quantity.unit, meaning, 0.0, symbol=symbol))
        if self.event is None:
            meaning = "phase of the push: share of the gait's period after a section crossing"
            added.append(Quantity(PHASE, "1", meaning, 0.0, low=0.0, high=1.0))
        if self.forced:
            added.append(Quantity(DURATION, "s", "duration of the push", low=0.0, open_ends=True))
        if self.stepped is not None:
            meaning = "section crossings until the parameter has its old value again"
            added.append(Quantity(CYCLES, "1", meaning, 1.0, low=1.0, whole=True))
        return tuple(added)

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return (*self.model.parameters, *self.added)

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return state_quantities(self.model) if self.resumes else self.model.initial_conditions

    @property
    def recommended(self) -> Recommended:
        recommended = self.model.recommended
        if recommended.method in METHODS and METHODS[recommended.method].step is None:
            # phases and phase shifts need located events
            return dataclasses.replace(recommended, method="auto")
        return recommended

    def skeleton(
        self, values: Mapping[str, float], signals: Mapping[str, Float[np.ndarray, " times"]]
    ) -> Skeleton | None:
        return self.model.skeleton(self._own(values), signals)

    def mjcf(self, values: Mapping[str, float]) -> str | None:
        return self.model.mjcf(self._own(values))

    def on_host(
        self, values: Mapping[str, Float[np.ndarray, " rows"]]
    ) -> dict[str, Float[np.ndarray, "rows ..."]]:
        added = {quantity.name: values[quantity.name] for quantity in self.added}
        return {**self.model.on_host(self._own(values)), **added}

    def params(self, values: Mapping[str, Float[Array, " ..."]], /) -> PushedParams:
        own = self._own(values)
        plain = self.model.params(own)
        stepped = ()
        if self.stepped is not None:
            value = own[self.stepped] + values[f"{PREFIX}{self.stepped}"]
            stepped = self.model.params({**own, self.stepped: value})
        zero = jnp.zeros_like(jnp.asarray(self.model.period(plain)))
        amounts = [values[f"{PREFIX}{name}"] + zero for name in self.variables]
        return PushedParams(
            plain=plain,
            stepped=stepped,
            amounts=jnp.stack(amounts) if amounts else jnp.zeros((0,), zero.dtype),
            phase=values.get(PHASE, 0.0) + zero,
            duration=values.get(DURATION, 0.0) + zero,
            cycles=values.get(CYCLES, 1.0) + zero,
        )

    def init(self, params: PushedParams, start: Mapping[str, Float[Array, ""]], /) -> State:
        if self.resumes:
            leaves, structure = jax.tree.flatten(_shapes(self.model)[0])
            numbers = jnp.stack([start[quantity.name] for quantity in self.initial_conditions])
            plain = jax.tree.unflatten(structure, split_like(numbers, leaves))
        else:
            plain = self.model.init(params.plain, start)
        return extended(plain, MODES, [jnp.zeros((), bool)] * len(MODES))

    def observe(self, params: PushedParams, state: State, /) -> dict[str, Real[Array, ""]]:
        return self.model.observe(params.plain, _plain(state))

    def signal(self, params: PushedParams, state: State, /) -> dict[str, Real[Array, ""]]:
        return self.model.signal(params.plain, _plain(state))

    def label(
        self, params: PushedParams, observations: Mapping[str, Real[Array, ""]], /
    ) -> dict[str, Real[Array, ""]]:
        return self.model.label(params.plain, observations)

    def failed(self, params: PushedParams, state: State, /) -> Bool[Array, ""]:
        return self.model.failed(self._acting(params, state), _plain(state))

    def period(self, params: PushedParams, /) -> Float[Array, ""]:
        return self.model.period(params.plain)

    def free_after(self, params: PushedParams, /) -> Float[Array, ""]:
        return self.model.free_after(params.plain)

    def beyond_at_start(self, params: PushedParams, state: State, /) -> dict[str, Bool[Array, ""]]:
        # a state where a row settled is just after a crossing, and its modes say so
        return {} if self.resumes else self.model.beyond_at_start(params.plain, _plain(state))

    def without_start(self, params: PushedParams, state: State, /) -> dict[str, Bool[Array, ""]]:
        return self.model.without_start(params.plain, _plain(state))

    def fast_modes(
        self, params: PushedParams, /
    ) -> tuple[Float[Array, " motions"], Float[Array, " motions"]] | None:
        modes = self.model.fast_modes(params.plain)
        if modes is None or self.stepped is None:
            return modes
        stepped = self.model.fast_modes(params.stepped)
        assert stepped is not None
        return jnp.concatenate([modes[0], stepped[0]]), jnp.concatenate([modes[1], stepped[1]])

    def flow(self, params: PushedParams, state: State, /) -> Rates:
        rates = dict(self.model.flow(self._acting(params, state), _plain(state)))
        if self.forced:
            force = jnp.where(state.push_acts, params.amounts / params.duration, 0.0)
            for name, more in self._along(state, force).items():
                rates[name] = rates[name] + more
        return rates

    def guards(self, params: PushedParams, state: State, /) -> Float[Array, " guards"]:
        return self.model.guards(self._acting(params, state), _plain(state))

    def jump(self, params: PushedParams, state: State, fired: Bool[Array, " events"], /) -> State:
        acting = self._acting(params, state)
        plain = _plain(state)
        after = self.model.jump(acting, plain, fired)
        acts, awaited, due, crossed = (getattr(state, mode) for mode in MODES)
        if self.event is not None:
            crossed = crossed | ((awaited | due) & self.model.section(acting, plain, fired))
            comes = awaited & self._is_event(acting, plain, fired)
            due = due | comes
            awaited = awaited & ~comes
        return extended(after, MODES, (acts, awaited, due, crossed))

    def section(self, params: PushedParams, before: State, fired: Bool[Array, " events"], /) -> Flag:
        acting = self._acting(params, before)
        plain = _plain(before)
        closes = self.model.section(acting, plain, fired)
        if self.event is None:
            return closes
        # the row waits for its recorder, which pushes it
        return closes | (before.push_awaited & self._is_event(acting, plain, fired))

    def occurred(
        self, params: PushedParams, state: State, fired: Bool[Array, " guards"], /
    ) -> Bool[Array, " guards"]:
        return self.model.occurred(self._acting(params, state), _plain(state), fired)

    def displaced(self, params: PushedParams, state: State, /) -> State:
        after = self.model.displaced(self._acting(params, state), _plain(state))
        return extended(after, MODES, [getattr(state, mode) for mode in MODES])

    def energies(self, params: PushedParams, state: State, /) -> dict[str, Float[Array, ""]]:
        return self.model.energies(self._acting(params, state), _plain(state))

    def awaiting(self, state: State, waits: Flag) -> State:
        """The state that awaits the event of the push if `waits`."""
        return dataclasses.replace(state, push_awaited=state.push_awaited | waits)

    def pushed(self, params: PushedParams, state: State, now: Flag) -> State:
        """The state with the impulse, or with the force or step switched on, if `now`.

        Args:
            params: the parameters of the row.
            state: the state.
            now: whether the push comes.
        """
        impulse = {} if self.forced else self._along(state, params.amounts)
        moved = {name: getattr(state, name) + more for name, more in impulse.items()}
        acts = jnp.asarray(self.forced or self.stepped is not None)
        after = dataclasses.replace(state, **moved, push_acts=acts, push_due=jnp.asarray(False))
        return select(now, self.displaced(params, after), state)

    def released(self, params: PushedParams, state: State, now: Flag) -> State:
        """The state without force and step if `now`; the arguments are those of `pushed`."""
        after = dataclasses.replace(state, push_acts=jnp.asarray(False))
        return select(now, self.displaced(params, after), state)

    def _own(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The values of the model's own parameters."""
        names_of_push = {quantity.name for quantity in self.added}
        return {name: value for name, value in values.items() if name not in names_of_push}

    def _acting(self, params: PushedParams, state: State) -> Params:
        """The model's parameters at a state."""
        if self.stepped is None:
            return params.plain
        return select(state.push_acts, params.stepped, params.plain)

    def _along(self, state: State, amounts: Float[Array, " pushes"]) -> dict[str, Float[Array, " ..."]]:
        """Amounts (n,) of the pushed variables as arrays of the fields of a state."""
        places = flow_places(self.model)
        fields: dict[str, Any] = {}
        for variable, amount in zip(self.variables, amounts, strict=True):
            name, place = places[variable]
            mask = np.zeros(np.shape(getattr(state, name)), bool)
            mask[place] = True
            fields[name] = fields.get(name, 0.0) + jnp.where(mask, amount, 0.0)
        return fields

    def _is_event(self, params: Params, before: State, fired: Bool[Array, " events"]) -> Flag:
        """Whether the event of the push is among those that fired."""
        is_of_push = np.array([name == self.event for name in self.model.guard_names])
        return jnp.any(self.model.occurred(params, before, fired) & is_of_push)


@cached_by_content(maxsize=64)
def flow_places(model: HybridModel) -> dict[str, Place]:
    """The variables that the flow of a model moves, by name: `angle`, or `phi_1`, `phi_2` of an array."""
    return places_of(*_shapes(model))


@cached_by_content(maxsize=64)
def state_quantities(model: HybridModel) -> tuple[Quantity, ...]:
    """The numbers of a state of a model, modes included, as start values or columns: `state_angle`."""
    known = {q.name: q.unit for q in (*model.signals, *model.observables)}
    return tuple(
        Quantity(f"{STATE}{name}", known.get(name, ""), f"{name} in the state of the model")
        for name in names_of_numbers(_shapes(model)[0])
    )


@cached_by_content(maxsize=64)
def _shapes(model: HybridModel) -> tuple[State, Rates]:
    """The shapes of a state of a model and of its rates."""
    params, state = shapes_of(model)
    return state, jax.eval_shape(model.flow, params, state)


def places_of(state: State, rates: Rates) -> dict[str, Place]:
    """The variables that rates move, by name.

    Args:
        state: a state, of shapes or of numbers.
        rates: the rates of its fields.
    """
    places: dict[str, Place] = {}
    for field in dataclasses.fields(state):
        if field.name in rates:
            shape = np.shape(getattr(state, field.name))
            places_of_field = [(field.name, place) for place in np.ndindex(*shape)]
            places |= zip(element_names(field.name, shape), places_of_field, strict=True)
    return places


def _plain(state: State) -> State:
    """The state of the model itself, without the modes of the push."""
    (kind,) = type(state).__bases__
    return kind(**{field.name: getattr(state, field.name) for field in dataclasses.fields(kind)})
