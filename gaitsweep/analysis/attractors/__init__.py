"""Attractors from settled states."""
