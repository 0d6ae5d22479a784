"""Figures of the theory: the free phase (Fig. 10), and all sets of solutions (Fig. 11)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gaitsweep.papers.ambe2021.theory.chain import Chain, touchdown_phase
from gaitsweep.papers.ambe2021.theory.gaits import GAITS, gait_of
from gaitsweep.papers.ambe2021.theory.order import jumps
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, branches, rule_of, solution
from gaitsweep.plot import theme


def draw_free_phase(N: int, chain: Chain, k: int, title: str | None) -> Figure:
    """psi_k over psi_{k-1} along the solution sets A and B (Fig. 10).

    Args:
        N: springs; the chain has N + 1 legs.
        chain: its parameters.
        k: the boundary leg of the source wave.
    """
    circle = touchdown_phase(chain)
    names = {"A": "#D55E00", "B": "#0072B2"}
    with theme.canvas(theme.COLUMN + 0.9, 3.0, title) as figure:
        axes = figure.subplots()
        for kind, colour in names.items():
            rule = rule_of(N, Branch(kind, k), chain)  # pyright: ignore[reportArgumentType]
            ends = np.array([float(rule.low) + 1e-9, float(rule.high) - 1e-9])
            psi = np.stack([np.asarray(solution(rule, jnp.asarray(s), circle, k)) for s in ends])
            label = f"solution set {kind}"
            axes.plot(psi[:, k - 2], psi[:, k - 1], "o-", color=colour, lw=2.4, ms=4, label=label)
            if kind == "A":
                for value, text, height in zip(ends, (r"$\psi_A$", r"$\psi_B$"), (0.03, 0.12), strict=True):
                    label = f"{text} = {theme.in_pi(value, fractions=False)}"
                    _mark(axes, value, label, height)
        axes.set_xlim(0.0, 2 * np.pi)
        theme.angle_axis(axes, "x")
        theme.angle_ticks(axes, "y")
        axes.set_xlabel(rf"$\psi_{{{k - 1}}}$ on section {k} (rad)")
        axes.set_ylabel(rf"$\psi_{{{k}}}$ on section {k} (rad)")
        _mark(axes, 2 * float(chain.beta) * np.pi, r"$2\beta\pi$", 0.03)
        theme.legend(figure, ncols=2)
    return figure


def _mark(axes: Axes, value: float, text: str, height: float) -> None:
    """A vertical line with its name beside it."""
    axes.axvline(value, color="#AAAAAA", lw=0.7, ls="--", zorder=0)
    look = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
    axes.annotate(text, (value, height), (5, 0), fontsize=theme.points(7.5), **look)


def draw_sets(N: int, chain: Chain, title: str | None) -> Figure:
    """The relative phases along the chain of all solution sets, on section 1 (Fig. 11).

    Args:
        N: springs; the chain has N + 1 legs.
        chain: its parameters.
    """
    shades = colormaps["viridis"](np.linspace(0.0, 0.92, N))
    with theme.canvas(theme.PAGE, 3.6, title) as figure:
        axes, place, jumped = figure.subplots(), 0.0, False
        for branch in branches(N):
            breaks = [jump.s for jump in jumps(N, branch, chain, 1)]
            jumped |= bool(breaks)
            place = _draw_set(axes, N, branch, chain, breaks, place, shades)
        axes.set_xlim(0, place)
        theme.angle_axis(axes, "y")
        axes.set_xlabel("way along the chain of sets: change of E (rad)")
        axes.set_ylabel("relative phases on section 1 (rad)")
        which = sorted({0, N // 2, N - 1}) if N > 5 else range(N)
        handles: list[Any] = [Line2D([], [], color=shades[i], label=rf"$\psi_{{{i + 1}}}$") for i in which]
        handles += [Patch(color=theme.colours([gait])[gait], alpha=0.3, label=f"{gait} wave")
                    for gait in ("direct", "source", "retrograde")]  # fmt: skip
        handles.append(Patch(color="#777777", alpha=0.6, label="darker: sets A"))
        if jumped:
            label = "a leg passes leg 1: jump by $m_Bb$"
            handles.append(Line2D([], [], color="#D55E00", ls=":", label=label))
        theme.legend(figure, handles, ncols=5)
    return figure


def _draw_set(
    axes: Axes,
    N: int,
    branch: Branch,
    chain: Chain,
    breaks: Sequence[float],
    place: float,
    shades: Float[np.ndarray, "springs 4"],
) -> float:
    """The relative phases of one set, cut at its jumps; returns the place at which the next set begins.

    Args:
        axes: the axes, over the change of E (rad).
        N, branch, chain: as in `rule_of`.
        breaks: the free phases (rad) of its jumps.
        place: the set's beginning along the axis, rad.
        shades: the colour of each relative phase.
    """
    rule, circle = rule_of(N, branch, chain), touchdown_phase(chain)
    low, high = float(rule.low), float(rule.high)
    rate = float(np.abs(np.sum(np.asarray(rule.slope))))
    psi_of = jax.jit(jax.vmap(lambda s: solution(rule, s, circle, 1)))
    begin, way = (high, -rate) if branch.kind == "direct" else (low, rate)
    for start, stop in itertools.pairwise([low, *breaks, high]):
        s = np.linspace(start + 1e-7, stop - 1e-7, 60)
        psi = np.asarray(psi_of(jnp.asarray(s)))
        for link in range(N):
            axes.plot(place + way * (s - begin), psi[:, link], color=shades[link], lw=1.3)
    for s in breaks:
        axes.axvline(place + way * (s - begin), color="#D55E00", lw=0.7, ls=":", zorder=0)
    width, gait = rate * (high - low), GAITS[gait_of(branch)]
    dark = 0.45 if branch.kind == "A" else 0.13
    axes.axvspan(place, place + width, color=theme.colours([gait])[gait], alpha=dark, lw=0, zorder=-1)
    if branch.kind != "A":
        name = "direct" if branch.kind == "direct" else f"k = {branch.k}"
        look: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": theme.points(7)}
        axes.text(place + width / 2, 1.015, name, transform=axes.get_xaxis_transform(), **look)
    return place + width
