import numpy as np

from tdgbench.thermal.contrast import picture


def test_no_contrast_gives_a_picture():
    flat = np.full((36, 48), 21.0)
    flat[0, 0] = np.nan
    assert picture(flat).shape == (36, 48) and picture(flat).dtype == np.uint8
