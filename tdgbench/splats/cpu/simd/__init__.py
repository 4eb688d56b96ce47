"""A small SIMD library for Numba: registers, memory, reductions, powers of two."""
