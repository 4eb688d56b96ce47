import gc
import weakref

import numpy as np
import pytest
import torch

from tdgbench.splats import Gaussians
from tdgbench.splats.backends.backend import StateOptions
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.render import render_state
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import Pinhole
from tests.helpers.backends import need
from tests.helpers.gaussians import RATES, turned_camera
from tests.splats.backward_passes import COUNT, backward_pass, cloud


def gradients_of(given: Gaussians, backend: str, used_degree: int):
    """Image, depth, transmittance, and the gradients by Gaussian (N, columns), (N, 2), radii (N,)."""
    done = backward_pass(given, backend, used_degree)
    found = done.gradients.compute()
    values, image = np.zeros((COUNT, 64)), np.zeros((COUNT, 2))
    index, rows, on_image = (t.double().numpy() for t in found.rows())
    values[index.astype(int), : rows.shape[1]], image[index.astype(int)] = rows, on_image[:, :2]
    return done.outputs, values, image, found.all_radii(COUNT), done.state


@pytest.mark.parametrize(("channels", "degree", "used"), [(1, 3, 3), (1, 3, 1), (3, 2, 2), (3, 3, 0)])
def test_past_autograd_is_the_reference(channels, degree, used):
    """Activations and their gradients inside the kernels against torch's, in float64."""
    fast = gradients_of(cloud(channels, degree), "cpu", used)
    exact = gradients_of(cloud(channels, degree, torch.float64), "reference", used)
    for a, b in zip(fast[0], exact[0], strict=True):
        assert (a - b).abs().max() < 1e-4
    for a, b in zip(fast[1:3], exact[1:3], strict=True):
        assert np.linalg.norm(a - b) < 1e-4 * np.linalg.norm(b)
    starts = [fast[4].columns_of(name).start for name in Gaussians.names()]
    for column in starts:  # every kind of parameter by itself
        assert np.linalg.norm((fast[1] - exact[1])[:, column]) < 1e-3 * np.linalg.norm(exact[1][:, column])
    assert torch.equal(fast[3], exact[3])


@pytest.mark.parametrize("backend", ["reference", "warp"])
def test_an_iteration_leaves_nothing_behind(backend):
    """Backends with autograd: the view, its graph and the gradients go with the step."""
    need(backend)
    state = TrainingState(cloud(1, 1))
    camera, optimizer = Pinhole(*(t[0] for t in turned_camera(20, 20)), 20, 20), Adam(state, RATES, 1.0)
    left, collected = [], []
    for _ in range(2):
        view = render_state(state, optimizer, camera, StateOptions(1, True), collected.append, backend)
        left += [weakref.ref(view), weakref.ref(view.image)]
        view.image.sum().backward()
        del view
    gc.collect()
    assert len(collected) == 2 and [one() for one in left] == [None] * 4


def test_no_gradients_without_grad():
    state = TrainingState(cloud(1, 0))
    camera = Pinhole(*(t[0] for t in turned_camera(20, 20)), 20, 20)
    collect = lambda _: pytest.fail("called without a backward pass")  # noqa: E731
    with torch.no_grad():
        view = render_state(state, Adam(state, RATES, 1.0), camera, StateOptions(), collect)
    assert not view.image.requires_grad and view.depth is None
