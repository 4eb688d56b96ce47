"""Evidence for growth that the package does not use: `python -m benchmarks.growth` measures it."""
