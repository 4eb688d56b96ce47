"""`tdgbench score DIR OUT`: stored renders scored by another protocol or a new metric, without training."""

from tdgbench.rescore.command import main

__all__ = ["main"]
