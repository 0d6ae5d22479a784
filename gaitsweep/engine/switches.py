"""Detection of switches of a flow within a step, and of models whose flow or guards are not smooth.

A flow may switch at an instant: `jnp.where(clock > 1.0, ...)`. Comparisons, signs and rounded values of
moving variables are found in its program, and a step across which one of them changes is shortened. The
differences that decide a comparison, a sign, a maximum or a minimum are evaluated inside the step as well, as
guards are, so that a pulse that begins and ends there is met.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Var, jaxpr_as_fun
from jaxtyping import Array, Float

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.carry import Flag, Number
from gaitsweep.engine.hidden_events import PROBES, may_hide, slopes_along, unresolved

# The argument below which exp is too small for step control (2e-9).
NEGLIGIBLE = -20.0
# The argument beyond which tanh and similar functions are constant (within 2e-7).
SATURATION = 8.0
# Operations whose results are constant between switches of a flow, and those whose arguments decide a switch
# by the sign of their difference.
_CAST = "convert_element_type"
_LEVELS = {"lt", "le", "gt", "ge", "sign", "floor", "ceil", "round", "argmax", "argmin", _CAST}
_SURFACES = {**dict.fromkeys(("lt", "le", "gt", "ge", "max", "min", "abs", "sign"), 0.0), "exp": NEGLIGIBLE}
_SATURATED = {"tanh", "logistic", "erf"}
_LARGEST = {"reduce_max", "argmax"}
_EXTREMES = {*_LARGEST, "reduce_min", "argmin"}
_SWITCHES = {*_LEVELS, *_SURFACES, *_SATURATED, *_EXTREMES, "rem", "clamp"}
# Operations that are not linear in their arguments; `_MULTILINEAR` ones are in each argument alone.
_CURVED = {
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
    *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    *("exp", "exp2", "expm1", "log", "log1p", "log2", "logistic", "erf", "erfc", "erf_inv", "lgamma"),
    *("sqrt", "rsqrt", "cbrt", "pow", "square"),
    *("custom_jvp_call", "custom_vjp_call"),  # of functions that are not written out
}
_MULTILINEAR = {"mul", "dot_general"}
# Operations that are finite at zero, where they have no derivative: in the drag of a body that is at rest.
ROOTS = {"sqrt", "cbrt", "pow"}
# Operations that are smooth in all their arguments, or in the arguments with these numbers.
_SMOOTH = {
    *("broadcast_in_dim", "reshape", "squeeze", "slice", "concatenate", "unstack", "stack", "transpose"),
    *("copy", "rev", "add", "sub", "mul", "neg", "square", "sin", "cos", "exp", "reduce_sum", "dot_general"),
}
_SMOOTH_IN = {"div": {0}, "select_n": {1, 2}, "gather": {0}, "dynamic_slice": {0}}
# The parameters of an equation that hold an inner program, and functions of JAX that are smooth, although
# their inner programs have a maximum.
_INNER = ("jaxpr", "call_jaxpr", "fun_jaxpr")
_CALLS = {
    *("jit", "pjit", "closed_call", "core_call", "checkpoint", "remat2"),
    *("custom_jvp_call", "custom_vjp_call", "custom_vjp_call_jaxpr"),
}
_SMOOTH_CALLS = {"logaddexp", "logaddexp2"}


class Switching(NamedTuple):
    """Possible switches of a flow at one state.

    Attributes:
        levels: the truths of comparisons, signs and rounded numbers (n,): constant between switches, and
            different by 1 or more after one.
        surfaces: the differences (m,) whose signs decide a comparison, a sign, a maximum or a minimum.
    """

    levels: Float[Array, " levels"]
    surfaces: Float[Array, " surfaces"]


def inner_program(equation: JaxprEqn) -> ClosedJaxpr | None:
    """The program of a checkpoint, or of a function with derivatives of its own; None of other operations."""
    if equation.primitive.name not in _CALLS:  # loops and reductions have programs of one round
        return None
    inner = next((equation.params[key] for key in _INNER if key in equation.params), None)
    return inner if inner is None or isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, [])


def _written_out(equation: JaxprEqn) -> ClosedJaxpr | None:
    """The inner program of an equation whose operations count; None where the equation itself counts."""
    inner = inner_program(equation)
    if inner is None or (written := inner.jaxpr.debug_info) is None:
        return inner
    # a user's function may have the same name
    of_jax = (written.func_filename or "").startswith(os.path.dirname(jax.__file__) + os.sep)
    return None if of_jax and written.func_name in _SMOOTH_CALLS else inner


def _program(
    function: Callable[[Params, State], Any], params: Params, state: State
) -> tuple[ClosedJaxpr, Any]:
    """The program of a function, with inner programs written out, and the shapes of its results."""
    with jax.disable_jit():  # the program of a jitted function is then inlined
        closed, shapes = jax.make_jaxpr(function, return_shape=True)(params, state)
        if any(_written_out(equation) for equation in closed.jaxpr.eqns):
            inputs = [jax.ShapeDtypeStruct(aval.shape, aval.dtype) for aval in closed.in_avals]
            closed = jax.make_jaxpr(partial(_results, closed))(*inputs)
    return closed, shapes


def _results(closed: ClosedJaxpr, *args: Array) -> list[Array]:
    """The results of a program, by the operations of its inner programs."""
    program = closed.jaxpr
    values = dict(zip((*program.constvars, *program.invars), (*closed.consts, *args), strict=True))
    for equation in program.eqns:
        inner = _written_out(equation)
        if inner is None:
            inputs = list(dict.fromkeys(v for v in equation.invars if not isinstance(v, Literal)))
            alone = program.replace(constvars=[], invars=inputs, outvars=equation.outvars, eqns=[equation])
            results = _function(alone, [])(*(values[v] for v in inputs))
        else:
            results = _results(inner, *_read(equation.invars, values))
        values.update(zip(equation.outvars, results, strict=True))
    return _read(program.outvars, values)


def _function(program: Jaxpr, constants: Sequence[Array]) -> Callable[..., list[Array]]:
    """The function of a program that was made from another one."""
    names = program.debug_info and program.debug_info._replace(arg_names=None, result_paths=None)
    return jaxpr_as_fun(ClosedJaxpr(program.replace(debug_info=names), constants))


def _read(atoms: Sequence[Any], values: Mapping[Var, Array]) -> list[Array]:
    """The values of variables and numbers."""
    return [atom.val if isinstance(atom, Literal) else values[atom] for atom in atoms]


def switching(flow: Callable[[Params, State], Rates], params: Params, state: State) -> Switching:
    """Possible switches of a flow as its variables move, from its program without loops and branches.

    Args:
        flow: the flow.
        params: its parameters.
        state: the state.
    """
    closed, rates = _program(flow, params, state)
    program = closed.jaxpr
    inputs = jax.tree.leaves((params, state))
    equations = [e for e, _ in _moving(program, state, rates) if e.primitive.name in _SWITCHES]
    variables = _variables(equations)
    part = _function(program.replace(outvars=variables), closed.consts)
    values = dict(zip(variables, part(*inputs), strict=True))
    levels = [jnp.zeros((0,))]
    surfaces = [jnp.zeros((0,))]
    for equation in equations:
        args = _read(equation.invars, values)
        if all(jnp.issubdtype(jnp.result_type(argument), jnp.floating) for argument in args):
            result = values[equation.outvars[0]]
            levels += [jnp.ravel(level) for level in _levels(equation, args, result)]
            surfaces += [jnp.ravel(surface) for surface in _surfaces(equation, args)]
    return Switching(jnp.concatenate(levels), jnp.concatenate(surfaces))


def _variables(equations: list[JaxprEqn]) -> list[Var]:
    """The arguments of equations and their first results, each once."""
    variables: dict[Var, None] = {}
    for equation in equations:
        for variable in (*equation.invars, equation.outvars[0]):
            if not isinstance(variable, Literal):
                variables[variable] = None
    return list(variables)


def _levels(equation: JaxprEqn, args: list[Array], result: Array) -> list[Array]:
    """The levels of an operation (see `Switching`), from its arguments and its result; most have none."""
    operation = equation.primitive.name
    if operation == "rem":
        return [jnp.floor(args[0] / jnp.where(args[1] == 0.0, 1.0, args[1]))]
    if operation in _SATURATED:  # the saturated ends differ by 1, each of them from the middle by 0.5
        return [jnp.where(jnp.abs(args[0]) > SATURATION, 0.5 * jnp.sign(args[0]), 0.0)]
    if operation in _LEVELS and (operation != _CAST or not jnp.issubdtype(result.dtype, jnp.inexact)):
        return [result.astype(float)]
    return []


def _surfaces(equation: JaxprEqn, args: list[Array]) -> list[Array]:
    """The surfaces of an operation (see `Switching`), from its arguments; most have none."""
    operation = equation.primitive.name
    if operation in _EXTREMES:
        return [_ahead(operation, args[0], equation.params["axes"])]
    if operation == "clamp":
        lowest, value, highest = args
        return [value - lowest, value - highest]
    if operation in _SURFACES:
        return [args[0] - (args[1] if len(args) > 1 else _SURFACES[operation])]
    return []


def _ahead(operation: str, values: Float[Array, " ..."], axes: Sequence[int]) -> Float[Array, " ..."]:
    """The distance of each element beyond all others over some axes; above zero for the extreme one."""
    flat = jnp.moveaxis(values if operation in _LARGEST else -values, axes, range(len(axes)))
    flat = flat.reshape(-1, *flat.shape[len(axes) :])
    if len(flat) < 2:
        return jnp.zeros((0,))
    others = [jnp.concatenate([flat[:i], flat[i + 1 :]]) for i in range(len(flat))]
    return jnp.stack([one - jnp.max(several, axis=0) for one, several in zip(flat, others, strict=True)])


def may_bend(
    function: Callable[[Params, State], Float[Array, " values"]], params: Params, state: State, rates: Rates
) -> bool:
    """Whether a function may jump or bend as a flow moves the state, since an operation is not smooth.

    A conversion of the dtype and a power by `integer_pow` count as not smooth, other than in `may_switch`.

    Args:
        function: the function.
        params: its parameters.
        state: a state.
        rates: the flow's rates there.
    """
    closed, _ = _program(function, params, state)
    for equation, places in _moving(closed.jaxpr, state, rates):
        name = equation.primitive.name
        if name not in _SMOOTH and not places <= _SMOOTH_IN.get(name, set()):
            return True
    return False


def may_switch(model: HybridModel, params: Params, state: State) -> bool:
    """Whether the flow may switch, or a guard may jump or bend, as the flow moves the state.

    A part of a guard without derivative (`stop_gradient`), such as a margin for rounding, does not count.

    Args:
        model: the model.
        params: its parameters.
        state: a state, of which only the shape counts.
    """
    rates = jax.eval_shape(model.flow, params, state)
    at_state = jax.eval_shape(partial(switching, model.flow), params, state)
    if at_state.levels.size + at_state.surfaces.size:
        return True
    closed, _ = _program(model.guards, params, state)
    deciding = _with_derivative(closed.jaxpr)
    return any(
        deciding.intersection(equation.outvars) and not _is_smooth(equation, places)
        for equation, places in _moving(closed.jaxpr, state, rates)
    )


def _with_derivative(program: Jaxpr) -> set[Var]:
    """The variables of a program that its results read other than through `stop_gradient`."""
    needed = {v for v in program.outvars if not isinstance(v, Literal)}
    deciding: set[Var] = set()
    for equation in reversed(program.eqns):
        if needed.intersection(equation.outvars) and equation.primitive.name != "stop_gradient":
            needed.update(v for v in equation.invars if not isinstance(v, Literal))
            deciding.update(equation.outvars)
    return deciding


def moving_operations(model: HybridModel, params: Params, state: State) -> set[str]:
    """JAX's names of the operations in the flow that move as it moves the state.

    A power with a whole number as its exponent is `integer_pow`, however it is written, and one of a constant
    is `exp`.

    Args:
        model: the model.
        params: its parameters.
        state: a state, of which only the shape counts.
    """
    closed, rates = _program(model.flow, params, state)
    return {_name(equation, places) for equation, places in _moving(closed.jaxpr, state, rates)}


def _name(equation: JaxprEqn, places: set[int]) -> str:
    """The name of an operation whose arguments with these numbers move."""
    name = equation.primitive.name
    if name != "pow":
        return name
    if 0 not in places:
        return "exp"
    exponent = equation.invars[1]
    is_whole = isinstance(exponent, Literal) and float(exponent.val).is_integer()
    return "integer_pow" if is_whole else name


def curving_operation(model: HybridModel, params: Params, state: State) -> str | None:
    """JAX's name of an operation by which the flow is not affine between switches, or None.

    Operations inside of loops and branches are not found, nor any in a flow whose state has no names of its
    fields.

    Args:
        model: the model.
        params: its parameters.
        state: a state, of which only the shape counts.
    """
    if None in _fields(state):  # modes are not told from what moves
        return None
    closed, rates = _program(model.flow, params, state)
    leaves = zip(jax.tree_util.tree_leaves_with_path(rates), closed.jaxpr.outvars, strict=True)
    # a constant variable has the rate 0.0
    varying = {
        path[0].key: None for (path, _), rate in leaves if not (isinstance(rate, Literal) and rate.val == 0.0)
    }
    moving = _moving(closed.jaxpr, state, varying, between_switches=True)
    return next(
        (equation.primitive.name for equation, places in moving if _is_curved(equation, places)), None
    )


def _is_curved(equation: JaxprEqn, places: set[int]) -> bool:
    """Whether an operation is not linear in its arguments at these places."""
    name = equation.primitive.name
    if name == "integer_pow":
        return equation.params["y"] not in (0, 1)
    if name == "div":
        return 1 in places
    return name in _CURVED or (name in _MULTILINEAR and len(places) > 1)


def _is_smooth(equation: JaxprEqn, places: set[int]) -> bool:
    """Whether an operation is smooth in its arguments at these places."""
    name = equation.primitive.name
    if name == _CAST:
        return jnp.issubdtype(equation.params["new_dtype"], jnp.floating)
    if name == "integer_pow":
        return equation.params["y"] > 0
    return name in _SMOOTH or places <= _SMOOTH_IN.get(name, set())


def _moving(
    program: Jaxpr, state: State, rates: Mapping[str, object], *, between_switches: bool = False
) -> list[tuple[JaxprEqn, set[int]]]:
    """The equations of a program of `(params, state)` that move with the state, and which arguments do.

    Between switches, flags and whole numbers do not move, nor do signs and rounded numbers.
    """
    # a state that is registered without names of its fields counts as moving as a whole
    fields = _fields(state)
    moves = zip(program.invars[len(program.invars) - len(fields) :], fields, strict=True)
    moving = {v for v, name in moves if name is None or name in rates}
    equations = []
    for equation in program.eqns:
        places = {i for i, v in enumerate(equation.invars) if not isinstance(v, Literal) and v in moving}
        if places:
            if not (between_switches and _is_level(equation)):
                moving.update(equation.outvars)
            equations.append((equation, places))
    return equations


def _fields(state: State) -> list[str | None]:
    """The field of each array of a state; None where the state is registered without their names."""
    return [getattr(path[0], "name", None) for path, _ in jax.tree_util.tree_leaves_with_path(state)]


def _is_level(equation: JaxprEqn) -> bool:
    """Whether the result of an operation is constant between switches."""
    if equation.primitive.name in _LEVELS - {_CAST}:
        return True
    dtype: Any = equation.outvars[0].aval.dtype  # pyright: ignore[reportAttributeAccessIssue]
    return not jnp.issubdtype(dtype, jnp.inexact)


def switches_within(
    flow: Callable[[Params, State], Rates],
    params: Params,
    ends: tuple[State, State],
    rates: tuple[Rates, Rates],
    h: Number,
    within: Callable[[float], State],
) -> tuple[Flag, Flag]:
    """Detect switches of a flow within a step.

    Args:
        flow: the flow.
        params: its parameters.
        ends: the states at the step's beginning and end.
        rates: the flow's rates there.
        h: its length (s).
        within: the state at a share of the step.

    Returns:
        Whether the flow has switched between the ends, and whether it may have switched there and back.
    """
    before = switching(flow, params, ends[0])
    after = switching(flow, params, ends[1])
    if not before.levels.size + before.surfaces.size:
        return jnp.asarray(False), jnp.asarray(False)
    shows = jnp.any(jnp.abs(after.levels - before.levels) >= 1.0)

    def surfaces(state: State) -> Float[Array, " surfaces"]:
        return switching(flow, params, state).surfaces

    # below zero at both ends, as a guard that may fire in between
    side = jnp.where(before.surfaces < 0.0, 1.0, -1.0)
    near = side * before.surfaces
    end = side * after.surfaces
    slopes = side * slopes_along(surfaces, ends[0], rates[0])
    end_slopes = side * slopes_along(surfaces, ends[1], rates[1])
    inside = [side * surfaces(within(share)) for share in PROBES]
    hides = may_hide(near, slopes, end, h) | unresolved(near, slopes, end, end_slopes, inside, h)
    return shows, hides
