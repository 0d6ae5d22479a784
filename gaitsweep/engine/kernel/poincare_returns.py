"""Ways to the next crossing as scalar kernels: each lane one state, or a state and one direction.

JAX sees a function with a derivative of its own (forward mode): all directions of a Jacobian are lanes of one
call. The derivative is that of the same straight-line attempt, by JAX's own differentiation of it. Where only
images are asked for, a kernel without derivatives is a third of the work.
"""

from __future__ import annotations

import dataclasses
import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import Params, State, Status
from gaitsweep.engine.kernel import cpu
from gaitsweep.engine.kernel.chunk import Leaf, chunk_of
from gaitsweep.engine.poincare.poincare_return import Aloft, Flight
from gaitsweep.engine.sweep.leaves import numbers_of, tangent_of, vector, with_numbers

# Looks in one call of the kernel: every way ends long before.
_POLLS = 1 << 40


@partial(jax.tree_util.register_dataclass, data_fields=["status", "filled"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class _Ends:
    """Whether a lane has ended, a `Status`; no buffer is ever `filled`."""

    status: jax.Array
    filled: jax.Array


@partial(jax.tree_util.register_dataclass, data_fields=["aloft", "rate"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class _Way:
    """A way, and the `rate` of its numbers along one direction, or nothing."""

    aloft: Aloft
    rate: Any

    @property
    def halt(self) -> Any:
        return self.aloft.carry.halt


class _Lane:
    """A flight, and its derivative along one direction, as the functions that a kernel's chunk is made of.

    What is held are the parameters and their direction. A way without a rate has no derivative.
    """

    def __init__(self, flight: Flight) -> None:
        self.flight = flight

    def open(self, held: Any, way: _Way) -> Any:
        none = jnp.zeros((), jnp.int32)
        return held, way, _Ends(none, none), jnp.zeros((0,)), jnp.zeros((), bool)

    def attempt(self, held: Any, way: _Way) -> _Way:
        (params, along), aloft = held, way.aloft
        if not way.rate:
            return _Way(self.flight.attempt(params, aloft), [])

        def moved(numbers: Any, moving: Any) -> Any:
            after = self.flight.attempt(with_numbers(params, numbers), with_numbers(aloft, moving))
            return numbers_of(after), after

        before = numbers_of(params), numbers_of(aloft)
        _, rate, after = jax.jvp(moved, before, (along, way.rate), has_aux=True)
        return _Way(after, rate)

    def poll(self, held: Any, way: _Way, ends: _Ends) -> Any:
        status = jnp.where(self.flight.ended(way.aloft), Status.complete, Status.running)
        ends = dataclasses.replace(ends, status=status.astype(jnp.int32))
        return way, ends, jnp.zeros((0,)), jnp.zeros((), bool)


class KernelFlights:
    """The function `(params, state) -> (t, state, way)` of a flight, by a kernel on the CPU's cores.

    Args:
        flight: what it flies.
        params, state: arrays, or shapes, like those that it will be given.

    Raises:
        UnsupportedError: the model computes with what a scalar kernel cannot express.
    """

    def __init__(self, flight: Flight, params: Params, state: State) -> None:
        self.flight = flight
        opened = jax.eval_shape(self._opened, params, state)
        self._shape = opened[1]
        held, carry = jax.eval_shape(self._still, *opened)
        self._plain = _Kernel(flight, held, carry, "way")
        held, carry = jax.eval_shape(self._resting, *opened)
        self._differentiated = _Kernel(flight, held, carry, "way with derivative")
        # what is read at a way's end: all of it, and the rates of the state's numbers and then of the time,
        # which come first in a carry
        self._ends = _slots(jax.tree.leaves(self._plain.way.aloft))
        self._rates = _slots(self._differentiated.way.rate[: len(numbers_of(state)) + 1])
        self._function = jax.custom_jvp(self._value)
        self._function.defjvp(self._slope)

    def __call__(self, params: Params, state: State) -> tuple[jax.Array, State, jax.Array]:
        return self._function(params, state)

    def _opened(self, params: Params, state: State) -> tuple[Params, Aloft]:
        return params, self.flight.begin(params, state)

    def _still(self, params: Params, aloft: Aloft) -> Any:
        """What a lane holds and carries, along no direction."""
        return (params, []), _Way(aloft, [])

    def _resting(self, params: Params, aloft: Aloft) -> Any:
        """The same along a direction of zeros."""
        nothing = jax.tree.map(jnp.zeros_like, (numbers_of(params), numbers_of(aloft)))
        return (params, nothing[0]), _Way(aloft, nothing[1])

    def _value(self, params: Params, state: State) -> tuple[jax.Array, State, jax.Array]:
        held, carry = self._still(*self._opened(params, state))
        flown = self._fly(self._plain, vector((held, carry)), self._ends)
        aloft, at = [], 0
        for leaf in jax.tree.leaves(self._shape):
            size = int(np.prod(leaf.shape))
            aloft.append(flown[at : at + size].reshape(leaf.shape).astype(leaf.dtype))
            at += size
        ended: Aloft = jax.tree.unflatten(jax.tree.structure(self._shape), aloft)
        return ended.carry.t, ended.carry.state, self.flight.way(ended)

    def _slope(self, primals: Any, tangents: Any) -> Any:
        params, state = primals
        along, rate = (
            [dot for leaf, dot in zip(jax.tree.leaves(tree), jax.tree.leaves(dots), strict=True)]
            for tree, dots in zip(primals, tangents, strict=True)
        )
        along = [dot for dot in along if dot.dtype != jax.dtypes.float0]
        rate = [dot for dot in rate if dot.dtype != jax.dtypes.float0]

        def begun(numbers: Any, moving: Any) -> Any:
            aloft = self.flight.begin(with_numbers(params, numbers), with_numbers(state, moving))
            return numbers_of(aloft), aloft

        _, rate, aloft = jax.jvp(begun, (numbers_of(params), numbers_of(state)), (along, rate), has_aux=True)
        flown = self._fly(self._differentiated, vector(((params, along), _Way(aloft, rate))), self._rates)
        pieces, at = [], 0
        for leaf in (*numbers_of(state), jnp.zeros(())):
            size = int(np.prod(jnp.shape(leaf)))
            pieces.append(flown[at : at + size].reshape(jnp.shape(leaf)))
            at += size
        value = self._function(params, state)
        *numbers, t = pieces
        return value, (t, tangent_of(state, numbers), np.zeros((), jax.dtypes.float0))

    def _fly(self, kernel: _Kernel, slots: jax.Array, read: np.ndarray) -> jax.Array:
        """What stands in the slots `read` (n,) of a lane when its way has ended, from where it begins."""
        result = jax.ShapeDtypeStruct((read.size,), jnp.float64)
        return jax.pure_callback(partial(kernel, read), result, slots, vmap_method="legacy_vectorized")


class _Kernel:
    """Ways compiled for the CPU's cores, from what lanes hold and carry."""

    def __init__(self, flight: Flight, held: Any, carry: Any, title: str) -> None:
        self._chunk = chunk_of(_Lane(flight), held, carry)  # type: ignore[arg-type]
        self._run = cpu.compiled(self._chunk, f"{flight.model.name}, {title}")
        self.way: _Way = self._chunk.carry

    def __call__(self, read: np.ndarray, slots: Any) -> np.ndarray:
        slots = np.asarray(slots)
        lanes, back = _different(slots.reshape(-1, slots.shape[-1]))
        tiles = -(-len(lanes) // cpu.TILE)
        # the last tile is filled up with its own last lane, which costs nothing
        order = np.minimum(np.arange(tiles * cpu.TILE), len(lanes) - 1)
        room = np.zeros((tiles, cpu.slots(self._chunk), cpu.TILE))
        room[:, : lanes.shape[1]] = lanes[order].reshape(tiles, cpu.TILE, -1).transpose(0, 2, 1)
        kept = np.zeros((tiles * cpu.TILE, 0, 0))
        with ThreadPoolExecutor(_cores()) as pool:
            flat = room.reshape(tiles, -1)
            list(pool.map(lambda i: self._run(flat[i : i + 1], kept, _POLLS), range(tiles)))
        found = room[:, read].transpose(0, 2, 1).reshape(tiles * cpu.TILE, -1)[back]
        return found.reshape(*slots.shape[:-1], read.size)


def _different(lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lanes that differ, and for each (n,) which of them it is: points may have been filled up."""
    seen: dict[bytes, int] = {}
    back = np.array([seen.setdefault(lane.tobytes(), len(seen)) for lane in lanes])
    return lanes[np.unique(back, return_index=True)[1]], back


def _slots(leaves: list[Leaf]) -> np.ndarray:
    return np.concatenate([np.arange(leaf.first, leaf.first + leaf.size) for leaf in leaves])


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
