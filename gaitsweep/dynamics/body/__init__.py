"""Bodies of an MJCF in the kernels: located contacts and joint limits, every number a parameter.

`body_model` is the class of their models and finds their rest on the ground, `mechanics` has their
accelerations, stops and contacts (points, sides and edges of geoms, on the ground and on boxes),
`body_parameters` the numbers of the MJCF by name, `coverage` what they have of an MJCF and refuse, `surfaces`
the ground below them.
"""
