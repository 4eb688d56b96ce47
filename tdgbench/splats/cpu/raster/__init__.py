"""Splatting on the CPU: culling, projection, tile lists, blending, and their gradients."""
