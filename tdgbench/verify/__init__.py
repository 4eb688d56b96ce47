"""`tdgbench verify results/<experiment> ...`: check results against their records."""

from tdgbench.verify.cell import verify_cell
from tdgbench.verify.experiment import main, verify

__all__ = ["main", "verify", "verify_cell"]
