"""Figures of the theory: the phases at touchdowns (Fig. 8), and their order (Fig. 9)."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from gaitsweep.papers.ambe2021.theory.chain import Chain, leg_length, touchdown_phase
from gaitsweep.papers.ambe2021.theory.order import reset_sets, touchdown_order
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, places, rule_of
from gaitsweep.plot import theme

_TOUCHING, _FRONT, _REAR = "#000000", "#E69F00", "#0072B2"


def draw_touchdowns(N: int, chain: Chain, k: int, title: str | None) -> Figure:
    """The phases of a leg and its neighbours at its touchdown, on the curve of leg length (Fig. 8).

    Args:
        N: springs; the chain has N + 1 legs.
        chain: its parameters, without a profile.
        k: the boundary leg of the source wave.
    """
    legs = [(leg, text) for leg, text in (
        (k - 1, "in the direct region"), (k, "the boundary leg k"),
        (k + 1, "in the retrograde region")) if 2 <= leg <= N]  # fmt: skip
    rule, circle = rule_of(N, Branch("B", k), chain), float(touchdown_phase(chain))
    free = np.linspace(float(rule.low), float(rule.high), 41)
    theta = np.asarray(jax.vmap(lambda s: places(rule, s))(jnp.asarray(free)))
    down, across = theme.shape(len(legs), theme.PAGE, 2.0)
    with theme.canvas(theme.PAGE, 1.9 * down + 0.8, title) as figure:
        panels = theme.panels(figure, (down, across), len(legs), sharey=True)
        for axes, (leg, text) in zip(panels, legs, strict=True):
            _segments(axes, chain)
            phi = circle - np.mod(theta[:, leg - 1 : leg] - theta + 1e-12, circle)
            for neighbour, colour, marker in ((leg - 2, _FRONT, "<"), (leg, _REAR, ">")):
                ends = np.array([phi[:, neighbour].min(), phi[:, neighbour].max()])
                if np.ptp(ends) > 1e-6:
                    along = np.linspace(ends[0], ends[1], 200)
                    look: dict[str, Any] = {"lw": 5, "alpha": 0.55, "solid_capstyle": "butt"}
                    axes.plot(along, leg_length(along, chain), color=colour, **look)
                else:
                    axes.plot(ends[:1], leg_length(ends[:1], chain), marker, color=colour, ms=8, zorder=4)
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


def _segments(axes: Axes, chain: Chain) -> None:
    """The curve of leg length, eq. (3), its three segments named."""
    beta = float(chain.beta)
    ends = np.array([0.0, 2 * beta * np.pi, (1 + beta) * np.pi, 2 * np.pi])
    axes.plot(ends, leg_length(ends, chain), color="#888888", lw=1.0)
    low = 1.22 * leg_length(np.array([(1 + beta) * np.pi]), chain)[0]
    for name, left, right, turn in (("stance", 0, 1, 0), ("takeoff", 1, 2, 90), ("landing", 2, 3, 90)):
        middle = 0.5 * (ends[left] + ends[right])
        height = 0.5 * low if name == "stance" else 0.995 * low
        axes.text(middle, height, name, ha="center", va="center" if name == "stance" else "bottom",
                  rotation=turn, fontsize=theme.points(7), color="#555555")  # fmt: skip
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
    rule, circle = rule_of(N, branch, chain), float(touchdown_phase(chain))
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
    axes: Axes,
    when: Float[np.ndarray, " legs"],
    stance: float,
    order: tuple[int, ...],
    reset_numbers: list[int],
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
    look: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": theme.points(7), "zorder": 5}
    for leg, at_leg, number in zip(legs, when, reset_numbers, strict=True):
        axes.text(at_leg, leg, str(order.index(leg) + 1), **look)
        axes.text(1.03, leg, f"$S_{{{number}}}$", va="center", fontsize=theme.points(8))
    axes.set_xlim(0, 1)
    axes.set_yticks(legs, [f"Leg {leg}" + (" = k" if leg == order[0] else "") for leg in legs])
    axes.set_ylim(len(when) + 0.6, 0.4)
    axes.tick_params(axis="y", pad=6.0)  # beyond a mark at 0
    axes.set_xlabel("time after the touchdown of leg k (cycles)")
    axes.set_title("order of touchdowns, and the set S of each leg", loc="left")


def _resets(axes: Axes, N: int, order: tuple[int, ...]) -> None:
    """A cell for each relative phase and touchdown: coloured where one of its legs was reset before."""
    touched_down: set[int] = set()
    for column, leg in enumerate(order):
        for link in range(1, N + 1):
            front, rear = link in touched_down, link + 1 in touched_down
            colour = "#BBBBBB" if front and rear else _FRONT if front else _REAR if rear else "white"
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
