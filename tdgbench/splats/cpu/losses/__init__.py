"""Fused image losses with their gradients: L1 + SSIM, smoothness, min-max."""
