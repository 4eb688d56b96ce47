"""Experiments: each plans, runs, measures, tabulates and draws, in one file or folder with one YAML file."""
