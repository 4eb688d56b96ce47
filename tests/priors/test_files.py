import numpy as np
import pytest
from PIL import Image

from tdgbench.priors import PriorError
from tdgbench.priors.files import FilePrior


def test_files(small_scene, tmp_path):
    view = small_scene.train[0]
    values = np.random.default_rng(0).random((36, 48)).astype(np.float32)
    np.save(tmp_path / f"{view.name}.npy", values)
    assert np.array_equal(FilePrior(str(tmp_path), "metric").estimate(small_scene, view).values, values)
    (tmp_path / f"{view.name}.npy").unlink()
    (tmp_path / small_scene.name).mkdir()
    counts = np.round(values * 65535).astype(np.uint16)
    counts[0, 0] = 0
    Image.fromarray(counts).save(tmp_path / small_scene.name / f"{view.name}.png")
    read = FilePrior(str(tmp_path), "disparity").estimate(small_scene, view)
    assert np.isnan(read.values[0, 0]) and np.allclose(read.values[1:], values[1:], atol=1e-4)
    with pytest.raises(PriorError, match=r"view view002 has no depth prior; expected .*view002\.npy"):
        FilePrior(str(tmp_path), "depth").estimate(small_scene, small_scene.train[1])
