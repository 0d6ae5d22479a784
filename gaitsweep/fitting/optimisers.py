"""Optimisers of a search: Sobol points, evolution strategies, or a front of several targets.

Each optimiser has an ask-and-tell interface: `ask` returns points of the unit cube, `tell` receives their
scores, of which lower ones are better. The points depend on the seed and on the scores so far, and on nothing
else. So a search that was stopped continues with a new optimiser, which receives the scores of the first.
"""

from __future__ import annotations

import heapq
import importlib.util
import math
from collections import deque
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

Point = Float[np.ndarray, " constants"]  # of the unit cube
PointArray = Float[np.ndarray, "points constants"]
Scores = Float[np.ndarray, " points"]
Misses = Float[np.ndarray, "points targets"]
Method = Literal["sobol", "cma", "nsga3"]
# Packages of the extra `search`.
_PACKAGES = {"cma": "cma", "nsga3": "pymoo"}
# Points of a strategy for each constant, at most: more points hardly improve a generation.
_MAX_PER_DIMENSION = 32
_MIN_POINTS = 4  # of a strategy, which CMA-ES needs
# The standard deviation with which a strategy begins, a share of the ranges.
_WIDTH = 0.2
# Doublings of the number of points of large strategies, at most.
_MAX_DOUBLINGS = 3
# Points of a Sobol sequence that are drawn at a time: a power of two, after which it is even.
_DRAWN_AT_ONCE = 256
RULE_OF_RESTARTS = 2  # raised when `Restarts` chooses other points, so that no older search is continued
_MAX_PARTITIONS = 100  # of the reference directions of a front


class Optimiser(Protocol):
    """Ask-and-tell interface of an optimiser."""

    def ask(self, n: int) -> PointArray:
        """Return the next points (n, constants) of the unit cube."""
        ...

    def tell(self, scores: Scores, misses: Misses) -> None:
        """Report the scores of the points of the first `ask` that has none yet.

        Args:
            scores: scores (n,), the lower the better.
            misses: misses (n, targets), the nearer to 0 the better.
        """
        ...


def missing_package(method: Method) -> str | None:
    """Return the package that a method needs if it is not installed, else None."""
    package = _PACKAGES.get(method)
    return package if package is not None and importlib.util.find_spec(package) is None else None


