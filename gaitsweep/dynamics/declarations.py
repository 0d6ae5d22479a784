"""Declarations in the body of a model's class: parameters, variables, modes, observables, signals.

Each function makes a record of what jobs, tables and figures show. A declaration does not know its own name,
which is that of the class's attribute.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Real, Shaped

from gaitsweep.contract import Model, Quantity

Start = float | str
TWO_PI = 2.0 * math.pi


def wrapped(phi: Float[Array, " ..."]) -> Float[Array, " ..."]:
    """The angle `phi` (rad) wrapped to [0, 2 pi)."""
    return phi - TWO_PI * jnp.floor(phi / TWO_PI)


def wrapped_about_zero(phi: Float[Array, " ..."]) -> Float[Array, " ..."]:
    """The angle `phi` (rad) wrapped to [-pi, pi]."""
    return phi - TWO_PI * jnp.round(phi / TWO_PI)


def numbered(text: str, number: int) -> str:
    """The text with a number in place of its braces, or at its end."""
    return (text if "{}" in text else f"{text} {{}}").replace("{}", str(number))


@dataclasses.dataclass(frozen=True)
class Counted:
    """A declaration of `count` numbers (`phi_1`, `phi_2`, ...), or of a single one where it is None.

    `count` is a number, or the name of a field of the model's structure.
    """

    count: int | str | None

    def __post_init__(self) -> None:
        """Refuse a count that is no number of components.

        Raises:
            TypeError: with what is allowed.
        """
        whole = isinstance(self.count, int) and not isinstance(self.count, bool) and self.count >= 1
        if not (whole or self.count is None or isinstance(self.count, str)):
            raise TypeError(
                f"A declaration has count={self.count!r}: allowed are whole numbers from 1 on, and the name "
                "of a field of the model's structure as text."
            )

    def size(self, model: Model) -> int:
        """Number of components, 1 for a single one."""
        return getattr(model, self.count) if isinstance(self.count, str) else self.count or 1

    def shape(self, model: Model) -> tuple[int, ...]:
        """The shape of the field."""
        return () if self.count is None else (self.size(model),)

    def gathered(self, numbers: Sequence[Float[Array, ""]]) -> Float[Array, " ..."]:
        """The value of the field from its components."""
        return numbers[0] if self.count is None else jnp.stack(numbers)


@dataclasses.dataclass(frozen=True)
class CountedQuantity(Counted):
    """A declaration with a quantity, which has no name yet."""

    quantity: Quantity

    def quantities(self, model: Model, name: str, **changes: Any) -> tuple[Quantity, ...]:
        """The quantities of a field by this name."""
        plain = name.removesuffix("_")
        if plain != name and not self.quantity.symbol:  # `lambda_` and `e_` are the paper's lambda and e
            changes["symbol"] = rf"\{plain}" if plain == "lambda" else plain
        quantity = dataclasses.replace(self.quantity, name=name, **changes)
        if self.count is None:
            return (quantity,)
        return tuple(
            dataclasses.replace(
                quantity,
                name=f"{plain}_{i}",
                meaning=numbered(quantity.meaning, i),
                symbol=quantity.symbol and f"{quantity.symbol}_{{{i}}}",
            )
            for i in range(1, self.size(model) + 1)
        )


@dataclasses.dataclass(frozen=True)
class Parameter(CountedQuantity):
    """A declared parameter; see `parameter`. `defaults` are those of its components, if they differ."""

    defaults: tuple[Start, ...] | None = None

    def parameters(self, model: Model, name: str) -> tuple[Quantity, ...]:
        """The quantities of its components, with their defaults."""
        quantities = self.quantities(model, name)
        if self.defaults is None:
            return quantities
        if len(self.defaults) != len(quantities):
            raise ValueError(f"{name} has {len(self.defaults)} defaults, but {len(quantities)} numbers")
        pairs = zip(quantities, self.defaults, strict=True)
        return tuple(dataclasses.replace(quantity, default=default) for quantity, default in pairs)


@dataclasses.dataclass(frozen=True)
class Variable(CountedQuantity):
    """A declared continuous variable; see `variable`."""

    start: Start | tuple[Start, ...] | None
    observed: bool
    signal: bool
    held: bool = False

    def starts(self, model: Model, name: str) -> tuple[Quantity, ...]:
        """The initial conditions, with their defaults; none where a job may not set them."""
        if self.start is None:
            return ()
        quantities = self.quantities(model, name)
        defaults = self.start if isinstance(self.start, tuple) else (self.start,) * len(quantities)
        if len(defaults) != len(quantities):
            raise ValueError(f"{name} has {len(defaults)} start values, but {len(quantities)} numbers")
        return tuple(
            dataclasses.replace(q, name=f"{q.name}_0", meaning=f"{q.meaning} at the start", default=default)
            for q, default in zip(quantities, defaults, strict=True)
        )

    def read(self, value: Float[Array, " ..."], /) -> Float[Array, " ..."]:
        """The value as it is recorded: angles from 0 to 2 pi."""
        return wrapped(value) if self.quantity.circular else value

    def recorded(self, model: Model, name: str) -> tuple[Quantity, ...]:
        """The observables or signals; bounds of the start do not hold for them."""
        return self.quantities(model, name, low=-math.inf, high=math.inf, open_ends=False)

    def values(self, model: Model, name: str, params: Any, state: Any) -> dict[str, Float[Array, ""]]:
        """The recorded values by name."""
        value = self.read(getattr(state, name))
        if self.count is None:
            return {name: value}
        return dict(zip([q.name for q in self.quantities(model, name)], value, strict=True))


@dataclasses.dataclass(frozen=True)
class Time(Variable):
    """The declared time; see `time`."""


@dataclasses.dataclass(frozen=True)
class Mode(Counted):
    """A declared discrete mode; see `mode`."""

    start: bool | int | tuple[bool | int, ...]
    meaning: str

    def starts(self, model: Model, name: str) -> tuple[Quantity, ...]:
        """The initial conditions, whole numbers, with their defaults."""
        values = np.asarray(self.start)
        if values.ndim and values.shape != self.shape(model):
            raise ValueError(f"{name} has {values.size} start values, but {self.size(model)} numbers")
        values = np.broadcast_to(values, self.shape(model))
        low, high = (0.0, 1.0) if np.issubdtype(values.dtype, np.bool_) else (-math.inf, math.inf)
        places = [""] if self.count is None else [f"_{i + 1}" for i in range(self.size(model))]
        meaning = f"{self.meaning}, at the start"
        return tuple(
            Quantity(f"{name}{place}_0", "1", meaning, float(value), low=low, high=high, whole=True)
            for place, value in zip(places, values.ravel(), strict=True)
        )

    def at_start(self, model: Model, numbers: Sequence[Float[Array, ""]]) -> Shaped[Array, " ..."]:
        """Its value at t = 0, from those of its initial conditions."""
        dtype = jnp.asarray(self.start).dtype
        value = jnp.stack([jnp.asarray(number) for number in numbers])
        return jnp.reshape(jnp.round(value).astype(dtype), self.shape(model))


@dataclasses.dataclass(frozen=True)
class Reading(CountedQuantity):
    """A declared observable or signal that is computed from the state; see `observable` and `signal`."""

    function: Callable[..., Real[Array, " ..."]]
    observed: bool
    signal: bool
    is_energy: bool = False
    is_conserved: bool = False

    def recorded(self, model: Model, name: str) -> tuple[Quantity, ...]:
        """The observables or signals."""
        return self.quantities(model, name)

    def values(self, model: Model, name: str, params: Any, state: Any) -> dict[str, Float[Array, ""]]:
        """The recorded values by name.

        Raises:
            ValueError: the function does not return `count` numbers.
        """
        value = jnp.asarray(self.function(model, params, state), float)
        names = [q.name for q in self.quantities(model, name)]
        if self.count is not None and value.shape != (len(names),):
            raise ValueError(
                f"{name} has the shape {value.shape}, but its count= asks for {len(names)} numbers, "
                f"({len(names)},)"
            )
        value = wrapped(value) if self.quantity.circular else value
        return {name: value} if self.count is None else dict(zip(names, value, strict=True))


@dataclasses.dataclass(frozen=True)
class Symmetry:
    """A declared symmetry; see `symmetry`."""

    function: Callable[..., Any]
    meaning: str


def symmetry(meaning: str) -> Callable[[Callable[..., Any]], Any]:
    """Declare a function (params, state) -> state that turns every motion into a motion.

    Gaits that are images of each other count as one in an atlas, which says which are their own images.

    Args:
        meaning: a few words, such as "left and right legs exchanged".
    """
    return lambda function: Symmetry(function, meaning)


def _quantity(unit: str, meaning: str, **others: Any) -> Quantity:
    """A quantity that has no name yet.

    Raises:
        TypeError: the unit or the meaning is no text, as where the order of arguments was mistaken.
    """
    for field, text in (("unit", unit), ("meaning", meaning)):
        if not isinstance(text, str):
            example = 'parameter("m/s2", "gravitational acceleration", 9.81)'
            order = f"write the unit, the meaning, then a number, as in {example}"
            raise TypeError(f"The {field} of a declaration is {text!r}, but must be text: {order}.")
    return Quantity("", unit, meaning, **others)


def _plain(value: Any) -> Any:
    """A default, also of NumPy, as a number or text of Python; those of several components as a tuple."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return np.asarray(value).item() if np.ndim(value) == 0 else tuple(map(_plain, value))


