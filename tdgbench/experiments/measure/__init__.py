"""Shared measuring tools: sets of Gaussians, the float64 oracle in tiles, interleaved timing."""
