"""One metric per file: its function, and its description `METRIC`. New files need no registration."""
