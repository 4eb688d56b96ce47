"""What errors of a thermal camera cost each method, and what correcting for it brings back."""
