"""Time until a page of `gaitsweep explore` is open, in a new browser and in one that runs already.

    python -m benchmarks.explorer DIR/explore.html [--repeat 5]

Each time is the median over `--repeat` new browsers (headless Chromium), of which each opens the page twice:
until the records, the body and a sketch of the map are shown, and until the map answers; then the CPU time
of all processes of the browser until that, which depends less on what else a machine does.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.support.browser import Page, browser, program


def opened(page: Page, file: Path) -> tuple[float, float, float]:
    """Seconds until a page is shown, until its map answers, and of CPU time until that."""
    before = page.cpu_time()
    page.open(file)
    shown, ready = page.evaluate("['shown', 'ready'].map(k => document.documentElement.dataset[k])")
    return float(shown) / 1e3, float(ready) / 1e3, page.cpu_time() - before


def main() -> None:
    """Measure, and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("page", type=Path, help="what `gaitsweep explore` wrote")
    parser.add_argument("--repeat", type=int, default=5, help="browsers")
    options = parser.parse_args()
    if program() is None:
        raise SystemExit("There is no Chromium on this machine (apt-get install chromium).")
    results: dict[str, list[tuple[float, float, float]]] = {"a new browser": [], "the same again": []}
    for _ in range(options.repeat):
        with browser() as page:
            page.size(1280, 900)
            for times in results.values():
                times.append(opened(page, options.page))
    print(f"{options.page}: {options.page.stat().st_size / 1e6:.1f} MB, {options.repeat} browsers")
    for name, times in results.items():
        shown, ready, spent = (statistics.median(samples) for samples in zip(*times, strict=True))
        span = f"{min(t[1] for t in times):.2f} to {max(t[1] for t in times):.2f}"
        print(f"{name:15} shown {shown:.2f} s, map {ready:.2f} s ({span}), CPU {spent:.2f} s")


if __name__ == "__main__":
    main()
