"""The abstract model that the engine runs: a set of pure JAX functions of *one* trajectory."""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

if TYPE_CHECKING:
    import pandas as pd

    from gaitsweep.skeleton import LimbLook, Skeleton

__all__ = [
    "Chart", "FixedStepDynamics", "HybridModel", "Model", "Params", "Quantity", "Rates", "Recommended",
    "Simultaneous", "State", "SteppedModel",
]  # fmt: skip

Params = Any  # a frozen pytree of scalars: a model's parameters
State = Any  # a frozen dataclass pytree: the continuous variables and the discrete modes of a trajectory
Rates = dict[str, Float[Array, " ..."]]  # time derivative of each continuous field of a State, by field name


@dataclasses.dataclass(frozen=True)
class Recommended:
    """The integration method and tolerances that a model recommends; steps follow from a row's parameters.

    Args:
        method: a value of `numerics.method` in a job.
        rtol, atol: the relative and the absolute tolerance on the local error, for methods with step control.
    """

    method: str
    rtol: float = 1.0e-8
    atol: float = 1.0e-10


@dataclasses.dataclass(frozen=True)
class Quantity:
    """Name, unit and meaning of a parameter, an initial condition, an observable, a label field or a signal.

    Args:
        name: its name in jobs and tables.
        unit: its unit, "1" without one.
        meaning: a few words.
        default: a number, an expression over parameters ("2*sqrt(kappa)"), or None where a job must give it.
        low, high: bounds of the values that a job may set.
        open_ends: whether the bounds themselves are excluded.
        circular: whether it is an angle in rad of period 2 pi.
        symbol: the paper's symbol in TeX, for the axes of figures.
        source: the paper, table or equation of the default.
        scale: the size (in `unit`, above 0) of an observable that counts as one in the test of convergence of
            a run of kind settle and in the self-check, which do not compare one with an infinite scale. None:
            the range of its values over the crossings of the row so far. Angles are compared in rad.
        whole: whether only whole numbers are admitted.
        may_be_nan: whether it has no value in some states, as the lag of a foot that stands.
    """

    name: str
    unit: str
    meaning: str
    default: float | str | None = None
    low: float = -math.inf
    high: float = math.inf
    open_ends: bool = False
    circular: bool = False
    symbol: str = ""
    source: str = ""
    scale: float | None = None
    whole: bool = False
    may_be_nan: bool = False

    @classmethod
    def positive(
        cls, name: str, unit: str, meaning: str, default: float | str, symbol: str = "", source: str = ""
    ) -> Quantity:
        """A quantity above zero, with the fields of the same names."""
        return cls(name, unit, meaning, default, low=0.0, open_ends=True, symbol=symbol, source=source)


def names_gait(label: str) -> bool:
    """Return whether a label holds an index of a gait: `gait` itself, or a label field `gait_...`."""
    return label == "gait" or label.startswith("gait_")


class Chart(abc.ABC):
    """Coordinates on a model's Poincare section; the discrete modes are not among them.

    Symmetry directions (position, heading) are left out, so that a steady gait is a fixed point. Variables
    that the section itself fixes are left out as well.

    1. A chart gives `coordinates`, `to_coordinates` and `from_coordinates`.
    2. It may give the optional members: `covers` where some crossings have no coordinates, and `conserved`
       with `conserved_values` where the return map conserves quantities.
    3. The engine alone calls its functions.
    """

    @property
    @abc.abstractmethod
    def coordinates(self) -> tuple[Quantity, ...]:
        """The coordinates, in order; angles are marked circular."""

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        """Conserved quantities of the return map: fixed points form families, and a condition selects one."""
        return ()

    @abc.abstractmethod
    def to_coordinates(self, params: Params, state: State, /) -> Float[Array, " coordinates"]:
        """The coordinates (n,) of a state just after the jump of a crossing."""

    @abc.abstractmethod
    def from_coordinates(self, params: Params, at: Float[Array, " coordinates"], modes: State, /) -> State:
        """The state on the section with some coordinates.

        Args:
            params: the parameters.
            at: the coordinates (n,).
            modes: a state near it on the section, whose discrete modes it has.
        """

    def covers(self, params: Params, state: State, /) -> Bool[Array, ""]:
        """Return whether `from_coordinates` can return this state, just after a crossing."""
        return jnp.ones((), bool)

    def conserved_values(
        self, params: Params, at: Float[Array, " coordinates"], /
    ) -> Float[Array, " conserved"]:
        """The values (k,) of the `conserved` quantities at the coordinates `at` (n,)."""
        return jnp.zeros((0,))


