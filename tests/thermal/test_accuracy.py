from dataclasses import replace

import numpy as np
import pytest

from tdgbench.scenes.synthetic.truth import read_truth
from tdgbench.thermal.accuracy import errors_of, normalized_truth


def test_the_truth_itself_has_no_error(drifting_scene, drifting_camera):
    truth = read_truth(drifting_scene.folder)
    true = normalized_truth(truth, drifting_camera.views, drifting_camera.reference).response
    errors = errors_of(replace(drifting_camera, offsets=true.offsets, gains=true.gains), truth)
    assert np.abs(errors.offsets).max() == 0 and np.abs(errors.gains).max() == 0


def test_an_error_is_counted_where_it_is_made(drifting_scene, drifting_camera):
    truth = read_truth(drifting_scene.folder)
    before = errors_of(drifting_camera, truth)
    offsets = drifting_camera.offsets.copy()
    offsets[2] += 1
    after = errors_of(replace(drifting_camera, offsets=offsets), truth)
    assert after.offsets - before.offsets == pytest.approx([float(i == 2) for i in range(12)])
    assert np.array_equal(after.vignette, before.vignette)
