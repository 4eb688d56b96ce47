"""Fuzzing: mutated inputs, each in a child with limits, judged by oracles that share no code with the loaders."""
