"""What a model gives to the engine, and the result codes that the engine gives back.

A model is a set of pure JAX functions of *one* trajectory; batching is the engine's business alone.
This module imports nothing of gaitsweep, so that a user's model needs nothing but JAX and this file
(and `gaitsweep/skeleton.py`, if it is to be drawn).
"""

from __future__ import annotations

import abc
import dataclasses
import enum
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np

if TYPE_CHECKING:
    from gaitsweep.skeleton import Skeleton

Params = Any  # a frozen pytree of scalars: a model's parameters
State = Any  # a frozen dataclass pytree: what changes along a trajectory, modes included
Rates = dict[str, jax.Array]  # time derivative of each continuous field of a State, by field name


class Verdict(enum.Enum):
    """What a status says of a row: that its result holds, that nothing was decided, or that it failed."""

    sound = "sound"  # the row came to what the run asked for
    undecided = "undecided"  # a limit ended it: with a larger one it could still come to anything
    failed = "failed"  # the body fell, or the numbers did: there is no gait at its end


class Status(enum.IntEnum):
    """How a row ended, with a sentence each and its verdict; every row of a table has exactly one.

    The numbers are stored in tables: those that are here stay as they are, and new ones come at the end.
    """

    running = 0, "The row has not ended yet.", Verdict.undecided
    settled = 1, "The section's state stopped moving, or repeats every 2 to 8 crossings.", Verdict.sound
    cycle_limit = 2, "The row reached run.max_cycles without settling.", Verdict.undecided
    fell = 3, "The model's own test of a fall came true.", Verdict.failed
    diverged = 4, "A state variable grew past the bound of divergence.", Verdict.failed
    not_a_number = 5, "A state variable became NaN.", Verdict.failed
    event_stall = (
        6,
        "Events followed each other at one instant without end (stalled_by names them).",
        Verdict.failed,
    )
    time_limit = (
        7,
        "Time ran out: run.max_time, or four nominal periods for each cycle allowed.",
        Verdict.undecided,
    )
    complete = 8, "The row recorded all that was asked of it.", Verdict.sound
    inferred = 9, "The row was not simulated: its neighbours decide its label.", Verdict.sound
    step_limit = 10, "The row needed more steps than its limit allows.", Verdict.undecided
    no_fixed_point = 11, "No fixed point was found from which to follow a branch.", Verdict.undecided

    sentence: str
    verdict: Verdict

    def __new__(cls, number: int, sentence: str, verdict: Verdict) -> Self:
        status = int.__new__(cls, number)
        status._value_, status.sentence, status.verdict = number, sentence, verdict
        return status

    @classmethod
    def of(cls, *verdicts: Verdict) -> frozenset[str]:
        """The names of the statuses with one of these verdicts, as the column `status` has them."""
        return frozenset(status.name for status in cls if status.verdict in verdicts)


@dataclasses.dataclass(frozen=True)
class Recommended:
    """The numerics that a model recommends for itself; how long a step may be depends on a row's parameters.

    `method` as `numerics.method` of a job names it; `rtol`, `atol` the relative and the absolute tolerance of
    a step's error, read by methods with step control.
    """

    method: str
    rtol: float = 1.0e-8
    atol: float = 1.0e-10


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A parameter, a start value, an observable or a signal: its name, unit and meaning.

    `default` is a number, or an expression over parameters ("2*sqrt(kappa)"), or None where a value must
    be given. `low` and `high` are what a job may set, the ends excluded where `open_ends` says so.
    `circular` marks an angle in rad of period 2 pi. `symbol` is the paper's, in TeX, for the axes of figures.
    `scale` (in `unit`, above 0) is the size in which changes of an observable count when a run settles; where
    it is None, the observable's own magnitude over the last crossings counts. An observable that tends to 0
    needs one: it has no magnitude of its own there. Angles marked circular count in rad.
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


