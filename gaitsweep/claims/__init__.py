"""A paper's claims beside what gaitsweep finds: their tables, measures, verdicts and page.

`configs/claims/PAPER.yaml` lists the claims. A claim names the jobs that it is measured from, a measure
(`gaitsweep.claims.measures`) and what the paper says; the verdict follows from both.
"""

from __future__ import annotations
