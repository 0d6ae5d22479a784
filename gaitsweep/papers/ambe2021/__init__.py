"""Ambe et al. 2021: a chain of legs with phase resetting, its theory, its waves and basins.

`multilegged/` has the model, its reduced form, and the chain of a table; `theory/` the analytic
solutions; `analysis/` what is computed from tables, `figures/` what is drawn of it, and `analyses.py` the
commands `gaitsweep analyse`. The measures of the claims are in `*_measures.py`: of equations, of the theory,
of settled states, and of waves.
"""

import gaitsweep as gs
from gaitsweep.papers import CLAIMS, CONFIGS, JOBS

extension = gs.Extension(
    models={
        "multilegged": "gaitsweep.papers.ambe2021.multilegged.model:Multilegged",
        "multilegged_reduced": "gaitsweep.papers.ambe2021.multilegged.reduced:MultileggedReduced",
    },
    figures=("gaitsweep.papers.ambe2021.figures",),
    gait_styles={
        "direct": ("#E69F00", "o", ""),
        "source": ("#009E73", "s", "...."),
        "retrograde": ("#0072B2", "^", ""),
        "locked": ("#CC79A7", "D", r"\\\\"),
    },
    analyses=("gaitsweep.papers.ambe2021.analyses",),
    functions={
        "gait_shares": "gaitsweep.papers.ambe2021.analysis.gait_shares:gait_shares",
        "multilegged_theory": "gaitsweep.papers.ambe2021.theory",
    },
    measures=(
        "gaitsweep.papers.ambe2021.equation_measures",
        "gaitsweep.papers.ambe2021.theory_measures",
        "gaitsweep.papers.ambe2021.settled_measures",
        "gaitsweep.papers.ambe2021.wave_measures",
    ),
    jobs=JOBS,
    configs=CONFIGS,
    claims=CLAIMS,
)
