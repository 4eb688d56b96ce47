"""What each skip saves, and what it does to the scores."""
