"""The analytic solutions of the multi-legged chain."""
