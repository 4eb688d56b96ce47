import numpy as np

from tdgbench.splats.cpu.rows import permute_rows


def test_is_fancy_indexing():
    rng = np.random.default_rng(0)
    for count in (0, 1, 2, 57):
        matrix, order = rng.normal(size=(count + 3, 16)).astype(np.float32), rng.permutation(count)
        want = np.concatenate([matrix[:count][order], matrix[count:]])
        permute_rows(matrix, order)
        assert np.array_equal(matrix, want)
