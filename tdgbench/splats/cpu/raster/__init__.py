"""Rasterization kernels: culling, projection, tiles, blending, and their gradients."""
