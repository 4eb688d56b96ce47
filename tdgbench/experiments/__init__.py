"""What tdgbench does with cells and kernels: sweeps, and the experiments that measure them."""
