"""Elementary functions from the program's operations, so that lanes can be vectorised.

Sine, cosine and the exponential are polynomials after argument reduction, with an error of about one unit in
the last place; for sine and cosine up to |x| = 1e6 rad (5e4 in float32), above which it grows. The error of
arctangent, arcsine and arccosine is at most two units, for subnormal and infinite arguments too.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

from gaitsweep.engine.kernel.trace import Writer

# Enough digits for a split into parts whose products with small integers are exact.
_PI = Fraction("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899")
_LN2 = Fraction("0.69314718055994530941723212145817656807550013436025525412068000949339362196969472")
# Above this ratio an angle is measured from pi/4. The tangent of the rest has a numerator without rounding
# error, since the ratio is above 1/2, and is at most 7/25.
_FLAT = 9 / 16
# Above this number an angle is measured from pi/2. Twice the arcsine of the rest is below 1, where floats are
# twice as dense as above.
_INNER = 35 / 64

# P in arctan(t) = t + t z P(z), z = t^2 up to _FLAT^2, and in arcsin(t) likewise, up to _INNER^2. By Remez's
# exchange in 60-digit decimals, which minimises the largest relative error; coefficients are rounded one by
# one, and the later ones are fitted again. Errors: 3.9e-18, 1.8e-17; float32 1.2e-9 both.
_ARCTANGENT = [
    -0.3333333333333302, 0.1999999999992086, -0.1428571427869901, 0.11111110797113893, -0.0909090077325586,
    0.07692165459915125, -0.06665013076329998, 0.058688693557069974, -0.051847244410340554,
    0.04434442590167581, -0.03369210168912141, 0.019235827153942602, -0.005838985868104794,
]  # fmt: skip
_ARCTANGENT_SINGLE = [-0.3333331, 0.19998564, -0.14255343, 0.10810079, -0.07521867, 0.03267482]
_ARCSINE = [
    0.16666666666668123, 0.07499999999622148, 0.04464285748517377, 0.030381928853377586, 0.022372576826476035,
    0.017345599305277626, 0.014047421059137642, 0.010895637263411024, 0.013385798974405966,
    -0.005389614327487404, 0.042181205843260586, -0.047834952343277726, 0.048194900274505466,
]  # fmt: skip
_ARCSINE_SINGLE = [0.16666643, 0.07501475, 0.04433629, 0.03326022, 0.009176841, 0.044568617]


def _parts(value: Fraction, bits: int, count: int) -> list[float]:
    """`value` as a sum of floats, all but the last with `bits` significant bits."""
    parts = []
    for _ in range(count - 1):
        exponent = math.frexp(float(value))[1] - bits
        whole = math.floor(value / Fraction(2) ** exponent)
        parts.append(float(whole * Fraction(2) ** exponent))
        value -= Fraction(parts[-1])
    return [*parts, float(value)]


def reciprocal_root(w: Writer, x: int) -> int:
    """1 / sqrt(x)."""
    return w("div", 1.0, w("sqrt", x))


def cube_root(w: Writer, x: int) -> int:
    """The cube root of x, by the power 1/3 and a Newton step."""
    size = w("abs", x)
    near = w("pow", size, w.number(1.0 / 3.0))
    # a Newton step without the cube of `near`, which has few digits for the smallest numbers
    excess = w("sub", near, w("div", size, w("mul", near, near)))
    better = w("sub", near, w("mul", excess, 1.0 / 3.0))
    # 0 and infinity are exact already
    root = w("select", w("and", w("lt", 0.0, size), w("lt", size, math.inf)), better, size)
    return _signed(w, w("lt", x, 0.0), root)


class _Quadrant(NamedTuple):
    """Nodes of an angle: its quarter turns (mod 4), whether they are odd, sine and cosine of the rest."""

    quarter: int
    swapped: int
    sine: int
    cosine: int


def _quadrant(w: Writer, x: int) -> _Quadrant:
    """Reduce an angle (rad) by quarter turns; the sine and cosine of the rest are polynomials."""
    turns = w("floor", w("add", w("mul", x, float(2 / _PI)), 0.5))
    remainder = x
    for part in _parts(_PI / 2, *((9, 4) if w.single else (30, 4))):
        remainder = w("sub", remainder, w("mul", turns, part))
    z = w("mul", remainder, remainder)
    terms = 5 if w.single else 9
    odd = [(-1) ** k / math.factorial(2 * k + 1) for k in range(1, terms)]
    even = [(-1) ** k / math.factorial(2 * k) for k in range(2, terms)]
    sine_part = w("add", remainder, w("mul", w("mul", remainder, z), w.polynomial(z, odd)))
    bend = w("mul", w("mul", z, z), w.polynomial(z, even))
    cosine_part = w("add", w("sub", 1.0, w("mul", z, 0.5)), bend)
    quarter = w("sub", turns, w("mul", w("floor", w("mul", turns, 0.25)), 4.0))
    swapped = w("or", w("eq", quarter, 1.0), w("eq", quarter, 3.0))
    return _Quadrant(quarter, swapped, sine_part, cosine_part)


def sine(w: Writer, x: int) -> int:
    """The sine of x (rad)."""
    quarter, swapped, s, c = _quadrant(w, x)
    value = w("select", swapped, c, s)
    return _signed(w, w("lt", 1.0, quarter), value)


def cosine(w: Writer, x: int) -> int:
    """The cosine of x (rad)."""
    quarter, swapped, s, c = _quadrant(w, x)
    value = w("select", swapped, s, c)
    negative = w("or", w("eq", quarter, 1.0), w("eq", quarter, 2.0))
    return _signed(w, negative, value)


def tangent(w: Writer, x: int) -> int:
    """The tangent of x (rad)."""
    _, swapped, s, c = _quadrant(w, x)
    top = w("select", swapped, c, s)
    bottom = w("select", swapped, s, c)
    return w("div", w("select", swapped, w("neg", top), top), bottom)


def exponential(w: Writer, x: int) -> int:
    """E to the power x."""
    turns = w("floor", w("add", w("mul", x, float(1 / _LN2)), 0.5))
    remainder = x
    for part in _parts(_LN2, *((9, 3) if w.single else (40, 3))):
        remainder = w("sub", remainder, w("mul", turns, part))
    terms = 8 if w.single else 14
    near = w.polynomial(remainder, [1.0 / math.factorial(k) for k in range(terms)])
    high, low = (88.73, -103.98) if w.single else (709.79, -745.14)
    value = _scaled(w, near, turns, 160.0 if w.single else 1100.0)
    value = w("select", w("lt", x, low), 0.0, value)
    return w("select", w("lt", high, x), math.inf, value)


def logarithm_to_base_2(w: Writer, x: int) -> int:
    """The logarithm of x to base 2."""
    return w("div", w("log", x), float(_LN2))


def power_of_two(w: Writer, x: int) -> int:
    """2 to the power x."""
    turns = w("floor", w("add", x, 0.5))
    near = exponential(w, w("mul", w("sub", x, turns), float(_LN2)))
    high, low = (128.0, -150.0) if w.single else (1024.0, -1075.0)
    value = _scaled(w, near, turns, 160.0 if w.single else 1100.0)
    value = w("select", w("lt", x, low), 0.0, value)
    return w("select", w("le", high, x), math.inf, value)


def _scaled(w: Writer, near: int, turns: int, most: float) -> int:
    """`near` times 2 to an integer power, in two factors, so that neither overflows before the result."""
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


def logistic(w: Writer, x: int) -> int:
    """1 / (1 + exp(-x))."""
    return w("div", 1.0, w("add", 1.0, exponential(w, w("neg", x))))


def hyperbolic_tangent(w: Writer, x: int) -> int:
    """The hyperbolic tangent: a continued fraction for small |x|, exponentials for others."""
    size = w("abs", x)
    t = exponential(w, w("mul", size, -2.0))
    far = w("div", w("sub", 1.0, t), w("add", 1.0, t))
    # Lambert's continued fraction x / (1 + z/(3 + z/(5 + ...))) as one quotient
    z = w("mul", x, x)
    top = w.number(1.0)
    bottom = w.number(17.0)
    for k in range(15, 0, -2):
        denominator = w("add", w("mul", bottom, float(k)), w("mul", z, top))
        top, bottom = bottom, denominator
    near = w("div", w("mul", size, top), bottom)
    value = w("select", w("lt", size, 0.625), near, far)
    return w("select", w("lt", x, 0.0), w("neg", value), w("select", w("ne", x, x), x, value))


def _half_exponential(w: Writer, size: int) -> int:
    """exp(size) / 2, without overflow of exp(size)."""
    root = exponential(w, w("mul", size, 0.5))
    return w("mul", w("mul", root, 0.5), root)


def hyperbolic_cosine(w: Writer, x: int) -> int:
    """The hyperbolic cosine of x."""
    half = _half_exponential(w, w("abs", x))
    return w("add", half, w("div", 0.25, half))


def hyperbolic_sine(w: Writer, x: int) -> int:
    """The hyperbolic sine: a polynomial for small |x|, exponentials for others."""
    size = w("abs", x)
    half = _half_exponential(w, size)
    far = w("sub", half, w("div", 0.25, half))
    z = w("mul", x, x)
    terms = [1.0 / math.factorial(2 * k + 1) for k in range(5 if w.single else 9)]
    near = w("mul", size, w.polynomial(z, terms))
    value = w("select", w("lt", size, 1.0), near, far)
    return _signed(w, w("lt", x, 0.0), value)


def _corrected(w: Writer, t: int, z: int, double: list[float], single: list[float]) -> int:
    """The sum t + t z P(z) of a polynomial P."""
    return w("add", t, w("mul", w("mul", t, z), w.polynomial(z, single if w.single else double)))


def _signed(w: Writer, negative: int, value: int) -> int:
    """The value with a minus sign where `negative` is true."""
    return w("select", negative, w("neg", value), value)


def arctangent(w: Writer, x: int) -> int:
    """The arctangent of x (rad)."""
    size = w("abs", x)
    flat = w("lt", size, _FLAT)
    steep = w("lt", 1 / _FLAT, size)
    top = w("select", flat, size, w("select", steep, -1.0, w("sub", size, 1.0)))
    bottom = w("select", flat, 1.0, w("select", steep, size, w("add", size, 1.0)))
    t = w("div", top, bottom)
    turn = w("select", flat, 0.0, w("select", steep, math.pi / 2, math.pi / 4))
    angle = w("add", turn, _corrected(w, t, w("mul", t, t), _ARCTANGENT, _ARCTANGENT_SINGLE))
    return _signed(w, w("lt", x, 0.0), angle)


def _minus(w: Writer, x: int) -> int:
    """Whether x has a minus sign: the sign of zero appears in its reciprocal only; float32 suffices."""
    x = w("to_f32", x)
    w = Writer(w.program, x)
    return w("lt", w("add", x, w("div", 1.0, x)), 0.0)


def angle_of_point(w: Writer, y: int, x: int) -> int:
    """The angle (rad) of the point (x, y) from the x axis, in [-pi, pi]; -0.0 is a small negative number."""
    width = w("abs", x)
    height = w("abs", y)
    upright = w("lt", width, height)
    small = w("select", upright, width, height)
    large = w("select", upright, height, width)
    # halved if the sum could overflow; otherwise enlarged, so that subnormal numbers keep their bits
    scale = w("select", w("lt", 2.0**60, large), 0.5, 16.0)
    small = w("mul", small, scale)
    large = w("mul", large, scale)
    difference = w("sub", small, large)
    # true for two zeros and false for two infinities, whose difference is NaN
    flat = w("le", difference, w("mul", large, _FLAT - 1.0))
    t = w("div", w("select", flat, small, difference), w("select", flat, large, w("add", small, large)))
    # the ratio of two zeros or two infinities is taken as 1
    t = w("select", w("eq", width, height), 0.0, t)
    from_axis = _corrected(w, t, w("mul", t, t), _ARCTANGENT, _ARCTANGENT_SINGLE)
    left = _minus(w, x)
    axis = w("select", upright, math.pi / 2, w("select", left, math.pi, 0.0))
    turn = w("select", flat, axis, w("select", left, 3 * math.pi / 4, math.pi / 4))
    angle = w("add", turn, _signed(w, w("ne", upright, left), from_axis))
    return _signed(w, _minus(w, y), angle)


def _half_arcsine(w: Writer, x: int) -> tuple[int, int]:
    """Whether |x| is large, and arcsin |x|; for large |x| half of arccos |x|, arcsin sqrt((1 - |x|)/2)."""
    size = w("abs", x)
    outer = w("lt", _INNER, size)
    z = w("select", outer, w("mul", w("sub", 1.0, size), 0.5), w("mul", x, x))
    t = w("select", outer, w("sqrt", z), size)
    return outer, _corrected(w, t, z, _ARCSINE, _ARCSINE_SINGLE)


def arcsine(w: Writer, x: int) -> int:
    """The arcsine of x (rad)."""
    outer, part = _half_arcsine(w, x)
    angle = w("select", outer, w("sub", math.pi / 2, w("add", part, part)), part)
    return _signed(w, w("lt", x, 0.0), angle)


def arccosine(w: Writer, x: int) -> int:
    """The arccosine of x (rad)."""
    outer, part = _half_arcsine(w, x)
    negative = w("lt", x, 0.0)
    turn = w("select", outer, w("select", negative, math.pi, 0.0), math.pi / 2)
    part = w("select", outer, w("add", part, part), part)
    return w("add", turn, _signed(w, w("eq", outer, negative), part))
