"""Random numbers (`dynamics/random_numbers.py`) in kernels: integer operations in C and in LLVM."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir

from gaitsweep.dynamics.random_numbers import MULTIPLIERS, ROUNDS, WEYL, WHOLE

_WORD = ir.IntType(64)
_MASK = 0xFFFFFFFF

# The function for a source in C; a head defines PART.
IN_C = f"""
PART double philox(const double seed, const double counter, const double stream, const int half) {{
    typedef unsigned long long word;
    const double numbers[3] = {{seed, counter, stream}};
    word k[2], c[4];
    for (int j = 0; j < 3; ++j) {{
        const double whole = fabs(numbers[j]) < {WHOLE!r} ? floor(numbers[j]) : 0.0;
        const word bits = (word)(long long)whole;
        word* const to = j == 0 ? k : c + 2 * (j - 1);
        to[0] = bits & {_MASK}ULL;
        to[1] = bits >> 32;
    }}
    for (int turn = 0; turn < {ROUNDS}; ++turn) {{
        if (turn > 0) {{
            k[0] = (k[0] + {WEYL[0]}ULL) & {_MASK}ULL;
            k[1] = (k[1] + {WEYL[1]}ULL) & {_MASK}ULL;
        }}
        const word first = c[0] * {MULTIPLIERS[0]}ULL, second = c[2] * {MULTIPLIERS[1]}ULL;
        c[0] = (second >> 32) ^ c[1] ^ k[0];
        c[2] = (first >> 32) ^ c[3] ^ k[1];
        c[1] = second & {_MASK}ULL;
        c[3] = first & {_MASK}ULL;
    }}
    const word whole = ((c[2 * half] >> 6) << 26) | (c[2 * half + 1] >> 6);
    return ((double)whole + 0.5) * {2.0**-52!r};
}}
"""


def in_llvm(
    builder: ir.IRBuilder, floor: Callable[[Any], Any], arguments: list[Any], half: int
) -> Any:  # values of llvmlite, which has no type with their members
    """Write the instructions that draw a uniform number in (0, 1) from seed, counter and stream.

    Args:
        builder: the builder of instructions.
        floor: writes the largest whole numbers below some numbers.
        arguments: seed, counter and stream, float64 or vectors of float64.
        half: 0 for the number of the first two of the four words, 1 for that of the last two.

    Returns:
        The number, or the vector of numbers, of the type of the arguments.
    """
    kind = arguments[0].type
    lanes = kind.count if isinstance(kind, ir.VectorType) else 1

    def of_all(scalar: ir.Type, value: float) -> ir.Constant:
        vector = scalar if lanes == 1 else ir.VectorType(scalar, lanes)
        return ir.Constant(vector, value if lanes == 1 else [value] * lanes)

    def word(value: int) -> ir.Constant:
        return of_all(_WORD, value)

    def number(value: float) -> ir.Constant:
        return of_all(ir.DoubleType(), value)

    words = []
    for value in arguments:
        # comparisons with NaN are false
        above = builder.fcmp_ordered("<", value, number(WHOLE))
        small = builder.and_(above, builder.fcmp_ordered(">", value, number(-WHOLE)))
        whole = builder.select(small, floor(value), number(0.0))
        bits = builder.fptosi(whole, word(0).type)
        words += [builder.and_(bits, word(_MASK)), builder.lshr(bits, word(32))]
    k0, k1, *c = words
    for turn in range(ROUNDS):
        if turn:
            k0 = builder.and_(builder.add(k0, word(WEYL[0])), word(_MASK))
            k1 = builder.and_(builder.add(k1, word(WEYL[1])), word(_MASK))
        first = builder.mul(c[0], word(MULTIPLIERS[0]))
        second = builder.mul(c[2], word(MULTIPLIERS[1]))
        c = [
            builder.xor(builder.xor(builder.lshr(second, word(32)), c[1]), k0),
            builder.and_(second, word(_MASK)),
            builder.xor(builder.xor(builder.lshr(first, word(32)), c[3]), k1),
            builder.and_(first, word(_MASK)),
        ]
    high, low = c[2 * half : 2 * half + 2]
    joined = builder.or_(builder.shl(builder.lshr(high, word(6)), word(26)), builder.lshr(low, word(6)))
    middle = builder.fadd(builder.sitofp(joined, kind), number(0.5))
    return builder.fmul(middle, number(2.0**-52))
