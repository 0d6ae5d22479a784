"""Henon's map, which stretches the plane, folds it and maps it into itself.

Source: Henon 1976, Commun. Math. Phys. 50:69.
"""

from gaitsweep import MapModel, parameter, variable


class Henon(MapModel):
    """The map, without units."""

    source = "Henon 1976, Commun. Math. Phys. 50:69"

    a = parameter("1", "folding", 1.4)
    b = parameter("1", "contraction of areas", 0.3)

    x = variable("1", "coordinate along the fold", 0.1)
    y = variable("1", "coordinate across the fold", 0.1)

    def image(self, p, s):
        return {"x": 1.0 - p.a * s.x**2 + s.y, "y": p.b * s.x}
