"""The results of the theory for one chain, as text."""

from __future__ import annotations

import collections
import re

import numpy as np
from jaxtyping import Inexact

from gaitsweep.papers.ambe2021.theory.chain import Chain, lag, shift, touchdown_phase, wave_speed, wavelength
from gaitsweep.papers.ambe2021.theory.line_drift import drift, line_length, worst_case_cycles
from gaitsweep.papers.ambe2021.theory.order import jumps, order_sets, reset_sets, touchdown_order
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, branches, rule_of
from gaitsweep.papers.ambe2021.theory.stability import eigenvalues, linear_map


def theory_summary(N: int, omega: float, chain: Chain) -> str:
    """The solutions of a chain: the numbers of its line of solutions, then each set.

    Args:
        N: springs; the chain has N + 1 legs.
        omega: basic frequency, rad/s.
        chain: its parameters.
    """
    speeds = wave_speed(omega, chain)
    rows = {
        "b (rad/kg)": shift(chain),
        "touchdown phase (rad), eq. (16)": touchdown_phase(chain),
        "lag of neighbours (rad), eq. (17)": lag(chain),
        "wavelength (legs), eq. (27)": wavelength(chain),
        "wave speed (legs/s), eq. (28) as printed": speeds.printed,
        "wave speed (legs/s), exact": speeds.exact,
        "length of the line in E (rad)": line_length(N, chain),
        "drift of E (rad a cycle), eqs. (30)-(32)": drift(chain),
        "cycles to drift along all of it": worst_case_cycles(N, chain),
    }
    lines = [f"{name:42} {float(value):.6g}" for name, value in rows.items()]
    lines += [
        "",
        "For each set of solutions: the range of its free relative phase (eqs. 19, 20, 25); then, at 0.45 of",
        "this range, the order of touchdowns, the set S of legs 1, 2, ... (Table 2), T_1 and T_2 (eq. 18);",
        "where a relative phase jumps; the eigenvalues of P_k (eqs. 21, 22, 26), their number in brackets.",
    ]
    for branch in branches(N):
        rule = rule_of(N, branch, chain)
        # not the middle itself, where two legs of set A touch down together
        s = float(rule.low + 0.45 * (rule.high - rule.low))
        T_1, T_2 = order_sets(N, branch, s, chain)
        jumps_of_set = [f"leg {jump.leg} at {jump.s:.3f}" for jump in jumps(N, branch, chain)]
        name = "direct wave" if branch.kind == "direct" else f"set {branch.kind}, k = {branch.k}"
        lines += [
            "",
            f"{name}: {free_phase(N, branch, chain)}",
            f"  touchdowns   {' '.join(map(str, touchdown_order(N, branch, s, chain)))}",
            f"  S            {' '.join(str(i) for i, *_ in reset_sets(N, branch, s, chain))}; "
            f"T_1 = {_listed(T_1)}, T_2 = {_listed(T_2)}",
            f"  jumps        {', '.join(jumps_of_set) or 'none'}",
            f"  eigenvalues  {_counted(eigenvalues(linear_map(N, branch, s, chain)))}",
        ]
    return "\n".join(lines)


def free_phase(N: int, branch: Branch, chain: Chain) -> str:
    """The range of a set's free relative phase, as the paper has it: psi_{k-1} on section k, or psi_N.

    Args:
        N, branch, chain: as in `rule_of`.
    """
    rule = rule_of(N, branch, chain)
    low, high = float(rule.low), float(rule.high)
    if branch.kind == "direct":
        return f"psi_{N} from {2 * np.pi - high:.6f} to {2 * np.pi - low:.6f} rad on section {N}"
    return f"psi_{branch.k - 1} from {low:.6f} to {high:.6f} rad on section {branch.k}"


def _listed(legs: frozenset[int]) -> str:
    """A set of legs as text, in their order."""
    return "{" + ", ".join(map(str, sorted(legs))) + "}"


def _counted(values: Inexact[np.ndarray, " springs"]) -> str:
    """Eigenvalues in falling order, equal ones once with their number."""
    texts = []
    for value in values:
        imaginary = f"{value.imag:+.6f}i" if abs(value.imag) > 1e-9 else ""
        texts.append(re.sub(r"\.?0+\Z", "", f"{value.real:.6f}{imaginary}"))
    counts = collections.Counter(texts)
    return ", ".join(text if n == 1 else f"{text} ({n})" for text, n in counts.items())
