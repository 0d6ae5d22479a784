"""Authors, year, journal: replace this line, the model, and what is claimed of it by your paper's."""

from pathlib import Path

import gaitsweep as gs

_HERE = Path(__file__).parent
extension = gs.Extension(
    models={"hopper": "hopper.model:Hopper"},
    figures=("hopper.figures",),
    gait_styles={"1:1": ("#0072B2", "o"), "2:1": ("#E69F00", "^"), "3:1": ("#009E73", "s")},
    analyses=("hopper.analyses",),
    functions={"hopper_launches": "hopper.analyses:launches"},
    measures=("hopper.measures",),
    jobs=_HERE / "jobs",
    configs=_HERE / "configs",
    claims=_HERE / "claims",
)
