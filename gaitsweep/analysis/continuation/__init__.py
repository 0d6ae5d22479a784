"""Fixed points of return maps: Newton, multipliers, continuation."""