class Jumps(abc.ABC):
    """Jumps of events, in a model or in a scheme of its own steps."""

    @abc.abstractmethod
    def jump(self, params: Params, state: State, fired: Bool[Array, " events"], /) -> State:
        """The state after some events; only a jump changes the modes.

        Events that are located at one time jump as `simultaneous` has it: by default one at a time, in the
        order of the guards, which are looked at again after each jump. Events of a scheme of steps jump
        together.

        Args:
            params: the parameters.
            state: the state before the jump.
            fired: a bool for each event.
        """

    @abc.abstractmethod
    def section(self, params: Params, before: State, fired: Bool[Array, " events"], /) -> Bool[Array, ""]:
        """Return whether the events `fired` close a cycle; `before` is the state before their jump."""


class Model(Jumps):
    """The properties and functions of every model; a concrete model is a frozen dataclass.

    Its fields are its structure (number of legs, kind of body): they shape the arrays and cannot vary inside
    a job. They have to be hashable, since compiled programs are cached by model.
    Derive from `HybridModel` or from `SteppedModel`, not from this class.

    1. A model gives `name`, `source`, `gaits` and the abstract members.
    2. It may give the optional members, which are all others. Their defaults describe a model without the
       feature: `precisions`, `label_fields`, `host_parameters` with `on_host`, `data_digest`,
       `caveats`, `caveats_notice`, `free_after`, `beyond_at_start`, `without_start`, `symmetries` and
       `chart` for runs; `own_ground`, `limbs`, `skeleton`, `free_link`, `analytic_distance` and `mjcf`
       for figures; `bibtex` for `gaitsweep cite`.
    3. The engine alone calls the functions, with arguments by position, so a model may name them as it likes.
    """

    name: ClassVar[str]
    source: ClassVar[str]  # the paper
    bibtex: ClassVar[str] = ""  # its BibTeX entry
    # the names that `label` indexes; "none" where no gait is recognised, and not "failed" or "not settled"
    gaits: ClassVar[tuple[str, ...]]

    @property
    def original(self) -> Model:
        """The model that its author wrote; a model that adds to another one returns that one."""
        return self

    @property
    def precisions(self) -> tuple[str, ...]:
        """The supported precisions: float64, float32, mixed (see `FixedStepDynamics.step`)."""
        return ("float64",)

    @property
    @abc.abstractmethod
    def parameters(self) -> tuple[Quantity, ...]:
        """All parameters, in display order."""

    @property
    @abc.abstractmethod
    def initial_conditions(self) -> tuple[Quantity, ...]:
        """The initial conditions that a job may set."""

    @property
    @abc.abstractmethod
    def observables(self) -> tuple[Quantity, ...]:
        """The observables, read at each crossing of the Poincare section."""

    @property
    @abc.abstractmethod
    def signals(self) -> tuple[Quantity, ...]:
        """The signals that a trace records."""

    @property
    def label_fields(self) -> tuple[Quantity, ...]:
        """The fields that `label` returns in addition to `gait`; a field `gait_...` is an index of a gait."""
        return ()

    @property
    def host_parameters(self) -> tuple[str, ...]:
        """Names of the parameters that `on_host` reads: they vary between rows, not along a trajectory."""
        return ()

    def on_host(
        self, values: Mapping[str, Float[np.ndarray, " rows"]]
    ) -> dict[str, Float[np.ndarray, "rows ..."]]:
        """The parameters (n,) of n rows by name, and derived arrays (n, ...) of floats, passed to `params`.

        Called once for each block of rows on the host, for quantities that cannot be computed on the device:
        constants that a simulator's compiler derives from masses and lengths. The names returned must be the
        same for all blocks.
        """
        return dict(values)

    @abc.abstractmethod
    def params(self, values: Mapping[str, Float[Array, " ..."]], /) -> Params:
        """The frozen pytree of parameters, from one scalar for each name in `parameters` (see `on_host`)."""

    @abc.abstractmethod
    def init(self, params: Params, start: Mapping[str, Float[Array, ""]], /) -> State:
        """The state at t = 0 (crossing 0), from one scalar for each name in `initial_conditions`."""

    @abc.abstractmethod
    def observe(self, params: Params, state: State, /) -> dict[str, Real[Array, ""]]:
        """The observables by name, of the state just after the jump that closes a cycle."""

    @abc.abstractmethod
    def signal(self, params: Params, state: State, /) -> dict[str, Real[Array, ""]]:
        """The signals by name, at a state."""

    @abc.abstractmethod
    def label(
        self, params: Params, observations: Mapping[str, Real[Array, ""]], /
    ) -> dict[str, Real[Array, ""]]:
        """`gait` (an index into `gaits`) and the `label_fields`, from the last crossing's observables."""

    @abc.abstractmethod
    def failed(self, params: Params, state: State, /) -> Bool[Array, ""]:
        """Return whether the body has fallen; a fallen body must stay so.

        The function is evaluated every 64 attempts of a method with fixed steps, and after every adaptive
        step: a fall that ends between two evaluations would be missed.
        """

    @abc.abstractmethod
    def period(self, params: Params, /) -> Float[Array, ""]:
        """The nominal period of a cycle (s); the engine's time limits are multiples of it."""

    @property
    @abc.abstractmethod
    def recommended(self) -> Recommended:
        """The default numerics of a job."""

    @property
    def data_digest(self) -> str:
        """A digest of data files that decide its numbers, such as an MJCF; empty without such files."""
        return ""

    def own_ground(
        self, x: Float[Array, " *places"], y: Float[Array, " *places"], /
    ) -> Float[Array, " *places"] | None:
        """The heights (m) of steps and hills of the model itself at places x, y (m); None without any."""
        return None

    def caveats(self) -> list[str]:
        """Sentences on the accuracy of its motions, which a run prints before its rows."""
        return []

    @property
    def caveats_notice(self) -> str:
        """A sentence that is printed before `caveats` is called, where that takes long; by default empty."""
        return ""

    def free_after(self, params: Params, /) -> Float[Array, ""]:
        """The time (s) at which external constraints on the gait end; no row settles before it."""
        return 0.0 * self.period(params)

    def beyond_at_start(self, params: Params, state: State, /) -> dict[str, Bool[Array, ""]]:
        """Masks, by an event's name, of starts on or beyond the surface of an event that changes the state.

        Such an event does not happen at the start; a run prints how many rows have such a start.
        """
        return {}

    def without_start(self, params: Params, state: State, /) -> dict[str, Bool[Array, ""]]:
        """Masks, by the reason, of starts that `init` could not make and whose variables are NaN.

        A run prints how many rows have none.
        """
        return {}

    def symmetries(self) -> Mapping[str, Callable[[Params, State], State]]:
        """Maps of states that turn motions into motions, such as the exchange of left and right, by name.

        An atlas combines them, so products of those given can be left out. It follows the image of a state
        on the section to the next crossing, so the image may be off the section.
        """
        return {}

    def chart(self) -> Chart | None:
        """The coordinates of the section; None: the return map uses all float variables of the state."""
        return None

    @property
    def limbs(self) -> tuple[LimbLook, ...]:
        """The limbs of the signals contact_1, contact_2, ..., for figures; empty: legs with numbers."""
        return ()

    def skeleton(
        self, values: Mapping[str, float], signals: Mapping[str, Float[np.ndarray, " times"]]
    ) -> Skeleton | None:
        """The drawing of the body, from parameters and signals (n,) of a trace; None: it cannot be drawn."""
        return None

    def free_link(self, trace: pd.DataFrame, legs: int) -> int | None:
        """The number i of the limbs i and i + 1 whose phase difference is free, from 1; None: there are none.

        Args:
            trace: the last records of a row of a trace, a DataFrame.
            legs: the number of its limbs.
        """
        return None

    def analytic_distance(self, table: pd.DataFrame) -> tuple[float, int] | None:
        """The largest distance (rad) of settled states from analytic solutions, and its row; None: not known.

        Args:
            table: a table of settled rows, a DataFrame.
        """
        return None

    def mjcf(self, values: Mapping[str, float]) -> str | None:
        """An MJCF of the body: its qpos are the signals q_0, q_1, ..., its feet the sites foot_1, ..."""
        return None


