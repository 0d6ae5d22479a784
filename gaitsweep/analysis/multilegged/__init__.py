"""Theory of the multi-legged chain (Ambe, Aoi, Tsuchiya and Matsuno 2021, sections 3.1 to 3.7)."""
