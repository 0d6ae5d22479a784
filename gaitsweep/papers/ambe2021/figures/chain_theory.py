"""The theory of the multi-legged chain in figures (Ambe 2021, Figs. 8 to 11).

They show the phases at touchdowns, the order of touchdowns, the free phase, and all sets of solutions.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from gaitsweep.papers.ambe2021.multilegged.chain_of_table import chain_of, springs_of
from gaitsweep.papers.ambe2021.multilegged.model import ChainModel
from gaitsweep.papers.ambe2021.theory.chain import Chain, leg_length, touchdown_phase
from gaitsweep.papers.ambe2021.theory.gaits import GAITS, WAVES, gait_of
from gaitsweep.papers.ambe2021.theory.order import jumps, reset_sets, touchdown_order
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, Kind, branches, places, rule_of, solution
from gaitsweep.plot import (
    CountOrZero,
    PlannedTable,
    PlotError,
    Positive,
    Refusal,
    Title,
    Word,
    figure_kind,
    theme,
)

Legs = Float[np.ndarray, " legs"]
Solutions = Float[np.ndarray, " solutions"]
Shades = Float[np.ndarray, "springs 4"]

Shown = Literal["touchdowns", "order", "free_phase", "sets"]
SHOWN: tuple[Shown, ...] = get_args(Shown)


def _check(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    model = table.model
    has_phases = bool({"psi_1_end", "psi_1_n", "phase_1"} & set(table.columns))
    if isinstance(model, ChainModel) and has_phases:
        yield from _out_of_range(model.N, figure.k, figure.at)
    else:
        yield figure.needs(table, "the multi-legged chain's psi_1 or phase_1")


def _out_of_range(N: int, k: int | None, at: float) -> Iterator[Refusal]:
    """Refusals of a boundary leg and of a place that a chain with N springs does not have."""
    if k is not None and not 2 <= k <= N:
        yield ("k",), f"is {k}, but a chain of {N + 1} legs has source waves of k = 2 to {N}."
    if not 0.0 < at < 1.0:
        yield ("at",), f"is {at:g}, but must be a fraction of the range of the free phase, between 0 and 1."


@figure_kind("settle", "fixed_time", "return_map", "trace", check=_check)
def chain_theory(
    table: pd.DataFrame,
    *,
    show: Annotated[
        Shown,
        Word(),
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
        PlotError: the table is not of the chain, its job's parameters cannot be read, show, k or at are out
            of range, or show is touchdowns for a chain with a profile.
    """
    N, chain = springs_of(table), chain_of(table)
    if N < 2:
        raise PlotError("The theory needs a chain of at least three legs.")
    return theory_figure(N, chain, show=show, k=k, at=at, title=title)


