"""Functions that between them use every primitive that the scalar kernel knows, with inputs for each."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.ad_checkpoint import checkpoint_name

from gaitsweep.dynamics import random_numbers

NAN, INF = math.nan, math.inf
X = np.array([0.3, -1.7, 2.4, 0.0, 5.1])
Y = np.array([-2.0, 0.7, 0.4, 1.5, -3.3])
M = np.arange(12.0).reshape(3, 4) * 0.7 - 3.1
T = np.sin(np.arange(24.0)).reshape(2, 3, 4)
ODD = np.array([NAN, INF, -INF, -0.0, 0.0, 1.0, -1.0, 0.5])
HALVES = np.array([-2.5, -1.5, -0.5, 0.49999999999999994, 0.5, 1.5, 2.5, 4503599627370497.0, -0.2, NAN, INF])
WHOLE = np.array([7, -7, 3, -3, 0], np.int64)
DIVISORS = np.array([2, 2, -2, -2, 5], np.int64)
FLAGS = np.array([True, False, True, True, False])
OTHERS = np.array([True, True, False, True, False])
INDEX = np.int64(1)


def _grid(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    first, second = np.meshgrid(a, a)
    return first.ravel(), second.ravel()


Case = tuple[Callable[..., Any], tuple[Any, ...]]
CASES: dict[str, Case] = {}


def _cases(table: dict[str, Case]) -> None:
    assert not set(table) & set(CASES)
    CASES.update(table)


_cases(
    {
        "arithmetic": (lambda x, y: (x + y, x - y, x * y, x / y, -x, abs(x)), (X, Y)),
        "arithmetic of odd numbers": (lambda x, y: (x + y, x - y, x * y, x / y, -x, abs(x)), _grid(ODD)),
        "floor, ceil, sign": (lambda x: (jnp.floor(x), jnp.ceil(x), jnp.sign(x)), (np.append(HALVES, ODD),)),
        "round to even": (lambda x: jnp.round(x), (HALVES,)),
        "round away": (lambda x: lax.round(x, lax.RoundingMethod.AWAY_FROM_ZERO), (HALVES,)),
        "round to decimals": (lambda x: jnp.round(x, 1), (X,)),
        "truncate": (jnp.trunc, (HALVES,)),
        "square roots": (
            lambda x: (jnp.sqrt(x), lax.rsqrt(x), jnp.cbrt(x)),
            (np.append(ODD, [2.0, -8.0, 1e-300]),),
        ),
        "whole powers": (lambda x: (x**2, x**3, x**7, x**-2, lax.integer_pow(x, 0), lax.square(x)), (Y,)),
        "powers": (lambda x, y: (jnp.abs(x) ** y, x**2.0, jnp.power(jnp.abs(x), 0.5), 2.0**y), (X, Y)),
        "negative base": (
            lambda x, y: lax.pow(x, y),
            (np.array([-1.0, -8.0, 0.0]), np.array([0.5, 3.0, -1.0])),
        ),
        "power by a whole number": (lambda x, n: lax.pow(x, n), (Y, np.array([2, 3, -1, 0, 5]))),
        "comparisons": (lambda x, y: (x < y, x <= y, x > y, x >= y, x == y, x != y), _grid(ODD)),
        "extremes": (lambda x, y: (jnp.maximum(x, y), jnp.minimum(x, y)), _grid(ODD)),
        "extremes with a number": (
            lambda x: (jnp.maximum(x, 0.2), jnp.minimum(0.2, x), jax.nn.relu(x)),
            (ODD,),
        ),
        "extremes with NaN": (lambda x: (jnp.maximum(x, NAN), jnp.minimum(NAN, x)), (ODD,)),
        "clamp": (lambda x: lax.clamp(-0.5, x, 0.7), (ODD,)),
        "clamp between arrays": (lambda x, y: lax.clamp(y, x, y + 1.0), (X, Y)),
        "clip": (lambda x: (jnp.clip(x, -1.0, 1.0), jnp.clip(x, min=0.0)), (X,)),
        "remainders": (
            lambda x, y: (lax.rem(x, y), jnp.mod(x, y), x // y, jnp.fmod(x, y), lax.rem(x[:0], y[:0])),
            _grid(np.array([0.3, -1.7, 2.4, 5.2])),
        ),
        "wrap": (lambda x: (jnp.mod(x, 2 * jnp.pi), jnp.mod(x + jnp.pi, 2 * jnp.pi) - jnp.pi), (10 * X,)),
        "finite": (lambda x: (jnp.isfinite(x), jnp.isnan(x), jnp.isinf(x)), (ODD,)),
        "NaN to numbers": (lambda x: jnp.nan_to_num(x), (ODD,)),
        "copysign-like": (lambda x, y: jnp.where(y < 0, -jnp.abs(x), jnp.abs(x)), (X, Y)),
        "trigonometry": (lambda x: (jnp.sin(x), jnp.cos(x), jnp.tan(x)), (np.append(X, [NAN, INF, -INF]),)),
        "inverse trigonometry": (
            lambda x: (jnp.arcsin(x), jnp.arccos(x), jnp.arctan(x)),
            (np.linspace(-1, 1, 5),),
        ),
        "angles": (lambda x, y: (jnp.arctan2(x, y), jnp.hypot(x, y)), _grid(X)),
        "hyperbolic": (lambda x: (jnp.sinh(x), jnp.cosh(x), jnp.tanh(x)), (np.append(X, ODD),)),
        "inverse hyperbolic": (
            lambda x: (jnp.arcsinh(x), jnp.arccosh(1.0 + jnp.abs(x)), jnp.arctanh(x / 6.0)),
            (X,),
        ),
        "exponentials": (lambda x: (jnp.exp(x), jnp.exp2(x), jnp.expm1(x)), (np.append(X, ODD),)),
        "logarithms": (lambda x: (jnp.log(x), jnp.log1p(x), jnp.log2(jnp.abs(x))), (np.append(X, ODD),)),
        "activations": (
            lambda x: (jax.nn.sigmoid(x), jax.nn.softplus(x), jax.nn.gelu(x), jax.nn.silu(x)),
            (X,),
        ),
        "random numbers": (
            lambda x, y: (random_numbers.uniform(x, y, 1), random_numbers.normal(y, x)),
            _grid(np.round(ODD)),
        ),
        "error function": (lambda x: (lax.erf(x), lax.erfc(x)), (X,)),
        "soft maximum": (lambda x: (jax.nn.softmax(x), jax.nn.logsumexp(x)), (X,)),
        "float32": (
            lambda x, y: (jnp.sin(x) * y + jnp.exp(-y), x / y, jnp.sqrt(x * x), x // y, x < y),
            (X.astype(np.float32), Y.astype(np.float32)),
        ),
        "float32 functions": (
            lambda x: (
                jnp.tanh(x),
                jnp.cosh(x),
                jax.nn.sigmoid(x),
                jnp.log1p(x * x),
                jnp.arctan2(x, 2.0),
                jnp.tan(x),
                jnp.cbrt(x),
                jnp.round(x),
                x**3,
                lax.erf(x),
                jnp.exp2(x),
                jnp.sinh(x),
            ),
            (X.astype(np.float32),),
        ),
        "mixed precision": (
            lambda x: (x.astype(jnp.float32) * 2, x.astype(jnp.float32).astype(jnp.float64) + x),
            (X,),
        ),
        "from float32 to whole": (
            lambda x: (x.astype(jnp.int32) + 1, x.astype(bool)),
            (X.astype(np.float32),),
        ),
        "conversions": (
            lambda x, n, b: (
                x.astype(int),
                n.astype(float) / 2,
                b.astype(float),
                b.astype(int),
                x.astype(bool),
                n.astype(bool),
                n.astype(jnp.float32) / 2,
            ),
            (X, WHOLE, FLAGS),
        ),
        "whole numbers": (
            lambda n, m: (
                n + m,
                n - m,
                n * m,
                n // m,
                n % m,
                lax.div(n, m),
                lax.rem(n, m),
                -n,
                abs(n),
                jnp.sign(n),
                jnp.maximum(n, m),
                jnp.minimum(n, 2),
                n < m,
                n == m,
                (n % 7) ** 3,
            ),
            (WHOLE, DIVISORS),
        ),
        "flags": (
            lambda a, b: (
                a & b,
                a | b,
                a ^ b,
                ~a,
                jnp.logical_and(a, True),
                a == b,
                a != b,
                jnp.maximum(a, b),
            ),
            (FLAGS, OTHERS),
        ),
        "select": (
            lambda x, y: (jnp.where(x > y, x, y), jnp.where(x > y, x, 0.0), jnp.where(x > 0, x < 1, y > 0)),
            (X, Y),
        ),
        "select by one flag": (lambda x, y: lax.select_n(x[0] > 0, x, y), (X, Y)),
        "select among flags": (
            lambda a, b: (jnp.where(a, b, ~b), jnp.where(a, True, b), jnp.where(a, b, False)),
            (FLAGS, OTHERS),
        ),
        "select of many": (
            lambda n, x: lax.select_n(n, x, 2 * x, -x),
            (np.array([0, 1, 2, 1, 0], np.int32), X),
        ),
        "select of conditions": (
            lambda x: (
                jnp.select([x < 0, x < 1], [x, 10 * x], 100 * x)
                + jnp.piecewise(x, [x < 0], [jnp.sin, jnp.cos])
            ),
            (X,),
        ),
        "choose": (lambda n, x: jnp.choose(n, [x, -x], mode="clip"), (np.array([0, 1, 1, 0, 1]), X)),
        "not differentiated": (lambda x: lax.stop_gradient(x) + jnp.copy(x), (X,)),
        "kept as it is": (lambda x: lax.optimization_barrier(lax.reduce_precision(x, 11, 52)), (X,)),
        "named": (lambda x: checkpoint_name(x, "here") * 2, (X,)),
    }
)

_cases(
    {
        "sums": (lambda x: (x.sum(), x.sum(0), x.sum((0, 2)), x.mean(1), x.prod(-1), x.sum(())), (T,)),
        "extremes along axes": (lambda x: (x.max(), x.min(0), x.max((1, 2)), jnp.ptp(x, 1)), (T,)),
        "extremes along axes with NaN": (lambda x: (x.max(), x.min()), (ODD,)),
        "any and all": (lambda x: (jnp.any(x > 0.9), jnp.all(x < 0.5, 1), lax.reduce_xor(x > 0, (0,))), (T,)),
        "counts": (lambda x: (jnp.sum(x > 0), jnp.count_nonzero(x, axis=1), jnp.mean(x > 0)), (T,)),
        "places of extremes": (
            lambda x: (jnp.argmax(x), jnp.argmin(x, 1), jnp.argmax(x, 0), jnp.argmax(x > 0, 2)),
            (T,),
        ),
        "places of the first NaN": (
            lambda x: (jnp.argmax(x), jnp.argmin(x)),
            (np.append(X, [NAN, 1.0, NAN]),),
        ),
        "places of ties": (lambda x: (jnp.argmax(x), jnp.argmin(x)), (np.array([1, 3, 3, 1]),)),
        "running sums": (
            lambda x: (
                jnp.cumsum(x, 1),
                lax.cumsum(x, 0, reverse=True),
                lax.cumprod(x, 2),
                lax.cummax(x, 1),
                lax.cummin(x, 2, reverse=True),
            ),
            (T,),
        ),
        "differences": (lambda x: (jnp.diff(x), jnp.diff(x, axis=0), jnp.gradient(x, axis=1)), (M,)),
        "nothing to sum": (
            lambda x: (
                x[:0].sum(),
                x[:0].prod(),
                jnp.all(x[:0] > 0),
                jnp.any(x[:0] > 0),
                x[:0] + 1,
                jnp.cumsum(x[:0]),
            ),
            (X,),
        ),
        "statistics": (
            lambda x: (x.var(), x.std(0), jnp.median(x[0]), jnp.average(x, weights=jnp.abs(x) + 1)),
            (M,),
        ),
        "norms": (lambda x: (jnp.linalg.norm(x), jnp.linalg.norm(x, axis=1)), (M,)),
    }
)

_cases(
    {
        "products of matrices": (
            lambda x, y: (x @ y.T, x.T @ y, x[0] @ y[1], jnp.outer(x[0], y[1]), x @ y[0]),
            (M, M - 1),
        ),
        "products of batches": (
            lambda x: (jnp.einsum("bij,bkj->bik", x, x), jnp.einsum("bij,kbj->ikb", x, x.transpose(1, 0, 2))),
            (T,),
        ),
        "products of nothing": (lambda x: (x[:, :0] @ x[:0], x[:0] @ x.T), (M[:3, :3],)),
        "products added up in double": (
            lambda x: lax.dot(x, x.T, preferred_element_type=jnp.float64),
            (M.astype(np.float32),),
        ),
        "products of whole numbers": (lambda n: n @ n, (WHOLE,)),
        "cross, trace, kron": (
            lambda x: (jnp.cross(x[0, :3], x[1, :3]), jnp.trace(x), jnp.kron(x[0], x[1])),
            (M,),
        ),
        "determinants": (lambda x: (jnp.linalg.det(x[:2, :2]), jnp.linalg.det(x[:, :3] + jnp.eye(3))), (M,)),
        "shapes": (
            lambda x: (
                x.T,
                x.reshape(2, 6),
                x.ravel(),
                x[None],
                x[:, None, :],
                jnp.moveaxis(x, 0, 1),
                jnp.squeeze(x[None]),
            ),
            (M,),
        ),
        "slices": (lambda x: (x[1:3], x[::2, 1::2], x[::-1], x[..., -1], x[:, :0], x[2, 3]), (M,)),
        "flips": (lambda x: (jnp.flip(x), jnp.flip(x, 1), jnp.rot90(x), jnp.roll(x, 2, axis=1)), (M,)),
        "pads": (
            lambda x: (
                jnp.pad(x, 1),
                jnp.pad(x, ((0, 2), (1, 0)), constant_values=7.0),
                jnp.pad(x, 1, mode="edge"),
                lax.pad(x, x[0, 0], ((-1, 2, 0), (1, -1, 2))),
                lax.pad(x[0], 0.0, ((-1, -1, 1),)),
            ),
            (M,),
        ),
        "put together": (
            lambda x: (
                jnp.concatenate([x, -x]),
                jnp.stack([x, -x], axis=1),
                jnp.hstack([x, x]),
                jnp.append(x, 1.0),
                jnp.block([[x, x], [x, x]]),
            ),
            (M,),
        ),
        "taken apart": (
            lambda x: (jnp.split(x, 2, axis=1), jnp.split(x, [1], axis=0), list(x), jnp.unstack(x, axis=1)),
            (M,),
        ),
        "repeated": (
            lambda x: (jnp.tile(x, (2, 1)), jnp.repeat(x, 2, axis=1), jnp.broadcast_to(x[0], (2, 4))),
            (M,),
        ),
        "numbers in a row": (
            lambda x: (
                jnp.arange(4) * x[0],
                lax.broadcasted_iota(float, (3, 4), 1) + x,
                jnp.eye(3, 4) * x,
                jnp.linspace(0.0, x[0, 0], 4),
            ),
            (M,),
        ),
        "triangles": (lambda x: (jnp.tril(x), jnp.triu(x, 1), jnp.diag(x[0]), jnp.diagonal(x)), (M,)),
        "sorted": (
            lambda x: (jnp.sort(x), jnp.argsort(x), jnp.sort(x, descending=True)),
            (X[[3, 1, 0, 1, 4, 2]],),
        ),
        "sorted along an axis": (lambda x: (jnp.sort(x, 0), jnp.argsort(x, 1)), (T[0],)),
        "sorted with NaN": (lambda x: (jnp.sort(x), jnp.argsort(x)), (ODD[[0, 1, 5, 0, 2, 7]],)),
        "sorted by two keys": (
            lambda n, x: lax.sort([n, x, jnp.arange(5)], num_keys=2),
            (np.array([2, 1, 2, 1, 2]), Y),
        ),
        "sorted flags": (jnp.sort, (FLAGS,)),
        "total order": (
            lambda x, y: (lax.lt_to_p.bind(x, y), lax.le_to_p.bind(x, y), lax.eq_to_p.bind(x, y)),
            _grid(ODD[[0, 1, 2, 4, 5]]),
        ),
        "looked up": (
            lambda x: jnp.interp(x, jnp.array([-2.0, 0.0, 1.0, 4.0]), jnp.array([1.0, 3.0, -1.0, 0.5])),
            (X,),
        ),
    }
)

_cases(
    {
        "read at known places": (
            lambda x: (
                x[jnp.array([2, 0, -1])],
                x[:, jnp.array([1, 1])],
                x[jnp.array([0, 1]), jnp.array([2, 3])],
                jnp.take(x, jnp.array([1, 9]), axis=1),
                x.at[jnp.array([1, 7])].get(mode="fill", fill_value=-5.0),
                x.at[jnp.array([1, 7])].get(mode="clip"),
            ),
            (M,),
        ),
        "read whole numbers outside": (lambda n: jnp.take(n, jnp.array([1, 9])), (WHOLE.astype(np.int32),)),
        "read unsigned numbers and flags outside": (
            lambda n: (jnp.take(n.astype(jnp.uint32), jnp.array([1, 9])), jnp.take(n > 0, jnp.array([1, 9]))),
            (np.abs(WHOLE),),
        ),
        "read flags by a mask": (lambda x: x[np.array([True, False, True])], (M,)),
        "read by batch": (lambda x: jax.vmap(lambda row, i: row[i])(x, jnp.array([0, 2, 3])), (M,)),
        "read at a moving place": (lambda x, i: (x[i], x[:, i], x[i, i], x[-i], x[i + 9]), (M, INDEX)),
        "read at moving places": (
            lambda x, i: (jnp.take(x, i, axis=1), x[i], x.at[:, 0].get()[i], x[i, i + 1]),
            (M, np.array([2, 0])),
        ),
        "read by batch at moving places": (
            lambda x, i: jax.vmap(lambda row, i: row[i])(x, i),
            (M, np.array([0, 2, 3])),
        ),
        "read outside at moving places": (lambda x, i: jnp.take(x, i), (X, np.array([-9, -1, 4, 5]))),
        "read along an axis": (lambda x: jnp.take_along_axis(x, jnp.argsort(x, axis=1), axis=1), (M,)),
        "slices at moving places": (
            lambda x, i: (
                lax.dynamic_slice(x, (i, 2 * i), (2, 2)),
                lax.dynamic_slice(x, (0, i), (2, 2)),
                lax.dynamic_slice(x, (7, -3), (2, 2)),
                lax.dynamic_slice_in_dim(x, i - 5, 2),
            ),
            (M, INDEX),
        ),
        "slices written": (
            lambda x, i: (
                lax.dynamic_update_slice(x, jnp.ones((2, 2)), (i, 2 * i)),
                lax.dynamic_update_slice(x, x[:1], (9, 9)),
                lax.dynamic_update_slice(x, x[:2], (i + 5, 0)),
            ),
            (M, INDEX),
        ),
        "written at known places": (
            lambda x: (
                x.at[1].set(0.5),
                x.at[:, 2].set(x[:, 0]),
                x.at[jnp.array([0, 2])].set(-x[:2]),
                x.at[0, 1].set(9.0),
                x.at[7].set(1.0),
                x.at[1:3, ::2].set(0.0),
            ),
            (M,),
        ),
        "added at known places": (
            lambda x: (
                x.at[1].add(0.5),
                x.at[jnp.array([0, 0, 2])].add(x),
                x.at[0].multiply(x[1]),
                x.at[0].min(0.0),
                x.at[0].max(0.0),
                x.at[jnp.array([1, 9])].add(1.0, mode="clip"),
                x.at[1].subtract(x[0]),
                x.at[1].divide(2.0),
                x.at[2].power(2.0),
                x.at[1].apply(jnp.cos),
            ),
            (M,),
        ),
        "written at a moving place": (
            lambda x, i: (
                x.at[i].set(0.5),
                x.at[i].add(x[0]),
                x.at[i, 2 * i].set(7.0),
                x.at[i + 5].set(1.0),
                x.at[i - 9].add(1.0, mode="clip"),
                x.at[:, i].multiply(2.0),
            ),
            (M, INDEX),
        ),
        "written at moving places": (
            lambda x, i: (x.at[i].set(i * 0.5), x.at[i].add(1.0)),
            (X, np.array([2, 0, 2])),
        ),
        "written by batch": (
            lambda x, i: jax.vmap(lambda row, i: row.at[i].set(0.0))(x, i),
            (M, np.array([0, 2, 3])),
        ),
        "counted": (lambda i: jnp.zeros(4, int).at[i].add(1), (np.array([2, 0, 2]),)),
    }
)


def _collatz(n: int) -> Any:
    start = (jnp.asarray(n), jnp.asarray(0))
    return lax.while_loop(
        lambda s: s[0] != 1, lambda s: (jnp.where(s[0] % 2 == 0, s[0] // 2, 3 * s[0] + 1), s[1] + 1), start
    )


@jax.custom_jvp
def _softened(x: Any) -> Any:
    return jnp.log1p(jnp.exp(x))


@_softened.defjvp
def _(primals: Any, tangents: Any) -> Any:
    return _softened(primals[0]), jax.nn.sigmoid(primals[0]) * tangents[0]


@jax.custom_vjp
def _clipped(x: Any) -> Any:
    return jnp.sin(x)


_clipped.defvjp(lambda x: (jnp.sin(x), x), lambda x, g: (jnp.clip(g * jnp.cos(x), -0.5, 0.5),))


_cases(
    {
        "branches": (
            lambda x: (lax.cond(x[0] > 0, jnp.sin, jnp.cos, x), lax.cond(x[1] > 0, jnp.sin, jnp.cos, x)),
            (X,),
        ),
        "a known branch": (lambda x: lax.cond(np.True_, jnp.sin, jnp.cos, x), (X,)),
        "many branches": (
            lambda n, x: [
                lax.switch(n + d, [jnp.sin, jnp.cos, lambda x: x * x, jnp.negative], x) for d in (-5, 0, 1, 9)
            ],
            (INDEX, X),
        ),
        "a known one of many": (lambda x: lax.switch(jnp.asarray(2), [jnp.sin, jnp.cos, jnp.abs], x), (X,)),
        "branches in branches": (
            lambda x: lax.cond(x[0] > 0, lambda x: lax.cond(x[1] > 0, jnp.sin, jnp.exp, x), jnp.cos, x),
            (X,),
        ),
        "counted loop": (lambda x: lax.fori_loop(0, 4, lambda i, y: y * x + i, x), (X,)),
        "loop over places": (
            lambda x: lax.fori_loop(1, 5, lambda i, y: y.at[i].set(y[i - 1] + x[i // 2]), x),
            (X,),
        ),
        "scan": (lambda x: lax.scan(lambda c, r: (c * 0.5 + r, (c, r.sum())), x[0], x), (M,)),
        "scan backwards": (lambda x: lax.scan(lambda c, r: (c + r, c), 0.0, x, reverse=True), (X,)),
        "scan of nothing": (lambda x: lax.scan(lambda c, r: (c + r, c), x[0], x[:0]), (X,)),
        "scan without rows": (lambda x: lax.scan(lambda c, _: (c * 2, None), x, None, length=3), (X,)),
        "scan by a map": (lambda x: lax.map(lambda row: row @ row, x), (M,)),
        "associative scan": (lambda x: lax.associative_scan(jnp.multiply, x), (X,)),
        "loop with a known end": (lambda x: x * _collatz(6)[1], (X,)),
        "loop that ends at once": (
            lambda x: lax.while_loop(lambda s: s[0] < 0, lambda s: s, (0, x))[1],
            (X,),
        ),
        "calls": (lambda x: jax.jit(lambda x: jax.jit(jnp.sin)(x) + 1.0)(x), (X,)),
        "checkpoint": (jax.checkpoint(lambda x: jnp.sin(x) * x), (X,)),
        "custom derivatives": (lambda x: (_softened(x), _clipped(x), jax.nn.relu6(x), jax.nn.elu(x)), (X,)),
        "forward derivative": (
            lambda x: jax.jvp(
                lambda x: jnp.sin(x) * jnp.exp(-x) + jnp.where(x > 0, x**3, x), (x,), (jnp.ones_like(x),)
            ),
            (X,),
        ),
        "jacobian": (
            jax.jacfwd(lambda x: jnp.stack([x[0] * x[1], jnp.sin(x[2]), jnp.hypot(x[0], x[2])])),
            (X,),
        ),
        "backward derivative": (
            jax.grad(lambda x: jnp.sum(jnp.tanh(x) * x) + jnp.max(x) + _softened(x[0]) + _clipped(x[1])),
            (X,),
        ),
        "backward through places": (
            jax.grad(lambda x: x[1] * x[jnp.array([0, 2])].sum() + jnp.sort(x)[0]),
            (X,),
        ),
        "hessian": (jax.hessian(lambda x: jnp.sum(jnp.sin(x) * x[0])), (X,)),
        "backward through a loop": (
            jax.grad(lambda x: jnp.sum(lax.scan(lambda c, r: (jnp.sin(c) + r, c), 0.0, x)[0])),
            (X,),
        ),
        "batches": (lambda x: jax.vmap(lambda row: lax.cond(row[0] > 0, jnp.sin, jnp.cos, row))(x), (M,)),
        "known numbers": (lambda x: x * jnp.sum(jnp.asarray(M)) + jnp.asarray(M)[0, 0], (X,)),
        "trees": (lambda t: {"a": t["b"][0] + 1, "c": (t["b"][1], t["n"])}, ({"b": [X, Y], "n": INDEX},)),
        "inputs handed on": (lambda x, n, b: (x, n, b, 1.0, True), (X, WHOLE, FLAGS)),
    }
)
