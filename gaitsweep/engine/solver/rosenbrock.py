"""A Rosenbrock method for stiff flows, with step control: Rodas5P of orders 5 and 4.

Each stage solves a linear system with the Jacobian of the flow at the beginning of the step, so a motion that
decays within a small part of the step neither limits the step nor disturbs it (the method is L-stable). The
Jacobian is the exact one, by forward-mode derivatives. The systems share one LU factorisation with partial
pivoting, which is written out as scalar arithmetic, so that kernels run it.

G. Steinebach, Construction of Rosenbrock-Wanner method Rodas5P and numerical benchmarks within the Julia
Differential Equations package, BIT Numer. Math. 63, 27 (2023); the form with U_i of E. Hairer and G. Wanner,
Solving ordinary differential equations II, section IV.7.
"""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp

from gaitsweep.contract import HybridModel, Params, Rates, State
from gaitsweep.engine.carry import Flag, Number
from gaitsweep.engine.solver.runge_kutta import Estimate
from gaitsweep.engine.switches import ROOTS, moving_operations

Vector = list[Number]  # the numbers of a state, or their rates
Matrix = list[Vector]  # the rows of a matrix

# Largest number of continuous variables: the factorisation is written out, with the cube of it operations.
MAX_VARIABLES = 30
# The diagonal coefficient gamma.
GAMMA = 0.21193756319429014
# a_ij: the state of a stage after the first, as a sum of increments; stages 7 and 8 begin at the state of the
# stage before them plus its increment.
STATES: tuple[tuple[float, ...], ...] = (
    (3.0,),
    (2.849394379747939, 0.45842242204463923),
    (-6.954028509809101, 2.489845061869568, -10.358996098473584),
    (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
    (-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946),
)
# C_ij: the increments that are added to the rates of a stage after the first, times the step.
INCREMENTS: tuple[tuple[float, ...], ...] = (
    (-14.155112264123755,),
    (-17.97296035885952, -2.859693295451294),
    (147.12150275711716, -1.41221402718213, 71.68940251302358),
    (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
    (24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471),
    (
        *(30.91273214028599, -3.1208243349937974, 77.79954646070892),
        *(34.28646028294783, -19.097331116725623, -28.087943162872662),
    ),
    (
        *(37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047),
        *(-40.06618937091002, -54.66780262877968, -9.48861652309627),
    ),
)


def rodas5p(model: HybridModel) -> Estimate:
    """The step of order 5 of Steinebach, with the difference from its embedded solution as the error."""

    def step(params: Params, state: State, h: Number) -> tuple[State, Rates]:
        names = jax.eval_shape(model.flow, params, state)
        layout = _Layout({name: jnp.shape(getattr(state, name)) for name in names})

        def rates_at(values: Vector) -> Vector:
            return layout.flat(model.flow(params, layout.state(state, values)))

        start = layout.flat({name: getattr(state, name) for name in layout.shapes})
        rates, times_jacobian = jax.linearize(rates_at, start)
        columns = [times_jacobian(unit) for unit in _unit_vectors(start)]
        if not ROOTS.isdisjoint(moving_operations(model, params, state)):
            columns = [_finite(column) for column in columns]
        factors = _factorised(_stage_matrix(columns, h * GAMMA))
        at = start
        increments = [_solved(factors, _scaled(rates, h))]
        for stage, weights in enumerate(INCREMENTS):
            if stage < len(STATES):
                at = _plus(start, STATES[stage], increments)
            else:
                at = _plus(at, (1.0,), increments[-1:])
            right = _plus(_scaled(rates_at(at), h), [GAMMA * weight for weight in weights], increments)
            increments.append(_solved(factors, right))
        end = _plus(at, (1.0,), increments[-1:])
        return layout.state(state, end), layout.fields(increments[-1])

    return step


@dataclasses.dataclass(frozen=True)
class _Layout:
    """The order of a state's continuous variables as single numbers: the shapes of its fields, by name."""

    shapes: dict[str, tuple[int, ...]]

    def flat(self, fields: Rates) -> Vector:
        """The fields as numbers."""
        numbers = []
        for name, shape in self.shapes.items():
            flat = jnp.ravel(jnp.broadcast_to(fields[name], shape))
            numbers += [flat[i] for i in range(flat.size)]
        return numbers

    def fields(self, values: Vector) -> Rates:
        """The numbers as fields."""
        fields = {}
        first = 0
        for name, shape in self.shapes.items():
            size = math.prod(shape)
            fields[name] = jnp.reshape(jnp.stack(values[first : first + size]), shape)
            first += size
        return fields

    def state(self, state: State, values: Vector) -> State:
        """A state with these numbers."""
        return dataclasses.replace(state, **self.fields(values))


def _unit_vectors(like: Vector) -> list[Vector]:
    """The unit vectors of the space of a vector."""
    return [[jnp.asarray(float(i == j), like[0].dtype) for i in range(len(like))] for j in range(len(like))]


def _finite(column: Vector) -> Vector:
    """A column of the Jacobian, with 0 where a derivative is infinite or NaN, as of a speed at rest.

    The error of a step with such a Jacobian is estimated, and the step shortened, as of any other.
    """
    return [jnp.where(jnp.abs(value) < jnp.inf, value, 0.0) for value in column]


def _scaled(rates: Vector, h: Number) -> Vector:
    """The rates times the step and the diagonal coefficient."""
    return [GAMMA * (h * rate) for rate in rates]


def _plus(start: Vector, weights: tuple[float, ...] | list[float], vectors: list[Vector]) -> Vector:
    """A vector plus the weighted sum of others."""
    total = start
    for weight, vector in zip(weights, vectors, strict=True):
        total = [a + weight * b for a, b in zip(total, vector, strict=True)]
    return total


def _stage_matrix(columns: Matrix, h: Number) -> Matrix:
    """The rows of I - h J, from the columns of J."""
    size = len(columns)
    return [[float(i == j) - h * columns[j][i] for j in range(size)] for i in range(size)]


@dataclasses.dataclass(frozen=True)
class _Factors:
    """The LU factors of a matrix with permuted rows.

    `rows` hold U on and above the diagonal. `exchanges` and `multipliers` have a list for each column k: for
    each row below k whether row k and that row were exchanged, and by how much row k was then subtracted.
    """

    rows: Matrix
    exchanges: list[list[Flag]]
    multipliers: Matrix


def _factorised(matrix: Matrix) -> _Factors:
    """The LU factors of a matrix, with partial pivoting.

    The largest element of a column moves up by exchanges of neighbours in order, which need no index that is
    known only at run time.
    """
    rows = [list(row) for row in matrix]
    exchanges: list[list[Flag]] = []
    multipliers: Matrix = []
    for k in range(len(rows)):
        exchanged = []
        for i in range(k + 1, len(rows)):
            swap = jnp.abs(rows[i][k]) > jnp.abs(rows[k][k])
            for j in range(k, len(rows)):
                upper = rows[k][j]
                rows[k][j] = jnp.where(swap, rows[i][j], upper)
                rows[i][j] = jnp.where(swap, upper, rows[i][j])
            exchanged.append(swap)
        subtracted = []
        for i in range(k + 1, len(rows)):
            multiplier = rows[i][k] / rows[k][k]
            for j in range(k + 1, len(rows)):
                rows[i][j] = rows[i][j] - multiplier * rows[k][j]
            subtracted.append(multiplier)
        exchanges.append(exchanged)
        multipliers.append(subtracted)
    return _Factors(rows, exchanges, multipliers)


def _solved(factors: _Factors, right: Vector) -> Vector:
    """The solution of the linear system of a factorised matrix with a right-hand side."""
    rows = factors.rows
    values = list(right)
    for k in range(len(rows)):
        for i, swap in enumerate(factors.exchanges[k], k + 1):
            upper = values[k]
            values[k] = jnp.where(swap, values[i], upper)
            values[i] = jnp.where(swap, upper, values[i])
        for i, multiplier in enumerate(factors.multipliers[k], k + 1):
            values[i] = values[i] - multiplier * values[k]
    for k in reversed(range(len(rows))):
        total = values[k]
        for j in range(k + 1, len(rows)):
            total = total - rows[k][j] * values[j]
        values[k] = total / rows[k][k]
    return values
