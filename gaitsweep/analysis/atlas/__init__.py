"""Atlas of a map: its periodic orbits, their branches along a parameter, and the bifurcations that join them."""
