"""Whether a GPU's backend computes what the reference computes: compared in each process, and chosen if it does."""
