"""The gallery: a picture of each kind of figure, drawn from small stored tables while the site is built.

`python docs/extensions/gallery.py [KIND ...]` runs the jobs and stores the columns and rows that their
pictures need in `docs/gallery/`, with command, job and units in the table's `.attrs`. Kinds of one run share
a table.
"""

from __future__ import annotations

import hashlib
import io
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

ROOT = Path(__file__).parents[2]
TABLES, PICTURES = ROOT / "docs" / "gallery", ROOT / "build" / "gallery"
LARGE = 50_000  # bytes of a table from which columns that its picture does not show are left out

# Overrides of jobs that several kinds share.
SLICES = ("vary.psi_3.linspace=[0, 2*pi, 3]",)
OFFSETS = ("vary.k2=[0.08]", "vary.com_x.linspace=[-0.08, 0.08, 9]", "vary.sigma.linspace=[0, 1, 11]")
# The job of each kind of figure, with the overrides that make its table small.
ENTRIES: dict[str, tuple[str, tuple[str, ...]]] = {
    "basin": ("quick_basins", ()),
    "basin_measures": ("multilegged_basin_measures", SLICES),
    "gait_map": ("multilegged_reduced_amplitudes", ()),
    "shock": ("multilegged_basin_measures", SLICES),
    "recovery": ("gaitsweep/examples/compass_walker_pushes.yaml", ()),
    "phase_response": ("gaitsweep/examples/compass_walker_pushes.yaml", ()),
    "survival": (
        "gaitsweep/examples/compass_walker_ground.yaml",
        ("vary.ground_seed.linspace=[0, 19, 20]", "vary.ground_roughness.linspace=[0, 0.002, 5]"),
    ),
    "branches": (
        "waist_quadruped_branches",
        ("vary.f.linspace=[2.0, 3.2, 9]", "vary.delta_13.linspace=[2.65, 3.15, 24]"),
    ),
    "continuation": ("multilegged_continuation_grid", ()),
    "cycles": ("multilegged_cycles", ()),
    "road_map": ("gaitsweep/examples/bouncing_ball.yaml", ()),
    "atlas": ("gaitsweep/examples/bouncing_ball.yaml", ()),
    "orbit": ("gaitsweep/examples/henon.yaml", ("vary.a.linspace=[1.0, 1.4, 61]", "run.max_period=24")),
    "orbit_family": ("gaitsweep/examples/slip_runner_atlas.yaml", ()),
    "gait_transitions": ("waist_quadruped_edges", ("vary.f.linspace=[2.0, 3.4, 15]", "run.max_time=240")),
    "hysteresis": ("planar_quadruped_walks_history", ()),
    "return_map": ("waist_quadruped_return_map", ("vary.delta_13.linspace=[2.65, 3.15, 20]",)),
    "stable_ranges": ("multilegged_continuation_grid", ()),
    "footprints": ("multilegged_footprints", ("run.duration=32",)),
    "drift_law": ("multilegged_reduced_amplitudes", ()),
    "gait_shares": ("multilegged_end_mass", ("vary.sample.n=32",)),
    "solution_set": (
        "multilegged_solution_set",
        tuple(f"vary.psi_{n}.linspace=[0, 2*pi, 13]" for n in (1, 2, 3)),
    ),
    "source_place": ("multilegged_source_place", ("vary.sample.n=16",)),
    "chain_theory": ("multilegged_ten_legs", ("run.duration=16",)),
    "wave_speed": (
        "multilegged_wave_speed",
        ("vary.beta.linspace=[0.6, 0.9, 3]", "run.duration=50", "run.every=0.1"),
    ),
    "gait_ramp": ("planar_quadruped_ramp", ()),
    "gait_series": (
        "planar_quadruped_series",
        ("vary.zip={com_x: [-0.03], sigma: [0.75]}", "run.duration=1.6"),
    ),
    "loading_rule": ("planar_quadruped_offset", OFFSETS),
    "nine_gaits": ("planar_quadruped_nine_traces", ("run.every=4.0e-3",)),
    "speed_gaits": ("planar_quadruped_offset", OFFSETS),
}


def command(kind: str) -> str:
    """The command that makes a kind's table and draws its picture."""
    overrides = (word for each in ENTRIES[kind][1] for word in ("--set", each))
    return shlex.join(["gaitsweep", "run", job_path(kind), *overrides])


def job_path(kind: str) -> str:
    """The path of a kind's job file from the repository's root."""
    job = ENTRIES[kind][0]
    return job if job.endswith(".yaml") else f"sweeps/{job}.yaml"


