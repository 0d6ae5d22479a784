"""Noise in a flow: dx = f(x) dt + g(x) dW, stepped with a fixed length along a path that a seed decides.

The equation is Ito's. A step is Euler-Maruyama's for the noise, with the drift of Heun's method,

    y = x + f(x) h + g(x) W,    x' = x + (f(x) + f(y)) h / 2 + g(x) W.

Where g is constant its strong order is 1 and its weak order 2; where g changes with the state they are 1/2
and 1. Source: Kloeden and Platen 1992, Numerical Solution of Stochastic Differential Equations, ch. 10, 14.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaitsweep.contract import FixedStepDynamics, Quantity, Rates
from gaitsweep.dynamics.random_numbers import normal

if TYPE_CHECKING:
    from gaitsweep.dynamics.declared_model import DeclaredModel

# The parameter of the seed, and the field of a state with the path.
SEED = Quantity("noise_seed", "1", "seed of the noise: the same seed is the same path", 0.0, whole=True)
PATH = "noise_path"
# Streams of a seed that models themselves hardly use, and those that are kept for each variable.
_FIRST_STREAM = 2.0**32
_COMPONENTS = 4096.0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class NoisePath:
    """A row's place on its path of noise: `steps` made, and the length `dt` (s) of the last one."""

    steps: Int[Array, ""]
    dt: Float[Array, ""]


@dataclasses.dataclass(frozen=True, eq=False)
class Diffusion:
    """The declared noise of a flow; see `diffusion`."""

    function: Callable[..., Mapping[str, Any]]


def diffusion(function: Callable[..., Mapping[str, Any]]) -> Any:
    """Declare a function (params, state) -> intensities of white noise in the flow, by name of variable.

    A variable x with the rate f and the intensity g follows the Ito equation dx = f dt + g dW, with a Wiener
    process W of its own; g has the unit of x per square root of a second. The model gets the parameter
    `noise_seed`, and steps of a fixed length, `numerics.dt`, which a job has to give: strong order 1 and weak
    order 2 where g is constant, 1/2 and 1 where it depends on the state.

    An event is looked for at the ends of steps, and its jump is applied where the drift met its surface
    within the step. So jumps have errors of time of the order of dt^2 where the guard depends on variables
    without noise of their own (angles whose rates are noisy); where noise itself moves the guard, a crossing
    and a return within one step are not seen, an error of the order of the square root of dt. A table has
    the end of its step as the time of a crossing, up to dt later.

    Example:
        >>> import numpy as np, gaitsweep as gs
        >>> class Particle(gs.DeclaredModel):
        ...     x = gs.variable("m", "place", 0.0)
        ...
        ...     def flow(self, p, s):
        ...         return {"x": -2.0 * s.x}
        ...
        ...     @gs.diffusion
        ...     def noise(self, p, s):
        ...         return {"x": 0.5}
        ...
        ...     def period(self, p):
        ...         return 1.0
        >>> run, dt = gs.FixedTime(duration=4.0), {"dt": 0.02}
        >>> ends = gs.sweep(Particle(), noise_seed=np.arange(4000), run=run, numerics=dt, verify=0).table
        >>> bool(abs(ends["x_end"].var() - 0.5**2 / (2.0 * 2.0)) < 0.005)
        True
    """
    return Diffusion(function)


@final
@dataclasses.dataclass(frozen=True)
class StochasticSteps(FixedStepDynamics):
    """The steps of a flow with declared noise."""

    model: DeclaredModel
    diffusion: Diffusion

    stochastic: ClassVar[bool] = True

    def step(
        self, params: Any, state: Any, dt: Float[Array, ""], share: Float[Array, ""] | float = 1.0, /
    ) -> Any:
        rates = self.model.flow(params, state)
        gains = self.diffusion.function(self.model, params, state)
        path = state.noise_path
        noise = {
            name: gain * self._kick(params, path.steps, dt, share, name, state)
            for name, gain in gains.items()
        }

        def moved(drift: Rates) -> dict[str, Any]:
            """The variables after these changes by the drift, and the noise."""
            values = {name: getattr(state, name) + change for name, change in drift.items()}
            for name, kick in noise.items():
                values[name] = values.get(name, getattr(state, name)) + kick
            return values

        predicted = state.replace(**moved({name: dt * rate for name, rate in rates.items()}))
        at_end = self.model.flow(params, predicted)
        drift = {name: 0.5 * dt * (rate + at_end[name]) for name, rate in rates.items()}
        return state.replace(**moved(drift), noise_path=NoisePath(path.steps + 1, dt))

    def _kick(
        self, params: Any, steps: Int[Array, ""], dt: Float[Array, ""], share: Any, name: str, state: Any
    ) -> Float[Array, " ..."]:
        """The increment of a variable's Wiener processes in a step.

        That of a whole step is the sum of those of its halves, so that the self-check, which repeats rows
        with half the step (`share` 1/2), compares motions along the same path.
        """
        place = float(list(self.model.declarations).index(name))
        shape = jnp.shape(getattr(state, name))
        stream = _FIRST_STREAM + _COMPONENTS * place + jnp.arange(float(jnp.size(getattr(state, name))))
        stream = jnp.reshape(stream, shape)
        half = share < 1.0
        count = steps.astype(float)
        first = normal(params.noise_seed, jnp.where(half, count, 2.0 * count), stream)
        second = normal(params.noise_seed, 2.0 * count + 1.0, stream)
        return jnp.sqrt(dt) * jnp.where(half, first, (first + second) * jnp.sqrt(0.5))

    def events(self, params: Any, before: Any, after: Any, /) -> Bool[Array, " events"]:
        return self.model.guards(params, after) >= 0.0

    def section(self, params: Any, before: Any, fired: Bool[Array, " events"], /) -> Bool[Array, ""]:
        return self.model.section(params, before, fired)

    def jump(self, params: Any, state: Any, fired: Bool[Array, " events"], /) -> Any:
        """The state after a jump where the drift met the surface, and after the rest of the step."""
        if not fired.size:
            return self.model.jump(params, state, fired)
        rates = self.model.flow(params, state)

        def heights(time: Float[Array, ""]) -> Float[Array, " guards"]:
            return self.model.guards(params, along_rates(state, rates, time))

        zero = jnp.zeros_like(state.noise_path.dt)
        height, slope = jax.jvp(heights, (zero,), (jnp.ones_like(zero),))
        rises = fired & (slope > 0.0)
        late = jnp.where(rises, height / jnp.where(rises, slope, 1.0), 0.0)
        # noise may have moved a state further than the drift does in a step
        late = jnp.minimum(jnp.max(late, initial=0.0), state.noise_path.dt)
        after = self.model.jump(params, along_rates(state, rates, -late), fired)
        return along_rates(after, self.model.flow(params, after), late)

    def longest_step(self, params: Any, /) -> None:
        return None


def along_rates(state: Any, rates: Rates, time: Float[Array, ""]) -> Any:
    """The state a time (s) later at these rates."""
    return state.replace(**{name: getattr(state, name) + time * rate for name, rate in rates.items()})
