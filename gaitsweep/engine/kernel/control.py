"""Rules of primitives with sub-programs: calls are inlined, branches selected, loops unrolled."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from gaitsweep.engine.kernel.trace import Nodes, Rule, RuleError, Tracer

# Longest loop that is unrolled; a longer one would be too expensive for a model's step.
MAX_TURNS = 256


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


RULES: dict[str, Rule] = {
    **dict.fromkeys(("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call",
                     "custom_vjp_call_jaxpr", "remat", "remat2", "checkpoint", "custom_lin"), _call),
    "cond": _cond,
    "while": _while,
    "scan": _scan,
    "call_hi_primitive": _expanded,
}  # fmt: skip
