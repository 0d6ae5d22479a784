"""The translation rules of JAX's primitives, by name.

Of primitives with sub-programs, calls are inlined, branches selected, loops unrolled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal

import jax
import numpy as np

from gaitsweep.engine.carry import USUAL
from gaitsweep.engine.kernel import arithmetic, arrays, elementary
from gaitsweep.engine.kernel.trace import Build, Nodes, Rule, RuleError, Tracer, kind_of

# Longest loop that is unrolled; a longer one would be too expensive for a model's step.
MAX_TURNS = 256


def rule_for(name: str) -> Rule:
    """The rule of a primitive.

    Raises:
        UnsupportedError: there is no rule of that name.
    """
    for rules in (_ELEMENTWISE, _REDUCTIONS, arrays.RULES, _SUB_PROGRAMS):
        if name in rules:
            return rules[name]
    if name == "pure_callback":
        raise RuleError("its steps are computed outside of JAX, as by MuJoCo C on a CPU")
    raise RuleError(f"the scalar kernel does not know JAX's operation '{name}'")


def _elementwise(build: Build) -> Rule:
    def rule(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
        return [tracer.write(build, *args)]

    return rule


def _parametric(build: Build, read: Callable[[dict[str, Any]], Any]) -> Rule:
    """A rule for each element, with one parameter of the equation as the last argument."""

    def rule(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
        parameter = read(equation.params)
        return [tracer.write(lambda w, at: build(w, at, parameter), args[0])]

    return rule


def _div(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    dtype = equation.outvars[0].aval.dtype
    quotients = tracer.write(arithmetic.quotient, *args)
    if kind_of(dtype) != "int":
        return [quotients]
    # by 0 all bits are 1, as in XLA
    limits = np.iinfo(dtype)
    by_zero = tracer.program.constant(-1 if limits.min else limits.max, "int")
    is_zero = tracer.write(lambda w, at: w("eq", at, 0.0), args[1])
    return [tracer.apply("select", is_zero, np.asarray(by_zero), quotients)]


def _convert(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    old, new = equation.invars[0].aval.dtype, equation.params["new_dtype"]
    kind = kind_of(new)
    if kind == "int" and kind_of(old) in ("f32", "f64"):
        limits = np.iinfo(new)
        low, high = float(limits.min), float(limits.max)
        return [tracer.write(lambda w, at: arithmetic.to_integer(w, at, low, high), args[0])]
    return [tracer.write(lambda w, at: arithmetic.converted(w, at, kind), args[0])]


def _reduce_precision(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    info = np.finfo(equation.invars[0].aval.dtype)
    if (equation.params["exponent_bits"], equation.params["mantissa_bits"]) != (info.iexp, info.nmant):
        raise RuleError("the scalar kernel rounds to float32 and float64 only")
    return list(args)


def _name(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    usual = USUAL.get(equation.params["name"])
    if usual is not None:
        tracer.program.usual.update(dict.fromkeys(args[0].ravel().tolist(), usual))
    return list(args)


def _clamp(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    low, x, high = args
    return [tracer.write(arithmetic.minimum, tracer.write(arithmetic.maximum, x, low), high)]


def _select_n(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    which, *cases = args
    program = tracer.program
    if len(cases) == 2 and kind_of(equation.invars[0].aval.dtype) == "bool":
        return [tracer.apply("select", which, *cases[::-1])]

    def choose(at: int, *nodes: int) -> int:
        chosen = nodes[-1]
        for i in range(len(nodes) - 2, -1, -1):
            is_index = program.apply("eq", at, program.constant(i, "int"))
            chosen = program.apply("select", is_index, nodes[i], chosen)
        return chosen

    return [tracer.each(choose, which, *cases)]


def _philox(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    return [tracer.apply(f"philox{equation.params['half']}", *args)]


def _reduction(build: Build, neutral: float | None = None) -> Rule:
    """A reduction along axes; `neutral` is the result for no elements."""

    def rule(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
        (array,) = args
        axes = equation.params["axes"]
        remaining = [i for i in range(array.ndim) if i not in axes]
        shape = [array.shape[i] for i in remaining]
        flat = np.transpose(array, [*remaining, *axes]).reshape(
            *shape, math.prod(array.shape[i] for i in axes)
        )
        if flat.shape[-1] == 0:
            if neutral is None:
                raise RuleError("the scalar kernel finds no extreme among no elements")
            kind = kind_of(equation.outvars[0].aval.dtype)
            return [np.full(shape, tracer.program.constant(neutral, kind), np.int64)]
        total = flat[..., 0]
        for i in range(1, flat.shape[-1]):
            total = tracer.write(build, total, flat[..., i])
        return [np.asarray(total, np.int64)]

    return rule


def _arg_reduction(order: Literal["lt", "gt"]) -> Rule:
    """The first index of the largest ("lt") or smallest ("gt") element along one axis."""

    def rule(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
        (axis,) = equation.params["axes"]
        moved = np.moveaxis(args[0], axis, -1)
        program = tracer.program
        best = moved[..., 0]
        place = np.full(best.shape, program.constant(0, "int"), np.int64)
        for i in range(1, moved.shape[-1]):
            new = moved[..., i]
            wins = tracer.write(lambda w, a, b: arithmetic.is_improved(w, a, b, order), best, new)
            index = np.full(best.shape, program.constant(i, "int"), np.int64)
            place = tracer.apply("select", wins, index, place)
            best = tracer.apply("select", wins, new, best)
        return [place]

    return rule


def _cumulative(build: Build) -> Rule:
    def rule(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
        moved = np.moveaxis(args[0], equation.params["axis"], 0)
        if equation.params["reverse"]:
            moved = moved[::-1]
        rows = list(moved[:1])
        for row in moved[1:]:
            rows.append(tracer.write(build, rows[-1], row))
        result = np.array(rows, np.int64).reshape(moved.shape)
        if equation.params["reverse"]:
            result = result[::-1]
        return [np.moveaxis(result, 0, equation.params["axis"])]

    return rule


def _op(name: str) -> Build:
    return lambda w, *nodes: w(name, *nodes)


def _call(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    for name in ("jaxpr", "call_jaxpr", "fun_jaxpr"):
        if name in equation.params:
            inner = equation.params[name]
            break
    else:
        raise RuleError(f"the scalar kernel finds no body in JAX's operation '{equation.primitive.name}'")
    if hasattr(inner, "consts"):
        return tracer.read(inner, args)
    return tracer.read_open(inner, [], args)


def _cond(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    which, *operands = args
    branches = equation.params["branches"]
    program = tracer.program
    known = tracer.known(which)
    if known is not None:
        return tracer.read(branches[min(max(int(known), 0), len(branches) - 1)], operands)
    # from the last branch to the first: each select overrides the branches with larger numbers
    chosen = tracer.read(branches[-1], operands)
    at = int(which)
    for i in range(len(branches) - 2, -1, -1):
        results = tracer.read(branches[i], operands)
        if program.nodes[at].kind == "bool":
            is_taken = program.apply("not", at)
        else:
            is_taken = program.apply("le", at, program.constant(i, "int"))
        pairs = zip(results, chosen, strict=True)
        chosen = [tracer.apply("select", np.asarray(is_taken), yes, no) for yes, no in pairs]
    return chosen


def _while(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    p = equation.params
    n_cond = p["cond_nconsts"]
    n_body = p["body_nconsts"]
    for_cond = args[:n_cond]
    for_body = args[n_cond : n_cond + n_body]
    carry = args[n_cond + n_body :]
    for _ in range(MAX_TURNS + 1):
        (goes_on,) = tracer.read(p["cond_jaxpr"], [*for_cond, *carry])
        known = tracer.known(goes_on)
        if known is None:
            raise RuleError("the scalar kernel needs loops whose number of turns does not depend on values")
        if not bool(known):
            return carry
        carry = tracer.read(p["body_jaxpr"], [*for_body, *carry])
    raise RuleError(f"the scalar kernel unrolls loops of at most {MAX_TURNS} turns")


def _scan(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    p = equation.params
    length = p["length"]
    if "ft_in" in p:  # JAX 0.11 and newer
        consts_in, carry_in, *_ = p["ft_in"].unpack()
        n_consts = len(list(consts_in))
        n_carry = len(list(carry_in))
    else:
        n_consts = p["num_consts"]
        n_carry = p["num_carry"]
    if length > MAX_TURNS:
        raise RuleError(
            f"the scalar kernel unrolls loops of at most {MAX_TURNS} turns; this one has {length}"
        )
    consts = args[:n_consts]
    carry = args[n_consts : n_consts + n_carry]
    columns = args[n_consts + n_carry :]
    rows: list[list[Nodes]] = []
    order = range(length - 1, -1, -1) if p["reverse"] else range(length)
    for i in order:
        turn = [np.asarray(column[i]) for column in columns]
        results = tracer.read(p["jaxpr"], [*consts, *carry, *turn])
        carry = results[:n_carry]
        rows.append(results[n_carry:])
    if p["reverse"]:
        rows.reverse()
    collected = [np.stack(list(column)) for column in zip(*rows, strict=True)]
    if not rows:
        collected = [np.zeros(v.aval.shape, np.int64) for v in equation.outvars[n_carry:]]
    return [*carry, *collected]


def _expanded(tracer: Tracer, equation: Any, args: list[Nodes]) -> list[Nodes]:
    """An operation that JAX expands to others when it compiles a program (JAX 0.11 and newer)."""
    operation = equation.params["_prim"]
    shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in equation.invars]
    try:
        program = jax.make_jaxpr(operation.expand)(*shapes)
    except (NotImplementedError, TypeError) as error:
        raise RuleError(f"the scalar kernel does not know JAX's operation '{operation}'") from error
    return tracer.read(program, args)


_ELEMENTWISE: dict[str, Rule] = {
    **{name: _elementwise(_op(name)) for name in (
        "add", "sub", "mul", "neg", "abs", "floor", "sqrt", "lt", "le", "eq", "ne",
        "log", "log1p", "expm1", "asinh", "acosh", "atanh", "erf", "erfc",
    )},
    "add_any": _elementwise(_op("add")),
    "gt": _elementwise(lambda w, a, b: w("lt", b, a)),
    "ge": _elementwise(lambda w, a, b: w("le", b, a)),
    "lt_to": _elementwise(arithmetic.before),
    "eq_to": _elementwise(arithmetic.same_rank),
    "le_to": _elementwise(arithmetic.not_after),
    "div": _div,
    "rem": _elementwise(arithmetic.remainder),
    "max": _elementwise(arithmetic.maximum),
    "min": _elementwise(arithmetic.minimum),
    "and": _elementwise(arithmetic.logical("and")),
    "or": _elementwise(arithmetic.logical("or")),
    "xor": _elementwise(arithmetic.logical("xor")),
    "not": _elementwise(arithmetic.logical("not")),
    "sign": _elementwise(arithmetic.sign),
    "ceil": _elementwise(arithmetic.ceiling),
    "round": _parametric(arithmetic.rounded, lambda params: params["rounding_method"]),
    "square": _elementwise(lambda w, a: w("mul", a, a)),
    "one_minus_square": _elementwise(arithmetic.one_minus_square),
    "rsqrt": _elementwise(elementary.reciprocal_root),
    "cbrt": _elementwise(elementary.cube_root),
    "pow": _elementwise(arithmetic.power),
    "exp": _elementwise(elementary.exponential),
    "exp2": _elementwise(elementary.power_of_two),
    "log2": _elementwise(elementary.logarithm_to_base_2),
    "logistic": _elementwise(elementary.logistic),
    "sin": _elementwise(elementary.sine),
    "cos": _elementwise(elementary.cosine),
    "tan": _elementwise(elementary.tangent),
    "asin": _elementwise(elementary.arcsine),
    "acos": _elementwise(elementary.arccosine),
    "atan": _elementwise(elementary.arctangent),
    "atan2": _elementwise(elementary.angle_of_point),
    "sinh": _elementwise(elementary.hyperbolic_sine),
    "cosh": _elementwise(elementary.hyperbolic_cosine),
    "tanh": _elementwise(elementary.hyperbolic_tangent),
    "is_finite": _elementwise(arithmetic.is_finite),
    "integer_pow": _parametric(arithmetic.whole_power, lambda params: params["y"]),
    "convert_element_type": _convert,
    "philox": _philox,
    "clamp": _clamp,
    "select_n": _select_n,
    **dict.fromkeys(
        ("copy", "device_put", "optimization_barrier", "stop_gradient"),
        lambda tracer, equation, args: list(args),
    ),
    "name": _name,
    "reduce_precision": _reduce_precision,
}  # fmt: skip

_REDUCTIONS: dict[str, Rule] = {
    "reduce_sum": _reduction(_op("add"), 0.0),
    "reduce_prod": _reduction(_op("mul"), 1.0),
    "reduce_max": _reduction(arithmetic.maximum),
    "reduce_min": _reduction(arithmetic.minimum),
    "reduce_and": _reduction(arithmetic.logical("and"), True),
    "reduce_or": _reduction(arithmetic.logical("or"), False),
    "reduce_xor": _reduction(arithmetic.logical("xor"), False),
    "argmax": _arg_reduction("lt"),
    "argmin": _arg_reduction("gt"),
    "cumsum": _cumulative(_op("add")),
    "cumprod": _cumulative(_op("mul")),
    "cummax": _cumulative(arithmetic.maximum),
    "cummin": _cumulative(arithmetic.minimum),
}

_SUB_PROGRAMS: dict[str, Rule] = {
    **dict.fromkeys(("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call",
                     "custom_vjp_call_jaxpr", "remat", "remat2", "checkpoint", "custom_lin"), _call),
    "cond": _cond,
    "while": _while,
    "scan": _scan,
    "call_hi_primitive": _expanded,
}  # fmt: skip
