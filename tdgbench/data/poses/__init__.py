"""Compare a scene's poses with those of a reference: another scene or model, or a file of other photogrammetry."""
