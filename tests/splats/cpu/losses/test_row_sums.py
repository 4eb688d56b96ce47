"""A sum must not depend on whether its kernel was compiled in this process or loaded from the machine-code cache."""

import os
import subprocess
import sys

import numpy as np
import pytest

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.losses.row_sums import difference_sum, row_sum
from tests.helpers.paths import ROOT

# Prints the bits of the sums of one photometric loss.
LOSS = """
import numpy as np
from tdgbench.splats.cpu.losses.photometric import photometric_and_gradient

rng = np.random.default_rng(0)
values = []
for channels in (1, 3):
    a, b = rng.random((2, 61, 83, channels)).astype(np.float32)
    values += photometric_and_gradient(a, b, 0.8, -0.2, 0.1, True)[:3]
print([value.hex() for value in values])
"""


@kernel()
def all_sums(a, b):
    return row_sum(a), difference_sum(a, b, None, None), difference_sum(a, b, a, b)


@pytest.mark.parametrize("count", [1, 7, 16, 33, 1920])
def test_sums_of_rows_of_any_length(count):
    a, b = np.random.default_rng(count).random((2, count)).astype(np.float32)
    expected = (
        a.sum(dtype=np.float64),
        np.abs(a - b).sum(dtype=np.float64),
        (a * b * np.abs(a - b)).sum(dtype=np.float64),
    )
    assert all_sums(a, b) == pytest.approx(expected, rel=1e-6)


def test_the_process_that_compiles_and_the_next_one_get_the_same_bits(tmp_path):
    env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(ROOT)}
    runs = [
        subprocess.run([sys.executable, "-c", LOSS], env=env, capture_output=True, text=True, check=True, timeout=300)
        for _ in range(2)
    ]
    assert runs[0].stdout.startswith("['0x") and runs[0].stdout == runs[1].stdout