def parameter(
    unit: str,
    meaning: str,
    default: Start | Sequence[Start] | None = None,
    *,
    count: int | str | None = None,
    low: float = -math.inf,
    high: float = math.inf,
    open_ends: bool = False,
    circular: bool = False,
    symbol: str = "",
    source: str = "",
    whole: bool = False,
) -> Any:
    """Declare a parameter, which the model's functions read as `params.NAME`.

    Args:
        unit, meaning: as jobs, tables and figures show them.
        default: a number, an expression over other parameters ("2*sqrt(kappa)"), or None where a job has to
            give it; with `count` also a sequence of these, one for each.
        count: how many there are (`NAME_1`, `NAME_2`, ... in a job, an array (count,) in `params`): a number,
            or the name of a field of the model's structure. None: one scalar.
        low, high, open_ends, circular, symbol, source, whole: as of `Quantity`. A name that ends with an
            underscore has by default the symbol without it: `e_` is e and `lambda_` is lambda in figures,
            since `e` is Euler's number in formulas and `lambda` a word of Python.

    Example:
        >>> import gaitsweep as gs
        >>> class Relaxation(gs.DeclaredModel):
        ...     k = gs.parameter("1/s", "rate of relaxation", (20.0, 21.0), count=2, low=0.0)
        ...     x = gs.variable("1", "distance from rest", (0.1, 0.2), count=2)
        ...
        ...     def flow(self, p, s):
        ...         return {"x": -p.k * s.x}
        ...
        ...     def period(self, p):
        ...         return 1.0
        >>> [(quantity.name, quantity.default) for quantity in Relaxation().parameters]
        [('k_1', 20.0), ('k_2', 21.0)]
    """
    plain = _plain(default)
    several = plain if isinstance(plain, tuple) else None
    first = plain if several is None else next(iter(several), None)
    bounds = {"low": low, "high": high, "open_ends": open_ends}
    words = {"symbol": symbol, "source": source}
    quantity = _quantity(unit, meaning, default=first, circular=circular, whole=whole, **bounds, **words)
    return Parameter(count, quantity, several)


