"""The kernel engine: one scalar program traced from JAX, simplified, and compiled by LLVM or NVRTC.

`trace` translates JAX's programs by the rules of `primitives` (`arrays`, `control`, `indexing`, `arithmetic`,
`elementary`) to a `program`; `chunk` is the program of a trajectory. `cpu_program` and `gpu_program` write
its source, `llvm_code` and `cuda_device` compile it, and `lanes` and `cuda_lanes` run it.
"""
