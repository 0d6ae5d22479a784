"""Attractors, their basins, and the edge states between basins."""
