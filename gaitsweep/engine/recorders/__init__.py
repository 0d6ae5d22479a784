"""Recorders: what is kept of a trajectory, and when it ends."""
