"""COLMAP models for the fuzzing suite: strict readers, writers and checks that share no code with the loaders."""
