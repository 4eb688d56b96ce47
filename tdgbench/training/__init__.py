"""Training, shared by all methods: contract of a method, budget, losses, models, loop, checkpoints."""
