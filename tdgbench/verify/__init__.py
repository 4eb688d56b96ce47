"""`tdgbench verify results/<experiment> ...`: check results against their records.

Every record must fit its schema, and lie in its cell's folder. For a finished cell, every file must have the recorded
hash, the model must give the stored renders from the test cameras, and the stored files must give the recorded numbers.
A check that cannot be made is a problem as well, and ends no other check.
"""

from tdgbench.verify.cell import verify_cell
from tdgbench.verify.experiment import main, verify

__all__ = ["main", "verify", "verify_cell"]
