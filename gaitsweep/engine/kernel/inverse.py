"""Arctangent, arcsine and arccosine from the program's operations.

The error is at most two units in the last place, for subnormal and infinite arguments too.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from gaitsweep.engine.kernel.arithmetic import Writer

if TYPE_CHECKING:
    from gaitsweep.engine.kernel.program import Program

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


def _corrected(w: Writer, t: int, z: int, double: list[float], single: list[float]) -> int:
    """t + t z P(z)."""
    return w("add", t, w("mul", w("mul", t, z), w.polynomial(z, single if w.single else double)))


def _signed(w: Writer, negative: int, value: int) -> int:
    return w("select", negative, w("neg", value), value)


def arctangent(program: Program, x: int) -> int:
    w = Writer(program, x)
    size = w("abs", x)
    flat, steep = w("lt", size, _FLAT), w("lt", 1 / _FLAT, size)
    top = w("select", flat, size, w("select", steep, -1.0, w("sub", size, 1.0)))
    bottom = w("select", flat, 1.0, w("select", steep, size, w("add", size, 1.0)))
    t = w("div", top, bottom)
    turn = w("select", flat, 0.0, w("select", steep, math.pi / 2, math.pi / 4))
    angle = w("add", turn, _corrected(w, t, w("mul", t, t), _ARCTANGENT, _ARCTANGENT_SINGLE))
    return _signed(w, w("lt", x, 0.0), angle)


def _minus(program: Program, x: int) -> int:
    """Whether x has a minus sign: the sign of zero appears in its reciprocal only; float32 suffices."""
    x = program.apply("to_f32", x)
    w = Writer(program, x)
    return w("lt", w("add", x, w("div", 1.0, x)), 0.0)


def angle_of_point(program: Program, y: int, x: int) -> int:
    """The angle (rad) of the point (x, y) from the x axis, in [-pi, pi]; -0.0 is a small negative number."""
    w = Writer(program, y)
    width, height = w("abs", x), w("abs", y)
    upright = w("lt", width, height)
    small, large = w("select", upright, width, height), w("select", upright, height, width)
    # halved if the sum could overflow; otherwise enlarged, so that subnormal numbers keep their bits
    scale = w("select", w("lt", 2.0**60, large), 0.5, 16.0)
    small, large = w("mul", small, scale), w("mul", large, scale)
    difference = w("sub", small, large)
    # true for two zeros and false for two infinities, whose difference is NaN
    flat = w("le", difference, w("mul", large, _FLAT - 1.0))
    t = w("div", w("select", flat, small, difference), w("select", flat, large, w("add", small, large)))
    # the ratio of two zeros or two infinities is taken as 1
    t = w("select", w("eq", width, height), 0.0, t)
    rest = _corrected(w, t, w("mul", t, t), _ARCTANGENT, _ARCTANGENT_SINGLE)
    left = _minus(program, x)
    axis = w("select", upright, math.pi / 2, w("select", left, math.pi, 0.0))
    turn = w("select", flat, axis, w("select", left, 3 * math.pi / 4, math.pi / 4))
    angle = w("add", turn, _signed(w, w("ne", upright, left), rest))
    return _signed(w, _minus(program, y), angle)


def _half_arcsine(w: Writer, x: int) -> tuple[int, int]:
    """Whether |x| is large, and arcsin |x|; for large |x| half of arccos |x|, arcsin sqrt((1 - |x|)/2)."""
    size = w("abs", x)
    outer = w("lt", _INNER, size)
    z = w("select", outer, w("mul", w("sub", 1.0, size), 0.5), w("mul", x, x))
    t = w("select", outer, w("sqrt", z), size)
    return outer, _corrected(w, t, z, _ARCSINE, _ARCSINE_SINGLE)


def arcsine(program: Program, x: int) -> int:
    w = Writer(program, x)
    outer, part = _half_arcsine(w, x)
    angle = w("select", outer, w("sub", math.pi / 2, w("add", part, part)), part)
    return _signed(w, w("lt", x, 0.0), angle)


def arccosine(program: Program, x: int) -> int:
    w = Writer(program, x)
    outer, part = _half_arcsine(w, x)
    negative = w("lt", x, 0.0)
    turn = w("select", outer, w("select", negative, math.pi, 0.0), math.pi / 2)
    part = w("select", outer, w("add", part, part), part)
    return w("add", turn, _signed(w, w("eq", outer, negative), part))
