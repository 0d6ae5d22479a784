"""The theory of the multi-legged chain in figures: touchdowns, their order, the free phase, all sets."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import pandas as pd
from matplotlib.figure import Figure

from gaitsweep.papers.ambe2021.figures.solution_theory import draw_free_phase, draw_sets
from gaitsweep.papers.ambe2021.figures.touchdown_theory import draw_order, draw_touchdowns
from gaitsweep.papers.ambe2021.multilegged.chain_of_table import chain_of, springs_of
from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.plot import CountOrZero, PlannedTable, PlotError, Positive, Refusal, Title, figure_kind, word

SHOWN = ("touchdowns", "order", "free_phase", "sets")


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    N = getattr(table.model, "N", None)
    if N is None or not {"psi_1_end", "psi_1_n", "phase_1"} & set(table.columns):
        yield figure.needs(table, "the multi-legged chain's psi_1 or phase_1")
    elif figure.k is not None and not 2 <= figure.k <= N:
        yield ("k",), f"is {figure.k}, but a chain of {N + 1} legs has source waves of k = 2 to {N}."
    if figure.at >= 1.0:
        yield ("at",), f"is {figure.at:g}, but must be a fraction of the range of the free phase, below 1."


@figure_kind("settle", "fixed_time", "return_map", "trace", check=_check)
def chain_theory(
    table: pd.DataFrame,
    *,
    show: Annotated[
        Literal["touchdowns", "order", "free_phase", "sets"],
        word(*SHOWN),
        "touchdowns (Fig. 8 of Ambe 2021), order (Fig. 9), free_phase (Fig. 10) or sets (Fig. 11)",
    ],
    k: Annotated[CountOrZero | None, "boundary leg of the source wave; 2: the retrograde wave"] = None,
    at: Annotated[Positive, "place in the range of the free phase, as a fraction of it; for order"] = 0.3,
    title: Title = None,
) -> Figure:
    """The analytic solutions of the multi-legged chain: touchdowns, their order, the free phase, all sets.

    Args:
        table: a table of the chain; the first row's values of varying parameters are used.

    Raises:
        PlotError: the table is not of the chain, show, k or at are out of range, or show is touchdowns for a
            chain with a profile.
    """
    N = springs_of(table)
    if N < 2:
        columns = "the columns psi_1_end, ... or phase_1, ..."
        raise PlotError(f"The theory needs a table of the multi-legged chain with {columns}")
    return theory_figure(N, chain_of(table), show=show, k=k, at=at, title=title)


def theory_figure(
    N: int, chain: Chain, *, show: str, k: int | None = None, at: float = 0.3, title: str | None = None
) -> Figure:
    """The figure `chain_theory` of N + 1 legs, without a table; arguments and errors as there."""
    k = max(3, (N + 3) // 2) if k is None else k
    if show not in SHOWN:
        raise PlotError(f"show is {show}. Allowed: {', '.join(SHOWN)}.")
    if not 2 <= k <= N:
        raise PlotError(f"k is {k}, but a chain of {N + 1} legs has source waves of k = 2 to {N}.")
    if not 0.0 < at < 1.0:
        raise PlotError(
            f"at is {at}, but must be a fraction of the range of the free phase, between 0 and 1."
        )
    if show == "touchdowns" and chain.has_profile:
        raise PlotError(
            "show: touchdowns draws one curve of leg length, but the legs of a chain with a profile differ."
        )
    if show == "touchdowns":
        return draw_touchdowns(N, chain, k, title)
    if show == "order":
        return draw_order(N, chain, k, at, title)
    return draw_free_phase(N, chain, k, title) if show == "free_phase" else draw_sets(N, chain, title)
