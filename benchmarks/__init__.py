"""Speed, accuracy and robustness of the code itself, outside the wheel: `python -m benchmarks.core` and others."""
