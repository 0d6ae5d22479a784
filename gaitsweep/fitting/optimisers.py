"""Optimisers of a search: Sobol points, evolution strategies, or a front of several targets.

Each optimiser has an ask-and-tell interface: `ask` returns points of the unit cube, `tell` receives their
scores. The points depend on the seed and on the scores so far, and on nothing else. So a search that was
stopped continues with a new optimiser, which receives the scores of the first.
"""

from __future__ import annotations

import heapq
import importlib.util
import math
from collections import deque
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

Point = Float[np.ndarray, " constants"]  # of the unit cube
PointArray = Float[np.ndarray, "points constants"]
METHODS = ("sobol", "cma", "nsga3")
# Packages of the extra `search`.
_PACKAGES = {"cma": "cma", "nsga3": "pymoo"}
# Points of a strategy for each constant, at most: with more it learns hardly faster from each generation.
_MAX_PER_DIMENSION = 32
# The standard deviation with which a strategy begins, a share of the ranges.
_WIDTH = 0.2
# Points of a Sobol sequence that are drawn at a time: a power of two, after which it is even.
_DRAWN_AT_ONCE = 256


class Optimiser(Protocol):
    """Ask-and-tell interface of an optimiser."""

    def ask(self, n: int) -> PointArray:
        """Return the next points (n, constants) of the unit cube."""
        ...

    def tell(self, scores: Float[np.ndarray, " points"], misses: Float[np.ndarray, "points targets"]) -> None:
        """Report the scores of the points of the first `ask` that has none yet.

        Args:
            scores: scores (n,).
            misses: misses (n, targets).
        """
        ...


def missing_package(method: str) -> str | None:
    """Return the package that a method needs if it is not installed, else None."""
    package = _PACKAGES.get(method)
    return package if package is not None and importlib.util.find_spec(package) is None else None


def optimiser(
    method: str,
    *,
    dimension: int,
    targets: int,
    start: int,
    together: int,
    seed: int,
    known_points: PointArray | None = None,
    width: float | None = None,
) -> Optimiser:
    """Create the optimiser of a search.

    Args:
        method: one of METHODS.
        dimension: the number of free constants.
        targets: the number of targets that count.
        start: points of a Sobol sequence with which `cma` begins.
        together: usual number of points of an `ask`.
        seed: seed of all random numbers.
        known_points: points (m, constants) that are returned first.
        width: standard deviation with which strategies of `cma` begin, a share of the ranges.
    """
    sobol = Sobol(dimension, seed, known_points)
    if method == "sobol":
        return sobol
    if method == "cma":
        start = max(start, 0 if known_points is None else len(known_points))
        return Restarts(sobol, start, together, seed, width or _WIDTH)
    return Front(sobol, targets, seed)


class Sobol:
    """Points that fill the cube evenly, whatever their scores, after known points (m, dimension)."""

    def __init__(self, dimension: int, seed: int, known: PointArray | None = None) -> None:
        self.dimension = dimension
        self._points = qmc.Sobol(dimension, rng=np.random.default_rng(seed))
        self._drawn: list[PointArray] = [] if known is None else [known]

    def ask(self, n: int) -> PointArray:
        while sum(map(len, self._drawn)) < n:
            self._drawn.append(self._points.random(_DRAWN_AT_ONCE))
        points = np.concatenate(self._drawn)
        self._drawn = [points[n:]]
        return points[:n]

    def tell(self, scores: Float[np.ndarray, " points"], misses: Float[np.ndarray, "points targets"]) -> None:
        """Ignore the scores, on which no point of the sequence depends."""


class _Strategy:
    """One evolution strategy (CMA-ES), with its pending points and its random numbers."""

    def __init__(self, middle: Point, width: float, size: int, seed: int) -> None:
        import cma

        rng = np.random.default_rng(seed)
        # the package's own seed is that of the whole process; strategies here run side by side
        options = {
            "bounds": [0.0, 1.0],
            "popsize": size,
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": float("nan"),
            "verbose": -9,
            "tolfun": 1e-6,
            "tolx": 1e-6,
        }
        self.size, self._dimension = size, middle.size
        # the package does not support one dimension: a second is added, on which nothing depends
        begun = [*middle, 0.5] if middle.size == 1 else list(middle)
        self._strategy = cma.CMAEvolutionStrategy(begun, width, options)
        self._asked: list[Any] = []
        self._scores: dict[int, float] = {}

    def ask(self) -> PointArray:
        self._asked = self._strategy.ask()
        self._scores = {}
        return np.clip(np.array(self._asked)[:, : self._dimension], 0.0, 1.0)

    def tell(self, place: int, score: float) -> bool:
        """Store a point's score; return True when the generation is complete."""
        self._scores[place] = score
        if len(self._scores) < len(self._asked):
            return False
        self._strategy.tell(self._asked, [self._scores[i] for i in range(len(self._asked))])
        return True

    @property
    def is_over(self) -> bool:
        """Whether the strategy has converged, or no longer improves."""
        return bool(self._strategy.stop())


