"""The `cpu` backend: Numba kernels, their compilation and cache, the thread pool and reused memory."""
