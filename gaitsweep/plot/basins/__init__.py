"""Figures of basins of attraction."""
