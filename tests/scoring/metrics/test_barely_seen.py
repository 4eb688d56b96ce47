import numpy as np
import pytest

from tdgbench.scoring import METRICS, RenderedImages
from tdgbench.scoring.scored_view import Convention, NotApplicableError, ScoredView


def score_of(view, determinacy) -> float:
    rendered = RenderedImages(view.thermal, None, determinacy=determinacy)
    return METRICS["barely_seen"].score(ScoredView(view, rendered, Convention("zero", lambda image, target: 0.0)))


def test_pixels_below_the_limit_are_counted(small_gray_scene):
    view = small_gray_scene.test[0]
    known = np.full(view.thermal.shape[:2], 0.8, np.float32)
    known[:, : view.camera.width // 4] = 0.1
    assert score_of(view, known) == pytest.approx(0.25)


def test_images_alone_do_not_tell(small_gray_scene):
    with pytest.raises(NotApplicableError, match="the renders are not of Gaussians"):
        score_of(small_gray_scene.test[0], None)
