import copy
from dataclasses import replace

import numpy as np
import pytest

from tdgbench.scoring.scored_view import Convention, NotApplicableError, RenderedImages, ScoredView, as_saved

CONVENTION = Convention("zero", lambda image, target: 0.0)


def shown(scene, view, **fields):
    images = RenderedImages(view.thermal, view.true_depth, {"rgb": view.rgb})
    return ScoredView(view, replace(images, **fields), CONVENTION, scene, {view.name: images})


def test_pairs_are_what_files_hold(small_scene):
    view = small_scene.test[0]
    pair = shown(small_scene, view, image=view.thermal + 0.3).pair("thermal")
    assert np.array_equal(pair.image, as_saved(view.thermal + 0.3)) and pair.image.max() == 1.0
    assert np.array_equal(shown(small_scene, view).pair("rgb").target, as_saved(view.rgb))


def test_reasons_why_there_is_nothing_to_compare(small_scene):
    view = small_scene.test[0]
    with pytest.raises(NotApplicableError, match="trains no RGB model"):
        shown(small_scene, view, others={}).pair("rgb")
    with pytest.raises(NotApplicableError, match="another size"):
        shown(small_scene, view, depth=np.ones((2, 2))).depths()
    with pytest.raises(NotApplicableError, match="one test view"):
        ScoredView(view, shown(small_scene, view).rendered, CONVENTION).nearest_test_view()


def test_the_nearest_camera(small_scene):
    scene = copy.copy(small_scene)
    scene.test = small_scene.views
    nearest = []
    for view in scene.test:
        others = [other for other in scene.test if other is not view]
        distances = [np.linalg.norm(other.camera.center - view.camera.center) for other in others]
        nearest.append(int(np.argmin(distances)))
        assert shown(scene, view).nearest_test_view().name == others[nearest[-1]].name
    assert {0} < {*nearest}  # not always the first of the others
