"""Geometry of thermal captures: `python -m benchmarks.captures` makes scenes with it."""
