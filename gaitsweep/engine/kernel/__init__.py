"""The kernel engine: one scalar program traced from JAX, simplified, and compiled by LLVM or NVRTC.

`trace` translates JAX's programs by the rules of `primitives` (`arrays`; `arithmetic` with minima, remainders
and whole powers; `elementary` with exponentials and trigonometry) to a `program` of `operations`, which
`simplify` shortens, with the ranges of `whole_numbers`; `chunk` is the program of a trajectory, with
`contraction` of its sums. `cpu_program` and `gpu_program` write its `source`, in an order that `registers`
chooses, with random numbers of `philox`; `llvm_code` and `cuda_device` compile it, and `lanes` and
`cuda_lanes` open and run rows. `row_kernel` and `row_functions` run functions of single rows,
`poincare_returns` returns to the section.
"""
