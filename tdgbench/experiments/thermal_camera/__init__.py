"""What errors of a thermal camera cost each method, and what correcting or refining the camera brings back."""
