import numpy as np
import torch

from tdgbench.scenes import Camera, View
from tdgbench.splats import Gaussians
from tdgbench.splats.harmonics import num_bases
from tdgbench.splats.render import render_view
from tdgbench.splats.view import Pinhole
from tdgbench.training.skips.view_dependence import explained_by_direction

SIZE = 48


def ring(count=16):
    """Cameras on an arc around the origin, looking at it."""
    views = []
    for angle in np.linspace(-1.2, 1.2, count):
        c, s = np.cos(angle), np.sin(angle)
        pose = np.eye(4)
        pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        pose[2, 3] = 4.0
        K = np.array([[40.0, 0, SIZE / 2], [0, 40.0, SIZE / 2], [0, 0, 1]])
        views.append(View(f"v{angle:.2f}", Camera(K, pose, SIZE, SIZE), lambda: np.zeros((SIZE, SIZE, 1), np.float32)))
    return views


def blobs(degree, band):
    g = torch.Generator().manual_seed(0)
    sh = torch.zeros(60, num_bases(3), 1)
    sh[:, 0] = torch.rand(60, 1, generator=g)
    if degree > 0:
        sh[:, 1 : num_bases(degree)] = band * torch.randn(60, num_bases(degree) - 1, 1, generator=g)
    return Gaussians(
        means=torch.rand(60, 3, generator=g) * 2 - 1,
        log_scales=torch.full((60, 3), -2.0),
        quats=torch.randn(60, 4, generator=g),
        opacity_logits=torch.zeros(60),
        sh=sh,
    )


def seen(gaussians, views):
    return [
        render_view(gaussians.activated(3), Pinhole.of(v.camera).to(gaussians.means)).image
        for v in views
    ]  # fmt: skip


def test_a_matt_scene_with_noise_shows_none():
    views, model = ring(), blobs(0, 0.0)
    g = torch.Generator().manual_seed(1)
    noisy = [image + 0.05 * torch.randn(image.shape, generator=g) for image in seen(model, views)]
    assert explained_by_direction(model, views, noisy, "auto") < 0.02


def test_a_shiny_scene_shows_it():
    views, shiny = ring(), blobs(1, 0.2)
    assert explained_by_direction(shiny, views, seen(shiny, views), "auto") > 0.5


def test_too_few_views_say_nothing():
    views, shiny = ring(3), blobs(1, 0.2)
    assert explained_by_direction(shiny, views, seen(shiny, views), "auto") == 0.0
