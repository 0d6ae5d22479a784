"""What varies: a job's `vary`, read once into a `Design`, and the values of each row from its number."""

from gaitsweep.design.design import Design, GridAxis

__all__ = ["Design", "GridAxis"]
