"""Atlas of a map: its periodic orbits, their branches, and the bifurcations that join them.

`atlas` is the whole computation, and `atlas_tables` its tables. `periodic_orbits` searches orbits, `branch`
has the points of their branches, also as text from which a later run continues. `plane_curves` follows
bifurcations in two parameters, `order_changes` changes in the order of events.
"""