class FixedStepDynamics(Jumps):
    """A time-stepping scheme of fixed step length, whose events are detected at the end of a step."""

    # whether every step ends on the section: the step is the return map, has its derivative and no error
    is_return_map: ClassVar[bool] = False
    # whether steps draw random numbers: `step` then has a fourth argument, the factor on the step's length
    # (1, or 1/2 in the self-check, along the same path of noise)
    stochastic: ClassVar[bool] = False

    @abc.abstractmethod
    def step(self, params: Params, state: State, dt: Float[Array, ""], /) -> State:
        """The state one step of `dt` (s) later; modes are left to `jump`.

        With `numerics.precision: mixed`, `dt` is float32: forces may then be computed in float32, while the
        state stays float64.
        """

    @abc.abstractmethod
    def events(self, params: Params, before: State, after: State, /) -> Bool[Array, " events"]:
        """A bool for each event: whether it happened during the step."""

    @abc.abstractmethod
    def longest_step(self, params: Params, /) -> Float[Array, ""] | None:
        """The longest accurate step (s) with these parameters; None: a job has to set `numerics.dt`."""


class SteppedModel(Model, FixedStepDynamics):
    """A model that a simulator's own step advances.

    1. A model gives what `Model` and `FixedStepDynamics` ask for.
    2. It may give the optional members of `Model`, `recommended` and `longest_step`.
    3. The engine alone calls the functions.
    """

    @property
    def recommended(self) -> Recommended:
        return Recommended("semi_implicit")

    def longest_step(self, params: Params, /) -> Float[Array, ""] | None:
        return None


