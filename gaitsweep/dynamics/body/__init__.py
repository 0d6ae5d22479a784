"""Bodies of an MJCF in the kernels: located contacts and joint limits, every number a parameter."""
