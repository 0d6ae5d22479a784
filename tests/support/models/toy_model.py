"""A user's own model for the tests: preloaded springs that bounce on a floor, known in closed form.

Each of N masses (kg) hangs on a spring (stiffness k, N/m) whose rest lies `preload` (m) below a rigid
floor at height 0, so it always falls back: x'' = -w^2 (x + d), w = sqrt(k/m), d the preload. At the
floor the speed u turns into `restitution` u + `kick`. Between bounces the motion is harmonic, hence, with u
the launch speed:

    flight time   T(u) = 2/w atan(u/(w d)),    landing speed = u,    apex = sqrt(d^2 + (u/w)^2) - d
    launch speeds u_n = u* + (u_0 - u*) r^n,   u* = kick/(1 - r),    bounce n at  T(u_0) + ... + T(u_{n-1})
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.contract import HybridModel, Quantity, Rates

# Seconds by which a rising mass counts as still far from the floor: a bounce re-arms its guard at once.
_REARM = 0.1


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["mass", "stiffness", "preload", "restitution", "kick", "kicking", "ceiling"],
    meta_fields=[],
)
@dataclasses.dataclass(frozen=True)
class Params:
    """Scalars, in the units of `Toy.parameters`."""

    mass: jax.Array
    stiffness: jax.Array
    preload: jax.Array
    restitution: jax.Array
    kick: jax.Array
    kicking: jax.Array
    ceiling: jax.Array


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["height", "speed", "launch", "bounces"], meta_fields=[]
)
@dataclasses.dataclass(frozen=True)
class State:
    """Heights (m) and speeds (m/s), (N,); the modes: launch speeds (m/s) and bounces so far, (N,)."""

    height: jax.Array
    speed: jax.Array
    launch: jax.Array
    bounces: jax.Array


@dataclasses.dataclass(frozen=True)
class Toy(HybridModel):
    """N bouncing masses that do not touch each other; the section is the bounce of mass 1."""

    N: int = dataclasses.field(default=1, metadata={"meaning": "number of masses", "low": 1, "high": 8})

    name: ClassVar[str] = "toy"
    source: ClassVar[str] = "this file: harmonic flight in closed form"
    gaits: ClassVar[tuple[str, ...]] = ("rest", "hop")

    @property
    def precisions(self) -> tuple[str, ...]:
        return ("float64", "float32")

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return (
            Quantity("mass", "kg", "mass", 1.0, low=0.0, open_ends=True),
            Quantity("stiffness", "N/m", "spring", 4.0, low=0.0, open_ends=True),
            Quantity("preload", "m", "rest of the spring below the floor", 0.5, low=0.0, open_ends=True),
            Quantity("restitution", "1", "share of the speed that a bounce keeps", 0.5, low=0.0, high=0.99),
            Quantity("kick", "m/s", "speed that a bounce adds", "0.25*sqrt(stiffness/mass)", low=0.0),
            Quantity("kicking", "1", "1: the floor kicks; 0: it does not", 1.0, low=0.0, high=1.0),
            Quantity("ceiling", "m", "height at which a mass counts as fallen", 1000.0, low=0.0),
        )

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return tuple(
            Quantity(
                f"launch_{i}", "m/s", f"launch speed of mass {i} from the floor", 1.0, low=0.0, open_ends=True
            )
            for i in range(1, self.N + 1)
        )

    @property
    def observables(self) -> tuple[Quantity, ...]:
        masses = range(1, self.N + 1)
        return tuple(
            Quantity(f"launch_{i}", "m/s", f"launch speed of mass {i}'s last bounce") for i in masses
        )

    @property
    def signals(self) -> tuple[Quantity, ...]:
        masses = range(1, self.N + 1)
        return (
            *(Quantity(f"height_{i}", "m", f"height of mass {i}") for i in masses),
            *(Quantity(f"speed_{i}", "m/s", f"speed of mass {i}") for i in masses),
        )

    @property
    def label_fields(self) -> tuple[Quantity, ...]:
        return (Quantity("apex", "m", "height that mass 1 reaches"),)

    def params(self, values: Mapping[str, jax.Array]) -> Params:
        return Params(**{field.name: jnp.asarray(values[field.name]) for field in dataclasses.fields(Params)})

    def init(self, params: Params, start: Mapping[str, jax.Array]) -> State:
        launch = jnp.stack([jnp.asarray(start[f"launch_{i}"]) for i in range(1, self.N + 1)])
        return State(jnp.zeros_like(launch), launch, launch, jnp.zeros(self.N, dtype=jnp.int32))

    def flow(self, params: Params, state: State) -> Rates:
        pull = params.stiffness / params.mass * (state.height + params.preload)
        return {"height": state.speed, "speed": -pull}

    def guards(self, params: Params, state: State) -> jax.Array:
        return -state.height - _REARM * jnp.maximum(state.speed, 0.0)

    def jump(self, params: Params, state: State, fired: jax.Array) -> State:
        launch = params.restitution * jnp.abs(state.speed) + params.kicking * params.kick
        return State(
            height=jnp.where(fired, 0.0, state.height),
            speed=jnp.where(fired, launch, state.speed),
            launch=jnp.where(fired, launch, state.launch),
            bounces=state.bounces + fired.astype(jnp.int32),
        )

    def section(self, params: Params, before: State, fired: jax.Array) -> jax.Array:
        return fired[0]

    def observe(self, params: Params, state: State) -> dict[str, jax.Array]:
        return {f"launch_{i + 1}": state.launch[i] for i in range(self.N)}

    def signal(self, params: Params, state: State) -> dict[str, jax.Array]:
        heights = {f"height_{i + 1}": state.height[i] for i in range(self.N)}
        return {**heights, **{f"speed_{i + 1}": state.speed[i] for i in range(self.N)}}

    def label(self, params: Params, observations: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        launch = jnp.asarray(observations["launch_1"])
        reach = jnp.sqrt(params.preload**2 + launch**2 * params.mass / params.stiffness)
        return {"gait": (launch > 1e-3).astype(jnp.int32), "apex": reach - params.preload}

    def failed(self, params: Params, state: State) -> jax.Array:
        """Whether a mass is above the ceiling."""
        return jnp.any(state.height > params.ceiling)

    def period(self, params: Params) -> jax.Array:
        # The longest flight there is, half a turn of the spring.
        return jnp.pi * jnp.sqrt(params.mass / params.stiffness)


def flight_time(launch: float | np.ndarray, frequency: float, preload: float) -> np.ndarray:
    """Seconds from a launch (m/s) to the next landing; frequency in rad/s, preload in m."""
    return 2.0 / frequency * np.arctan(np.asarray(launch) / (frequency * preload))


def launches(first: float, restitution: float, kick: float, count: int) -> np.ndarray:
    """The launch speeds (m/s) of a start and of the `count` bounces after it, (count + 1,)."""
    settled = kick / (1.0 - restitution)
    return settled + (first - settled) * restitution ** np.arange(count + 1)


def bounce_times(
    first: float, frequency: float, preload: float, restitution: float, kick: float, count: int
) -> np.ndarray:
    """The instants (s) of the first `count` bounces, (count,)."""
    return np.cumsum(flight_time(launches(first, restitution, kick, count)[:-1], frequency, preload))
