"""What several benchmarks share: clouds of Gaussians with their exact render, and timing in turns."""