class Restarts:
    """Evolution strategies (CMA-ES) that begin anew where they end, small and large ones in turn (BIPOP).

    Several run side by side to fill each `ask`. The first has as many points as an `ask`, within limits. They
    begin at the best points of a Sobol sequence, in order of their scores.

    Source: Hansen 2009, Benchmarking a BI-population CMA-ES on the BBOB-2009 function testbed.
    """

    def __init__(self, sobol: Sobol, start: int, together: int, seed: int, width: float) -> None:
        dimension = sobol.dimension
        self._least = 4 + int(3 * np.log(dimension))
        self._first = min(max(together, self._least), _MAX_PER_DIMENSION * dimension)
        self._dimension = dimension
        self._rng = np.random.default_rng([seed, 1])
        # whole batches, so that a strategy's generation is one batch where it has as many points
        self._sobol, self._start = sobol, -(-start // together) * together
        # scores, numbers and points of the Sobol start, the best first (a heap)
        self._begun: list[tuple[float, int, Point]] = []
        self._scored = 0
        self._waiting: deque[tuple[int, int, Point]] = deque()  # strategy, place, point
        self._strategies: dict[int, _Strategy] = {}
        self._asked: deque[list[tuple[int, int, Point]]] = deque()
        self._number = 0
        self._width = width
        self._doublings = 0
        self._spent = {"small": 0, "large": 0}

    def ask(self, n: int) -> PointArray:
        asked: list[tuple[int, int, Point]] = []
        while len(asked) < n:
            if self._start > 0:
                point = self._sobol.ask(1)[0]
                self._start -= 1
                asked.append((-1, 0, point))
                continue
            if not self._waiting:
                self._begin()
            asked.append(self._waiting.popleft())
        self._asked.append(asked)
        return np.array([point for _, _, point in asked])

    def tell(self, scores: Float[np.ndarray, " points"], misses: Float[np.ndarray, "points targets"]) -> None:
        for (number, place, point), score in zip(self._asked.popleft(), scores, strict=True):
            if number < 0:
                heapq.heappush(self._begun, (float(score), self._scored, point))
                self._scored += 1
                continue
            strategy = self._strategies[number]
            if not strategy.tell(place, float(score)):
                continue
            if strategy.is_over:
                del self._strategies[number]
            else:
                self._queue(number)

    def _begin(self) -> None:
        """Begin a strategy: a large one if the small ones have had more points, else a small one."""
        if self._spent["large"] <= self._spent["small"]:
            size, width, regime = self._first * 2**self._doublings, self._width, "large"
            self._doublings = min(self._doublings + 1, 3)
        else:
            share = self._rng.random() ** 2
            size = int(self._least * (0.5 * self._first * 2**self._doublings / self._least) ** share)
            width = self._width * 10.0 ** (-2.0 * self._rng.random())
            regime = "small"
        self._spent[regime] += size
        middle = heapq.heappop(self._begun)[2] if self._begun else self._rng.random(self._dimension)
        seed = int(self._rng.integers(2**63))
        self._strategies[self._number] = _Strategy(middle, width, max(size, 4), seed)
        self._queue(self._number)
        self._number += 1

    def _queue(self, number: int) -> None:
        """Queue the points of a strategy's next generation."""
        points = self._strategies[number].ask()
        self._waiting.extend((number, place, point) for place, point in enumerate(points))


class Front:
    """Pareto front of sets (NSGA-III), which begins with a Sobol sequence."""

    def __init__(self, sobol: Sobol, targets: int, seed: int) -> None:
        self._dimension, self._targets, self._seed = sobol.dimension, targets, seed
        self._sobol = sobol
        self._algorithm: Any = None
        self._asked: deque[Any] = deque()

    def ask(self, n: int) -> PointArray:
        from pymoo.core.population import Population

        begins = self._algorithm is None
        if begins:
            self._algorithm = self._first(n)
        # before the first scores there is no parent
        breeds = begins or self._algorithm.is_initialized
        offspring = self._algorithm.infill() if breeds else Population()
        if len(offspring) < n:  # duplicates are left out
            more = Population.new("X", self._sobol.ask(n - len(offspring)))
            offspring = Population.merge(offspring, more)
        self._asked.append(offspring[:n])
        return np.clip(self._asked[-1].get("X"), 0.0, 1.0)

    def tell(self, scores: Float[np.ndarray, " points"], misses: Float[np.ndarray, "points targets"]) -> None:
        from pymoo.core.evaluator import Evaluator
        from pymoo.problems.static import StaticProblem

        asked = self._asked.popleft()
        Evaluator().eval(StaticProblem(self._algorithm.problem, F=np.abs(misses)), asked)
        self._algorithm.advance(infills=asked)

    def _first(self, n: int) -> Any:
        """Set up NSGA-III with its first n points."""
        from pymoo.algorithms.moo.nsga3 import NSGA3
        from pymoo.core.problem import Problem

        first: Any = self._sobol.ask(n)  # in the place of pymoo's own random points
        algorithm = NSGA3(_directions(self._targets, n), pop_size=n, n_offsprings=n, sampling=first)
        problem = Problem(n_var=self._dimension, n_obj=self._targets, xl=0.0, xu=1.0)
        algorithm.setup(problem, termination=("n_gen", 10**9), seed=self._seed)
        return algorithm


def _directions(targets: int, most: int) -> Float[np.ndarray, "directions targets"]:
    """Return reference directions (n, targets) of a front, at most `most` if possible."""
    from pymoo.util.ref_dirs import get_reference_directions

    parts = 1
    while math.comb(targets + parts, targets - 1) <= most and parts < 100:
        parts += 1
    return get_reference_directions("das-dennis", targets, n_partitions=parts)
