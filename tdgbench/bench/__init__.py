"""Cells: keys, locks, runs, files, records and failures."""
