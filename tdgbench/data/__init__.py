"""Data sets on disk: get the published ones, check what is there, prepare a scene of camera files."""
