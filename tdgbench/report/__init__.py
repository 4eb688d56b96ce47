"""What a person looks at: pictures, and the end of a run."""
