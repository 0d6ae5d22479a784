"""Basins of attraction in numbers."""
