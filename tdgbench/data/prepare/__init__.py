"""Prepare a scene of camera files: temperatures, COLMAP model, undistorted images of both modalities."""
