"""Measures of basins of attraction."""
