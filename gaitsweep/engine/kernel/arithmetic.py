"""Arithmetic of several operations: extremes, order, quotients, rounding, conversion, powers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from gaitsweep.engine.kernel.trace import refuse

if TYPE_CHECKING:
    from gaitsweep.engine.kernel.program import Kind, Program


class Writer:
    """Writes operations whose constants have the kind of a given node."""

    def __init__(self, program: Program, like: int) -> None:
        self.program = program
        self.kind: Kind = program.nodes[like].kind

    def number(self, value: float) -> int:
        return self.program.constant(value, self.kind)

    def __call__(self, op: str, *args: int | float) -> int:
        return self.program.apply(op, *(self.number(a) if isinstance(a, float) else a for a in args))

    def polynomial(self, x: int, coefficients: list[float]) -> int:
        """A polynomial by Horner's scheme; `coefficients` are in order of rising power."""
        total = self.number(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            total = self("add", self("mul", total, x), c)
        return total

    @property
    def single(self) -> bool:
        return self.kind == "f32"


def maximum(program: Program, a: int, b: int) -> int:
    """The larger number; NaN if one is NaN."""
    return _extreme(program, a, b, "or", lambda x, y: program.apply("lt", y, x))


def minimum(program: Program, a: int, b: int) -> int:
    """The smaller number; NaN if one is NaN."""
    return _extreme(program, a, b, "and", lambda x, y: program.apply("lt", x, y))


def _extreme(program: Program, a: int, b: int, truth: str, wins: Callable[[int, int], int]) -> int:
    kind = program.nodes[a].kind
    if kind == "bool":
        return program.apply(truth, a, b)
    if program.value(a) is not None:
        a, b = b, a
    known = program.value(b)
    if known is not None:
        # NaN always wins; another constant is not NaN, so one comparison is enough
        return b if math.isnan(known) else program.apply("select", wins(b, a), b, a)
    first = wins(a, b)
    if kind != "int":
        first = program.apply("or", first, program.apply("ne", a, a))
    return program.apply("select", first, a, b)


def _nan(program: Program, x: int) -> int:
    """Whether a number is NaN; integers and flags never are."""
    if program.nodes[x].kind in ("int", "bool"):
        return program.constant(False, "bool")
    return program.apply("ne", x, x)


def before(program: Program, a: int, b: int) -> int:
    """A < b in sorting order, in which NaN is last."""
    later = program.apply("and", program.apply("not", _nan(program, a)), _nan(program, b))
    return program.apply("or", program.apply("lt", a, b), later)


def alike(program: Program, a: int, b: int) -> int:
    """A = b in sorting order, in which all NaN are equal."""
    both = program.apply("and", _nan(program, a), _nan(program, b))
    return program.apply("or", program.apply("eq", a, b), both)


def not_after(program: Program, a: int, b: int) -> int:
    """A <= b in sorting order."""
    return program.apply("not", before(program, b, a))


def outdone(program: Program, best: int, new: int, order: str) -> int:
    """Whether the best number so far is less ("lt") or greater ("gt") than a new one; NaN beats all."""
    better = program.apply("lt", best, new) if order == "lt" else program.apply("lt", new, best)
    unmatched = program.apply("and", program.apply("not", _nan(program, best)), _nan(program, new))
    return program.apply("or", better, unmatched)


def quotient(program: Program, a: int, b: int) -> int:
    """A / b; the quotient of integers is rounded towards zero."""
    if program.nodes[a].kind == "int":
        return truncated(program, program.apply("div", a, b))
    return program.apply("div", a, b)


def remainder(program: Program, a: int, b: int) -> int:
    """The remainder of a / b, with the sign of a, up to the rounding of a."""
    known = program.evaluated("div", (a, b))
    whole = truncated(program, program.write("div", a, b) if known is None else known)
    return program.apply("sub", a, program.apply("mul", b, whole))


def truncated(program: Program, x: int) -> int:
    known = program.value(x)
    if known is not None and math.isfinite(known):
        return program.constant(float(math.trunc(known)), program.nodes[x].kind)
    down = program.apply("floor", x)
    up = ceiling(program, x)
    return program.apply("select", program.apply("lt", x, Writer(program, x).number(0.0)), up, down)


def ceiling(program: Program, x: int) -> int:
    return program.apply("neg", program.apply("floor", program.apply("neg", x)))


def rounded(program: Program, x: int, method: object) -> int:
    """X rounded to the nearest integer; halves away from zero, or to even (JAX's two methods)."""
    w = Writer(program, x)
    # the fraction is exact, x + 0.5 is not: the float before 0.5 would become 1, and large odd numbers even
    if "EVEN" not in str(method) and str(method) != "1":
        size = w("abs", x)
        down = w("floor", size)
        up = w("le", 0.5, w("sub", size, down))
        return program.apply("mul", sign(program, x), w("select", up, w("add", down, 1.0), down))
    down = w("floor", x)
    fraction = w("sub", x, down)
    odd = w("ne", w("mul", w("floor", w("mul", down, 0.5)), 2.0), down)
    up = w("or", w("lt", 0.5, fraction), w("and", w("eq", fraction, 0.5), odd))
    return w("select", up, w("add", down, 1.0), down)


def sign(program: Program, x: int) -> int:
    w = Writer(program, x)
    return w("select", w("lt", 0.0, x), 1.0, w("select", w("lt", x, 0.0), -1.0, x))


def is_finite(program: Program, x: int) -> int:
    w = Writer(program, x)
    return w("eq", w("sub", x, x), 0.0)


def logical(op: str) -> Callable[..., int]:
    def build(program: Program, *nodes: int) -> int:
        if any(program.nodes[at].kind != "bool" for at in nodes):
            raise refuse(f"the scalar kernel knows '{op}' of flags only, not of whole numbers")
        return program.apply(op, *nodes)

    return build


def exclusive_or(program: Program, a: int, b: int) -> int:
    if program.nodes[a].kind != "bool":
        raise refuse("the scalar kernel knows 'xor' of flags only, not of whole numbers")
    return program.apply("select", b, program.apply("not", a), a)


def converted(program: Program, x: int, kind: Kind) -> int:
    """`x` as another kind of number; to integers by rounding towards zero, flags as 0 and 1."""
    now = program.nodes[x].kind
    if now == kind:
        return x
    if now == "bool":
        one, zero = (program.constant(v, kind) for v in (1.0, 0.0))
        return program.apply("select", x, one, zero)
    if kind == "bool":
        return program.apply("ne", x, program.constant(0.0, now))
    if kind == "int":
        return program.apply("to_int", truncated(program, x))
    return program.apply(f"to_{kind}", x)


def one_minus_square(program: Program, x: int) -> int:
    """1 - x^2, without cancellation where x is close to 1 or -1."""
    w = Writer(program, x)
    return w("mul", w("add", x, 1.0), w("sub", 1.0, x))


def whole_power(program: Program, x: int, power: int) -> int:
    """X to an integer power, by repeated squaring."""
    if power < 0:
        return program.apply("div", Writer(program, x).number(1.0), whole_power(program, x, -power))
    total, base = Writer(program, x).number(1.0), x
    while power:
        if power & 1:
            total = program.apply("mul", total, base)
        power >>= 1
        if power:
            base = program.apply("mul", base, base)
    return total


def power(program: Program, x: int, y: int) -> int:
    known = program.value(y)
    if known is not None and float(known).is_integer() and abs(known) <= 16:
        return whole_power(program, x, int(known))
    if known == 0.5:
        return program.apply("sqrt", x)
    if program.nodes[y].kind != program.nodes[x].kind:
        y = converted(program, y, program.nodes[x].kind)
    return program.apply("pow", x, y)
