"""Poincare maps: a state from one crossing of the section to the next, with its derivative."""
