"""The kernel engine: one scalar program traced from JAX, simplified, and compiled by LLVM."""
