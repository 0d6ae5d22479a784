"""Poincare returns by scalar kernels: a lane is one state, or one state with one direction.

JAX sees a function with a custom forward-mode derivative: all directions of a Jacobian are lanes of one call.
JAX differentiates the same straight-line attempt that the plain kernel runs. Where only images are needed, a
kernel without derivatives takes a third of the time.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaitsweep.contract import Model, Params, State
from gaitsweep.engine.carry import Carry
from gaitsweep.engine.devices import usable_cores
from gaitsweep.engine.kernel import cpu_program
from gaitsweep.engine.kernel.chunk import Chunk, Leaf, chunk_of
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.leaves import float_leaves, split_like, tangent_of, vector, with_float_leaves
from gaitsweep.engine.numerics import ResolvedNumerics
from gaitsweep.engine.poincare.poincare_return import PoincareReturn, Returned, ReturnState
from gaitsweep.engine.stored_traces import stored
from gaitsweep.status import Status

# Polls in one call of the kernel: every return ends long before.
_POLLS = 1 << 40


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Ends:
    """Whether a lane has ended, a `Status`; no buffer is ever `filled`."""

    status: Int[Array, ""]
    filled: Int[Array, ""]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _LaneState:
    """A trajectory, and the tangent `rate` of its float leaves along one direction; [] without derivative."""

    trajectory: ReturnState
    rate: Any

    @property
    def halt(self) -> Any:
        return self.trajectory.carry.halt


def _with_tangent(function: Callable[..., ReturnState], args: Any, tangents: Any) -> _LaneState:
    """A trajectory as a function of two trees, and its tangent along `tangents` of their float leaves."""

    def moved(*numbers: Any) -> Any:
        trajectory = function(*map(with_float_leaves, args, numbers))
        return float_leaves(trajectory), trajectory

    _, rate, trajectory = jax.jvp(moved, tuple(map(float_leaves, args)), tangents, has_aux=True)
    return _LaneState(trajectory, rate)


class _Lane:
    """One return and its derivative along one direction, as the functions from which a chunk is compiled.

    `constants` are the parameters and their tangent. A lane with an empty `rate` has no derivative.
    """

    deciding = None

    def __init__(self, crossing: PoincareReturn) -> None:
        self.crossing = crossing

    def open(self, constants: Any, lane: _LaneState) -> Any:
        """Return what `OneLane.open` does, for a trajectory that has begun already."""
        none = jnp.zeros((), jnp.int32)
        return constants, lane, _Ends(none, none), jnp.zeros((0,)), jnp.zeros((), bool)

    def attempt(self, constants: Any, lane: _LaneState) -> _LaneState:
        """The trajectory and its tangent after one more attempt."""
        (params, along) = constants
        trajectory = lane.trajectory
        if not lane.rate:
            return _LaneState(self.crossing.attempt(params, trajectory), [])
        return _with_tangent(self.crossing.attempt, (params, trajectory), (along, lane.rate))

    def poll(self, constants: Any, lane: _LaneState, ends: _Ends) -> Any:
        """The test whether the return has ended, as `OneLane.poll` returns it."""
        status = jnp.where(self.crossing.ended(lane.trajectory), Status.complete, Status.running)
        ends = dataclasses.replace(ends, status=status.astype(jnp.int32))
        return lane, ends, jnp.zeros((0,)), jnp.zeros((), bool)


class KernelReturns:
    """The function `(params, state) -> (t, state, status)` of one return, by a kernel on the CPU's cores.

    Args:
        crossing: the functions of a return.
        params, state: arrays, or shapes, like the arguments of the function.
        quick: as of `llvm_code.machine_code`.

    Raises:
        UnsupportedError: the model uses operations that a scalar kernel does not have.
    """

    def __init__(
        self, crossing: PoincareReturn, params: Params, state: State, *, quick: bool = False
    ) -> None:
        self.crossing = crossing
        self._quick = quick
        self._like = jax.eval_shape(self._opened, params, state)
        self._shape = self._like[1]
        self._plain = _Kernel(crossing, *jax.eval_shape(self._without_tangent, *self._like), quick=quick)
        # slots that are read when a return has ended
        self._values = _slots(jax.tree.leaves(self._plain.lane_state.trajectory))
        self._function = jax.custom_jvp(self._value)
        self._function.defjvp(self._slope)

    def __call__(self, params: Params, state: State) -> Returned:
        return self._function(params, state)

    @cached_property
    def _differentiated(self) -> _Kernel:
        """The kernel with derivatives, compiled once a derivative is asked for."""
        shapes = jax.eval_shape(self._with_zero_tangent, *self._like)
        return _Kernel(self.crossing, *shapes, quick=self._quick)

    def _opened(self, params: Params, state: State) -> tuple[Params, ReturnState]:
        return params, self.crossing.begin(params, state)

    def _without_tangent(self, params: Params, trajectory: ReturnState) -> Any:
        """State of a lane without a derivative."""
        return (params, []), _LaneState(trajectory, [])

    def _with_zero_tangent(self, params: Params, trajectory: ReturnState) -> Any:
        """State of a lane with a tangent of zeros."""
        nothing = jax.tree.map(jnp.zeros_like, (float_leaves(params), float_leaves(trajectory)))
        return (params, nothing[0]), _LaneState(trajectory, nothing[1])

    def _value(self, params: Params, state: State) -> Returned:
        """The return from a state, without derivative."""
        constants, carry = self._without_tangent(*self._opened(params, state))
        ends = self._ends_of(self._plain, vector((constants, carry)), self._values)
        leaves, structure = jax.tree.flatten(self._shape)
        ended: ReturnState = jax.tree.unflatten(structure, split_like(ends, leaves))
        return ended.carry.t, ended.carry.state, self.crossing.status(params, ended)

    def _slope(self, primals: Any, tangents: Any) -> Any:
        """The return and its derivative along the tangents of parameters and state."""
        params, state = primals
        along, rate = map(_float_tangents, tangents)
        lane = _with_tangent(self.crossing.begin, (params, state), (along, rate))
        # the tangents of the state's float leaves and of the time come first in a carry
        rates = _slots(self._differentiated.lane_state.rate[: len(float_leaves(state)) + 1])
        ends = self._ends_of(self._differentiated, vector(((params, along), lane)), rates)
        *numbers, t = split_like(ends, [*float_leaves(state), jnp.zeros(())])
        return self._function(params, state), (t, tangent_of(state, numbers), np.zeros((), jax.dtypes.float0))

    def _ends_of(
        self, kernel: _Kernel, slots: Float[Array, " slots"], read: Int[np.ndarray, " read"]
    ) -> Float[Array, " read"]:
        """The slots `read` (n,) of a lane at the end of its return, from its slots at the beginning."""
        result = jax.ShapeDtypeStruct((read.size,), jnp.float64)
        return jax.pure_callback(partial(kernel, read), result, slots, vmap_method="legacy_vectorized")


class _Kernel:
    """Returns compiled for the CPU's cores.

    Args:
        crossing: the functions of a return.
        constants, carry: shapes and dtypes of what `_Lane.open` takes.
        quick: as of `llvm_code.machine_code`.
    """

    def __init__(self, crossing: PoincareReturn, constants: Any, carry: Any, *, quick: bool) -> None:
        self._crossing = crossing
        self._opened = (constants, carry)
        leaves = self._stored("leaves", self._read_leaves)
        self._run, self._slots = cpu_program.compiled(
            lambda: self._chunk, self._stored, contraction=crossing.numerics.contraction, quick=quick
        )
        slots = [Leaf(first, tuple(shape)) for first, shape in leaves]
        self.lane_state: _LaneState = jax.tree.unflatten(jax.tree.structure(carry), slots)

    def _stored(self, name: str, compute: Callable[[], Any], *others: Any) -> Any:
        """As `stored_traces.stored`, for this return."""
        deciding = (self._crossing.numerics, repr(self._opened), *others)
        return stored(f"return_{name}", self._crossing.model, deciding, compute)

    @cached_property
    def _chunk(self) -> Chunk:
        """The program of a return."""
        return chunk_of(_Lane(self._crossing), *self._opened)

    def _read_leaves(self) -> list[tuple[int, tuple[int, ...]]]:
        """The first slot and the shape of each number of a lane."""
        return [(leaf.first, leaf.shape) for leaf in jax.tree.leaves(self._chunk.carry)]

    def __call__(
        self, read: Int[np.ndarray, "... read"], slots: Float[Array, " ..."] | Float[np.ndarray, " ..."]
    ) -> Float[np.ndarray, " ..."]:
        slots = np.asarray(slots)
        lanes, back = _unique_lanes(slots.reshape(-1, slots.shape[-1]))
        slots_of_ends = _followed(self._run, self._slots, lanes, read)[back]
        return slots_of_ends.reshape(*slots.shape[:-1], read.size)


def _followed(
    run: Callable[[Any, Any, int], None],
    n_slots: int,
    lanes: Float[np.ndarray, "lanes slots"],
    read: Int[np.ndarray, " read"],
) -> Float[np.ndarray, "lanes read"]:
    """The slots `read` (n,) of lanes at the ends of their returns, from their slots at the beginning."""
    tiles = -(-len(lanes) // cpu_program.TILE)
    # the last tile is filled up by repeating its last lane, which costs nothing
    order = np.minimum(np.arange(tiles * cpu_program.TILE), len(lanes) - 1)
    room = np.zeros((tiles, n_slots, cpu_program.TILE))
    room[:, : lanes.shape[1]] = lanes[order].reshape(tiles, cpu_program.TILE, -1).transpose(0, 2, 1)
    no_samples = np.zeros((tiles * cpu_program.TILE, 0, 0))
    with ThreadPoolExecutor(usable_cores()) as pool:
        flat = room.reshape(tiles, -1)
        list(pool.map(lambda i: run(flat[i : i + 1], no_samples, _POLLS), range(tiles)))
    return room[:, read].transpose(0, 2, 1).reshape(tiles * cpu_program.TILE, -1)[: len(lanes)]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _LimitedEnds(_Ends):
    """The same, and the largest number of attempts of a lane."""

    limit: Float[Array, ""]


class _PlainLane:
    """One return without derivatives, with the attempts of the rows of a run.

    Args:
        crossing: the functions of the return.
        begin: `(*point) -> (params, state)`, a point's parameters and its state.
    """

    def __init__(self, crossing: PoincareReturn, begin: Callable[..., tuple[Params, State]]) -> None:
        self.crossing = crossing
        self._begin = begin
        self.deciding = (crossing.model, crossing.numerics, None, 0)

    def open(self, *point: Any) -> Any:
        """Return what `OneLane.open` does, for the return from a point."""
        params, state = self._begin(*point)
        trajectory = self.crossing.begin(params, state)
        none = jnp.zeros((), jnp.int32)
        ends = _LimitedEnds(none, none, trajectory.limit)
        return params, trajectory.carry, ends, jnp.zeros((0,)), jnp.zeros((), bool)

    def attempt(self, params: Params, carry: Carry) -> Carry:
        """The trajectory after one more attempt."""
        return self.crossing.attempt(params, ReturnState(carry, (), jnp.zeros(()))).carry

    def poll(self, params: Params, carry: Carry, ends: _LimitedEnds) -> Any:
        """The test whether the return has ended, as `OneLane.poll` returns it."""
        ended = self.crossing.ended(ReturnState(carry, (), ends.limit))
        status = jnp.where(ended, Status.complete, Status.running)
        ends = dataclasses.replace(ends, status=status.astype(jnp.int32))
        return carry, ends, jnp.zeros((0,)), jnp.zeros((), bool)


class ReturnsWithoutXla:
    """The function of many points that follows each for one return, by kernels alone.

    XLA takes longer to compile a function around a kernel than a few hundred returns take, and cannot store
    it: where no derivative is asked for, what is before and after the return are kernels, too.

    Args:
        model, numerics: those of the return.
        begin: `(*point) -> (params, state)`, the parameters and the state of one point.
        end: `(params, Returned) -> results`, from the end of the return, mappings and lists of arrays.
        deciding: what decides the two functions besides the model.

    Raises:
        UnsupportedError: at its first call; the model uses operations that a scalar kernel does not have.
    """

    def __init__(
        self,
        model: Model,
        numerics: ResolvedNumerics,
        begin: Callable[..., tuple[Params, State]],
        end: Callable[[Params, Returned], Any],
        *deciding: Any,
    ) -> None:
        self._crossing = PoincareReturn(model, numerics, derivatives=False)
        self._lane = _PlainLane(self._crossing, begin)
        self._deciding = (numerics, *deciding)
        self._finish = end
        self._of_shapes: dict[Any, tuple[Any, ...]] = {}

    def __call__(self, *points: Any) -> Any:
        """The results of points, whose arrays have them as their first axis."""
        like = jax.tree.map(lambda x: jax.ShapeDtypeStruct(np.shape(x)[1:], np.asarray(x).dtype), points)
        key = jax.tree.structure(like), tuple(jax.tree.leaves(like))
        if key not in self._of_shapes:
            self._of_shapes[key] = self._compiled(like, repr(key))
        open_lanes, run, n_slots, read, finished = self._of_shapes[key]
        return finished(_followed(run, n_slots, open_lanes(*points), read))

    def _compiled(self, like: Any, key: str) -> tuple[Any, ...]:
        """The kernels before, of and after returns from points of these shapes, and the slots of a lane."""
        model = self._crossing.model
        deciding = (*self._deciding, key)
        opened = functools.cache(lambda: jax.eval_shape(self._lane.open, *like)[:3])  # traced if need be
        chunk = functools.cache(lambda: chunk_of(self._lane, *like))

        def stored_return(name: str, compute: Callable[[], Any], *others: Any) -> Any:
            return stored(f"plain_return_{name}", model, (*deciding, *others), compute)

        def end(slots: Float[Array, " slots"]) -> Any:
            leaves, structure = jax.tree.flatten(opened())
            params, carry, ends = jax.tree.unflatten(structure, split_like(slots, leaves))
            status = self._crossing.status(params, ReturnState(carry, (), ends.limit))
            return self._finish(params, (carry.t, carry.state, status))

        run, n_slots = cpu_program.compiled(
            chunk, stored_return, contraction=self._crossing.numerics.contraction, quick=True
        )
        open_lanes = over_rows(
            lambda *point: vector(self._lane.open(*point)[:3]),
            "plain_return_open",
            model,
            *deciding,
            all_rows=True,
        )
        read = np.arange(stored_return("slots", lambda: sum(leaf.size for leaf in jax.tree.leaves(opened()))))
        finished = over_rows(end, "plain_return_end", model, *deciding, all_rows=True)
        return open_lanes, run, n_slots, read, finished


def _float_tangents(tangents: Any) -> list[Array]:
    """The tangents of float leaves; those of modes have no numbers."""
    return [tangent for tangent in jax.tree.leaves(tangents) if tangent.dtype != jax.dtypes.float0]


def _unique_lanes(
    lanes: Float[np.ndarray, "lanes slots"],
) -> tuple[Float[np.ndarray, "unique slots"], Int[np.ndarray, " lanes"]]:
    """The unique lanes, and for each lane (n,) the index of its equal: a batch may repeat a point."""
    index_of: dict[bytes, int] = {}
    back = np.array([index_of.setdefault(lane.tobytes(), len(index_of)) for lane in lanes])
    return lanes[np.unique(back, return_index=True)[1]], back


def _slots(leaves: list[Leaf]) -> Int[np.ndarray, " slots"]:
    """The slots of arrays, one after the other."""
    return np.concatenate([np.arange(leaf.first, leaf.first + leaf.size) for leaf in leaves])
