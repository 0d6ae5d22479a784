"""Functions of one number, written in the program's own operations so that lanes can run side by side.

Sine, cosine and the exponential are polynomials after a reduction of their argument, right to about one
unit in the last place; sine and cosine to |x| of some 1e6 rad, beyond which their error grows with |x|.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import TYPE_CHECKING

from gaitsweep.engine.kernel.trace import refuse

if TYPE_CHECKING:
    from gaitsweep.engine.kernel.program import Program

# Digits enough to split in parts whose products with small whole numbers are exact.
_PI = Fraction("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899")
_LN2 = Fraction("0.69314718055994530941723212145817656807550013436025525412068000949339362196969472")


def _parts(value: Fraction, bits: int, count: int) -> list[float]:
    """`value` as a sum of floats, the first ones of `bits` significant bits."""
    parts = []
    for _ in range(count - 1):
        exponent = math.frexp(float(value))[1] - bits
        whole = math.floor(value / Fraction(2) ** exponent)
        parts.append(float(whole * Fraction(2) ** exponent))
        value -= Fraction(parts[-1])
    return [*parts, float(value)]


class _Writer:
    """Arithmetic on nodes in the kind of one of them."""

    def __init__(self, program: Program, like: int) -> None:
        self.program = program
        self.kind = program.nodes[like].kind

    def number(self, value: float) -> int:
        return self.program.constant(value, self.kind)

    def __call__(self, op: str, *args: int | float) -> int:
        return self.program.apply(op, *(self.number(a) if isinstance(a, float) else a for a in args))

    def polynomial(self, x: int, coefficients: list[float]) -> int:
        """Horner's scheme, the highest power last in `coefficients`."""
        total = self.number(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            total = self("add", self("mul", total, x), c)
        return total

    @property
    def single(self) -> bool:
        return self.kind == "f32"


def maximum(program: Program, a: int, b: int) -> int:
    """The larger; NaN where either is."""
    return _extreme(program, a, b, "or", lambda x, y: program.apply("lt", y, x))


def minimum(program: Program, a: int, b: int) -> int:
    """The smaller; NaN where either is."""
    return _extreme(program, a, b, "and", lambda x, y: program.apply("lt", x, y))


def _extreme(program: Program, a: int, b: int, truth: str, wins: Callable[[int, int], int]) -> int:
    kind = program.nodes[a].kind
    if kind == "bool":
        return program.apply(truth, a, b)
    if program.value(a) is not None:
        a, b = b, a
    known = program.value(b)
    if known is not None:
        # NaN is known to win; any other number is no NaN, so one comparison does
        return b if math.isnan(known) else program.apply("select", wins(b, a), b, a)
    first = wins(a, b)
    if kind != "int":
        first = program.apply("or", first, program.apply("ne", a, a))
    return program.apply("select", first, a, b)


def _nan(program: Program, x: int) -> int:
    """Whether a number is NaN, which whole numbers and flags never are."""
    if program.nodes[x].kind in ("int", "bool"):
        return program.constant(False, "bool")
    return program.apply("ne", x, x)


def before(program: Program, a: int, b: int) -> int:
    """a < b in the order of sorting, in which NaN comes last."""
    later = program.apply("and", program.apply("not", _nan(program, a)), _nan(program, b))
    return program.apply("or", program.apply("lt", a, b), later)


def alike(program: Program, a: int, b: int) -> int:
    """a = b in the order of sorting, in which all NaN are one."""
    both = program.apply("and", _nan(program, a), _nan(program, b))
    return program.apply("or", program.apply("eq", a, b), both)


def not_after(program: Program, a: int, b: int) -> int:
    """a <= b in the order of sorting."""
    return program.apply("not", before(program, b, a))


def outdone(program: Program, best: int, new: int, order: str) -> int:
    """Whether the best number so far is less ("lt") or greater ("gt") than a new one; NaN outdoes all."""
    better = program.apply("lt", best, new) if order == "lt" else program.apply("lt", new, best)
    unmatched = program.apply("and", program.apply("not", _nan(program, best)), _nan(program, new))
    return program.apply("or", better, unmatched)


def quotient(program: Program, a: int, b: int) -> int:
    """a / b; whole numbers are cut towards zero."""
    if program.nodes[a].kind == "int":
        return truncated(program, program.apply("div", a, b))
    return program.apply("div", a, b)


def remainder(program: Program, a: int, b: int) -> int:
    """What is left of a, with its sign, after whole multiples of b, to the rounding of a."""
    known = program.evaluated("div", (a, b))
    whole = truncated(program, program.write("div", a, b) if known is None else known)
    return program.apply("sub", a, program.apply("mul", b, whole))


def truncated(program: Program, x: int) -> int:
    known = program.value(x)
    if known is not None and math.isfinite(known):
        return program.constant(float(math.trunc(known)), program.nodes[x].kind)
    down = program.apply("floor", x)
    up = ceiling(program, x)
    return program.apply("select", program.apply("lt", x, _Writer(program, x).number(0.0)), up, down)


def ceiling(program: Program, x: int) -> int:
    return program.apply("neg", program.apply("floor", program.apply("neg", x)))


def rounded(program: Program, x: int, method: object) -> int:
    """To the nearest whole number; halves away from zero, or to even ones (JAX's two methods)."""
    w = _Writer(program, x)
    # the fraction is exact, where x + 0.5 is not: 0.5 less a bit would become 1, and large odd numbers even
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
    w = _Writer(program, x)
    return w("select", w("lt", 0.0, x), 1.0, w("select", w("lt", x, 0.0), -1.0, x))


def is_finite(program: Program, x: int) -> int:
    w = _Writer(program, x)
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


def converted(program: Program, x: int, kind: str) -> int:
    """`x` as another kind of number; fractions are cut towards zero, flags count as 0 and 1."""
    now = program.nodes[x].kind
    if now == kind:
        return x
    if now == "bool":
        one, zero = (program.constant(v, kind) for v in (1.0, 0.0))  # type: ignore[arg-type]
        return program.apply("select", x, one, zero)
    if kind == "bool":
        return program.apply("ne", x, program.constant(0.0, now))
    if kind == "int":
        return program.apply("to_int", truncated(program, x))
    return program.apply(f"to_{kind}", x)


def whole_power(program: Program, x: int, power: int) -> int:
    """x to a whole power, by squaring."""
    if power < 0:
        return program.apply("div", _Writer(program, x).number(1.0), whole_power(program, x, -power))
    total, base = _Writer(program, x).number(1.0), x
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


def reciprocal_root(program: Program, x: int) -> int:
    w = _Writer(program, x)
    return w("div", 1.0, w("sqrt", x))


def cube_root(program: Program, x: int) -> int:
    w = _Writer(program, x)
    size = w("abs", x)
    near = w("pow", size, w.number(1.0 / 3.0))
    # Newton's step, without the cube of `near`: of the least numbers it has but a few digits
    excess = w("sub", near, w("div", size, w("mul", near, near)))
    better = w("sub", near, w("mul", excess, 1.0 / 3.0))
    # nothing to better at 0 and infinity
    root = w("select", w("and", w("lt", 0.0, size), w("lt", size, math.inf)), better, size)
    return w("select", w("lt", x, 0.0), w("neg", root), root)


def _quadrant(program: Program, x: int) -> tuple[_Writer, int, int, int]:
    """The number of quarter turns (mod 4), and sine and cosine of what is left of the angle."""
    w = _Writer(program, x)
    turns = w("floor", w("add", w("mul", x, float(2 / _PI)), 0.5))
    rest = x
    for part in _parts(_PI / 2, *((9, 4) if w.single else (30, 4))):
        rest = w("sub", rest, w("mul", turns, part))
    z = w("mul", rest, rest)
    terms = 5 if w.single else 9
    odd = [(-1) ** k / math.factorial(2 * k + 1) for k in range(1, terms)]
    even = [(-1) ** k / math.factorial(2 * k) for k in range(2, terms)]
    sine_part = w("add", rest, w("mul", w("mul", rest, z), w.polynomial(z, odd)))
    bend = w("mul", w("mul", z, z), w.polynomial(z, even))
    cosine_part = w("add", w("sub", 1.0, w("mul", z, 0.5)), bend)
    quarter = w("sub", turns, w("mul", w("floor", w("mul", turns, 0.25)), 4.0))
    return w, quarter, sine_part, cosine_part


def sine(program: Program, x: int) -> int:
    w, quarter, s, c = _quadrant(program, x)
    swapped = w("or", w("eq", quarter, 1.0), w("eq", quarter, 3.0))
    value = w("select", swapped, c, s)
    return w("select", w("lt", 1.0, quarter), w("neg", value), value)


def cosine(program: Program, x: int) -> int:
    w, quarter, s, c = _quadrant(program, x)
    swapped = w("or", w("eq", quarter, 1.0), w("eq", quarter, 3.0))
    value = w("select", swapped, s, c)
    negative = w("or", w("eq", quarter, 1.0), w("eq", quarter, 2.0))
    return w("select", negative, w("neg", value), value)


def tangent(program: Program, x: int) -> int:
    w, quarter, s, c = _quadrant(program, x)
    swapped = w("or", w("eq", quarter, 1.0), w("eq", quarter, 3.0))
    top, bottom = w("select", swapped, c, s), w("select", swapped, s, c)
    return w("div", w("select", swapped, w("neg", top), top), bottom)


def exponential(program: Program, x: int) -> int:
    w = _Writer(program, x)
    turns = w("floor", w("add", w("mul", x, float(1 / _LN2)), 0.5))
    rest = x
    for part in _parts(_LN2, *((9, 3) if w.single else (40, 3))):
        rest = w("sub", rest, w("mul", turns, part))
    terms = 8 if w.single else 14
    near = w.polynomial(rest, [1.0 / math.factorial(k) for k in range(terms)])
    high, low = (88.73, -103.98) if w.single else (709.79, -745.14)
    value = _scaled(w, near, turns, 160.0 if w.single else 1100.0)
    value = w("select", w("lt", x, low), 0.0, value)
    return w("select", w("lt", high, x), math.inf, value)


def power_of_two(program: Program, x: int) -> int:
    w = _Writer(program, x)
    turns = w("floor", w("add", x, 0.5))
    near = exponential(program, w("mul", w("sub", x, turns), float(_LN2)))
    high, low = (128.0, -150.0) if w.single else (1024.0, -1075.0)
    value = _scaled(w, near, turns, 160.0 if w.single else 1100.0)
    value = w("select", w("lt", x, low), 0.0, value)
    return w("select", w("le", high, x), math.inf, value)


def _scaled(w: _Writer, near: int, turns: int, most: float) -> int:
    """`near` times 2 to a whole number, in two factors so that neither overflows before the result does."""
    bounded = w("select", w("lt", most, turns), most, w("select", w("lt", turns, -most), -most, turns))
    half = w("floor", w("mul", bounded, 0.5))
    left = w("abs", half)
    factor = w.number(1.0)
    for bit in range(math.frexp(most)[1] - 2, -1, -1):
        size = float(2**bit)
        has = w("le", size, left)
        left = w("select", has, w("sub", left, size), left)
        factor = w("select", has, w("mul", factor, 2.0**size), factor)
    factor = w("select", w("lt", half, 0.0), w("div", 1.0, factor), factor)
    odd = w("lt", w("add", half, half), bounded)
    other = w("select", odd, w("mul", factor, 2.0), factor)
    return w("mul", w("mul", near, factor), other)


def logistic(program: Program, x: int) -> int:
    w = _Writer(program, x)
    return w("div", 1.0, w("add", 1.0, exponential(program, w("neg", x))))


def hyperbolic_tangent(program: Program, x: int) -> int:
    w = _Writer(program, x)
    size = w("abs", x)
    t = exponential(program, w("mul", size, -2.0))
    far = w("div", w("sub", 1.0, t), w("add", 1.0, t))
    # Lambert's continued fraction x / (1 + z/(3 + z/(5 + ...))), as one quotient
    z = w("mul", x, x)
    top, bottom = w.number(1.0), w.number(17.0)
    for k in range(15, 0, -2):
        top, bottom = bottom, w("add", w("mul", bottom, float(k)), w("mul", z, top))
    near = w("div", w("mul", size, top), bottom)
    value = w("select", w("lt", size, 0.625), near, far)
    return w("select", w("lt", x, 0.0), w("neg", value), w("select", w("ne", x, x), x, value))


def _half_exponential(w: _Writer, size: int) -> int:
    """exp(size) / 2, also where exp(size) itself would be infinite."""
    root = exponential(w.program, w("mul", size, 0.5))
    return w("mul", w("mul", root, 0.5), root)


def hyperbolic_cosine(program: Program, x: int) -> int:
    w = _Writer(program, x)
    half = _half_exponential(w, w("abs", x))
    return w("add", half, w("div", 0.25, half))


def hyperbolic_sine(program: Program, x: int) -> int:
    w = _Writer(program, x)
    size = w("abs", x)
    half = _half_exponential(w, size)
    far = w("sub", half, w("div", 0.25, half))
    z = w("mul", x, x)
    terms = [1.0 / math.factorial(2 * k + 1) for k in range(5 if w.single else 9)]
    near = w("mul", size, w.polynomial(z, terms))
    value = w("select", w("lt", size, 1.0), near, far)
    return w("select", w("lt", x, 0.0), w("neg", value), value)
