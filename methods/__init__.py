"""One method a file: its losses and its step, to be read beside the paper. `conf/method/` names their constants."""