class Chart(abc.ABC):
    """Coordinates of a model's section: few numbers that say where on it a state is, its modes apart.

    Directions along which the model is the same everywhere (where it stands, which way it heads) are left
    out, so that a steady gait is a fixed point; so are numbers that the section itself fixes.
    """

    @property
    @abc.abstractmethod
    def coordinates(self) -> tuple[Quantity, ...]:
        """What each coordinate is, in their order; angles marked circular."""

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        """What a cycle leaves as it is: there fixed points are not alone, and a condition picks one."""
        return ()

    @abc.abstractmethod
    def read(self, params: Params, state: State) -> jax.Array:
        """The coordinates (n,) of a state just after a crossing's jump."""

    @abc.abstractmethod
    def place(self, params: Params, at: jax.Array, like: State) -> State:
        """The state on the section with the coordinates `at` (n,) and the modes of `like`, which is near."""

    def holds(self, params: Params, state: State) -> jax.Array:
        """Whether a state just after a crossing is one that `place` can give."""
        return jnp.ones((), bool)

    def kept(self, params: Params, at: jax.Array) -> jax.Array:
        """The `conserved` quantities at these coordinates."""
        return jnp.zeros((0,))


class Model(abc.ABC):
    """What every model gives; a concrete model is a frozen dataclass whose fields are its structure.

    The structure (number of legs, kind of body) shapes the arrays and cannot vary inside a job. It has to
    be hashable, since compiled programs are kept by model.
    Derive from `HybridModel` or from `SteppedModel`, not from this class.
    """

    name: ClassVar[str]
    source: ClassVar[str]  # the paper
    gaits: ClassVar[tuple[str, ...]]  # what `label` indexes; "none" stands for what is no gait of these

    @property
    def precisions(self) -> tuple[str, ...]:
        """Those in which it is known to hold: float64, float32, mixed (see `Steps.step`)."""
        return ("float64",)

    @property
    @abc.abstractmethod
    def parameters(self) -> tuple[Quantity, ...]:
        """All parameters, in the order in which they are shown."""

    @property
    @abc.abstractmethod
    def starts(self) -> tuple[Quantity, ...]:
        """The initial conditions that a job may set."""

    @property
    @abc.abstractmethod
    def observables(self) -> tuple[Quantity, ...]:
        """What is read at each crossing of the Poincare section."""

    @property
    @abc.abstractmethod
    def signals(self) -> tuple[Quantity, ...]:
        """What a trace records."""

    @property
    def traits(self) -> tuple[Quantity, ...]:
        """Columns that `label` gives beside `gait`."""
        return ()

    @property
    def host_parameters(self) -> tuple[str, ...]:
        """The parameters that `on_host` reads: they differ between rows, but cannot move while a row runs."""
        return ()

    def on_host(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The parameters (n,) of n rows by name, and arrays (n, ...) of floats made of them, for `params`.

        Called once for each block of rows, before they go to a device. For what cannot be worked out there:
        constants that a simulator's compiler makes of masses and lengths. All blocks get the same names.
        """
        return dict(values)

    @abc.abstractmethod
    def params(self, values: Mapping[str, jax.Array]) -> Params:
        """The frozen pytree of parameters from one scalar for each name in `parameters` (see `on_host`)."""

    @abc.abstractmethod
    def init(self, params: Params, start: Mapping[str, jax.Array]) -> State:
        """The state at t = 0, which is crossing 0 of the section, from one scalar for each start."""

    @abc.abstractmethod
    def observe(self, params: Params, state: State) -> dict[str, jax.Array]:
        """The section's observables, read just after the jump that closes a cycle."""

    @abc.abstractmethod
    def section(self, params: Params, before: State, fired: jax.Array) -> jax.Array:
        """True where the events `fired` close a cycle; `before` is the state before their jump."""

    @abc.abstractmethod
    def signal(self, params: Params, state: State) -> dict[str, jax.Array]:
        """The signals of a trace at this state."""

    @abc.abstractmethod
    def label(self, params: Params, observations: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        """`gait` (an index into `gaits`) and the `traits`, from the observables where a row ended."""

    @abc.abstractmethod
    def failed(self, params: Params, state: State) -> jax.Array:
        """True where the body has fallen; asked every 64 attempts (after each of adaptive steps), so a fall
        is what lasts."""

    @abc.abstractmethod
    def period(self, params: Params) -> jax.Array:
        """A cycle's nominal duration in s; the engine's limits on time are multiples of it."""

    @property
    @abc.abstractmethod
    def recommended(self) -> Recommended:
        """The numerics of a job that says nothing of them."""

    def free_after(self, params: Params) -> jax.Array:
        """The time (s) before which something still holds the gait, so that no row can settle."""
        return 0.0 * self.period(params)

    def chart(self) -> Chart | None:
        """Coordinates of the section; where there are none, all numbers of a state serve."""
        return None

    def skeleton(self, values: Mapping[str, float], signals: Mapping[str, np.ndarray]) -> Skeleton | None:
        """How the body is drawn with these parameters and signals (n,) of a trace; None where it is not."""
        return None

    def mjcf(self, values: Mapping[str, float]) -> str | None:
        """An MJCF of the body whose qpos are the signals q_0, q_1, ..., its feet the sites foot_1, ..."""
        return None

    @abc.abstractmethod
    def jump(self, params: Params, state: State, fired: jax.Array) -> State:
        """The state after the events `fired` (a bool for each guard or event); it alone changes modes."""


class Steps(abc.ABC):
    """What advances a trajectory in steps of fixed length, whose events happen at a step's end."""

    @abc.abstractmethod
    def step(self, params: Params, state: State, dt: jax.Array) -> State:
        """The state one step of `dt` (s) later; modes are left to `jump`, where that has anything to do.

        `dt` is float32 where `numerics.precision` is mixed: forces may then be worked out in float32, the
        state stays float64.
        """

    @abc.abstractmethod
    def events(self, params: Params, before: State, after: State) -> jax.Array:
        """A bool for each event that this step brought about."""

    @abc.abstractmethod
    def jump(self, params: Params, state: State, fired: jax.Array) -> State:
        """The state after the events `fired`."""

    @abc.abstractmethod
    def section(self, params: Params, before: State, fired: jax.Array) -> jax.Array:
        """True where the events `fired` close a cycle."""

    def longest_step(self, params: Params) -> jax.Array | None:
        """The longest step (s) that is right with these parameters; None: a job has to say `numerics.dt`."""
        return None


class SteppedModel(Model, Steps):
    """A model advanced by a simulator's own step."""

    @property
    def recommended(self) -> Recommended:
        return Recommended("semi_implicit")


class HybridModel(Model):
    """A model whose state flows by an ODE between located events.

    `flow` and `guards` only read the discrete modes in the state (contacts, leg segments): a `flow` that
    recomputes a contact inside a step ruins the location of events and the order of convergence.
    """

    linear: ClassVar[bool] = False  # whether `flow` is affine in the continuous fields, modes held

    @property
    def recommended(self) -> Recommended:
        """By default the adaptive pair, whose steps follow from its tolerances: right for every flow."""
        return Recommended("tsit5")

    def fast_modes(self, params: Params) -> tuple[jax.Array, jax.Array] | None:
        """Rates (n,) in 1/s and damping ratios (n,) of the fastest motions, over all discrete modes.

        Methods of fixed order take steps in proportion to 1 / rate (a job's `numerics.dt` is compared with
        them). Of a linear flow no eigenvalue of its matrix, in any discrete mode, may be larger than the
        largest rate. A damping ratio of 1 and more means a motion that does not oscillate. None where the
        rates are not known: methods of fixed order then need `numerics.dt`.
        """
        return None

    @property
    def located(self) -> bool:
        """Whether events can be located; if not, `flow` only names what moves, and `in_steps` moves it."""
        return True

    def in_steps(self) -> Steps | None:
        """The same model in steps of fixed length, for `numerics.method: semi_implicit`, if it has them."""
        return None

    @abc.abstractmethod
    def flow(self, params: Params, state: State) -> Rates:
        """Time derivatives of the continuous fields of `state`, by field name."""

    @abc.abstractmethod
    def guards(self, params: Params, state: State) -> jax.Array:
        """One number for each possible event: negative while armed, firing where it becomes >= 0.

        Finite, and continuous as long as the modes stay. A guard that is still >= 0 after its own jump fires
        again at once, so a jump changes a mode that turns the guard's sign (a contact flag), or the guard
        counts on the way up (`-height - c * max(speed, 0)` for a ball that bounces).
        A flow without events gives `jnp.zeros((0,))`; its section is then never crossed.
        """

    @property
    def guard_names(self) -> tuple[str, ...]:
        """What happens where each guard fires, in the order of `guards`: "foot 2 lands".

        A row that ends as `event_stall` is told by these names; guards without one are guard 1, guard 2, ...
        """
        return ()
