"""Comparison of a paper's claims with results: tables of claims, measures, verdicts, page.

`configs/claims/PAPER.yaml` lists the claims. A claim names its jobs, a `measure` of their tables and the
paper's value; the verdict compares the two.

`claims_and_verdicts` reads the list and has the rule of the verdicts, `measures` has the general measures,
`reproduce` runs the jobs, `page` shows the result.
"""

from __future__ import annotations

from gaitsweep.lazy_imports import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
