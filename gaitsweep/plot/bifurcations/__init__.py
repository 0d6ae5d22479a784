"""Figures of return maps, hysteresis and branches of fixed points."""
