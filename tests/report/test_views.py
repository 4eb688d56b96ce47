import numpy as np

from tdgbench.bench.colours import colored
from tdgbench.report.views import embedded


def test_colours_span_the_range_and_gray_marks_what_is_not_known():
    pixels = colored(np.array([[0.0, 1.0, np.nan]]), "inferno", 0, 1)
    assert pixels[0, 0].sum() < 20 < pixels[0, 1].sum() and (pixels[0, 2] == 128).all()
    assert embedded(pixels).startswith("data:image/png;base64,")