def job_of(kind: str) -> dict[str, Any]:
    """The content of a kind's job file, with those overrides that replace a whole field."""
    data = yaml.safe_load((ROOT / job_path(kind)).read_text(encoding="utf-8"))
    whole = (each.partition("=") for each in ENTRIES[kind][1] if "." not in each.partition("=")[0])
    return data | {field: yaml.safe_load(value) for field, _, value in whole}


def fields(kind: str) -> dict[str, Any]:
    """The first figure of the kind in its job."""
    return next(each for each in job_of(kind)["figures"] if each["kind"] == kind)


def table_of(kind: str) -> Path:
    """The file of a kind's table, named after the first kind of its run."""
    return TABLES / f"{_of_one_run(kind)[0]}.parquet"


def _of_one_run(kind: str) -> list[str]:
    return [each for each in ENTRIES if ENTRIES[each] == ENTRIES[kind]]


def picture(kind: str, table: pd.DataFrame) -> bytes:
    """The PNG of a kind's figure."""
    from gaitsweep.plot import draw

    spec = {key: value for key, value in fields(kind).items() if key not in ("kind", "name")}
    file = io.BytesIO()
    draw(kind, table.copy(), **spec).savefig(file, dpi=100, metadata={"Software": None})
    return file.getvalue()


def draw_pictures() -> None:
    """Draw the pictures that are missing or older than the tables or the code of figures."""
    code = [*ROOT.glob("gaitsweep/plot/**/*.py"), *ROOT.glob("gaitsweep/papers/*/figures/*.py")]
    inputs = b"".join(file.read_bytes() for file in [Path(__file__), *sorted(code), *TABLES.glob("*")])
    stamp, digest = PICTURES / "stamp", hashlib.sha256(inputs).hexdigest()
    if stamp.exists() and stamp.read_text() == digest:
        return
    PICTURES.mkdir(parents=True, exist_ok=True)
    for kind in ENTRIES:
        (PICTURES / f"{kind}.png").write_bytes(picture(kind, pd.read_parquet(table_of(kind))))
    stamp.write_text(digest)


def store(kind: str) -> None:
    """Run a kind's job, and store what the pictures of its run need."""
    import gaitsweep as gs

    target = table_of(kind)
    folder = ROOT / "results" / "gallery" / target.stem
    words = [*shlex.split(command(kind))[1:], "--out", str(folder)]
    subprocess.run([sys.executable, "-m", "gaitsweep", *words], cwd=ROOT, check=True)
    table = gs.load(folder)
    known, manifest = table.attrs, table.attrs["manifest"]
    attrs = {
        "command": command(kind),
        "job": known["job"],
        "manifest": {name: manifest.get(name) for name in ("rows", "self_check")},
    }
    floats = table.select_dtypes("float64").columns.difference(gs.analyses.axes_of(table))
    table = table.astype(dict.fromkeys(floats, "float32"))  # but the axes, whose spacing figures read
    table.attrs = {**attrs, "quantities": known["quantities"]}
    table.to_parquet(target, compression="zstd", index=False)
    if target.stat().st_size > LARGE:
        small = _without_unused(_of_one_run(kind), table)
        used = {name: each for name, each in known["quantities"].items() if name in small}
        small.attrs = {**table.attrs, "quantities": used}
        small.to_parquet(target, compression="zstd", index=False)


def _without_unused(kinds: Sequence[str], table: pd.DataFrame) -> pd.DataFrame:
    """The table without the columns that do not change its pictures."""
    whole = [picture(kind, table) for kind in kinds]

    def needed(columns: Sequence[str], others: Sequence[str]) -> list[str]:
        """The columns without which a picture changes, if `others` are there."""
        try:
            if [picture(kind, table.loc[:, [*others]]) for kind in kinds] == whole:
                return []
        except Exception:  # figures refuse tables without their columns in many ways
            pass
        if len(columns) == 1:
            return list(columns)
        half = len(columns) // 2
        kept = needed(columns[:half], [*others, *columns[half:]])
        return kept + needed(columns[half:], [*others, *kept])

    kept = needed(list(table), [])
    return table.loc[:, [name for name in table if name in kept]]


def setup(app: Any) -> dict[str, Any]:
    """Draw the pictures before pages are read, in another process: the build forks, which JAX forbids."""
    draw = [sys.executable, __file__, "--draw"]
    app.connect("builder-inited", lambda app: subprocess.run(draw, cwd=ROOT, check=True))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    if sys.argv[1:] == ["--draw"]:
        draw_pictures()
    else:
        for name in sys.argv[1:] or ENTRIES:
            store(name)
