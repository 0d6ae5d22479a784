"""Hysteresis, return maps and transitions between gaits."""
