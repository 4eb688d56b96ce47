"""The training loop that every method shares: budget, losses, models, the method contract."""
