"""Axes and rows of a job: `vary` is read once into a `Design`, which computes the values of each row.

`vary` has the grammar, `axes` the forms of an axis and their points, `design` the rows.
"""

from gaitsweep.design.design import Design, GridAxis

__all__ = ["Design", "GridAxis"]
