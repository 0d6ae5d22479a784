"""A paper's claims beside what gaitsweep finds: their tables, measures, verdicts and page.

`configs/claims/PAPER.yaml` lists the claims. A claim names the jobs that it is measured from, a `measure` and
what the paper says; the verdict follows from both.
"""

from __future__ import annotations

from gaitsweep.public_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
