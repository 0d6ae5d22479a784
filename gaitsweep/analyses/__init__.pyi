from gaitsweep.analysis.basins.attractors import agreement as agreement
from gaitsweep.analysis.basins.attractors import attractors as attractors
from gaitsweep.analysis.basins.basin_boundaries import wada as wada
from gaitsweep.analysis.basins.fractions import LEVEL as LEVEL
from gaitsweep.analysis.basins.fractions import fractions as fractions
from gaitsweep.analysis.basins.fractions import proportion_interval as proportion_interval
from gaitsweep.analysis.basins.measures import basins as basins
from gaitsweep.analysis.basins.measures import least_fatal_push as least_fatal_push
from gaitsweep.analysis.continuation.stable_ranges import stable_ranges as stable_ranges
from gaitsweep.analysis.falls import steps_to_fall as steps_to_fall
from gaitsweep.analysis.falls import survival as survival
from gaitsweep.analysis.rare_falls import RareFalls as RareFalls
from gaitsweep.analysis.records import AnalysisError as AnalysisError
from gaitsweep.analysis.records import axes_of as axes_of
from gaitsweep.analysis.records import in_order as in_order
from gaitsweep.analysis.records import require as require
from gaitsweep.analysis.records import require_single_records as require_single_records
from gaitsweep.analysis.transitions.hysteresis import Hysteresis as Hysteresis
from gaitsweep.analysis.transitions.hysteresis import hysteresis as hysteresis
from gaitsweep.analysis.transitions.hysteresis import transition_points as transition_points
from gaitsweep.analysis.transitions.hysteresis import (
    transition_points_by_gait as transition_points_by_gait,
)
from gaitsweep.analysis.transitions.jumps import LEAST_JUMP as LEAST_JUMP
from gaitsweep.analysis.transitions.return_map import fixed_points as fixed_points
from gaitsweep.angles import TURN as TURN
from gaitsweep.angles import is_circular as is_circular
from gaitsweep.angles import mean_direction as mean_direction
from gaitsweep.angles import unwrap_from as unwrap_from
from gaitsweep.angles import wrapped_difference as wrapped_difference
from gaitsweep.dynamics.gaits_by_footfalls import gait_of_footfalls as gait_of_footfalls
from gaitsweep.dynamics.gaits_by_footfalls import support_patterns as support_patterns
from gaitsweep.engine.kernel.row_functions import stored_function as stored_function
from gaitsweep.fitting.targets import Conflicts as Conflicts
from gaitsweep.fitting.targets import conflicts as conflicts
