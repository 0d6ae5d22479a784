"""Aoi et al. 2011: a quadruped with a passive waist joint, and the hysteresis of its gaits.

`waist_quadruped/` has the model. The measures of the claims are in `*_measures.py`: of equations, of steady
motions, and of transitions between gaits.
"""

import gaitsweep as gs
from gaitsweep.papers import CLAIMS, CONFIGS, JOBS

extension = gs.Extension(
    models={"waist_quadruped": "gaitsweep.papers.aoi2011.waist_quadruped:WaistQuadruped"},
    gait_styles={
        "walk": ("#E69F00", "^", ""),
        "trot": ("#0072B2", "o", ""),
        "pace": ("#D55E00", "v", "...."),
    },
    measures=(
        "gaitsweep.papers.aoi2011.equation_measures",
        "gaitsweep.papers.aoi2011.transition_measures",
        "gaitsweep.papers.aoi2011.motion_measures",
    ),
    jobs=JOBS,
    configs=CONFIGS,
    claims=CLAIMS,
)
