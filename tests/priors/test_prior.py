import numpy as np
import pytest

from tdgbench.priors import DepthPrior, PriorError
from tests.helpers.configs import config


def test_invalid_priors_are_refused(small_scene):
    view = small_scene.train[0]
    with pytest.raises(PriorError, match="is \\(3, 4\\), its image \\(36, 48\\)"):
        DepthPrior(np.zeros((3, 4), np.float32), "depth").check(view)
    with pytest.raises(PriorError, match="no finite value"):
        DepthPrior(np.full((36, 48), np.nan, np.float32), "depth").check(view)
    with pytest.raises(PriorError, match="kind 'height'"):
        DepthPrior(np.zeros((36, 48), np.float32), "height").check(view)


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ((), "synthetic"), (("dataset=folder",), "marigold"), (("dataset=paper",), "marigold"),
        (("dataset=synthetic", "prior=marigold"), "marigold"), (("dataset=folder", "prior=sfm_points"), "sfm_points"),
        (("+experiment=table1",), "marigold"), (("+experiment=table2",), "marigold"),
        (("+experiment=readings",), "marigold"), (("+experiment=readings", "dataset=synthetic"), "synthetic"),
        (("+experiment=demo",), "synthetic"), (("+experiment=error_time",), "synthetic"),
        (("+experiment=skips",), "synthetic"), (("+experiment=skips", "dataset=folder"), "marigold"),
        (("+experiment=stress",), "synthetic"), (("+experiment=demo", "prior=files"), "files"),
    ],
)  # fmt: skip
def test_the_default_prior_is_the_paper_s_for_real_scenes_and_needs_no_network_for_built_in_ones(words, name):
    assert config(*words).prior.name == name


@pytest.mark.parametrize(
    ("name", "source"),
    [("marigold", "thermal images"), ("depth_anything", "thermal images"), ("onnx", "thermal images"),
     ("sfm_points", "points"), ("files", "files"), ("synthetic", "truth")],
)  # fmt: skip
def test_a_prior_says_what_it_is_made_from(name, source):
    assert config(f"prior={name}").prior.made_from == source
