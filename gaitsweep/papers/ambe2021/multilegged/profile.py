"""The parameters of a chain whose inner legs are not all alike: mass, spring and amplitude of each.

With x = -1 at the head and 1 at the tail, each inner mass, spring and amplitude has the default
value * (1 + slope * x + bend * (1 - x^2)): a gradient along the chain, and a bump in its middle.
"""

from __future__ import annotations

from fractions import Fraction

from gaitsweep.contract import Quantity

SPRINGS = 3  # of the paper's chain

_WHAT = {
    "m": ("kg", "mass of leg {i}'s segment", "m"),
    "kappa": ("N/m", "spring between legs {i} and {next}", r"\kappa"),
    "a": ("m", "amplitude of leg {i}'s shortening", "a"),
}
_SHAPES = {
    "slope": "gradient of the inner {things}: relative change from the chain's middle to its tail",
    "bend": "bump of the inner {things}: relative change of the middle, none at the ends",
}
_THINGS = {"m": "masses", "kappa": "springs", "a": "amplitudes"}
_SOURCE = "beyond the paper; its sec. 4.3"


def profile_parameters(N: int) -> tuple[Quantity, ...]:
    """The parameters that a profile adds: m_slope, m_bend, ..., then m_2 .. m_N, kappa_2 .., a_2 ..

    The ends stay m_1, m_end, kappa_1, kappa_end, a_1 and a_end, and no shape applies to them.

    Args:
        N: springs; there are N + 1 legs, of which 2 .. N are inner ones.
    """
    shapes = [
        Quantity(
            f"{name}_{shape}",
            "1",
            meaning.format(things=_THINGS[name]),
            0.0,
            symbol=rf"{symbol}_{{\rm {shape}}}",
            source=_SOURCE,
        )
        for name, (_, _, symbol) in _WHAT.items()
        for shape, meaning in _SHAPES.items()
    ]
    values = [
        Quantity(
            f"{name}_{i}",
            unit,
            meaning.format(i=i, next=i + 1),
            _shaped(name, place),
            low=0.0,
            open_ends=True,
            symbol=rf"{symbol}_{{{i}}}",
            source=_SOURCE,
        )
        for name, (unit, meaning, symbol) in _WHAT.items()
        for i, place in _places(name, N).items()
    ]
    return (*shapes, *values)


def _places(name: str, N: int) -> dict[int, Fraction]:
    """X of each inner leg, 2 .. N, or of the middle of each inner spring, 2 .. N - 1."""
    if name == "kappa":
        return {i: Fraction(2 * i - 1, N) - 1 for i in range(2, N)}
    return {i: Fraction(2 * (i - 1), N) - 1 for i in range(2, N + 1)}


def _shaped(name: str, place: Fraction) -> str:
    """The default as a formula; with slope and bend 0 it is the very number of `name`."""
    return f"{name}*(1 + ({place})*{name}_slope + ({1 - place**2})*{name}_bend)"
