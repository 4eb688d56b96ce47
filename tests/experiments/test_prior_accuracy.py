from dataclasses import replace

import numpy as np
import pytest

from tdgbench.experiments.prior_accuracy import accuracy, aligned, measure_prior, source, split_points
from tdgbench.priors.known_depth import known_depth
from tests.helpers.configs import config

RNG = np.random.default_rng(0)
Z = RNG.uniform(1, 5, 400)


@pytest.mark.parametrize(
    ("kind", "values"), [("depth", 3 * Z - 7), ("disparity", 0.2 / Z + 5), ("metric", 40 * Z)], ids=str
)
def test_a_prior_that_is_right_up_to_what_its_kind_leaves_open(kind, values):
    found = accuracy(values.astype(np.float32), kind, Z)
    assert found.abs_rel < 1e-4 and found.delta == 1 and found.rank == pytest.approx(1, abs=1e-4)


def test_a_wrong_kind_is_not_right():
    assert accuracy(1 / Z, "depth", Z).abs_rel > 0.1 and accuracy(1 / Z, "depth", Z).rank == pytest.approx(-1)
    assert accuracy(Z + 3, "metric", Z).abs_rel > 0.1  # a metric depth has no shift


def test_numbers_by_hand():
    """z = 1, 2, 4; the prior has 1, 2, 3: with its median, that is 0, 0 and a quarter off; 4 / 3 is above 1.25."""
    found = accuracy(np.array([1.0, 2.0, 3.0]), "metric", np.array([1.0, 2.0, 4.0]))
    assert found.abs_rel == pytest.approx(0.25 / 3) and found.delta == pytest.approx(2 / 3) and found.rank == 1


def test_the_alignment_is_the_least_squares_fit():
    values = 1 / Z + RNG.normal(0, 0.02, len(Z))
    slope, shift = np.polyfit(values, 1 / Z, 1)
    assert np.allclose(aligned(values, "disparity", Z), np.clip(1 / (slope * values + shift), Z.min(), Z.max()))


def test_a_flat_map_has_no_rank_and_a_useless_one_stays_in_range():
    assert np.isnan(accuracy(np.ones(400), "depth", Z).rank)
    useless = accuracy(RNG.normal(size=400), "disparity", Z)
    assert abs(useless.rank) < 0.2 and 0.2 < useless.abs_rel < 1.0


def without_truth(scene):
    return replace(scene, train=[replace(view, load_true_depth=None) for view in scene.train])


def test_true_depth_counts_before_points(small_scene):
    assert source(small_scene) == "true depth" and source(without_truth(small_scene)) == "SfM points"
    assert source(replace(without_truth(small_scene), points=None)) == ""
    view = small_scene.train[0]
    known = known_depth(view, np.zeros((0, 3)))
    assert len(known.z) == 36 * 48 and np.allclose(view.true_depth[known.rows, known.columns], known.z)


def test_points_show_the_true_depth(small_scene):
    given, truth = split_points(small_scene)
    assert len(given.points.points) == len(truth) == 150
    both = np.concatenate([given.points.points, truth])
    assert {tuple(p) for p in both} == {tuple(p) for p in small_scene.points.points}
    assert given.fingerprint != small_scene.fingerprint  # so that their maps are cached apart
    view = small_scene.train[0]
    known = known_depth(replace(view, load_true_depth=None), truth)
    assert 20 <= len(known.z) <= 150
    error = np.abs(view.true_depth[known.rows, known.columns] - known.z) / known.z
    assert np.median(error) < 0.05


def test_pixels_that_were_not_measured_do_not_count(small_scene):
    view = small_scene.train[0]
    left = np.zeros((36, 48), bool)
    left[:, :24] = True
    known = known_depth(replace(view, load_valid=lambda: left), np.zeros((0, 3)))
    assert len(known.z) == 36 * 24 and known.columns.max() == 23
    assert not len(known_depth(replace(view, load_valid=lambda: left & False), np.zeros((0, 3))).z)


def test_a_prior_from_points_is_judged_by_the_others(small_scene):
    scene, prior = without_truth(small_scene), config("prior=sfm_points").prior
    honest = measure_prior(prior, scene, None)
    assert honest.kind == "disparity" and len(honest.views) == 8
    prior.made_from = "files"  # then it is given the points that it is judged by
    assert measure_prior(prior, scene, None).mean.abs_rel < honest.mean.abs_rel
    against_truth = measure_prior(config("prior=sfm_points").prior, small_scene, None)
    assert honest.mean.rank == pytest.approx(against_truth.mean.rank, abs=0.1)


def test_a_prior_that_is_not_available_says_why(small_scene):
    bare = replace(without_truth(small_scene), points=None)
    assert measure_prior(config("prior=synthetic").prior, bare, None).reason.startswith(
        "view view001 of orbit has no true depth"
    )
    assert "has no sparse points" in measure_prior(config("prior=sfm_points").prior, bare, None).reason
    assert (
        measure_prior(config("prior=onnx").prior, bare, None).reason == "prior=onnx is not available: it has no network"
    )
