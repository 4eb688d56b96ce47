"""What several benchmarks share: clouds of Gaussians, and timing in turns."""
