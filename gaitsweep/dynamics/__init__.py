"""Mechanics and oscillators that models share."""
