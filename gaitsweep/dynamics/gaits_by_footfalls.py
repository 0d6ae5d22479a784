"""Footfalls of a model: touchdown lags, duty factors and support of its feet, and the names of gaits.

Sources of the names: Hildebrand 1965, Science 150:701, and 1989, BioScience 39:766, of symmetrical gaits of
four legs; Hildebrand 1977, J. Mammalogy 58:131, of asymmetrical ones; Wilson 1966, Annu. Rev. Entomology
11:103, and DeAngelis et al. 2019, eLife 8:e46409, of six legs.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaitsweep.contract import Model, Quantity
from gaitsweep.skeleton import LimbLook

# The legs that have names of gaits: left and right, fore and hind, or from the first pair to the last.
LEGS = {2: ("L", "R"), 4: ("LF", "RF", "LH", "RH"), 6: ("L1", "R1", "L2", "R2", "L3", "R3")}
KNOWN_LEGS = "; ".join(", ".join(names) for names in LEGS.values())
GAITS = {
    2: ("walk", "run", "hop", "none"),
    4: (
        *("lateral sequence walk", "lateral sequence run", "diagonal sequence walk"),
        *("diagonal sequence run", "trot", "pace", "pronk", "bound", "half-bound"),
        *("transverse gallop", "rotary gallop", "none"),
    ),
    6: ("tripod", "tetrapod", "metachronal wave", "none"),
}
# Shares of a stride. A trot's or a pace's diagonality is within a sixteenth of 1/2 or 0, half the width of
# Hildebrand's classes; legs land together, and have equal strides, within that. Legs of a pair alternate
# within a tenth. Lags of six legs, whose gaits are a sixth apart, are within a twelfth.
TOGETHER = 1.0 / 16.0
ALTERNATE = 0.1
_OF_SIX_LEGS = 1.0 / 12.0
_ROUNDING = 1e-12  # a difference of two instants of a stride that are the same

# Strides, or periods of the model if these are longer, after a touchdown within which a foot that steps lands
# again.
LATE = 1.5

# Share of a model's period for which a foot of a body in an MJCF has to stay down, or up, to count as landed,
# or lifted, unless its footfalls have another one. Compliant feet bounce after touchdown and before liftoff,
# and a simulator's contacts open and close for a step or two; swings and stances last longer.
SHORTEST_CONTACT = 0.05

Legs = Mapping[str, Any]


def gait_index(touchdowns: Legs, duty: Any) -> Int[Array, ""]:
    """The index of a gait in `GAITS`, in JAX.

    Args:
        touchdowns: of each leg by its name, as shares of a stride.
        duty: the mean duty factor.
    """
    names = GAITS[len(touchdowns)]
    index = jnp.asarray(len(names) - 1, jnp.int32)
    rules = {2: _of_two, 4: _of_four, 6: _of_six}[len(touchdowns)](touchdowns, duty)
    for name, rule in reversed(rules.items()):
        index = jnp.where(rule, names.index(name), index)
    return index.astype(jnp.int32)


def gait_of_footfalls(touchdowns: Sequence[float], duty: Sequence[float], legs: Sequence[str]) -> str:
    """The name of a gait from its touchdowns and duty factors.

    Args:
        touchdowns: of each leg, as shares of a stride after any instant.
        duty: the duty factor of each leg, from 0 to 1.
        legs: the legs: L and R; LF, RF, LH and RH; or L1, R1, L2, R2, L3 and R3, in any order.

    Returns:
        One of `GAITS`; "none" also where a touchdown or duty factor is NaN, as that of a foot that stands.

    Raises:
        ValueError: other legs, another number of touchdowns or duty factors, or a duty factor outside its
            range.

    Example:
        >>> import gaitsweep as gs
        >>> gs.analyses.gait_of_footfalls([0.0, 0.5, 0.75, 0.25], [0.7] * 4, ["LF", "RF", "LH", "RH"])
        'lateral sequence walk'
    """
    refuse_legs(legs)
    _refuse_numbers(touchdowns, duty, legs)
    if not np.isfinite([*touchdowns, *duty]).all():
        return "none"
    index = gait_index(dict(zip(legs, touchdowns, strict=True)), float(np.mean(duty)))
    return GAITS[len(legs)][int(index)]


def support_patterns(
    touchdowns: Sequence[float], duty: Sequence[float], legs: Sequence[str]
) -> dict[str, float]:
    """The feet that are down together, "LF RH", and for which share of a stride, from the first touchdown on.

    Args:
        touchdowns, duty, legs: as of `gait_of_footfalls`; legs may have any names.

    Raises:
        ValueError: there is no leg, another number of touchdowns or duty factors, one that is not finite, or
            a duty factor outside its range.

    Example:
        >>> import gaitsweep as gs
        >>> gs.analyses.support_patterns([0.0, 0.5, 0.5, 0.0], [0.5] * 4, ["LF", "RF", "LH", "RH"])
        {'LF RH': 0.5, 'RF LH': 0.5}
    """
    _refuse_numbers(touchdowns, duty, legs)
    if not np.isfinite([*touchdowns, *duty]).all():
        numbers = ", ".join(f"{number:g}" for number in (*touchdowns, *duty))
        raise ValueError(f"The touchdowns and duty factors are {numbers}, but must be finite numbers.")
    begin = np.asarray(touchdowns, float)
    length = np.asarray(duty, float)
    edges = np.unique(np.r_[0.0, np.mod(np.r_[begin, begin + length] - begin.min(), 1.0), 1.0])
    shares: dict[str, float] = {}
    for low, high in itertools.pairwise(edges):
        if high - low < _ROUNDING:
            continue
        down = np.mod(0.5 * (low + high) + begin.min() - begin, 1.0) < length
        feet = " ".join(leg for leg, is_down in zip(legs, down, strict=True) if is_down)
        shares[feet] = shares.get(feet, 0.0) + float(high - low)
    return shares


def _refuse_numbers(touchdowns: Sequence[float], duty: Sequence[float], legs: Sequence[str]) -> None:
    """Refuse touchdowns and duty factors that are not one for each leg, no leg, and other duty factors."""
    if not len(touchdowns) == len(duty) == len(legs) > 0:
        counts = f"{len(touchdowns)} touchdowns, {len(duty)} duty factors and {len(legs)} legs"
        raise ValueError(f"There are {counts}: give one touchdown and one duty factor for each leg.")
    for share in duty:
        if share < 0.0 or share > 1.0:
            raise ValueError(f"A duty factor is {share:g}, but must be a share of the stride, from 0 to 1.")


def refuse_legs(legs: Sequence[str]) -> None:
    """Refuse legs without names of gaits.

    Raises:
        ValueError: with those that have them.
    """
    if not have_names(legs):
        names = ", ".join(map(str, legs))
        raise ValueError(f"legs is {names}: allowed are, in any order, {KNOWN_LEGS}.")


def have_names(legs: Sequence[str]) -> bool:
    """Whether footfalls of legs with these names have names of gaits."""
    return sorted(legs) in [sorted(known) for known in LEGS.values()]


def _between(one: Any, other: Any) -> Any:
    """The lag of touchdowns after others, from -1/2 to 1/2 of a stride."""
    return (one - other) - jnp.round(one - other)


def _near(lag: Any, target: float, within: float) -> Any:
    """Whether a lag is within a share of a stride of another one."""
    return jnp.abs(_between(lag, target)) <= within


def _of_two(at: Legs, duty: Any) -> dict[str, Any]:
    """Whether two legs have each gait; the first that holds counts."""
    alternate = _near(at["R"] - at["L"], 0.5, ALTERNATE)
    return {
        "walk": alternate & (duty >= 0.5),
        "run": alternate,
        "hop": _near(at["R"] - at["L"], 0.0, TOGETHER),
    }


def _of_four(at: Legs, duty: Any) -> dict[str, Any]:
    """Whether four legs have each gait; the first that holds counts."""
    fore = _between(at["RF"], at["LF"])
    hind = _between(at["RH"], at["LH"])
    left = at["LF"] - at["LH"]
    # the share of a stride by which a fore foot follows the hind foot of its side, the mean of both sides
    diagonality = left + 0.5 * _between(at["RF"] - at["RH"], left)
    diagonality = diagonality - jnp.floor(diagonality)
    symmetrical = _near(fore, 0.5, ALTERNATE) & _near(hind, 0.5, ALTERNATE)
    fores = _near(fore, 0.0, TOGETHER)
    hinds = _near(hind, 0.0, TOGETHER)
    gallop = ~(fores | hinds | _near(fore, 0.5, ALTERNATE) | _near(hind, 0.5, ALTERNATE))
    lateral = symmetrical & (diagonality < 0.5)
    return {
        "trot": symmetrical & _near(diagonality, 0.5, TOGETHER),
        "pace": symmetrical & _near(diagonality, 0.0, TOGETHER),
        "lateral sequence walk": lateral & (duty >= 0.5),
        "lateral sequence run": lateral,
        "diagonal sequence walk": symmetrical & (duty >= 0.5),
        "diagonal sequence run": symmetrical,
        "pronk": fores & hinds & _near(diagonality, 0.0, TOGETHER),
        "bound": fores & hinds,
        "half-bound": hinds & ~fores & ~_near(fore, 0.5, ALTERNATE),
        # both pairs land left before right, or both right before left
        "transverse gallop": gallop & (fore * hind > 0.0),
        "rotary gallop": gallop,
    }


def _of_six(at: Legs, duty: Any) -> dict[str, Any]:
    """Whether six legs have each gait; the first that holds counts."""

    def lags(ipsilateral: float, contralateral: float) -> Any:
        """Whether legs follow those behind them, and right legs follow left ones, by these lags."""
        pairs = [(f"{s}{k}", f"{s}{k + 1}", ipsilateral) for s in "LR" for k in (1, 2)]
        pairs += [(f"R{k}", f"L{k}", contralateral) for k in (1, 2, 3)]
        return jnp.all(
            jnp.stack([_near(at[one] - at[other], lag, _OF_SIX_LEGS) for one, other, lag in pairs])
        )

    return {
        "tripod": lags(1.0 / 2.0, 1.0 / 2.0),
        "tetrapod": lags(1.0 / 3.0, 1.0 / 3.0) | lags(1.0 / 3.0, 2.0 / 3.0),
        "metachronal wave": lags(1.0 / 6.0, 1.0 / 2.0),
    }


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Steps:
    """The last steps of n feet: times of the model's clock (s) and durations (s).

    `landings` (n,): touchdowns so far; `landed` (n,): times of the last ones, at first of the start;
    `strides` (n,): times between the last two; `stances` (n,): durations of the last complete stances.
    `changed`: the time of the last touchdown or lift; `spent` (n + 1,): time with 0 to n feet down since the
    first foot's last touchdown; `support` (n + 1,): the shares of the stride before that.
    """

    landings: jax.Array
    landed: jax.Array
    strides: jax.Array
    stances: jax.Array
    changed: jax.Array
    spent: jax.Array
    support: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class DebouncedSteps(Steps):
    """The last steps of feet whose short contacts and lifts do not count.

    `is_down` (n,): whether each foot counts as down; `since` (n,): the times (s) since which its contact, or
    its lack, lasts; `touched` (n,): the times (s) of its last touches that did not follow on a short lift.
    """

    is_down: jax.Array
    since: jax.Array
    touched: jax.Array


_Steps = TypeVar("_Steps", bound=Steps)


def _counted(
    steps: _Steps, was: Bool[Array, " feet"], down: Bool[Array, " feet"], at: Float[Array, " feet"]
) -> _Steps:
    """The steps after those feet have landed or lifted that `was` and `down` tell apart, at the times `at`.

    Times may differ from foot to foot. A bounce lands before others have moved that were counted sooner: its
    support counts from the last of these on.
    """
    lands = down & ~was
    lifts = was & ~down
    moved = lands | lifts
    # whether a foot (column) has moved before another one (row); feet that move together do so in turn
    feet = jnp.arange(was.size)
    is_sooner = at[None, :] < at[:, None]
    is_together = at[None, :] == at[:, None]
    earlier = moved[None, :] & (is_sooner | (is_together & (feet[None, :] < feet[:, None])))
    begin = jnp.max(jnp.where(earlier, at[None, :], steps.changed), axis=1)
    change = down.astype(int) - was.astype(int)
    feet_down = jnp.sum(was) + jnp.sum(jnp.where(earlier, change[None, :], 0), axis=1)
    is_number = jnp.arange(was.size + 1)[None, :] == feet_down[:, None]
    spans = jnp.where(is_number & moved[:, None], jnp.maximum(at - begin, 0.0)[:, None], 0.0)
    # the first foot's touchdown ends its stride, and begins the next one
    in_next = (lands[0] & earlier[:, 0])[:, None]
    spent = steps.spent + jnp.sum(jnp.where(in_next, 0.0, spans), axis=0)
    spent_in_next = jnp.sum(jnp.where(in_next, spans, 0.0), axis=0)
    landed_before = steps.landings >= 1
    stride = jnp.where(landed_before[0], jnp.sum(spent), 0.0)
    share = jnp.where(stride > 0.0, spent / jnp.where(stride > 0.0, stride, 1.0), 0.0)
    return dataclasses.replace(
        steps,
        landings=steps.landings + lands.astype(jnp.int32),
        landed=jnp.where(lands, at, steps.landed),
        strides=jnp.where(lands & landed_before, at - steps.landed, steps.strides),
        stances=jnp.where(lifts & landed_before, at - steps.landed, steps.stances),
        changed=jnp.maximum(steps.changed, jnp.max(jnp.where(moved, at, steps.changed))),
        spent=jnp.where(lands[0], spent_in_next, spent),
        support=jnp.where(lands[0], share, steps.support),
    )


@dataclasses.dataclass(frozen=True)
class Footfalls:
    """Declared footfalls; see `footfalls`."""

    function: Callable[..., Any]
    clock: str
    legs: tuple[str, ...]
    shortest_contact: float = SHORTEST_CONTACT

    @property
    def gaits(self) -> tuple[str, ...]:
        """The names of gaits of so many legs."""
        return GAITS[len(self.legs)]

    @property
    def stride_names(self) -> tuple[str, ...]:
        """The names of the observables that are strides."""
        return tuple(f"stride_{i}" for i, _ in enumerate(self.legs, 1))

    @property
    def limbs(self) -> tuple[LimbLook, ...]:
        """The limbs for figures; those of the left are the far ones."""
        order = list(LEGS[len(self.legs)])
        return tuple(LimbLook(leg, order.index(leg) // 2, leg.startswith("L")) for leg in self.legs)

    @property
    def observables(self) -> tuple[Quantity, ...]:
        """Quantities that are read at crossings."""
        legs = list(enumerate(self.legs, 1))
        first = self.legs[0]
        numbers = [
            *((f"stride_{i}", "s", f"time between touchdowns of {leg}") for i, leg in legs),
            *((f"lag_{i}", "rad", f"touchdown of {leg} after that of {first}") for i, leg in legs[1:]),
            *((f"duty_{i}", "1", f"duty factor of {leg}") for i, leg in legs),
            *((f"support_{k}", "1", f"share of the stride with {k} feet down") for k in range(len(legs) + 1)),
        ]
        options: dict[str, dict[str, Any]] = {"s": {}, "rad": {"circular": True}, "1": {"scale": 1.0}}
        return tuple(
            Quantity(name, unit, f"{meaning}; NaN without steps", may_be_nan=True, **options[unit])
            for name, unit, meaning in numbers
        )

    @property
    def signals(self) -> tuple[Quantity, ...]:
        """Quantities that traces record: the contacts."""
        legs = enumerate(self.legs, 1)
        return tuple(Quantity(f"contact_{i}", "1", f"whether {leg} is down") for i, leg in legs)

    def begun(self, now: Float[Array, ""], *, debounced: bool) -> Steps:
        """The steps of feet that have made none; `debounced`: without short contacts and lifts."""
        n = len(self.legs)
        now = jnp.asarray(now, float)
        begin = jnp.broadcast_to(now, (n,))
        none = jnp.zeros(n)
        shares = jnp.zeros(n + 1)
        steps = (jnp.zeros(n, jnp.int32), begin, none, none, now, shares, shares)
        return DebouncedSteps(*steps, jnp.zeros(n, bool), begin, begin) if debounced else Steps(*steps)

    def down(self, model: Model, params: Any, state: Any) -> Bool[Array, " feet"]:
        """Whether each foot is down.

        Raises:
            ValueError: the declared function does not return a truth value for each leg.
        """
        down = jnp.asarray(self.function(model, params, state))
        if down.shape != (len(self.legs),) or down.dtype != bool:
            required = f"return ({len(self.legs)},) of bool, one for each of {', '.join(self.legs)}"
            raise ValueError(f"footfalls returns {down.shape} of {down.dtype}, but must {required}")
        return down

    def after(
        self, model: Model, params: Any, steps: Steps, before: Any, after: Any, reset: Float[Array, ""]
    ) -> Steps:
        """The steps after a change of the state.

        Args:
            model, params: the model and its parameters.
            steps: the steps before.
            before, after: the states before and after the change.
            reset: the time (s) by which the change has set the clock forward.
        """
        was = self.down(model, params, before)
        down = self.down(model, params, after)
        now = getattr(after, self.clock)
        steps = dataclasses.replace(steps, landed=steps.landed + reset, changed=steps.changed + reset)
        if not isinstance(steps, DebouncedSteps):
            return _counted(steps, was, down, jnp.broadcast_to(now, was.shape))
        # a contact or lift counts once it has lasted: a lift from its beginning on, a contact from the first
        # touch of the bounces, between short lifts, that it ends
        since = steps.since + reset
        touched = steps.touched + reset
        lasts = now - since >= self.shortest_contact * model.period(params)
        is_down = jnp.where(lasts, was, steps.is_down)
        # a foot that has been down since the start has not landed
        none_landed = steps.landings == 0
        was_down = steps.is_down | (is_down & none_landed & (touched == steps.landed))
        counted = _counted(steps, was_down, is_down, jnp.where(is_down, touched, since))
        after_lift = lasts | (none_landed & (since == steps.landed))
        return dataclasses.replace(
            counted,
            is_down=is_down,
            since=jnp.where(down == was, since, now),
            touched=jnp.where(down & ~was & after_lift, now, touched),
        )

    def observed(self, model: Model, params: Any, state: Any, steps: Steps) -> dict[str, Float[Array, ""]]:
        """The observables by name; NaN for a foot that has not landed twice, or has stopped stepping."""
        # a foot that has not landed for longer stands still, or is held up; strides of bounces are short
        since = getattr(state, self.clock) - steps.landed
        longest = LATE * jnp.maximum(steps.strides, model.period(params))
        steps_on = (steps.strides > 0.0) & (since <= longest)
        stride = jnp.where(steps_on, steps.strides, jnp.nan)
        lag = (steps.landed - steps.landed[0]) / stride[0]
        lag = jnp.where(steps_on, 2.0 * jnp.pi * (lag - jnp.floor(lag)), jnp.nan)
        support = jnp.where(steps_on[0], steps.support, jnp.nan)
        # a stance that is longer than the time between two touchdowns is not of that stride
        duty = jnp.where(steps.stances <= stride, steps.stances / stride, jnp.nan)
        values = [*stride, *lag[1:], *duty, *support]
        return dict(zip([q.name for q in self.observables], values, strict=True))

    def gait(self, at: Mapping[str, Any]) -> Int[Array, ""]:
        """The index of the gait with these observables; none unless each leg steps once a stride."""
        numbers = range(1, len(self.legs) + 1)
        strides, duty = (
            jnp.stack([jnp.asarray(at[f"{k}_{i}"]) for i in numbers]) for k in ("stride", "duty")
        )
        touchdowns = [0.0, *(at[f"lag_{i}"] / (2.0 * jnp.pi) for i in numbers[1:])]
        steady = jnp.abs(strides - strides[0]) <= TOGETHER * strides[0]
        walks = jnp.all((strides > 0.0) & steady & (duty > 0.0) & (duty < 1.0))
        index = gait_index(dict(zip(self.legs, touchdowns, strict=True)), jnp.mean(duty))
        return jnp.where(walks, index, len(self.gaits) - 1).astype(jnp.int32)


def footfalls(
    clock: str, *, legs: Sequence[str], shortest_contact: float = SHORTEST_CONTACT
) -> Callable[[Callable[..., Any]], Any]:
    """Declare a function (params, state) -> (n,) of bool, whether each foot is down, as a model's footfalls.

    The model then has the signals `contact_1`, ..., the observables `stride_1`, ... (s), `lag_2`, ... (rad,
    the touchdown after the first leg's), `duty_1`, ... and `support_0`, ... (shares of the first leg's stride
    with so many feet down), of the last steps, and the names of their gaits: `gaits` and `label` may be left
    out. They are NaN for a foot that has not made two touchdowns, or that has stood or been held up for 1.5
    of its strides, or of the model's periods if these are longer; such a row has no gait. A duty factor is
    NaN where the last stance is longer than the last stride: the foot lands more than once a cycle.

    A foot of a body in an MJCF (`BodyModel`, `MjcfModel`) has landed, or lifted, only if it then stays down,
    or up, for the share `shortest_contact` of the model's `period`. It landed at the first touch of the
    bounces, with shorter lifts between them, that this contact ends, and lifted at the last lift. A larger
    share lets a foot scuff in swing. The signals show every contact.

    Args:
        clock: the variable of the model, in s, whose rate is 1; a jump may set it back.
        legs: L and R; LF, RF, LH and RH; or L1, R1, L2, R2, L3 and R3, in the order of the function's array.
        shortest_contact: of a body in an MJCF, a share of the model's period, from 0 to 1/2.

    Raises:
        ValueError: other legs, or a share outside its range.

    Example:
        >>> import jax.numpy as jnp, gaitsweep as gs
        >>> class Biped(gs.DeclaredModel):
        ...     omega = gs.parameter("rad/s", "frequency of the legs", 6.0)
        ...     phase = gs.variable("rad", "phase of leg", (0.1, 3.2), count=2, circular=True)
        ...     down = gs.mode(True, "foot is down", count=2)
        ...     time = gs.variable("s", "time since the last touchdown of the left foot")
        ...
        ...     def flow(self, p, s):
        ...         return {"phase": p.omega * jnp.ones(2), "time": 1.0}
        ...
        ...     @gs.event("foot {} lands", count=2, section="first")
        ...     def landing(self, p, s):
        ...         return s.phase - 2.0 * jnp.pi
        ...
        ...     @landing.jump
        ...     def land(self, p, s, i):
        ...         time = 0.0 if i == 0 else s.time
        ...         phase = s.phase.at[i].add(-2.0 * jnp.pi)
        ...         return s.replace(phase=phase, down=s.down.at[i].set(True), time=time)
        ...
        ...     @gs.event("foot {} lifts", count=2)
        ...     def lift(self, p, s):
        ...         return s.phase - 2.0 * jnp.pi * 0.6
        ...
        ...     @lift.jump
        ...     def lifted(self, p, s, i):
        ...         return s.replace(down=s.down.at[i].set(False))
        ...
        ...     @gs.footfalls("time", legs=("L", "R"))
        ...     def feet(self, p, s):
        ...         return s.down
        ...
        ...     def period(self, p):
        ...         return 2.0 * jnp.pi / p.omega
        >>> table = gs.sweep(Biped(), omega=[6.0], run=gs.Settle(tolerance=1e-9)).table
        >>> table["gait"].tolist(), table[["duty_2_end", "support_2_end"]].round(6).to_numpy().tolist()
        (['walk'], [[0.6, 0.2]])
    """
    refuse_legs(legs)
    if not 0.0 <= shortest_contact <= 0.5:
        raise ValueError(f"shortest_contact is {shortest_contact:g}, but must be a share from 0 to 0.5.")
    return lambda function: Footfalls(function, clock, tuple(legs), float(shortest_contact))
