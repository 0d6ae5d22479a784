"""Rivals on their own tasks: `python -m benchmarks.rivals_tasks [TASK ...]`; without names, all tasks.

Rivals are no dependencies of gaitsweep: one that is not installed is skipped with a line that says so. Those
that need another JAX are best installed in a folder of their own (`pip install --no-deps --target DIR NAME`),
which PYTHONPATH then names. Times are of the processor, of all threads together, without compilation, unless
a line says otherwise; on a card (`--platform cuda`) compare times of the clock.
"""

from __future__ import annotations

import argparse
import os
from importlib import import_module

from .measured import Options, print_lines

TASKS = ("simplest_walker", "pendulum", "van_der_pol", "walkers", "branches", "basin", "published")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=", ".join(TASKS))
    parser.add_argument("--rows", type=int, nargs="+", help="rows of a task, instead of its own number")
    parser.add_argument("--platform", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--repeats", type=int, default=3, help="timed calls, of which the fastest counts")
    arguments = parser.parse_args()
    for task in arguments.tasks:
        if task not in TASKS:
            parser.error(f"{task} is not a task: choose from {', '.join(TASKS)}")
    os.environ.setdefault("JAX_PLATFORMS", arguments.platform)
    # rivals in JAX get float64, as gaitsweep does
    os.environ.setdefault("JAX_ENABLE_X64", "1")
    options = Options(arguments.rows, arguments.platform, arguments.repeats)
    for task in arguments.tasks or TASKS:
        module = import_module(f"{__package__}.{task}")
        print_lines(str(module.__doc__).partition("\n")[0], module.lines(options))


if __name__ == "__main__":
    main()
