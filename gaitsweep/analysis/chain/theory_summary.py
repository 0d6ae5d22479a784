"""The results of the theory for one chain, as text."""

from __future__ import annotations

import numpy as np

from gaitsweep.models.multilegged.theory import conserved
from gaitsweep.models.multilegged.theory.chain import (
    Chain,
    lag,
    shift,
    touchdown_phase,
    wave_speed,
    wavelength,
)
from gaitsweep.models.multilegged.theory.order import jumps, order_sets, touchdown_order
from gaitsweep.models.multilegged.theory.solution_sets import branches, rule_of
from gaitsweep.models.multilegged.theory.stability import characteristic_polynomial, linear_map, multipliers


def theory_summary(N: int, omega: float, chain: Chain) -> str:
    """The solutions of a chain: the numbers of its line of solutions, then one line for each set.

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
        "length of the line in E (rad)": conserved.line_length(N, chain),
        "drift of E (rad a cycle), eqs. (30)-(32)": conserved.drift(chain),
        "cycles to drift along all of it": conserved.worst_case_cycles(N, chain),
    }
    lines = [f"{name:42} {float(value):.6g}" for name, value in rows.items()]
    lines += [
        "",
        "set          free phase      order of touchdowns in its middle; T_1, T_2; jumps; error of (22)",
    ]
    for branch in branches(N):
        rule = rule_of(N, branch, chain)
        # not the middle itself, where two legs of set A touch down together
        s = float(rule.low + 0.45 * (rule.high - rule.low))
        order = " ".join(map(str, touchdown_order(N, branch, s, chain)))
        early = ", ".join(str(sorted(legs)) for legs in order_sets(N, branch, s, chain))
        at = [f"leg {jump.leg} at {jump.s:.3f}" for jump in jumps(N, branch, chain)]
        found = characteristic_polynomial(linear_map(N, branch, s, chain))
        error = np.abs(found - np.poly(multipliers(N, branch))).max()
        name = branch.kind if branch.kind == "direct" else f"{branch.kind}, k = {branch.k}"
        ends = f"{float(rule.low):.4f} {float(rule.high):.4f}"
        lines.append(f"{name:12} {ends}   {order}; {early}; {', '.join(at) or 'none'}; {error:.0e}")
    return "\n".join(lines)
