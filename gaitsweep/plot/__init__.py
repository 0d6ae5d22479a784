"""Figures from tables; each function is a kind of figure for jobs.

`figure_kind` turns a function into a kind, and `register` adds a class; call them before jobs are read.

Kinds: `basin_maps/` has the outcomes of starts and pushes, `bifurcations/` what happens along a parameter;
`footprint_diagrams.py`, `phase_shifts.py` and `survival_shares.py` have one kind each. `kind.py` is the
interface of a kind, `arguments.py` has the types of its arguments, and `kinds.py` imports all kinds and draws
any of them.

Looks: `figure_style.py` is the style that users give, `style_names.py` checks its names; `gait_looks.py` has
the colours, markers and hatches of gaits and other outcomes; `theme.py` has all of a figure's layout:
`canvas.py` (pages and panels), `legend.py`, `figure_layout.py` and `value_axes.py`; `limbs.py` has the
colours of limbs, `provenance_marks.py` the remarks on a doubtful table. `columns.py` and `column_labels.py`
read columns of tables and label them.
"""

from __future__ import annotations

from typing import Any

from gaitsweep.lazy_imports import Lazy, attach_stub
from gaitsweep.plot.kind import FIGURES, drawing_function

_public, _, __all__ = attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """The drawing function of a kind of figure, extensions' too, or another public name of this package."""
    if name == "theme":  # jobs are read without Matplotlib
        return Lazy({}, f"{__name__}.{name}")
    if name not in __all__ and name in FIGURES:
        return drawing_function(FIGURES[name])
    return _public(name)


def __dir__() -> list[str]:
    return sorted({*__all__, *FIGURES})
