"""Recorders: they select the records of a trajectory and end its row."""
