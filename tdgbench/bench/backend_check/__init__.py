"""Whether a GPU's backend computes what the reference computes: compared once, remembered, and chosen if it does."""
