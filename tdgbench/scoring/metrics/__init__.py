"""One metric per file: its function, and its description `METRIC`. A new file is found by itself."""
