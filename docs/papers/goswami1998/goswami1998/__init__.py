"""Goswami, Thuilot and Espiau 1998, Int. J. Robotics Research 17(12):1282: the compass gait and its chaos."""

from pathlib import Path

import gaitsweep as gs

_HERE = Path(__file__).parent
extension = gs.Extension(
    models={"goswami1998": "goswami1998.model:CompassGait"},
    figures=("goswami1998.figures",),
    analyses=("goswami1998.analyses",),
    functions={"steps_over_slope": "goswami1998.analyses:steps_over_slope"},
    measures=("goswami1998.measures",),
    jobs=_HERE / "jobs",
    configs=_HERE / "configs",
    claims=_HERE / "claims",
)
