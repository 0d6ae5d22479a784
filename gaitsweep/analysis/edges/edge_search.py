"""What a search for edge states may take, and how it ends."""

from __future__ import annotations

import dataclasses
import enum
from typing import Self

from gaitsweep.errors import ArgumentError


class Outcome(enum.IntEnum):
    """How the search for an edge state ended, with a sentence each."""

    fixed = 0, "The edge state is a fixed point of the map."
    periodic = 1, "The edge state is a cycle of the map."
    wandering = 2, "The edge did not come to rest in the rounds allowed."
    jump = 3, "What lies between stays where it is and is no fixed point: the map jumps there."
    same = 4, "Both come to the same attractor, so no edge need lie between them."
    third = 5, "The line between the two leads from the first's basin into that of a third attractor."
    undecided = 6, "A trajectory came to none of the attractors in the cycles allowed."
    fell = 7, "A trajectory fell."
    lost = 8, "A trajectory did not come back to the section, or diverged."
    together = 9, "The two were drawn together: what decides parts them, and not the map."

    sentence: str

    def __new__(cls, number: int, sentence: str) -> Self:
        outcome = int.__new__(cls, number)
        outcome._value_, outcome.sentence = number, sentence
        return outcome


@dataclasses.dataclass(frozen=True)
class Limits:
    """How near, how far and how long; lengths are the largest of any coordinate, as a share of its size.

    Args:
        narrow: distance to which two points are brought together.
        apart: distance from which on they are brought together again. The line between them then misses the
            edge state by the order of its square.
        still: residual of the map at which a state stays where it is.
        cuts: points between the two that are tried at once: 1 bisects. More of them take fewer rounds and
            more evaluations, and find an edge beside a third basin more often.
        most: cycles within which a trajectory has to come to an attractor, and two have to come apart.
        longest: period up to which cycles are told from edges that wander.
        rounds: how often the two are brought together at most.
        settle: cycles after which a start is at its attractor, where nothing else decides.
    """

    narrow: float = 1e-7
    apart: float = 1e-5
    still: float = 1e-6
    cuts: int = 1
    most: int = 1000
    longest: int = 4
    rounds: int = 20
    settle: int = 200

    def __post_init__(self) -> None:
        if not 1e-13 <= self.narrow < self.apart:
            raise ArgumentError(
                f"narrow is {self.narrow:g} and apart is {self.apart:g}. Allowed: narrow from 1e-13 on, "
                "since float64 tells no finer, and apart above it."
            )
        for name in ("cuts", "most", "longest", "rounds", "settle"):
            if getattr(self, name) < 1:
                raise ArgumentError(f"{name} is {getattr(self, name)}. Allowed: whole numbers from 1 on.")
