"""Bodies on MuJoCo's MJX."""
