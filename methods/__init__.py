"""One method per file: its losses and its step, readable beside the paper. Constants are in `conf/method/`."""
