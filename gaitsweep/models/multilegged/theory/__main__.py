"""The theory's results for a chain: `python -m gaitsweep.models.multilegged.theory --N 9 --m_1 0.85`."""

from __future__ import annotations

import argparse

import jax
import numpy as np

from gaitsweep.models.multilegged.theory import conserved, waves
from gaitsweep.models.multilegged.theory.chain import Chain, lag, shift, touchdown_phase
from gaitsweep.models.multilegged.theory.order import jumps, order_sets, touchdown_order
from gaitsweep.models.multilegged.theory.solution_sets import branches, rule_of
from gaitsweep.models.multilegged.theory.stability import characteristic_polynomial, linear_map, polynomial


def main() -> None:
    """Print the solutions of a chain: quantities of the whole line, then a row for each set."""
    parser = argparse.ArgumentParser(
        prog="python -m gaitsweep.models.multilegged.theory", description=__doc__
    )
    parser.add_argument("--N", type=int, default=3, help="springs; the chain has N + 1 legs")
    parser.add_argument("--omega", type=float, default=0.4, help="basic frequency, rad/s")
    for name, value in Chain()._asdict().items():
        parser.add_argument(f"--{name}", type=float, default=value)
    given = vars(parser.parse_args())
    N, omega = given.pop("N"), given.pop("omega")
    jax.config.update("jax_enable_x64", True)
    chain = Chain(**given)
    speeds = waves.wave_speed(omega, chain)
    rows = {
        "b (rad/kg)": shift(chain),
        "touchdown phase (rad), eq. (16)": touchdown_phase(chain),
        "lag of neighbours (rad), eq. (17)": lag(chain),
        "wavelength (legs), eq. (27)": waves.wavelength(chain),
        "wave speed (legs/s), eq. (28) as printed": speeds.printed,
        "wave speed (legs/s), exact": speeds.exact,
        "length of the line in E (rad)": conserved.line_length(N, chain),
        "drift of E (rad a cycle), eqs. (30)-(32)": conserved.drift(chain),
        "cycles to drift along all of it": conserved.worst_case_cycles(N, chain),
    }
    for name, value in rows.items():
        print(f"{name:42} {float(value):.6g}")
    print("\nset          free phase      order of touchdowns in its middle; T_1, T_2; jumps; error of (22)")
    for branch in branches(N):
        rule = rule_of(N, branch, chain)
        # not the middle itself, where two legs of set A touch down together
        s = float(rule.low + 0.45 * (rule.high - rule.low))
        order = " ".join(map(str, touchdown_order(N, branch, s, chain)))
        early = ", ".join(str(sorted(legs)) for legs in order_sets(N, branch, s, chain))
        at = [f"leg {jump.leg} at {jump.s:.3f}" for jump in jumps(N, branch, chain)]
        found = characteristic_polynomial(linear_map(N, branch, s, chain))
        error = np.abs(found - polynomial(N, branch)).max()
        name = branch.kind if branch.kind == "direct" else f"{branch.kind}, k = {branch.k}"
        ends = f"{float(rule.low):.4f} {float(rule.high):.4f}"
        print(f"{name:12} {ends}   {order}; {early}; {', '.join(at) or 'none'}; {error:.0e}")


if __name__ == "__main__":
    main()
