"""`tdgbench score DIR OUT`: stored renders scored by another protocol or a new metric, without training."""
