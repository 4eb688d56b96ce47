"""One method per file: its parts, losses and renders, readable beside the paper. Constants are in `conf/method/`."""