def theory_figure(
    N: int, chain: Chain, *, show: Shown, k: int | None = None, at: float = 0.3, title: str | None = None
) -> Figure:
    """The figure `chain_theory` without a table.

    Args:
        N: springs; the chain has N + 1 legs.
        chain: its parameters.
        show, k, at, title: as for `chain_theory`.

    Raises:
        PlotError: as for `chain_theory`.
    """
    k = min(max(3, (N + 3) // 2), N) if k is None else k
    if show not in SHOWN:
        raise PlotError(f"show is {show}. Allowed: {', '.join(SHOWN)}.")
    for field, text in _out_of_range(N, k, at):
        raise PlotError(f"{field[0]} {text}")
    if show == "touchdowns":
        if chain.has_profile:
            raise PlotError("show: touchdowns has one leg length, but legs of a chain with a profile differ.")
        return draw_touchdowns(N, chain, k, title)
    if show == "order":
        return draw_order(N, chain, k, at, title)
    if show == "free_phase":
        return draw_free_phase(N, chain, k, title)
    return draw_sets(N, chain, title)


_TOUCHING, _FRONT, _REAR = "#000000", "#E69F00", "#0072B2"
# of a relative phase, by whether its front leg and whether its rear leg was reset
_RESET_COLOURS = {
    (True, True): "#BBBBBB",
    (True, False): _FRONT,
    (False, True): _REAR,
    (False, False): "white",
}


def draw_touchdowns(N: int, chain: Chain, k: int, title: str | None) -> Figure:
    """The phases of a leg and its neighbours at its touchdown, on the curve of leg length (Fig. 8).

    Args:
        N: springs; the chain has N + 1 legs.
        chain: its parameters, without a profile.
        k: the boundary leg of the source wave.
    """
    regions = ("in the direct region", "the boundary leg k", "in the retrograde region")
    legs = [(leg, text) for leg, text in enumerate(regions, k - 1) if 2 <= leg <= N]
    rule = rule_of(N, Branch("B", k), chain)
    circle = float(touchdown_phase(chain))
    free = np.linspace(float(rule.low), float(rule.high), 41)
    theta = np.asarray(jax.vmap(functools.partial(places, rule))(jnp.asarray(free)))
    down, across = theme.shape(len(legs), theme.PAGE, 2.0)
    with theme.canvas(theme.PAGE, 1.9 * down + 0.8, title) as figure:
        panels = theme.panels(figure, (down, across), len(legs), sharey=True)
        for axes, (leg, text) in zip(panels, legs, strict=True):
            _segments(axes, chain)
            phi = circle - np.mod(theta[:, leg - 1 : leg] - theta + 1e-12, circle)
            _neighbour(axes, phi[:, leg - 2], chain, _FRONT, "<")
            _neighbour(axes, phi[:, leg], chain, _REAR, ">")
            axes.plot([circle], leg_length(np.array([circle]), chain), "o", color=_TOUCHING, ms=7, zorder=5)
            axes.set_title(f"touchdown of leg {leg}:\n{text}", loc="left")
            axes.set_xlabel("phase (rad)")
            theme.angle_axis(axes, "x")
        for axes in panels[::across]:
            axes.set_ylabel(r"leg length less $L$ (m)")
        handles = [
            Line2D([], [], ls="", marker="o", color=_TOUCHING, label="leg that touches down"),
            Line2D([], [], ls="", marker="<", color=_FRONT, label="leg in front of it, towards the head"),
            Line2D([], [], ls="", marker=">", color=_REAR, label="leg behind it"),
            Line2D([], [], color=_FRONT, lw=5, alpha=0.55, label="any phase of this range: the lag is free"),
        ]
        theme.legend(figure, handles, ncols=2)
    return figure


def _neighbour(axes: Axes, phi: Solutions, chain: Chain, colour: str, marker: str) -> None:
    """The phases (rad) of a neighbour on the curve of leg length: their range, or the only one."""
    low, high = phi.min(), phi.max()
    if high - low > 1e-6:
        along = np.linspace(low, high, 200)
        style: dict[str, Any] = {"lw": 5, "alpha": 0.55, "solid_capstyle": "butt"}
        axes.plot(along, leg_length(along, chain), color=colour, **style)
    else:
        axes.plot([low], leg_length(np.array([low]), chain), marker, color=colour, ms=8, zorder=4)


def _segments(axes: Axes, chain: Chain) -> None:
    """The curve of leg length, eq. (3), its three segments named."""
    beta = float(chain.beta)
    ends = np.array([0.0, 2 * beta * np.pi, (1 + beta) * np.pi, 2 * np.pi])
    axes.plot(ends, leg_length(ends, chain), color="#888888", lw=1.0)
    low = 1.22 * leg_length(np.array([(1 + beta) * np.pi]), chain)[0]
    style: dict[str, Any] = {"ha": "center", "fontsize": theme.points(7), "color": "#555555"}
    stance, takeoff, landing = 0.5 * (ends[1:] + ends[:-1])
    axes.text(stance, 0.5 * low, "stance", va="center", **style)
    axes.text(takeoff, 0.995 * low, "takeoff", va="bottom", rotation=90, **style)
    axes.text(landing, 0.995 * low, "landing", va="bottom", rotation=90, **style)
    for end in ends[1:3]:
        axes.axvline(end, color="#CCCCCC", lw=0.6, zorder=0)
    axes.set_ylim(1.25 * low, -0.18 * low)


def draw_order(N: int, chain: Chain, k: int, at: float, title: str | None) -> Figure:
    """The order of touchdowns, and which relative phases are changed by them before a leg's own (Fig. 9).

    Args:
        N: springs; the chain has N + 1 legs.
        chain: its parameters.
        k: the boundary leg of the source wave.
        at: place in the range of the free phase, as a fraction of it.
    """
    branch = Branch("B", k)
    rule = rule_of(N, branch, chain)
    circle = float(touchdown_phase(chain))
    s = float(rule.low + at * (rule.high - rule.low))
    order = touchdown_order(N, branch, s, chain)
    theta = np.asarray(places(rule, s))
    when = np.mod(theta[k - 1] - theta, circle) / circle  # cycles after the touchdown of leg k
    down, across = theme.shape(2, theme.PAGE, 2.5)
    height = (0.7 + 0.2 * (N + 1)) * down + 0.8
    with theme.canvas(theme.PAGE, height, title) as figure:
        left, right = figure.subplots(down, across, width_ratios=(1.15, 1.0)[:across])
        numbers = [reset_set.number for reset_set in reset_sets(N, branch, s, chain)]
        _touchdown_times(left, when, 2 * float(chain.beta) * np.pi / circle, order, numbers)
        _resets(right, N, order)
        right.set_title("relative phases at each touchdown", loc="left")
        handles = [
            Patch(color="#444444", label="phase in stance"),
            Patch(color=_FRONT, label=r"$\psi_i$ is less by $m_Bb$: leg i was reset"),
            Patch(color=_REAR, label=r"$\psi_i$ is more by $m_Bb$: leg i + 1 was reset"),
            Patch(color="#BBBBBB", label="both were"),
            Patch(facecolor="none", edgecolor="black", label="beside the leg that touches"),
        ]
        theme.legend(figure, handles, ncols=3)
    return figure


def _touchdown_times(
    axes: Axes, when: Legs, stance: float, order: tuple[int, ...], reset_numbers: list[int]
) -> None:
    """Each leg's stance from its touchdown on, with its place in the order and the number of its set S.

    Args:
        axes: the axes, over time in cycles.
        when: the touchdowns, cycles after that of the first leg in `order`, the boundary leg.
        stance: the duration of stance, cycles.
        order: the legs in their order of touchdown.
        reset_numbers: the number of each leg's set.
    """
    legs = range(1, len(when) + 1)
    for turn in (-1, 0, 1):
        axes.barh(legs, stance, left=when + turn, height=0.6, color="#444444")
    axes.plot(when, legs, "o", ms=8.5, mfc="white", mec="black", mew=0.8, zorder=4, clip_on=False)
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": theme.points(7), "zorder": 5}
    for leg, at_leg, number in zip(legs, when, reset_numbers, strict=True):
        axes.text(at_leg, leg, str(order.index(leg) + 1), **style)
        axes.text(1.03, leg, f"$S_{{{number}}}$", va="center", fontsize=theme.points(8))
    axes.set_xlim(0, 1)
    axes.set_yticks(legs, [f"Leg {leg}{' = k' if leg == order[0] else ''}" for leg in legs])
    axes.set_ylim(len(when) + 0.6, 0.4)
    axes.tick_params(axis="y", pad=6.0)  # beyond a mark at 0
    axes.set_xlabel("time after the touchdown of leg k (cycles)")
    axes.set_title("order of touchdowns, and the set S of each leg", loc="left")


def _resets(axes: Axes, N: int, order: tuple[int, ...]) -> None:
    """A cell for each relative phase and touchdown: coloured where one of its legs was reset before."""
    touched_down: set[int] = set()
    for column, leg in enumerate(order):
        for link in range(1, N + 1):
            colour = _RESET_COLOURS[link in touched_down, link + 1 in touched_down]
            cell = {"fc": colour, "ec": "#DDDDDD", "lw": 0.5, "zorder": 1}
            axes.add_patch(Rectangle((column - 0.5, link - 0.5), 1, 1, **cell))
            if leg in (link, link + 1):
                frame = {"fc": "none", "ec": "black", "lw": 1.3, "zorder": 3}
                axes.add_patch(Rectangle((column - 0.45, link - 0.45), 0.9, 0.9, **frame))
        touched_down.add(leg)
    axes.set_xlim(-0.5, len(order) - 0.5)
    axes.set_ylim(N + 0.5, 0.5)
    axes.set_xticks(range(len(order)), [str(leg) for leg in order])
    axes.set_yticks(range(1, N + 1), [rf"$\psi_{{{link}}}$" for link in range(1, N + 1)])
    axes.tick_params(length=0)
    axes.set_xlabel("leg that touches down, in order")


def draw_free_phase(N: int, chain: Chain, k: int, title: str | None) -> Figure:
    """psi_k over psi_{k-1} along the solution sets A and B (Fig. 10).

    Args:
        N: springs; the chain has N + 1 legs.
        chain: its parameters.
        k: the boundary leg of the source wave.
    """
    circle = touchdown_phase(chain)
    colours: dict[Kind, str] = {"A": "#D55E00", "B": "#0072B2"}
    with theme.canvas(theme.COLUMN + 0.9, 3.0, title) as figure:
        axes = figure.subplots()
        for kind, colour in colours.items():
            rule = rule_of(N, Branch(kind, k), chain)
            ends = np.array([float(rule.low) + 1e-9, float(rule.high) - 1e-9])
            psi = np.stack([np.asarray(solution(rule, jnp.asarray(s), circle, k)) for s in ends])
            style: dict[str, Any] = {"color": colour, "lw": 2.4, "ms": 4, "label": f"solution set {kind}"}
            axes.plot(psi[:, k - 2], psi[:, k - 1], "o-", **style)
            if kind == "A":
                for value, name, height in zip(ends, (r"$\psi_A$", r"$\psi_B$"), (0.03, 0.12), strict=True):
                    _mark(axes, value, f"{name} = {theme.in_pi(value, fractions=False)}", height)
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
    style = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
    axes.annotate(text, (value, height), (5, 0), fontsize=theme.points(7.5), **style)


def draw_sets(N: int, chain: Chain, title: str | None) -> Figure:
    """The relative phases along the chain of all solution sets, on section 1 (Fig. 11).

    Args:
        N: springs; the chain has N + 1 legs.
        chain: its parameters.
    """
    shades = colormaps["viridis"](np.linspace(0.0, 0.92, N))
    with theme.canvas(theme.PAGE, 3.6, title) as figure:
        axes = figure.subplots()
        place = 0.0
        jumped = False
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
        for gait, colour in theme.colours(WAVES).items():
            handles.append(Patch(color=colour, alpha=0.3, label=f"{gait} wave"))
        handles.append(Patch(color="#777777", alpha=0.6, label="darker: sets A"))
        if jumped:
            label = "a leg passes leg 1: jump by $m_Bb$"
            handles.append(Line2D([], [], color="#D55E00", ls=":", label=label))
        theme.legend(figure, handles, ncols=5)
    return figure


def _draw_set(
    axes: Axes, N: int, branch: Branch, chain: Chain, breaks: Sequence[float], place: float, shades: Shades
) -> float:
    """The relative phases of one set, cut at its jumps; returns the place at which the next set begins.

    Args:
        axes: the axes, over the change of E (rad).
        N, branch, chain: as in `rule_of`.
        breaks: the free phases (rad) of its jumps.
        place: the set's beginning along the axis, rad.
        shades: the colour of each relative phase.
    """
    rule = rule_of(N, branch, chain)
    circle = touchdown_phase(chain)
    low, high = float(rule.low), float(rule.high)
    rate = float(np.abs(np.sum(np.asarray(rule.slope))))

    @jax.jit
    @jax.vmap
    def psi_of(s: jax.Array) -> jax.Array:
        return solution(rule, s, circle, 1)

    begin, way = (high, -rate) if branch.kind == "direct" else (low, rate)
    for start, stop in itertools.pairwise([low, *breaks, high]):
        s = np.linspace(start + 1e-7, stop - 1e-7, 60)
        psi = np.asarray(psi_of(jnp.asarray(s)))
        for link in range(N):
            axes.plot(place + way * (s - begin), psi[:, link], color=shades[link], lw=1.3)
    for s in breaks:
        axes.axvline(place + way * (s - begin), color="#D55E00", lw=0.7, ls=":", zorder=0)
    width = rate * (high - low)
    gait = GAITS[gait_of(branch)]
    dark = 0.45 if branch.kind == "A" else 0.13
    axes.axvspan(place, place + width, color=theme.colours([gait])[gait], alpha=dark, lw=0, zorder=-1)
    if branch.kind != "A":
        name = "direct" if branch.kind == "direct" else f"k = {branch.k}"
        style: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": theme.points(7)}
        axes.text(place + width / 2, 1.015, name, transform=axes.get_xaxis_transform(), **style)
    return place + width
