"""Modules that a test wrote and had imported."""

import sys
from contextlib import contextmanager
from pathlib import Path


def forget_modules(folder):
    """Remove the modules of a folder from Python's, and these alone.

    With numba's own modules imported a second time, machine code of before could not be read.
    """
    for name, module in list(sys.modules.items()):
        if Path(getattr(module, "__file__", None) or "").is_relative_to(folder):
            parent, _, child = name.rpartition(".")
            if parent in sys.modules and hasattr(sys.modules[parent], child):
                delattr(sys.modules[parent], child)
            del sys.modules[name]


@contextmanager
def forgotten(folder):
    """Forget what is imported from a folder when the block ends."""
    try:
        yield
    finally:
        forget_modules(folder)
