"""Cells: what to run, what is already there, what failed, on which machine."""
