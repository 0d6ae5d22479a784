"""The axes of a job: `vary` is read once into a `Design`, which gives the values of each row."""

from gaitsweep.design.design import Design, GridAxis

__all__ = ["Design", "GridAxis"]
