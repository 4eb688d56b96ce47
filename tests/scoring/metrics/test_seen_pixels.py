import numpy as np
import pytest
from scipy.stats import rankdata

from tdgbench.scoring import METRICS, RenderedImages
from tdgbench.scoring.metrics.seen_pixels import guess_correlation
from tdgbench.scoring.scored_view import Convention, NotApplicableError, ScoredView

BAD, GOOD = 0.1, 0.02  # errors


def scores(scene, determinacy) -> dict[str, list[float]]:
    """Scores by metric, of each test view; the left `determinacy` columns are guessed, with errors of BAD."""
    renders = {}
    for view in scene.test:
        guessed = np.zeros(view.thermal.shape[:2], bool)
        guessed[:, :determinacy] = True
        error = np.where(guessed, BAD, GOOD)[..., None] * np.where(view.thermal > 0.5, -1, 1)
        image = (view.thermal + error).astype(np.float32)
        renders[view.name] = RenderedImages(image, None, determinacy=np.where(guessed, 0.1, 0.8).astype(np.float32))
    convention, common = Convention("zero", lambda image, target: 0.0), {}
    shown = [ScoredView(view, renders[view.name], convention, scene, renders, common) for view in scene.test]
    names = ("barely_seen", "psnr_well_seen", "psnr_barely_seen", "guess_correlation")
    return {name: [METRICS[name].score(one) for one in shown] for name in names}


def test_pixels_are_split_by_determinacy_over_all_test_views(small_gray_scene):
    width = small_gray_scene.test[0].camera.width
    found = scores(small_gray_scene, width // 4)
    assert found["barely_seen"] == pytest.approx([0.25] * len(small_gray_scene.test))
    assert found["psnr_barely_seen"] == pytest.approx([20.0] * len(small_gray_scene.test), abs=0.3)  # of 8-bit pictures
    assert found["psnr_well_seen"] == pytest.approx([34.0] * len(small_gray_scene.test), abs=0.3)
    assert min(found["guess_correlation"]) > 0.6


def test_without_barely_seen_pixels_there_is_no_score_of_them(small_gray_scene):
    with pytest.raises(NotApplicableError, match="no pixel of the test views is barely seen"):
        scores(small_gray_scene, 0)


def test_images_alone_do_not_tell(small_gray_scene):
    view = small_gray_scene.test[0]
    shown = ScoredView(view, RenderedImages(view.thermal, None), Convention("zero", lambda a, b: 0.0))
    with pytest.raises(NotApplicableError, match="the renders are not of Gaussians"):
        METRICS["barely_seen"].score(shown)


def test_correlation_is_that_of_ranks():
    rng = np.random.default_rng(0)
    determinacy = rng.random(500).round(1)
    error = (1 - determinacy) ** 3 + rng.normal(0, 0.2, 500)
    expected = np.corrcoef(rankdata(1 - determinacy), rankdata(error))[0, 1]
    assert guess_correlation(determinacy, error) == pytest.approx(expected)
    with pytest.raises(NotApplicableError, match="equally well"):
        guess_correlation(np.ones(5), error[:5])
