"""The explorer of the home page, written by the commands of gaitsweep while the site is built.

The commands run beside Sphinx, and again only if the package or the job has changed.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

ROOT = Path(__file__).parents[2]
JOB = ROOT / "sweeps" / "quick_basins.yaml"
MADE = ROOT / "build" / "explorer"
PAGE = "explore_quick_basins.html"


def write_page() -> None:
    """Run the job and write its explorer, unless the page of this code is there."""
    code = [*ROOT.glob("gaitsweep/**/*.py"), *ROOT.glob("gaitsweep/view/explorer/page/*")]
    inputs = [Path(__file__), JOB, ROOT / "configs" / "ambe2021.yaml", *sorted(code)]
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in inputs)).hexdigest()
    stamp = MADE / "stamp"
    if stamp.exists() and stamp.read_text() == digest:
        return
    MADE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        result = f"{folder}/quick_basins"
        for words in (
            ["run", str(JOB), "--out", result],
            ["explore", result, "--replays", "100", "--out", str(MADE / PAGE)],
        ):
            subprocess.run([sys.executable, "-m", "gaitsweep", *words], cwd=ROOT, check=True)
    stamp.write_text(digest)


def setup(app: Sphinx) -> dict[str, Any]:
    """Begin to write the page before pages are read, and copy it beside the home page at the end."""
    process: list[subprocess.Popen[str]] = []

    def begin(app: Sphinx) -> None:
        words = [sys.executable, __file__]
        process.append(subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True))

    def finish(app: Sphinx, error: Exception | None) -> None:
        output, _ = process[0].communicate()
        if process[0].returncode:
            raise ExtensionError(f"The explorer of the home page could not be written: {output}")
        shutil.copyfile(MADE / PAGE, Path(app.outdir) / "docs" / PAGE)

    app.connect("builder-inited", begin)
    app.connect("build-finished", finish)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    write_page()
