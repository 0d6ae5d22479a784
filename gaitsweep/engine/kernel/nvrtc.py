"""Compiles CUDA C for an NVIDIA GPU by NVRTC; the machine code is kept in the cache of kernels."""

from __future__ import annotations

from gaitsweep.engine.kernel.cache import binary_of


def compiled(source: str, architecture: str, *, contraction: bool = True) -> bytes:
    """The machine code (a cubin) of a source.

    Args:
        source: CUDA C without headers, whose kernels are `extern "C"`.
        architecture: of the card, such as sm_90.
        contraction: whether a product and a sum may become one instruction, which rounds once.
    """
    from cuda.bindings import nvrtc  # pyright: ignore[reportMissingImports]
    from cuda.core import Program, ProgramOptions  # pyright: ignore[reportMissingImports]

    def compile_() -> bytes:
        options = ProgramOptions(arch=architecture, fma=contraction, std="c++17")
        return bytes(Program(source, "c++", options).compile("cubin").code)

    _, major, minor = nvrtc.nvrtcVersion()
    key = (source, f"NVRTC {major}.{minor}", architecture, f"contraction {contraction}")
    return binary_of("cubin", key, compile_)
