"""The integration methods by name: their steps, limits, and requirements on a model."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp

from gaitsweep.contract import FixedStepDynamics, HybridModel, Model, Params, State
from gaitsweep.dynamics.ground import is_uneven
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.solver.exponential import PROPAGATOR, PROPAGATOR6, exponential
from gaitsweep.engine.solver.rosenbrock import MAX_VARIABLES, rodas5p
from gaitsweep.engine.solver.runge_kutta import Step, euler_update, rk4, tsit5
from gaitsweep.engine.solver.taylor import lacking_recurrence, taylor
from gaitsweep.engine.stored_traces import counts_of_state, shapes_of, stored
from gaitsweep.engine.switches import curving_operation, moving_operations
from gaitsweep.errors import ArgumentError

# The dtype of states and times; mixed: they are float64, and steps are passed to the model as float32.
Precision = Literal["float64", "float32", "mixed"]


@dataclasses.dataclass(frozen=True)
class Method:
    """An integration method, its steps after an event, and its longest step.

    Short steps are needed after an event, which excites stiff modes (a foot on hard ground) that decay within
    a few steps, and since feet may lift off and touch down again within milliseconds.

    Attributes:
        step: returns the function that steps a model; None if the model has its own.
        first_step: the first step after an event, as a share of the longest step (of the last one if
            `adaptive`).
        growth: the factor by which each accepted step may exceed the one before, up to the longest.
        linear_only: whether it is accurate only for `HybridModel.linear`.
        adaptive: whether its step is an `Estimate`, with step control.
        series: whether its steps are expansions, of the order that the tolerance asks for.
        limits: pairs of a damping ratio, in rising order, and the largest accurate dt times rate of a motion
            with that damping ratio.
    """

    step: Callable[..., Any] | None
    first_step: float
    growth: float
    linear_only: bool = False
    adaptive: bool = False
    series: bool = False
    limits: tuple[tuple[float, float], ...] = ()


# On the negative axis the polynomials approximate exp(z) down to -20. Away from the axis they are accurate
# closer to zero and stable farther out. The short steps after an event damp fast motions before the longest
# step is reached, so the limits are between accuracy and stability (`tests/engine/test_solver.py`).
METHODS: dict[str, Method] = {
    "tsit5": Method(tsit5, first_step=0.25, growth=5.0, adaptive=True),
    "taylor": Method(taylor, first_step=0.5, growth=4.0, adaptive=True, series=True),
    "rodas5p": Method(rodas5p, first_step=0.25, growth=5.0, adaptive=True),
    "rk4": Method(rk4, first_step=0.125, growth=1.25, limits=((0.0, 2.6), (0.65, 2.6), (1.0, 2.7))),
    "propagator6": Method(
        exponential(PROPAGATOR6),
        first_step=1.0 / 32.0,
        growth=2.0,
        linear_only=True,
        limits=((0.0, 2.0), (0.26, 4.5), (0.5, 5.1), (0.71, 6.1), (0.87, 7.8), (0.966, 11.8), (0.985, 14.6),
                (1.0, 20.0)),
    ),
    "propagator": Method(
        exponential(PROPAGATOR),
        first_step=1.0 / 32.0,
        growth=2.0,
        linear_only=True,
        limits=((0.0, 3.0), (0.26, 7.4), (0.5, 8.7), (0.71, 10.9), (0.87, 14.4), (0.966, 19.0), (1.0, 20.0)),
    ),
    "semi_implicit": Method(None, first_step=1.0, growth=1.0),
}  # fmt: skip

# The methods that take the steps of the model itself.
_OWN = ", ".join(name for name, method in METHODS.items() if method.step is None)

__all__ = [
    "METHODS",
    "Method",
    "Precision",
    "Step",
    "derivative_refusal",
    "euler_update",
    "fixed_step_scheme",
    "refusal",
]


def fixed_step_scheme(name: str, model: Model) -> FixedStepDynamics | None:
    """The model's own fixed steps, if it has nothing else or the method is semi_implicit; else None.

    Args:
        name: a name of `METHODS`.
        model: the model.

    Raises:
        ArgumentError: the method needs a flow, but the model has only steps.
    """
    if not isinstance(model, HybridModel):
        return model if isinstance(model, FixedStepDynamics) else None
    reason = _steps_alone(name, model)
    if reason is not None:
        raise ArgumentError(f"The method {reason}")
    return model.fixed_step_scheme() if METHODS[name].step is None else None


def refusal(name: str, model: Model, precision: Precision) -> str | None:
    """The reason why a method does not suit a model and a precision, or None; it follows the field's name.

    Args:
        name: a name of `METHODS`.
        model: the model.
        precision: that of the states and times.
    """
    if METHODS[name].step is None and fixed_step_scheme(name, model) is None:
        linear = isinstance(model, HybridModel) and model.linear
        return (
            f"is {name}, a step that {model.name} does not have. Allowed: {_allowed(model, linear=linear)}."
        )
    reason = _steps_alone(name, model)
    if reason is not None:
        return reason
    if precision == "mixed" and fixed_step_scheme(name, model) is None:
        return f"is {name}, but precision mixed is for steps of fixed length. Allowed in mixed: {_OWN}."
    if METHODS[name].adaptive and isinstance(model, HybridModel):
        return _adaptive_refusal(name, model, precision)
    if METHODS[name].linear_only:
        return _refusal_of_linear_method(name, model, precision)
    return None


def _allowed(model: Model, *, linear: bool) -> str:
    """The methods whose steps a model can take, with those for linear flows if `linear`."""
    names = []
    for name, method in METHODS.items():
        if (linear or not method.linear_only) and (method.step or fixed_step_scheme(name, model) is not None):
            names.append(name)
    return ", ".join(names)


def _refusal_of_linear_method(name: str, model: Model, precision: Precision) -> str | None:
    """The reason why a method for linear flows does not suit a model and a precision, or None."""
    general = _allowed(model, linear=False)
    needs = "needs a flow that is linear in the state between events"
    if not (isinstance(model, HybridModel) and model.linear):
        lacks = f"{model.name} does not declare that of its flow"
        return f"is {name}, which {needs}, but {lacks}. Allowed: {general}."
    if precision != "float64":
        return f"is {name}, which needs numerics.precision float64. Allowed in {precision}: {general}."
    if _hides_derivative(model):
        hides = f"stop_gradient hides a part of it in {model.name}"
        return f"is {name}, whose matrix is the derivative of the flow, but {hides}. Allowed: {general}."
    if (curved := _curving_operation(model)) is not None:
        has = f"the flow of {model.name}, whose class states `linear`, has '{curved}' of what it moves"
        return f"is {name}, which {needs}, but {has}: remove `linear`. Allowed: {general}."
    return None


@cached_by_content(maxsize=64)
def _curving_operation(model: HybridModel) -> str | None:
    """The name of an operation by which the flow of a model is not affine between switches, or None."""
    return stored("curving", model, (), lambda: curving_operation(model, *shapes_of(model)))


@cached_by_content(maxsize=64)
def _hides_derivative(model: HybridModel) -> bool:
    """Whether the flow of a model has a moving part without derivative, by `stop_gradient`."""
    return stored(
        "hides_derivative", model, (), lambda: "stop_gradient" in moving_operations(model, *shapes_of(model))
    )


def _adaptive_refusal(name: str, model: HybridModel, precision: Precision) -> str | None:
    """The `refusal` of a method with step control."""
    if METHODS[name].series and (lacking := lacking_recurrence(model)):
        return f"is {name}, which has no recurrence for {lacking} in {model.name}: use tsit5."
    if name != "rodas5p":
        return None
    if precision != "float64":
        return f"is {name}, which needs numerics.precision float64."
    size, _ = counts_of_state(model)
    if size > MAX_VARIABLES:
        return f"is {name}, for at most {MAX_VARIABLES} variables, but {model.name} has {size}: use tsit5."
    if (lacking := _lacking_derivative(model)) is not None:
        words = lacking.rstrip(".")
        return (
            f"is {name}, which takes the flow's derivative, but JAX has none in {model.name} ({words}). Use"
            " tsit5, or write x.at[i].set(f(x[i])) for x.at[i].apply(f), and custom_jvp for custom_vjp."
        )
    return None


@cached_by_content(maxsize=64)
def _lacking_derivative(model: HybridModel) -> str | None:
    """JAX's words about an operation of a flow without derivative; None if all have one."""
    return stored("lacking_derivative", model, (), lambda: _refused_derivative(model))


