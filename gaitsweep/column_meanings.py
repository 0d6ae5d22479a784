"""Names, units and meanings of the columns that run kinds add to those of a model."""

from __future__ import annotations

import re

# The unit ("" of texts) and the meaning by name. Parameters and observables have other names.
COLUMNS = {
    "row": ("1", "number of the row"),
    "status": ("", "how the row ended"),
    "stalled_by": ("", "events that followed each other without end"),
    "gait": ("", "gait, by the model's label"),
    "outcome": ("", "gait of a settled row, or why it has none"),
    "slowest": (
        "",
        "observable that moved most over the last 10 crossings of a row that did not settle; on a stair, "
        "and on an orbit of more than 5 crossings, it may be one that repeats",
    ),
    "cycles": ("1", "section crossings of the row"),
    "crossing": ("1", "number of the section crossing"),
    "t": ("s", "time"),
    "t_end": ("s", "time at the end of the row"),
    "attractor_period": ("1", "section crossings after which a settled row repeats"),
    "recovery": ("", "whether the row is back at its gait after the push, or why not"),
    "gait_before": ("", "gait before the push, by the model's label"),
    "t_push": ("s", "time of the push"),
    "cycles_back": ("1", "section crossings after the push until the row is back at its gait"),
    "time_back": ("s", "time after the push until the row is back at its gait"),
    "excursion": ("1", "largest distance from the gait at a crossing after the push, relative to its size"),
    "phase_shift": ("1", "share of the gait's period by which the row is ahead for good"),
    "pass": ("1", "number of the pass along the parameter's path"),
    "stair": ("1", "number of the stair"),
    "settled": ("1", "whether the gait had settled at the end of the stair; status is that of the whole row"),
    "part": ("", "branch, or kind of the bifurcations along the curve"),
    "number": ("1", "number of the branch or curve in its row"),
    "branch": ("1", "number of the branch in its row"),
    "point": ("1", "number of the point on its branch or curve"),
    "period": ("1", "section crossings after which the gait repeats"),
    "depth": ("1", "bifurcations between the branch and a gait of the search"),
    "begins": ("1", "branch at whose bifurcation this one begins; -1: none"),
    "time": ("s", "time in which the gait repeats"),
    "multiplier": ("1", "largest modulus of the multipliers"),
    "multiplier_re": ("1", "real part of the largest multiplier; on a curve, of the critical one"),
    "multiplier_im": ("1", "imaginary part of the largest multiplier; on a curve, of the critical one"),
    "eigenvalue_re": ("1/s", "largest real part of the eigenvalues; on a curve, that of the critical one"),
    "eigenvalue_im": ("1/s", "imaginary part of this eigenvalue"),
    "hopf_frequency": ("rad/s", "angular frequency of the cycle that begins at the Hopf point"),
    "hopf_period": ("s", "period of the cycle that begins at the Hopf point"),
    "unstable": ("1", "multipliers outside the unit circle, or eigenvalues with a positive real part"),
    "stable": ("1", "whether none is unstable"),
    "special": ("", "bifurcation, or kink of the map, at this point"),
    "coefficient": (
        "1",
        "coefficient of the normal form, coordinates X in units of 0.1 + abs(X), angles in rad",
    ),
    "found": ("1", "searches that found the gait; 0: its branch alone leads there; -1: not searched here"),
    "symmetry": ("", "symmetries that the gait has itself"),
    "reached": ("1", "share of the simulated starts that settled to the gait"),
    "error": ("1", "estimated error of the gait, relative to the sizes of coordinates"),
    "missing": ("1", "gaits that the search did not find, at least, by an estimate"),
    "events": ("", "events of a cycle of the gait, in their order"),
    "change": ("", "change of the order of events at this point"),
    "left_out": ("1", "branches of the row beyond the largest number"),
    "drawn_starts": ("1", "starts of the search that were drawn for the row"),
    "stored_point": ("", "point of the section, with its discrete modes"),
    "corrections": ("1", "corrections by Newton's method"),
    "end": ("", "why the branch or curve ends here"),
}


def time_column(event: str) -> str:
    """The column of an atlas with the times of an event.

    Example:
        >>> from gaitsweep.column_meanings import time_column
        >>> time_column("left foot lands")
        't_left_foot_lands'
    """
    return "t_" + re.sub(r"\W+", "_", event).strip("_")