def variable(
    unit: str,
    meaning: str,
    start: Start | Sequence[Start] | None = None,
    *,
    count: int | str | None = None,
    low: float = -math.inf,
    high: float = math.inf,
    open_ends: bool = False,
    circular: bool = False,
    symbol: str = "",
    scale: float | None = None,
    observed: bool | None = None,
    signal: bool = True,
    held: bool = False,
) -> Any:
    """Declare a continuous variable of the state, which the model's functions read as `state.NAME`.

    Args:
        unit, meaning: as jobs, tables and figures show them.
        start: its default at t = 0, for which jobs have the name `NAME_0`; a number, an expression over
            parameters, or one for each of `count`. None: it starts at 0, or where `complete` puts it.
        count: how many there are, as for `parameter`.
        low, high, open_ends: bounds of the start that a job may set.
        circular: an angle in rad of period 2 pi; it is recorded from 0 to 2 pi.
        symbol, scale: as of `Quantity`.
        observed: whether it is recorded at crossings of the section; by default if it has a start.
        signal: whether traces record it.
        held: whether events alone change it, so that `flow` returns no rate of it; of other variables without
            a rate, checks and runs warn.

    Example:
        >>> import gaitsweep as gs
        >>> class Rotor(gs.DeclaredModel):
        ...     phase = gs.variable("rad", "phase", 1.5, circular=True)
        ...     turned = gs.variable("rad", "angle turned through")
        ...
        ...     def flow(self, p, s):
        ...         return {"phase": 1.0, "turned": 1.0}
        ...
        ...     def period(self, p):
        ...         return 6.28
        >>> [quantity.name for quantity in Rotor().initial_conditions]
        ['phase_0']
        >>> [quantity.name for quantity in Rotor().observables]
        ['phase']
        >>> [quantity.name for quantity in Rotor().signals]
        ['phase', 'turned']
    """
    bounds = {"low": low, "high": high, "open_ends": open_ends}
    quantity = _quantity(unit, meaning, **bounds, circular=circular, symbol=symbol, scale=scale)
    is_observed = start is not None if observed is None else observed
    return Variable(count, quantity, _plain(start), is_observed, signal, held)