def _refused_derivative(model: HybridModel) -> str | None:
    """The result of `_lacking_derivative`, for which the model is traced."""

    def derived(params: Params, state: State) -> Any:
        moving = {name: getattr(state, name) for name in jax.eval_shape(model.flow, params, state)}
        flow = lambda moved: model.flow(params, dataclasses.replace(state, **moved))  # noqa: E731
        along = lambda tangent: jax.jvp(flow, (moving,), (tangent,))  # noqa: E731
        # a flow with a `custom_vjp` is refused only under `vmap`, as in a Jacobian
        return jax.vmap(along)(jax.tree.map(lambda leaf: jnp.expand_dims(leaf, 0), moving))

    try:
        jax.eval_shape(derived, *shapes_of(model))
    except (NotImplementedError, TypeError, ValueError) as error:  # those of callbacks and `custom_vjp`
        return str(error)
    return None


def derivative_refusal(name: str, model: Model) -> str | None:
    """The reason why a return map by a method has no derivative, with an alternative; None if it has one.

    Args:
        name: a name of `METHODS`.
        model: the model.

    Raises:
        ArgumentError: the method needs a flow, but the model has only steps.
    """
    if is_uneven(model):
        return (
            "the ground differs from place to place, so no step repeats another. Use even ground, or runs of "
            "kind fixed_time and return_map."
        )
    steps = fixed_step_scheme(name, model)
    if steps is None or steps.is_return_map:
        return None
    # so a derivative of the steps lacks the effect of event times, however short they are
    reason = "steps have a fixed length, and an event is met at the end of one"
    if isinstance(model, HybridModel) and _steps_alone("rk4", model) is None:
        return f"{reason}. Use rk4."
    return (
        f"{reason}; {model.name} has no other method. Instead, fit a straight line through the images of "
        "points that are so far apart that events move by many steps, or follow stable "
        "gaits by a run of kind staircase."
    )


def _steps_alone(name: str, model: Model) -> str | None:
    """The reason why a method is refused for a model that has only its own steps, or None."""
    if METHODS[name].step is None or (isinstance(model, HybridModel) and model.locates_events):
        return None
    structure = []
    if isinstance(model, HybridModel):  # of another model no structure has a flow
        for field in dataclasses.fields(model):  # pyright: ignore[reportArgumentType] (each is a dataclass)
            value = getattr(model, field.name)
            if value != field.default:
                structure.append(f"{field.name} {value}")
    with_structure = f" with {', '.join(structure)}" if structure else ""
    return f"is {name}, which needs a flow, but {model.name} has only steps{with_structure}. Allowed: {_OWN}."
