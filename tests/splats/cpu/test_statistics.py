import numpy as np

from tdgbench.splats.cpu.statistics import StatisticsArrays, add_lengths, count_visible


def test_only_visible_gaussians_count():
    times, largest = np.zeros(6, np.float32), np.array([0, 0, 9, 0, 0, 0], np.float32)
    index, radii = np.array([5, 1, 2, 3], np.int32), np.array([4, 0, 7, 8], np.int32)
    count_visible(0, 3, index, radii, times, largest)
    assert times.tolist() == [0, 0, 1, 0, 0, 1] and largest.tolist() == [0, 0, 9, 0, 0, 4]


def test_gradients_are_in_units_of_half_the_image():
    total = np.zeros(4, np.float32)
    image = np.array([[0.3, 0.2, 5], [1, 1, 0], [0, -1, 2]], np.float32)
    add_lengths(0, 3, np.array([2, 1, 0], np.int32), image, StatisticsArrays(total, 10.0, 20.0, True))
    assert np.allclose(total, [20, 0, 5, 0])
