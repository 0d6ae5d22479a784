"""JaxCont's example: branches of the imperfect pitchfork, p u - u^3 + b = 0, for 64 values of b at once.

p goes from -1 to 2 along each branch. The error is the largest residual of a branch's points.
"""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

import gaitsweep as gs
from gaitsweep import DeclaredModel, parameter, variable

from .measured import Array, Line, Options, installed, missing, timed, version_of

BEGIN, END = -1.0, 2.0


class Pitchfork(DeclaredModel):
    """The normal form of a pitchfork with an imperfection."""

    p = parameter("1", "bifurcation parameter", BEGIN)
    b = parameter("1", "imperfection", 0.1)
    u = variable("1", "state", 0.05, observed=True)

    def flow(self, p, s):
        return {"u": p.p * s.u - s.u**3 + p.b}

    def period(self, p):
        return 1.0 + 0.0 * p.b


def lines(options: Options) -> Iterator[Line]:
    """The lines of JaxCont and of gaitsweep."""
    for rows in options.rows_or(64):
        yield from lines_of(rows, options)


def lines_of(rows: int, options: Options) -> Iterator[Line]:
    """The lines of one number of rows."""
    b = np.linspace(-0.4, 0.4, rows)
    if installed("jaxcont") is None:
        yield missing("jaxcont")
    else:
        yield jaxcont_line(b, options.repeats)
    followed(b)  # compiles
    (u, p, row), cpu, clock = timed(lambda: followed(b), options.repeats)
    error = float(np.max(np.abs(p * u - u**3 + b[row])))
    note = f"{1e3 * cpu / len(u):.2g} ms a point; {len(u)} points"
    yield Line(f"gaitsweep, {rows} branches", cpu, clock, error, note)


def followed(b: Array) -> tuple[Array, Array, NDArray[np.int_]]:
    """u, p and the row of each point of all branches, by gaitsweep."""
    points = gs.stationary(Pitchfork(), params={"b": b})
    fixed = points.fixed_points(np.full((len(b), 1), 0.05)).points
    table = points.continue_(fixed, "p", (BEGIN, END), towards=1)
    return table["u"].to_numpy(float), table["p"].to_numpy(float), table["row"].to_numpy(int)


def jaxcont_line(b: Array, repeats: int) -> Line:
    """The line of JaxCont: `continuation` under vmap, with the settings of its example."""
    jaxcont = installed("jaxcont")
    settings = jaxcont.ContinuationPar(
        ds=0.05, ds_min=1e-5, ds_max=0.2, max_steps=120, newton_tol=1e-6, newton_max_iter=20
    )

    def branch(imperfection):
        problem = jaxcont.bif_problem(
            lambda u, p, args: jnp.array([p * u[0] - u[0] ** 3 + args]), u0=jnp.array([0.05]), p0=BEGIN,
            args=imperfection,
        )  # fmt: skip
        return jaxcont.continuation(problem, p_span=(BEGIN, END), settings=settings)

    together = jax.vmap(branch)
    jax.block_until_ready(together(b).branch.params)  # compiles
    result, cpu, clock = timed(lambda: jax.block_until_ready(together(b)), repeats)
    valid = np.asarray(result.branch.valid)
    u, p = np.asarray(result.branch.states)[..., 0], np.asarray(result.branch.params)
    error = float(np.max(np.abs(p * u - u**3 + b[:, None])[valid]))
    note = (
        f"{1e3 * cpu / valid.sum():.2g} ms a point; {valid.sum()} points; no folds are located under vmap; "
        "no events, no return maps of hybrid flows"
    )
    return Line(f"{version_of('jaxcont')}, {len(b)} branches", cpu, clock, error, note)