# Guards that fire in the same trial jump "in_turn", or "together" in one jump, with the derivative of one
# event time, where a jump decides by all events of the instant. "independent": both ways give the same;
# they jump in turn where derivatives are asked for, and else in one jump, which is faster.
Simultaneous = Literal["in_turn", "together", "independent"]


class HybridModel(Model):
    """A hybrid system: an ODE between events that are located in time.

    `flow` and `guards` only read the discrete modes in the state (contacts, leg segments): a `flow` that
    recomputes a contact inside a step breaks event location and the order of convergence.

    1. A model gives what `Model` asks for, `flow` and `guards`.
    2. It may give the optional members of `Model`, and those of this class: `linear`, `recommended`,
       `fast_modes`, `locates_events` and `fixed_step_scheme` for the method, `simultaneous`, `longest_chain`,
       `guard_names` and `occurred` for the events, `energies` for the check of the flow,
       `displaced` for pushes.
    3. The engine alone calls the functions.
    """

    linear: ClassVar[bool] = False  # whether `flow` is affine in the continuous fields at fixed modes
    simultaneous: ClassVar[Simultaneous] = "in_turn"  # how guards that fire in the same trial jump

    @property
    def recommended(self) -> Recommended:
        """A method whose steps follow from its tolerances, so it suits every flow: tsit5, or taylor.

        `auto` is taylor where that is the faster one (`engine.numerics.taylor_is_faster`).
        """
        return Recommended("auto")

    def fast_modes(
        self, params: Params, /
    ) -> tuple[Float[Array, " motions"], Float[Array, " motions"]] | None:
        """Rates (n,) in 1/s and damping ratios (n,) of the fastest motions, over all discrete modes.

        Methods with fixed steps take steps proportional to 1 / rate (a job's `numerics.dt` is compared with
        them). For a linear flow, the largest rate bounds the absolute eigenvalues of its matrix in every
        discrete mode. A damping ratio of 1 or more means a motion that does not oscillate. None where the
        rates are unknown: methods with fixed steps then need `numerics.dt`.
        """
        return None

    @property
    def locates_events(self) -> bool:
        """Return whether events can be located; else `flow` only names the moving fields."""
        return True

    def fixed_step_scheme(self) -> FixedStepDynamics | None:
        """The model's own fixed-step scheme, for `numerics.method: semi_implicit`; None: it has none."""
        return None

    @property
    def longest_chain(self) -> int | None:
        """The most jumps at one instant; a row with more ends as `event_stall`.

        None: 4 for each guard and 4 more. A model in which guards may jump more often at an instant (cells
        that fire each other in turn) gives its own number.
        """
        return None

    @abc.abstractmethod
    def flow(self, params: Params, state: State, /) -> Rates:
        """Time derivatives of the continuous fields of `state`, by field name."""

    @abc.abstractmethod
    def guards(self, params: Params, state: State, /) -> Float[Array, " guards"]:
        """The guard function (n,) of each event: negative while armed; the event fires where it becomes >= 0.

        Guards are finite, and continuous while the modes are constant. A guard that is still >= 0 after its
        own jump fires again at once. So a jump changes a mode that reverses the guard's sign (a contact
        flag), or the guard includes the velocity (`-height - c * max(speed, 0)` for a bouncing ball).
        A mode that is switched both ways by the sign of one function needs both guards to be below zero by
        its rounding error after a jump: otherwise simultaneous events of two limbs may follow without end.
        A flow without events returns `jnp.zeros((0,))`; its section is then never crossed.
        """

    def displaced(self, params: Params, state: State, /) -> State:
        """The state after a push has moved its variables, with the modes that follow from where it lies."""
        return state

    def energies(self, params: Params, state: State, /) -> dict[str, Float[Array, ""]]:
        """Energies by name that the flow keeps between events; `gaitsweep check-model` prints their rates."""
        return {}

    @property
    def guard_names(self) -> tuple[str, ...]:
        """Names of the events, in the order of `guards`: "foot 2 lands".

        The column `stalled_by` of a row that ends as `event_stall` has these names; without them they are
        guard 1, guard 2, ...
        """
        return ()

    def occurred(
        self, params: Params, state: State, fired: Bool[Array, " guards"], /
    ) -> Bool[Array, " guards"]:
        """Mask of the guards that are events of the motion, among those that fired, for the order of events.

        A guard that only arms another one is none; by default all are.
        """
        return fired
