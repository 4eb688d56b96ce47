"""Edges are OpenCV's, pixel by pixel."""

import numpy as np
import pytest

from methods.canny import canny
from tests.parity.originals import original


@pytest.mark.parametrize("name", ["smooth", "noise", "steps", "white", "colour", "thin", "column"])
def test_edges_are_those_of_opencv(name):
    data = original("canny")
    for low, high in ((50, 150), (100, 200)):
        edges = data[f"{name}_{low}_{high}"]
        assert edges.any() and np.array_equal(canny(data[name], low, high), edges)


def test_only_8_bit_images_have_edges():
    with pytest.raises(ValueError, match="uint8"):
        canny(np.zeros((3, 3)), 50, 150)
