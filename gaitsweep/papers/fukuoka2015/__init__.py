"""Fukuoka et al. 2015: a planar quadruped with Matsuoka oscillators and leg loading, and its nine gaits.

`planar_quadruped/` has the model and the names of the nine gaits; `analysis/` what is computed from tables,
`figures/` what is drawn of it, and `analyses.py` the commands `gaitsweep analyse`. The measures of the claims
are in `gait_measures.py` (equations, gaits and legs) and `ramp_measures.py`.
"""

import gaitsweep as gs
from gaitsweep.papers import CLAIMS, CONFIGS, JOBS

extension = gs.Extension(
    models={"planar_quadruped": "gaitsweep.papers.fukuoka2015.planar_quadruped:PlanarQuadruped"},
    figures=("gaitsweep.papers.fukuoka2015.figures",),
    analyses=("gaitsweep.papers.fukuoka2015.analyses",),
    # a colour for each family of gaits, a marker and a hatch for each gait, in the order of speed
    gait_styles={
        "D-walk": ("#8C4A00", "v", "xxxx"),
        "L-walk": ("#E69F00", "^", ""),
        "trot": ("#0072B2", "o", ""),
        "uR-canter": ("#56B4E9", ">", r"\\\\"),
        "uL-canter": ("#56B4E9", "<", "||||"),
        "R-canter": ("#009E73", "s", "...."),
        "L-canter": ("#009E73", "D", "----"),
        "RT-gallop": ("#CC79A7", "P", "++++"),
        "LT-gallop": ("#CC79A7", "X", "oo"),
        "unsteady": ("#999999", "*", "**"),
    },
    functions={
        "gait_bouts": "gaitsweep.papers.fukuoka2015.analysis.gait_bouts:gait_bouts",
        "gaits_along": "gaitsweep.papers.fukuoka2015.analysis.gait_bouts:gaits_along",
        "gait_measures": "gaitsweep.papers.fukuoka2015.analysis.gait_tables:gait_measures",
        "gaits_by_threshold": "gaitsweep.papers.fukuoka2015.analysis.gait_tables:gaits_by_threshold",
        "gaits_in": "gaitsweep.papers.fukuoka2015.analysis.gait_tables:gaits_in",
        "loading_rule": "gaitsweep.papers.fukuoka2015.analysis.loading_rule:loading_rule",
        "repertoire": "gaitsweep.papers.fukuoka2015.analysis.gait_tables:repertoire",
        "speed_transitions": "gaitsweep.papers.fukuoka2015.analysis.gait_bouts:speed_transitions",
    },
    measures=(
        "gaitsweep.papers.fukuoka2015.gait_measures",
        "gaitsweep.papers.fukuoka2015.ramp_measures",
    ),
    jobs=JOBS,
    configs=CONFIGS,
    claims=CLAIMS,
)
