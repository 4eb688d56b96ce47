from dataclasses import replace

import numpy as np
import pytest

from tdgbench.experiments.priors.judge import judge
from tdgbench.experiments.priors.truth import halves, known_depth, source
from tests.helpers.configs import config


def without_truth(scene):
    return replace(scene, train=[replace(view, true_depth_path=None) for view in scene.train])


def test_true_depth_counts_before_points(small_scene):
    assert source(small_scene) == "true depth" and source(without_truth(small_scene)) == "SfM points"
    assert source(replace(without_truth(small_scene), points=None)) == ""
    view = small_scene.train[0]
    known = known_depth(view, np.zeros((0, 3)))
    assert len(known.z) == 36 * 48 and np.allclose(view.true_depth[known.rows, known.columns], known.z)


def test_points_show_the_true_depth(small_scene):
    given, truth = halves(small_scene)
    assert len(given.points.points) == len(truth) == 150
    both = np.concatenate([given.points.points, truth])
    assert {tuple(p) for p in both} == {tuple(p) for p in small_scene.points.points}
    assert given.fingerprint != small_scene.fingerprint  # so that their maps are cached apart
    view = small_scene.train[0]
    known = known_depth(replace(view, true_depth_path=None), truth)
    assert 20 <= len(known.z) <= 150
    error = np.abs(view.true_depth[known.rows, known.columns] - known.z) / known.z
    assert np.median(error) < 0.05


def test_pixels_that_were_not_measured_do_not_count(small_scene):
    view = small_scene.train[0]
    left = np.zeros((36, 48), bool)
    left[:, :24] = True
    known = known_depth(replace(view, load_valid=lambda: left), np.zeros((0, 3)))
    assert len(known.z) == 36 * 24 and known.columns.max() == 23
    assert known_depth(replace(view, load_valid=lambda: left & False), np.zeros((0, 3))) is None


def test_a_prior_from_points_is_judged_by_the_others(small_scene):
    scene, prior = without_truth(small_scene), config("prior=sfm_points").prior
    honest = judge(prior, scene, None)
    assert honest.kind == "disparity" and len(honest.views) == 8
    prior.made_from = "files"  # then it is given the points that it is judged by
    assert judge(prior, scene, None).mean.abs_rel < honest.mean.abs_rel
    against_truth = judge(config("prior=sfm_points").prior, small_scene, None)
    assert honest.mean.rank == pytest.approx(against_truth.mean.rank, abs=0.1)


def test_a_prior_that_cannot_be_had_says_why(small_scene):
    bare = replace(without_truth(small_scene), points=None)
    assert judge(config("prior=synthetic").prior, bare, None).reason.startswith(
        "view view001 of orbit has no true depth"
    )
    assert "has no sparse points" in judge(config("prior=sfm_points").prior, bare, None).reason
    assert judge(config("prior=onnx").prior, bare, None).reason == "prior=onnx is not available: it has no network"
