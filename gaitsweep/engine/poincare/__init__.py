"""Poincare maps: returns to the section, with their derivatives."""
