import numpy as np
import pytest

from tdgbench.splats.cpu.losses.photometric import photometric_and_gradient, prepare_target


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("masked", [False, True])
def test_a_prepared_image_gives_the_same_bytes(channels, masked):
    rng = np.random.default_rng(3)
    a, b = (rng.random((37, 41, channels)).astype(np.float32) for _ in range(2))
    valid = rng.random((37, 41)) > 0.2 if masked else None
    prepared = prepare_target(b, valid)
    for _ in range(2):
        once = photometric_and_gradient(a, b, 0.8, -0.2, 0.01, valid=valid)
        again = photometric_and_gradient(a, prepared, 0.8, -0.2, 0.01)
        assert once[:3] == again[:3] and once[3].tobytes() == again[3].tobytes()
