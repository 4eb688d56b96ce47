"""Kernels of the `warp` backend, a file per stage: one source for CUDA and for the CPU device of NVIDIA Warp."""
