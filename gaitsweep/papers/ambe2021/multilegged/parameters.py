"""The parameters of the chain, and those of a chain whose inner legs are not all alike.

`configs/ambe2021.yaml` has the paper's set of values. With x = -1 at the head and 1 at the tail, each inner
mass, spring and amplitude has the default value * (1 + slope * x + bend * (1 - x^2)): a gradient along the
chain, and a bump in its middle.
"""

from __future__ import annotations

from fractions import Fraction

from gaitsweep.contract import Quantity

SPRINGS = 3  # of the paper's chain

_TABLE_1 = "Ambe 2021, Table 1"
_EQ_31, _EQ_32 = "eq. (31)", "eq. (32)"  # the equations in which head and tail differ


_positive = Quantity.positive

PARAMETERS = (
    Quantity(
        "beta", "1", "duty factor", 0.8, low=0.0, high=1.0, open_ends=True, symbol=r"\beta", source=_TABLE_1
    ),
    _positive("kappa", "N/m", "spring between neighbours", 100.0, r"\kappa", _TABLE_1),
    _positive("kappa_1", "N/m", "spring between the first two legs", "kappa", r"\kappa_1", _EQ_31),
    _positive("kappa_end", "N/m", "spring between the last two legs", "kappa", r"\kappa_N", _EQ_32),
    _positive("sigma", "N s/m", "damper between neighbours", "2*sqrt(kappa)", r"\sigma", _TABLE_1),
    _positive("m", "kg", "mass of each inner leg's segment", 1.0, "m", _TABLE_1),
    _positive("m_B", "kg", "mass of both end segments", 0.9, "m_B", _TABLE_1),
    _positive("m_1", "kg", "mass of the head's segment", "m_B", "m_1", _EQ_31),
    _positive("m_end", "kg", "mass of the tail's segment", "m_B", "m_{N+1}", _EQ_32),
    _positive("a", "m", "amplitude of the leg's shortening", 0.4, "a", _TABLE_1),
    _positive("a_1", "m", "amplitude of the first leg's shortening", "a", "a_1", _EQ_31),
    _positive("a_end", "m", "amplitude of the last leg's shortening", "a", "a_{N+1}", _EQ_32),
    _positive("L", "m", "longest leg length", 1.0, "L", _TABLE_1),
    _positive("K", "N/m", "spring of the ground", 1.0e5, "K", _TABLE_1),
    _positive("D", "N s/m", "damper of the ground", "2*sqrt(K)", "D", _TABLE_1),
    _positive("omega", "rad/s", "basic frequency of locomotion", 0.4, r"\omega", _TABLE_1),
    _positive("tau", "s", "time constant of the phase reset", 0.5, r"\tau", _TABLE_1),
    _positive("g", "m/s2", "gravitational acceleration", 9.8, "g", _TABLE_1),
    Quantity("clamp", "1", "1: the ground cannot pull; 0: eq. (1) exactly", 0.0, low=0.0, high=1.0,
             symbol="c", whole=True),
)  # fmt: skip

# Unit, meaning and symbol of the quantities that may differ among the inner legs.
_PROFILED = {
    "m": ("kg", "mass of leg {i}'s segment", "m"),
    "kappa": ("N/m", "spring between legs {i} and {next}", r"\kappa"),
    "a": ("m", "amplitude of leg {i}'s shortening", "a"),
}
_SHAPES = {
    "slope": "gradient of the inner {things}: relative change from the chain's middle to its tail",
    "bend": "bump of the inner {things}: relative change of the middle, none at the ends",
}
_PLURALS = {"m": "masses", "kappa": "springs", "a": "amplitudes"}
_SOURCE = "beyond the paper; its sec. 4.3"


def chain_parameters(N: int, *, profile: bool) -> tuple[Quantity, ...]:
    """The parameters of a chain with N springs, with or without a profile of its inner legs."""
    return (*PARAMETERS, *profile_parameters(N)) if profile else PARAMETERS


def profile_parameters(N: int) -> tuple[Quantity, ...]:
    """The parameters that a profile adds: m_slope, m_bend, ..., then m_2 .. m_N, kappa_2 .., a_2 ..

    The ends stay m_1, m_end, kappa_1, kappa_end, a_1 and a_end, and no shape applies to them.

    Args:
        N: springs; there are N + 1 legs, of which 2 .. N are inner ones.
    """
    shapes = [
        Quantity(f"{name}_{shape}", "1", meaning.format(things=_PLURALS[name]), 0.0,
                 symbol=rf"{symbol}_{{\rm {shape}}}", source=_SOURCE)
        for name, (_, _, symbol) in _PROFILED.items()
        for shape, meaning in _SHAPES.items()
    ]  # fmt: skip
    values = [
        _positive(f"{name}_{i}", unit, meaning.format(i=i, next=i + 1),
                  # with slope and bend 0 it is the very number of `name`
                  f"{name}*(1 + ({x})*{name}_slope + ({1 - x**2})*{name}_bend)",
                  rf"{symbol}_{{{i}}}", _SOURCE)
        for name, (unit, meaning, symbol) in _PROFILED.items()
        for i, x in _places_along_chain(name, N).items()
    ]  # fmt: skip
    return (*shapes, *values)


def _places_along_chain(name: str, N: int) -> dict[int, Fraction]:
    """The place x, -1 to 1, of each inner leg, 2 .. N, or of the middle of each inner spring, 2 .. N - 1."""
    if name == "kappa":
        return {i: Fraction(2 * i - 1, N) - 1 for i in range(2, N)}
    return {i: Fraction(2 * (i - 1), N) - 1 for i in range(2, N + 1)}
