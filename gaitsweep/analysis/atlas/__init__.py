"""Atlas of a map: its periodic orbits, their branches, and the bifurcations that join them."""
