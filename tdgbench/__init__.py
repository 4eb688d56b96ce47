"""tdgbench: benchmark and reproduction harness for thermal Gaussian splatting."""

__version__ = "0.8.0"
