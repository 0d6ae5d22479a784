"""All kinds of figures, those of extensions too; the functions that draw any of them and style several."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from gaitsweep import near_miss
from gaitsweep.extension import import_all
from gaitsweep.plot.basin_maps.basin_heat_map import basin as basin
from gaitsweep.plot.basin_maps.basin_heat_map import recovery as recovery
from gaitsweep.plot.basin_maps.basin_heat_map import shock as shock
from gaitsweep.plot.basin_maps.basin_measures import basin_measures as basin_measures
from gaitsweep.plot.basin_maps.gait_map import gait_map as gait_map
from gaitsweep.plot.bifurcations.atlas import atlas as atlas
from gaitsweep.plot.bifurcations.atlas import orbit_family as orbit_family
from gaitsweep.plot.bifurcations.atlas import road_map as road_map
from gaitsweep.plot.bifurcations.bifurcation_diagram import orbit as orbit
from gaitsweep.plot.bifurcations.branches import branches as branches
from gaitsweep.plot.bifurcations.continuation import continuation as continuation
from gaitsweep.plot.bifurcations.continuation import stable_ranges as stable_ranges
from gaitsweep.plot.bifurcations.cycles import cycles as cycles
from gaitsweep.plot.bifurcations.gait_transitions import gait_transitions as gait_transitions
from gaitsweep.plot.bifurcations.hysteresis import hysteresis as hysteresis
from gaitsweep.plot.bifurcations.return_map import return_map as return_map
from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.figure_style import STYLE_FIELDS, StyleError, read_style, styled
from gaitsweep.plot.footprint_diagrams import footprints as footprints
from gaitsweep.plot.kind import FIGURES, drawing_function
from gaitsweep.plot.phase_shifts import phase_response as phase_response
from gaitsweep.plot.survival_shares import survival as survival


def draw(kind: str, table: pd.DataFrame, **spec: Any) -> Figure:
    """Draw a figure of some kind from a table.

    Args:
        kind: a key of FIGURES.
        table: a result table from `gaitsweep.load`.
        spec: the arguments of the kind, the fields of `FigureStyle`, and `ax`, Matplotlib axes for a figure
            of one panel.

    Raises:
        PlotError: the kind is unknown, the table lacks a column of the figure, or the figure has several
            panels and `ax` is given.
        StyleError: a field of the style is not allowed.
    """
    if kind not in FIGURES:
        raise PlotError(f"{kind} is not a kind of figure{near_miss.suggestion(kind, FIGURES)}")
    return drawing_function(FIGURES[kind])(table, **spec)


@contextlib.contextmanager
def style(**fields: Any) -> Iterator[None]:
    """A context in which all figures have a style: `with gs.plot.style(width="column", format="pdf"): ...`.

    A figure's own arguments take precedence. A figure that cannot use any of the colours warns.

    Args:
        fields: those of `FigureStyle`: width, height, panel_columns, format, dpi, colours, order, labels,
            hatches, panel_letters, caption, marks.

    Raises:
        StyleError: a field does not exist, or has a value that is not allowed. The message names the kinds of
            figures that take the field as an argument.
    """
    for name in fields:
        kinds = [kind for kind in FIGURES if name in FIGURES[kind].model_fields]
        if kinds and name not in STYLE_FIELDS:
            raise StyleError(
                f"{name} is not a field of a style, but an argument of single figures ({', '.join(kinds)}): "
                f"gs.plot.{kinds[0]}(table, ..., {name}=...). {near_miss.allowing(STYLE_FIELDS)}"
            )
    with styled(read_style(**fields)):
        yield


import_all("figures")
