"""The same functions as one scalar program: traced from JAX, folded, printed as Python, compiled by Numba."""
