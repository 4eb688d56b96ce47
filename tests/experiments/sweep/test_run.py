"""What a sweep holds in memory while it trains."""

from __future__ import annotations

import subprocess
import sys

CODE = """
import sys
import methods.msmg, methods.tdg, tdgbench.bench.run_cell, tdgbench.experiments.sweep.run
print([name for name in ("matplotlib", "pandas", "scipy.stats") if name in sys.modules])
"""


def test_no_library_of_the_tables_is_there_before_they_are_made():
    found = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert found.stdout == "[]\n"
