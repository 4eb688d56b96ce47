import numpy as np

from tdgbench.bench.colours import colored
from tdgbench.report.views import coverage, embedded
from tdgbench.scenes import Camera


def camera(x: float, width: int = 8, height: int = 6) -> Camera:
    pose = np.eye(4)
    pose[0, 3] = -x
    return Camera(np.array([[8.0, 0, width / 2], [0, 8.0, height / 2], [0, 0, 1]]), pose, width, height)


def test_coverage_counts_the_cameras_that_have_a_point_in_their_picture():
    depth = np.full((6, 8), 2.0)
    depth[0, 0] = np.nan
    # Half of what the first camera sees lies in the picture of one that stands 1 unit to the right.
    covered = coverage(depth, camera(0), [camera(0), camera(1), camera(100)])
    assert np.isnan(covered[0, 0])
    assert (covered[1:, 4:] == 2).all() and (covered[1:, :4] == 1).all()


def test_behind_a_camera_nothing_is_seen():
    back = camera(0)
    back.world_to_camera[2, 2] = back.world_to_camera[0, 0] = -1
    assert (coverage(np.full((6, 8), 2.0), camera(0), [back]) == 0).all()


def test_colours_span_the_range_and_gray_marks_what_is_not_known():
    pixels = colored(np.array([[0.0, 1.0, np.nan]]), "inferno", 0, 1)
    assert pixels[0, 0].sum() < 20 < pixels[0, 1].sum() and (pixels[0, 2] == 128).all()
    assert embedded(pixels).startswith("data:image/png;base64,")
