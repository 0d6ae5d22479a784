"""Bodies of an MJCF in the kernels: located contacts and joint limits, every number a parameter.

`body_model` is the class of their models, `mechanics` their accelerations and stops, `body_parameters` the
numbers of the MJCF by name, `coverage` what they have of an MJCF and refuse, `standing` their rest on the
ground.
"""
