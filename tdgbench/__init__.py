"""tdgbench: benchmark and reproduction harness for thermal Gaussian splatting."""
