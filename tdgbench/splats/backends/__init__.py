"""Rasterization backends: one module each."""
