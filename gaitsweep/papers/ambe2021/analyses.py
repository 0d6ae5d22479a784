"""The commands `gaitsweep analyse` of the multi-legged chain."""

from __future__ import annotations

import collections
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import gaitsweep as gs
from gaitsweep.cli import Directory, print_table

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Inexact

    from gaitsweep.papers.ambe2021.theory.chain import Chain
    from gaitsweep.papers.ambe2021.theory.solution_sets import Branch

app = typer.Typer()


@app.command()
def waves(directory: Directory) -> None:
    """Compare waves of the chain with the theory.

    Wavelength and speed of waves in traces of the multi-legged chain, and eqs. (27), (28).
    """
    from gaitsweep.papers.ambe2021.analysis.travelling_wave import waves as measured

    print_table(measured(gs.load(directory)), 6)


@app.command()
def gait_shares(directory: Directory) -> None:
    """Count parameter sets of the chain by gait.

    For the multi-legged chain, by the conditions of the theory.
    """
    from gaitsweep.papers.ambe2021.analysis.gait_shares import sets_by_conditions

    print_table(sets_by_conditions(gs.load(directory)))


@app.command()
def source_place(directory: Directory) -> None:
    """Print the shares of starts by the leg of the source.

    Where the waves of the multi-legged chain settle to a source.
    """
    from gaitsweep.papers.ambe2021.analysis.travelling_wave import source_place as places

    shares = places(gs.load(directory))
    print_table(shares.loc[(shares["source"] > 0) | (shares["meeting"] > 0) | (shares["leg"] == 1)])


@app.command()
def source_drift(directory: Directory) -> None:
    """Compare the drift of the chain's source with its law.

    The drift of E, and so of the source of the multi-legged chain's waves.
    """
    from gaitsweep.papers.ambe2021.analysis.travelling_wave import source_drift as drifts

    print_table(drifts(gs.load(directory)), 8)