def optimiser(
    method: Method,
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
        method: the method.
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
        return Restarts(sobol, start, together, seed, _WIDTH if width is None else width)
    return Front(sobol, targets, seed)


class Sobol:
    """Points that fill the cube evenly, whatever their scores, after known points (m, dimension)."""

    def __init__(self, dimension: int, seed: int, known: PointArray | None = None) -> None:
        self.dimension = dimension
        self._sequence = qmc.Sobol(dimension, rng=np.random.default_rng(seed))
        self._drawn = np.zeros((0, dimension)) if known is None else known
        self.known_left = len(self._drawn)  # known points that have not been asked for

    def ask(self, n: int) -> PointArray:
        self.known_left = max(self.known_left - n, 0)
        while len(self._drawn) < n:
            self._drawn = np.concatenate([self._drawn, self._sequence.random(_DRAWN_AT_ONCE)])
        points = self._drawn[:n]
        self._drawn = self._drawn[n:]
        return points

    def tell(self, scores: Scores, misses: Misses) -> None:
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
        self._dimension = middle.size
        # the package does not support one dimension: a second is added, on which nothing depends
        begin = [*middle, 0.5] if middle.size == 1 else list(middle)
        self._strategy = cma.CMAEvolutionStrategy(begin, width, options)
        self._asked: list[Any] = []
        self._scores: dict[int, float] = {}

    def ask(self) -> PointArray:
        """Return the points of the next generation."""
        self._asked = self._strategy.ask()
        self._scores = {}
        return np.clip(np.array(self._asked)[:, : self._dimension], 0.0, 1.0)

    def tell(self, place: int, score: float) -> bool:
        """Record the score of a point of the generation; return whether all of its points now have one.

        A complete generation moves the strategy.

        Args:
            place: the point's place in the generation.
            score: its score.
        """
        self._scores[place] = score
        if len(self._scores) < len(self._asked):
            return False
        self._strategy.tell(self._asked, [self._scores[number] for number in range(len(self._asked))])
        return True

    @property
    def is_over(self) -> bool:
        """Whether the strategy has converged, or no longer improves."""
        return bool(self._strategy.stop())


class _AskedPoint(NamedTuple):
    """A point without a score so far, of a strategy's generation, or of the Sobol start (no strategy)."""

    point: Point
    strategy: int | None = None  # its number
    place: int = 0  # in the generation


class Restarts:
    """Evolution strategies (CMA-ES) that begin anew where they end, small and large ones in turn (BIPOP).

    A large strategy has twice the points a generation of the large one before, up to eight times those of
    the first, and a small one between the least number and half of the latest large one's, with a smaller
    width. A strategy begins as a large one unless the large ones have had more points than the small ones,
    counted as they are asked. Several run side by side to fill each `ask`. The first has as many points as an
    `ask`, within limits. They begin at the best points of a Sobol sequence, in order of their scores.

    Source: Hansen 2009, Benchmarking a BI-population CMA-ES on the BBOB-2009 function testbed, whose
    strategies run one after the other and begin at random points.
    """

    def __init__(self, sobol: Sobol, start: int, together: int, seed: int, width: float) -> None:
        self._sobol = sobol
        self._dimension = sobol.dimension
        # points of a small strategy at least, and of the first large one
        self._smallest = _MIN_POINTS + int(3 * np.log(self._dimension))
        self._first_size = min(max(together, self._smallest), _MAX_PER_DIMENSION * self._dimension)
        self._width = width
        self._rng = np.random.default_rng([seed, 1])
        # whole batches, so that a strategy's generation is one batch where it has as many points
        self._start_left = math.ceil(start / together) * together
        # scores, numbers and points of the Sobol start, the best first (a heap)
        self._start_points: list[tuple[float, int, Point]] = []
        self._start_scored = 0
        self._strategies: dict[int, _Strategy] = {}
        self._begun = 0
        self._queue: deque[_AskedPoint] = deque()
        self._asked: deque[list[_AskedPoint]] = deque()
        self._doublings = 0
        self._large: set[int] = set()  # numbers of the large strategies
        self._points_of_small = 0  # asked of small strategies so far
        self._points_of_large = 0

    def ask(self, n: int) -> PointArray:
        asked = [self._next_point() for _ in range(n)]
        self._asked.append(asked)
        return np.array([asked_point.point for asked_point in asked])

    def tell(self, scores: Scores, misses: Misses) -> None:
        for (point, number, place), score in zip(self._asked.popleft(), scores, strict=True):
            if number is None:
                heapq.heappush(self._start_points, (float(score), self._start_scored, point))
                self._start_scored += 1
            elif self._strategies[number].tell(place, float(score)):
                if self._strategies[number].is_over:
                    del self._strategies[number]
                else:
                    self._queue_generation(number)

    def _next_point(self) -> _AskedPoint:
        """Return the next point of the Sobol start, then of the strategies; begin one if none has points."""
        if self._start_left > 0:
            self._start_left -= 1
            return _AskedPoint(self._sobol.ask(1)[0])
        if not self._queue:
            self._begin_strategy()
        return self._queue.popleft()

    def _begin_strategy(self) -> None:
        """Begin a strategy: a large one if the small ones have had as many points, else a small one."""
        if self._points_of_large <= self._points_of_small:
            size = self._first_size * 2 ** min(self._doublings, _MAX_DOUBLINGS)
            width = self._width
            self._doublings += 1
            self._large.add(self._begun)
        else:
            latest = self._first_size * 2 ** min(self._doublings - 1, _MAX_DOUBLINGS)
            share = self._rng.random() ** 2
            size = int(self._smallest * max(0.5 * latest / self._smallest, 1.0) ** share)
            width = self._width * 10.0 ** (-2.0 * self._rng.random())
        if self._start_points:
            _, _, middle = heapq.heappop(self._start_points)
        else:
            middle = self._rng.random(self._dimension)
        seed = int(self._rng.integers(2**63))
        self._strategies[self._begun] = _Strategy(middle, width, size, seed)
        self._queue_generation(self._begun)
        self._begun += 1

    def _queue_generation(self, number: int) -> None:
        """Queue the points of a strategy's next generation."""
        points = self._strategies[number].ask()
        if number in self._large:
            self._points_of_large += len(points)
        else:
            self._points_of_small += len(points)
        self._queue.extend(_AskedPoint(point, number, place) for place, point in enumerate(points))


class Front:
    """Pareto front of sets (NSGA-III), which begins with a Sobol sequence."""

    def __init__(self, sobol: Sobol, targets: int, seed: int) -> None:
        self._sobol = sobol
        self._targets = targets
        self._seed = seed
        self._algorithm: Any = None  # of pymoo, set up by the first `ask`
        self._asked: deque[Any] = deque()

    def ask(self, n: int) -> PointArray:
        from pymoo.core.population import Population

        if self._algorithm is None:
            self._algorithm = self._set_up(n)
            offspring = self._algorithm.infill()
        elif self._algorithm.is_initialized and not self._sobol.known_left:
            offspring = self._algorithm.infill()
        else:  # known points come first, and before the first scores there are no parents
            offspring = Population()
        if len(offspring) < n:  # duplicates are left out
            sobol_points = Population.new("X", self._sobol.ask(n - len(offspring)))
            offspring = Population.merge(offspring, sobol_points)
        asked: Any = offspring[:n]
        self._asked.append(asked)
        return np.clip(asked.get("X"), 0.0, 1.0)

    def tell(self, scores: Scores, misses: Misses) -> None:
        from pymoo.core.evaluator import Evaluator
        from pymoo.problems.static import StaticProblem

        asked = self._asked.popleft()
        Evaluator().eval(StaticProblem(self._algorithm.problem, F=np.abs(misses)), asked)
        self._algorithm.advance(infills=asked)

    def _set_up(self, n: int) -> Any:
        """Create NSGA-III with its first n points."""
        from pymoo.algorithms.moo.nsga3 import NSGA3
        from pymoo.core.problem import Problem

        points: Any = self._sobol.ask(n)  # in the place of pymoo's own random points
        algorithm = NSGA3(_directions(self._targets, n), pop_size=n, n_offsprings=n, sampling=points)
        problem = Problem(n_var=self._sobol.dimension, n_obj=self._targets, xl=0.0, xu=1.0)
        algorithm.setup(problem, termination=("n_gen", 10**9), seed=self._seed)
        return algorithm


def _directions(targets: int, most: int) -> Float[np.ndarray, "directions targets"]:
    """Return reference directions (n, targets) of a front, at most `most` if possible."""
    from pymoo.util.ref_dirs import get_reference_directions

    partitions = 1
    # `comb` is the number of directions with one more partition
    while math.comb(targets + partitions, targets - 1) <= most and partitions < _MAX_PARTITIONS:
        partitions += 1
    return get_reference_directions("das-dennis", targets, n_partitions=partitions)
