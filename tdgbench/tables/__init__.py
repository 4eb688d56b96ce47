"""Aggregate records, compare them with the published numbers, write LaTeX and CSV."""
