"""Arithmetic of several operations: extremes, order, quotients, rounding, conversion, powers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from jax.lax import RoundingMethod

from gaitsweep.engine.kernel.trace import Build, RuleError, Writer

if TYPE_CHECKING:
    from gaitsweep.engine.kernel.program import Kind


def maximum(w: Writer, a: int, b: int) -> int:
    """The larger number; NaN if one is NaN."""
    return _extreme(w, a, b, "or", lambda x, y: w("lt", y, x))


def minimum(w: Writer, a: int, b: int) -> int:
    """The smaller number; NaN if one is NaN."""
    return _extreme(w, a, b, "and", lambda x, y: w("lt", x, y))


def _extreme(w: Writer, a: int, b: int, truth: str, wins: Build) -> int:
    """An extreme of two numbers; `truth` is the operation for flags, `wins(x, y)` prefers x to y."""
    if w.kind == "bool":
        return w(truth, a, b)
    if w.program.value(a) is not None:
        a, b = b, a
    known = w.program.value(b)
    if known is not None:
        # NaN always wins; another constant is not NaN, so one comparison is enough
        return b if math.isnan(known) else w("select", wins(b, a), b, a)
    first = wins(a, b)
    if w.kind != "int":
        first = w("or", first, w("ne", a, a))
    return w("select", first, a, b)


def _nan(w: Writer, x: int) -> int:
    """Whether a number is NaN; integers and flags never are."""
    return w.program.constant(False, "bool") if w.kind in ("int", "bool") else w("ne", x, x)


def before(w: Writer, a: int, b: int) -> int:
    """Whether a comes before b in sorting order, in which NaN is last."""
    later = w("and", w("not", _nan(w, a)), _nan(w, b))
    return w("or", w("lt", a, b), later)


def same_rank(w: Writer, a: int, b: int) -> int:
    """Whether a and b are equal in sorting order, in which all NaN are equal."""
    both = w("and", _nan(w, a), _nan(w, b))
    return w("or", w("eq", a, b), both)


def not_after(w: Writer, a: int, b: int) -> int:
    """Whether a does not come after b in sorting order."""
    return w("not", before(w, b, a))


def is_improved(w: Writer, best: int, new: int, order: Literal["lt", "gt"]) -> int:
    """Whether a new number replaces the best one so far; NaN beats all.

    Args:
        w: the writer.
        best, new: nodes of the numbers.
        order: "lt" for a maximum (the best is less than the new one), "gt" for a minimum.
    """
    better = w("lt", best, new) if order == "lt" else w("lt", new, best)
    unmatched = w("and", w("not", _nan(w, best)), _nan(w, new))
    return w("or", better, unmatched)


def quotient(w: Writer, a: int, b: int) -> int:
    """The quotient of a and b; that of integers is rounded towards zero, and not finite where b is 0."""
    return truncated(w, w("div", a, b)) if w.kind == "int" else w("div", a, b)


def remainder(w: Writer, a: int, b: int) -> int:
    """The remainder of a / b, with the sign of a, up to the rounding of a; of integers a where b is 0.

    It is NaN where it has no digit within this rounding, the quotient of floats being 1 / eps or more.
    """
    known = w.program.evaluated("div", (a, b))
    ratio = w.program.write("div", a, b) if known is None else known
    rest = w("sub", a, w("mul", b, truncated(w, ratio)))
    if w.kind == "int":
        return w("select", w("eq", b, 0.0), a, rest)
    has_digits = w("lt", w("abs", ratio), 2.0**23 if w.single else 2.0**52)
    # also of an infinite b
    is_smaller = w("lt", w("abs", a), w("abs", b))
    return w("select", is_smaller, a, w("select", has_digits, rest, math.nan))


def truncated(w: Writer, x: int) -> int:
    """The whole number next to x towards zero."""
    known = w.program.value(x)
    if known is not None and math.isfinite(known):
        return w.number(float(math.trunc(known)))
    down = w("floor", x)
    up = ceiling(w, x)
    return w("select", w("lt", x, 0.0), up, down)


def ceiling(w: Writer, x: int) -> int:
    """The smallest whole number that is not below x."""
    return w("neg", w("floor", w("neg", x)))


def rounded(w: Writer, x: int, method: RoundingMethod) -> int:
    """The integer nearest to x; halves are rounded away from zero, or to even (JAX's two methods)."""
    # the fraction is exact, x + 0.5 is not: the float before 0.5 would become 1, and large odd numbers even
    if method == RoundingMethod.AWAY_FROM_ZERO:
        size = w("abs", x)
        down = w("floor", size)
        up = w("le", 0.5, w("sub", size, down))
        return w("mul", sign(w, x), w("select", up, w("add", down, 1.0), down))
    down = w("floor", x)
    fraction = w("sub", x, down)
    odd = w("ne", w("mul", w("floor", w("mul", down, 0.5)), 2.0), down)
    up = w("or", w("lt", 0.5, fraction), w("and", w("eq", fraction, 0.5), odd))
    return w("select", up, w("add", down, 1.0), down)


def sign(w: Writer, x: int) -> int:
    """The sign of x: 1, -1, or x itself where it is zero or NaN."""
    return w("select", w("lt", 0.0, x), 1.0, w("select", w("lt", x, 0.0), -1.0, x))


def is_finite(w: Writer, x: int) -> int:
    """Whether x is neither infinite nor NaN, which is below nothing."""
    return w("lt", w("abs", x), math.inf)


def logical(op: str) -> Build:
    """The writer of an operation on flags: and, or, not, xor."""

    def build(w: Writer, *nodes: int) -> int:
        if any(w.program.nodes[at].kind != "bool" for at in nodes):
            raise RuleError(f"the scalar kernel knows '{op}' of flags only, not of whole numbers")
        return w("select", nodes[1], w("not", nodes[0]), nodes[0]) if op == "xor" else w(op, *nodes)

    return build


def to_integer(w: Writer, x: int, low: float, high: float) -> int:
    """A float rounded towards zero, within the limits of an integer dtype; NaN becomes 0."""
    whole = w("to_f64", truncated(w, x))
    # the limits of 32 bits are no float32
    double = Writer(w.program, whole)
    inside = minimum(double, maximum(double, whole, double.number(low)), double.number(high))
    return w("to_int", double("select", w("ne", x, x), 0.0, inside))


def converted(w: Writer, x: int, kind: Kind) -> int:
    """`x` as another kind of number; to integers by rounding towards zero, flags as 0 and 1."""
    if w.kind == kind:
        return x
    if w.kind == "bool":
        return w("select", x, w.program.constant(1.0, kind), w.program.constant(0.0, kind))
    if kind == "bool":
        return w("ne", x, 0.0)
    if kind == "int":
        return w("to_int", truncated(w, x))
    return w(f"to_{kind}", x)


def one_minus_square(w: Writer, x: int) -> int:
    """The number 1 - x^2, without cancellation where x is close to 1 or -1."""
    return w("mul", w("add", x, 1.0), w("sub", 1.0, x))


def whole_power(w: Writer, x: int, power: int) -> int:
    """An integer power of x, by repeated squaring."""
    if power < 0:
        return w("div", 1.0, whole_power(w, x, -power))
    total = w.number(1.0)
    base = x
    while power:
        if power & 1:
            total = w("mul", total, base)
        power >>= 1
        if power:
            base = w("mul", base, base)
    return total


def power(w: Writer, x: int, y: int) -> int:
    """The number x to the power y; small whole powers are products, and the power 0.5 is a root."""
    known = w.program.value(y)
    if known is not None and float(known).is_integer() and abs(known) <= 16:
        return whole_power(w, x, int(known))
    if known == 0.5:  # the power of -infinity is infinity, its root NaN
        return w("select", w("eq", x, -math.inf), math.inf, w("sqrt", x))
    return w("pow", x, converted(Writer(w.program, y), y, w.kind))
