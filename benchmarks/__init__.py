"""How fast, in ratios from one interleaved run: `python -m benchmarks.core`, `python -m benchmarks.training`."""
