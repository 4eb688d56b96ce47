"""`tdgbench compare A B`: two result folders side by side: scores, verdicts, and what differs behind them."""
