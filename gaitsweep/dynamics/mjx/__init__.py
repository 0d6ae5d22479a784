"""Rigid bodies simulated by MuJoCo's MJX."""