def time() -> Any:
    """Declare the time since the start, in s, for flows and jumps that depend on it: `t = gs.time()`.

    Its rate is 1, so `flow` returns `"t": 1.0`. It is neither recorded (tables have the time anyway) nor a
    coordinate of the section, so the section of a driven model has to be `instants` of its drive. A section
    that is crossed at any phase of the drive needs "t" in `section_coordinates`.

    Example:
        >>> import jax.numpy as jnp, numpy as np, gaitsweep as gs
        >>> class Driven(gs.DeclaredModel):
        ...     rate = gs.parameter("rad/s", "angular frequency of the drive", 2.0)
        ...     t = gs.time()
        ...     x = gs.variable("m", "displacement", 0.0)
        ...     strobe = gs.instants("strobe", every=lambda p: 2.0 * jnp.pi / p.rate, section=True)
        ...
        ...     def flow(self, p, s):
        ...         return {"t": 1.0, "x": jnp.cos(p.rate * s.t) - s.x}
        ...
        ...     def period(self, p):
        ...         return 2.0 * jnp.pi / p.rate
        >>> gs.return_map(Driven()).fixed_points([0.1]).points.at.round(6).item()  # 1 / (1 + rate^2)
        0.2
    """
    quantity = _quantity("s", "time since the start")
    return Time(None, quantity, start=None, observed=False, signal=False)


def mode(start: bool | int | Sequence[bool | int], meaning: str, *, count: int | str | None = None) -> Any:
    """Declare a discrete mode of the state (a contact, the phase of a step), which only jumps change.

    Args:
        start: its default at t = 0, for which jobs have the name `NAME_0`, and which decides its type: a
            bool or an integer, or one for each of `count`.
        meaning: as jobs and tables show it.
        count: how many there are, as for `parameter`.

    Raises:
        TypeError: `start` is no bool or whole number, and no sequence of them.
    """
    plain = _plain(start)
    if not all(isinstance(value, (bool, int)) for value in (plain if isinstance(plain, tuple) else (plain,))):
        raise TypeError(f"A mode has the start {start!r}, but must have a bool or a whole number.")
    return Mode(count, plain, meaning)


def observable(
    unit: str,
    meaning: str,
    *,
    count: int | str | None = None,
    circular: bool = False,
    symbol: str = "",
    scale: float | None = None,
    signal: bool = False,
) -> Callable[[Callable[..., Real[Array, " ..."]]], Any]:
    """Declare a function (params, state) -> number as an observable, read at crossings of the section.

    Args:
        unit, meaning: as tables and figures show them.
        count: how many numbers the function returns, as an array (count,): observables `NAME_1`, `NAME_2`,
            ...; as for `parameter`.
        circular, symbol, scale: as of `Quantity`.
        signal: whether traces record it too.
    """
    quantity = _quantity(unit, meaning, circular=circular, symbol=symbol, scale=scale)
    return lambda function: Reading(count, quantity, function, observed=True, signal=signal)


def signal(
    unit: str, meaning: str, *, count: int | str | None = None, circular: bool = False, symbol: str = ""
) -> Callable[[Callable[..., Real[Array, " ..."]]], Any]:
    """Declare a function (params, state) -> number as a signal, which traces record.

    Args:
        unit, meaning: as tables and figures show them.
        count: how many numbers the function returns, as for `observable`.
        circular, symbol: as of `Quantity`.
    """
    quantity = _quantity(unit, meaning, circular=circular, symbol=symbol)
    return lambda function: Reading(count, quantity, function, observed=False, signal=True)


def energy(
    unit: str,
    meaning: str,
    *,
    symbol: str = "",
    scale: float | None = None,
    observed: bool = False,
    conserved: bool = False,
) -> Callable[[Callable[..., Real[Array, ""]]], Any]:
    """Declare a function (params, state) -> number as an energy that the flow keeps between events.

    `gaitsweep check-model` prints how fast it changes: a wrong sign in the flow shows there. It is a signal.

    Args:
        unit, meaning: as tables and figures show them.
        symbol, scale: as of `Quantity`.
        observed: whether it is an observable too, read at crossings of the section.
        conserved: whether jumps keep it, too. The gaits of such a model form families: a return map holds it
            (`fix`), and follows them along it (`continue_`).
    """
    quantity = _quantity(unit, meaning, symbol=symbol, scale=scale)
    return lambda function: Reading(
        None, quantity, function, observed, signal=True, is_energy=True, is_conserved=conserved
    )
