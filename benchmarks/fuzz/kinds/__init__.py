"""The kinds of inputs: one or more classes per file, found by the folder."""
