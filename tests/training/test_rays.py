"""Batches of rays: their pixels, their cameras, and what a checkpoint keeps of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tdgbench.training.curriculum import Curriculum, Resolution
from tdgbench.training.rays import RayBatches
from tests.helpers.training import ready_to_train

CPU = torch.device("cpu")
BOTH = ("thermal", "rgb")


def batches(views, curriculum: Curriculum | None = None, modalities=BOTH, seed: int = 0) -> RayBatches:
    return RayBatches(views, seed, curriculum or Curriculum(), modalities, CPU)


def place_of(batch, views) -> np.ndarray:
    """Return the pixels (R, 2) that rays go through in their views, x and y."""
    found = []
    for ray in range(len(batch.views)):
        camera = views[batch.views[ray]].camera
        direction = camera.world_to_camera[:3, :3] @ batch.rays.directions[ray].double().numpy()
        image = camera.K @ direction
        found.append(image[:2] / image[2])
    return np.array(found)


def test_rays_go_through_the_pixels_whose_values_they_bring(small_scene):
    views = small_scene.train
    batch = batches(views).next(200)
    at = np.floor(place_of(batch, views) + 1e-3).astype(int)
    assert len({*batch.views.tolist()}) > 3
    for ray, (x, y) in enumerate(at):
        view = views[batch.views[ray]]
        assert np.allclose(batch.rays.origins[ray], view.camera.center, atol=1e-4)
        assert np.array_equal(batch.pixels["thermal"][ray], view.thermal[y, x])
        assert np.array_equal(batch.pixels["rgb"][ray], view.rgb[y, x])


def test_further_maps_come_with_their_pixels_at_the_resolution_of_the_iteration(small_gray_scene):
    views = small_gray_scene.train
    maps = {"twice": lambda view: torch.from_numpy(2 * view.thermal)}
    curriculum = Curriculum([Resolution(5, 4)])
    drawn = RayBatches(views, 0, curriculum, ("thermal",), CPU, maps)
    for iteration in (1, 6):
        curriculum.begin(iteration)
        pixels = drawn.next(100).pixels
        assert torch.equal(pixels["twice"], 2 * pixels["thermal"]) and pixels["twice"].any()


def test_every_pixel_is_drawn_as_often(small_gray_scene):
    views = small_gray_scene.train[:2]
    pixels = views[0].camera.width * views[0].camera.height
    batch = batches(views, modalities=("thermal",)).next(40 * pixels)
    counts = np.bincount(batch.views.numpy())
    assert abs(counts[0] / counts[1] - 1) < 0.03 and len(batch.pixels) == 1


def test_masked_pixels_are_not_drawn(small_gray_scene):
    first, second = small_gray_scene.train[:2]
    valid = np.zeros(first.thermal.shape[:2], bool)
    valid[3:9, 5:20] = True
    views = [replace(first, load_valid=lambda: valid), second]
    batch = batches(views, modalities=("thermal",)).next(20_000)
    x, y = np.floor(place_of(batch, views) + 1e-3).astype(int).T
    of_first = batch.views.numpy() == 0
    assert valid[y[of_first], x[of_first]].all()
    share = valid.sum() / (valid.sum() + valid.size)
    assert of_first.mean() == pytest.approx(share, rel=0.1)


def test_thermal_masks_hide_no_pixel_of_rgb_alone(small_gray_scene):
    valid = np.zeros(small_gray_scene.train[0].thermal.shape[:2], bool)
    valid[0, 0] = True
    views = [replace(view, load_valid=lambda: valid) for view in small_gray_scene.train]
    drawn = [batches(views, modalities=names).next(500) for names in (("rgb",), ("thermal", "rgb"))]
    places = [np.unique(np.floor(place_of(batch, views) + 1e-3), axis=0) for batch in drawn]
    assert len(places[0]) > 100 and len(places[1]) == 1


def test_views_are_small_and_held_out_as_the_curriculum_says(small_gray_scene):
    views = small_gray_scene.train
    curriculum = Curriculum([Resolution(5, 4)], [views[1]])
    drawn = batches(views, curriculum, ("thermal",))
    curriculum.begin(1)
    batch = drawn.next(3000)
    small = [curriculum.at_resolution(view) for view in views]
    assert 1 not in batch.views and {*batch.views.tolist()} == {*range(len(views))} - {1}
    x, y = np.floor(place_of(batch, small) + 1e-3).astype(int).T
    assert x.max() < small[0].camera.width <= views[0].camera.width / 3
    assert batch.pixels["thermal"][7, 0] == small[batch.views[7]].thermal[y[7], x[7], 0]
    curriculum.begin(6)
    curriculum.settle(1, 0.1)
    assert 1 in drawn.next(3000).views and drawn.next(3000).rays.origins.shape == (3000, 3)


def test_equal_seeds_draw_equal_rays_and_a_state_goes_on(small_gray_scene):
    views = small_gray_scene.train
    first, second = batches(views), batches(views)
    assert torch.equal(first.next(50).views, second.next(50).views)
    state = first.state_dict()
    expected = [first.next(50) for _ in range(3)]
    resumed = batches(views, seed=9)
    resumed.load_state_dict(state)
    for batch in expected:
        again = resumed.next(50)
        assert torch.equal(batch.rays.directions, again.rays.directions)
        assert torch.equal(batch.pixels["rgb"], again.pixels["rgb"])
    assert not torch.equal(batches(views, seed=9).next(50).views, expected[0].views)


def test_a_rig_is_refused(small_gray_scene):
    with pytest.raises(ValueError, match="cannot learn the rig of the thermal camera"):
        ready_to_train(small_gray_scene, "thermonerf_thermal", 5, "thermal_camera.rig=true")
