"""`python -m benchmarks.strangers`."""

import sys

from benchmarks.strangers.sweep import main

if __name__ == "__main__":  # not in the pool's processes
    sys.exit(main())
