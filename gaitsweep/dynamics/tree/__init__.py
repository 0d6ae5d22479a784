"""Articulated trees: kinematics, dynamics and energy of bodies joined by hinges and slides."""
