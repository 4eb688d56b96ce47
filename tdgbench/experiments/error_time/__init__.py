"""Run time against error: of kernels, of training, and how cost grows."""
