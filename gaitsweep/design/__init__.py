"""Axes and rows of a job: `vary` is read once into a `Design`, which computes the values of each row.

`vary` has the grammar, `axes` the forms of an axis and the points of grids, `samples` draws random, Latin
hypercube and Sobol points from a seed, `design` has the rows.
"""

from gaitsweep.design.design import Design, GridAxis

__all__ = ["Design", "GridAxis"]
