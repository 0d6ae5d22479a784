from typing import Any

from gaitsweep.plot import theme as theme
from gaitsweep.plot.arguments import TEXT_COLUMNS as TEXT_COLUMNS
from gaitsweep.plot.arguments import AlongAxis as AlongAxis
from gaitsweep.plot.arguments import Column as Column
from gaitsweep.plot.arguments import GaitColumn as GaitColumn
from gaitsweep.plot.arguments import Horizontal as Horizontal
from gaitsweep.plot.arguments import Hue as Hue
from gaitsweep.plot.arguments import Observable as Observable
from gaitsweep.plot.arguments import Observed as Observed
from gaitsweep.plot.arguments import Panels as Panels
from gaitsweep.plot.arguments import TableOrName as TableOrName
from gaitsweep.plot.arguments import Title as Title
from gaitsweep.plot.arguments import Window as Window
from gaitsweep.plot.basin_maps.cells import CellGrid as CellGrid
from gaitsweep.plot.basin_maps.cells import cell_edges as cell_edges
from gaitsweep.plot.basin_maps.cells import cell_grid as cell_grid
from gaitsweep.plot.basin_maps.cells import hatch_cells as hatch_cells
from gaitsweep.plot.column_labels import axis_label as axis_label
from gaitsweep.plot.column_labels import described as described
from gaitsweep.plot.column_labels import row_names as row_names
from gaitsweep.plot.column_labels import written as written
from gaitsweep.plot.columns import PlotError as PlotError
from gaitsweep.plot.columns import column as column
from gaitsweep.plot.columns import is_angle as is_angle
from gaitsweep.plot.columns import is_logarithmic as is_logarithmic
from gaitsweep.plot.columns import log_axes as log_axes
from gaitsweep.plot.columns import moved_parameter as moved_parameter
from gaitsweep.plot.columns import outcome as outcome
from gaitsweep.plot.columns import require_columns as require_columns
from gaitsweep.plot.columns import rows_where as rows_where
from gaitsweep.plot.figure_style import FigureStyle as FigureStyle
from gaitsweep.plot.figure_style import StyleError as StyleError
from gaitsweep.plot.footprint_diagrams import contact_intervals as contact_intervals
from gaitsweep.plot.kind import FIGURES as FIGURES
from gaitsweep.plot.kind import FigureKind as FigureKind
from gaitsweep.plot.kind import PlannedTable as PlannedTable
from gaitsweep.plot.kind import Refusal as Refusal
from gaitsweep.plot.kind import check_window as check_window
from gaitsweep.plot.kind import drawing_function as drawing_function
from gaitsweep.plot.kind import figure_kind as figure_kind
from gaitsweep.plot.kind import register as register
from gaitsweep.plot.kind import unregister as unregister
from gaitsweep.plot.kinds import *  # noqa: F403 - of `FIGURES` where Python runs
from gaitsweep.plot.kinds import draw as draw
from gaitsweep.plot.kinds import style as style
from gaitsweep.plot.limbs import limb_colours as limb_colours
from gaitsweep.plot.limbs import name_limbs as name_limbs
from gaitsweep.schema.numbers import Count as Count
from gaitsweep.schema.numbers import CountOrZero as CountOrZero
from gaitsweep.schema.numbers import Flag as Flag
from gaitsweep.schema.numbers import Positive as Positive
from gaitsweep.schema.numbers import Real as Real
from gaitsweep.schema.numbers import Text as Text
from gaitsweep.schema.numbers import Word as Word

def __getattr__(name: str) -> Any: ...  # kinds of figures of extensions