@app.command()
def multilegged_theory(
    springs: Annotated[int, typer.Option("--N", help="Number of springs; the chain has N + 1 legs.")] = 3,
    omega: Annotated[float, typer.Option("--omega", help="Basic frequency, rad/s.")] = 0.4,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Set a parameter of the chain; may be repeated."),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option("--figures", metavar="DIR", help="Folder in which to draw Figs. 8 to 11 of Ambe 2021."),
    ] = None,
    k: Annotated[
        int | None, typer.Option("--k", help="Boundary leg of the source wave in these figures.")
    ] = None,
) -> None:
    """Print the analytic solutions of a chain of legs.

    It needs no result directory.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    chain = _chain_of_settings(settings or ())
    print(_theory_summary(springs, _in_bounds("omega", omega), chain))
    if figures is not None:
        from gaitsweep.papers.ambe2021.figures.chain_theory import SHOWN, theory_figure

        figures.mkdir(parents=True, exist_ok=True)
        for show in SHOWN:
            file = figures / f"{show}.png"
            theory_figure(springs, chain, show=show, k=k).savefig(file)
            print(f"Figure: {file}")


def _chain_of_settings(settings: Iterable[str]) -> Chain:
    """The chain of Table 1 with the parameters that the options `--set NAME=VALUE` give.

    Raises:
        ArgumentError: a text is not NAME=VALUE, a name is not a parameter of the chain, or a value is out of
            its bounds.
        ExpressionError: a value cannot be evaluated.
    """
    from gaitsweep import ArgumentError, near_miss
    from gaitsweep.expression import evaluate
    from gaitsweep.papers.ambe2021.theory.chain import Chain

    names = ("m_B", *Chain._fields)
    values: dict[str, float] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals:
            raise ArgumentError(f"--set is {setting}, but must be NAME=VALUE, such as kappa=80.")
        if name not in names:
            raise ArgumentError(f"{name} is not a parameter of the chain{near_miss.suggestion(name, names)}")
        number = _in_bounds(name, float(evaluate(value, {})))
        values |= dict.fromkeys(("m_1", "m_end") if name == "m_B" else (name,), number)
    return Chain(**values)


def _in_bounds(name: str, number: float) -> float:
    """A value of a parameter of the chain unchanged; refuses one out of its bounds."""
    from gaitsweep.papers.ambe2021.multilegged.parameters import PARAMETERS

    low, high = next((quantity.low, quantity.high) for quantity in PARAMETERS if quantity.name == name)
    if not low < number < high:
        allowed = f"above {low:g}" if math.isinf(high) else f"between {low:g} and {high:g}"
        raise gs.ArgumentError(f"{name} is {number:g}, but must be {allowed}.")
    return number


def _theory_summary(N: int, omega: float, chain: Chain) -> str:
    """The solutions of a chain of N + 1 legs as text: the numbers of its line of solutions, then each set."""
    from gaitsweep.papers.ambe2021.theory.conditions import existing_waves
    from gaitsweep.papers.ambe2021.theory.solution_sets import branches

    lines = [f"{name:42} {value:.6g}" for name, value in _numbers_of_line(N, omega, chain).items()]
    if N > 2:
        waves = [wave for wave, exists in existing_waves(N, chain).items() if exists]
        lines.append(f"{'waves that are motions of the chain':42} {', '.join(waves) or 'none'}")
    lines += [
        "",
        "For each set of solutions: the range of its free relative phase (eqs. 19, 20, 25); then, at 0.45 of",
        "this range, the order of touchdowns, the set S of legs 1, 2, ... (Table 2), T_1 and T_2 (eq. 18);",
        "where a relative phase jumps; the eigenvalues of P_k (eqs. 21, 22, 26), their number in brackets.",
    ]
    for branch in branches(N):
        lines += ["", *_lines_of_set(N, branch, chain)]
    return "\n".join(lines)


def _numbers_of_line(N: int, omega: float, chain: Chain) -> dict[str, float]:
    """The numbers that hold for all solutions of a chain, by their description."""
    from gaitsweep.papers.ambe2021.theory import chain as theory
    from gaitsweep.papers.ambe2021.theory.solution_sets import drift, line_length, worst_case_cycles

    speeds = theory.wave_speed(omega, chain)
    numbers = {
        "b (rad/kg)": theory.shift(chain),
        "touchdown phase (rad), eq. (16)": theory.touchdown_phase(chain),
        "lag of neighbours (rad), eq. (17)": theory.lag(chain),
        "wavelength (legs), eq. (27)": theory.wavelength(chain),
        "wave speed (legs/s), eq. (28) as printed": speeds.printed,
        "wave speed (legs/s), exact": speeds.exact,
        "length of the line in E (rad)": line_length(N, chain),
        "drift of E (rad a cycle), eqs. (30)-(32)": drift(chain),
        "cycles to drift along all of it": worst_case_cycles(N, chain),
    }
    return {name: float(number) for name, number in numbers.items()}


def _lines_of_set(N: int, branch: Branch, chain: Chain) -> list[str]:
    """One set of solutions as lines of text."""
    from gaitsweep.papers.ambe2021.theory.order import (
        eigenvalues,
        jumps,
        linear_map,
        reset_sets,
        touchdown_order,
    )
    from gaitsweep.papers.ambe2021.theory.solution_sets import rule_of

    rule = rule_of(N, branch, chain)
    # not the middle itself, where two legs of set A touch down together
    s = float(rule.low + 0.45 * (rule.high - rule.low))
    sets = reset_sets(N, branch, s, chain)
    first = [leg for leg, reset_set in enumerate(sets, 1) if reset_set.is_first]
    T_1, T_2 = [leg for leg in first if leg < branch.k], [leg for leg in first if leg > branch.k]
    jumps_of_set = [f"leg {jump.leg} at {jump.s:.3f}" for jump in jumps(N, branch, chain)]
    # the free relative phase as the paper has it: psi_{k-1} on section k, or psi_N
    low, high = float(rule.low), float(rule.high)
    name, phase, section = f"set {branch.kind}, k = {branch.k}", branch.k - 1, branch.k
    if branch.kind == "direct":
        name, phase, section = "direct wave", N, N
        low, high = 2 * math.pi - high, 2 * math.pi - low
    return [
        f"{name}: psi_{phase} from {low:.6f} to {high:.6f} rad on section {section}",
        f"  touchdowns   {' '.join(map(str, touchdown_order(N, branch, s, chain)))}",
        f"  S            {' '.join(str(reset_set.number) for reset_set in sets)}; "
        f"T_1 = {_listed(T_1)}, T_2 = {_listed(T_2)}",
        f"  jumps        {', '.join(jumps_of_set) or 'none'}",
        f"  eigenvalues  {_counted(eigenvalues(linear_map(N, branch, s, chain)))}",
    ]


def _listed(legs: Iterable[int]) -> str:
    """A set of legs as text."""
    return "{" + ", ".join(map(str, legs)) + "}"


def _counted(values: Inexact[np.ndarray, " springs"]) -> str:
    """Eigenvalues in falling order, equal ones once with their number."""
    texts = []
    for value in values:
        imaginary = f"{value.imag:+.6f}i" if abs(value.imag) > 1e-9 else ""
        texts.append(re.sub(r"\.?0+\Z", "", f"{value.real:.6f}{imaginary}"))
    counts = collections.Counter(texts)
    return ", ".join(text if n == 1 else f"{text} ({n})" for text, n in counts.items())
