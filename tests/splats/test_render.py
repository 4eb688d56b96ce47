import gc
import weakref

import numpy as np
import pytest
import torch

from tdgbench.splats import Gaussians
from tdgbench.splats.backends.backend import StateOptions
from tdgbench.splats.gaussians import RenderedFields
from tdgbench.splats.gradients import Gradients, PendingGradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.render import render_state
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import Pinhole
from tests.helpers.backends import need
from tests.helpers.gaussians import RATES, turned_camera
from tests.splats.backward_passes import COUNT, backward_pass, cloud, with_rgb


def gradients_of(given: Gaussians, backend: str, used_degree: int, **of_view):
    """Image, depth, transmittance, and the gradients by Gaussian (N, columns), (N, 2), radii (N,)."""
    done = backward_pass(given, backend, used_degree, **of_view)
    found = done.gradients.compute()
    values, image = np.zeros((COUNT, 112)), np.zeros((COUNT, 2))
    index, rows, on_image = (t.double().numpy() for t in found.rows())
    values[index.astype(int), : rows.shape[1]], image[index.astype(int)] = rows, on_image[:, :2]
    return done.outputs, values, image, found.all_radii(COUNT), done.state


@pytest.mark.parametrize(("channels", "degree", "used"), [(1, 3, 3), (1, 3, 1), (3, 2, 2), (3, 3, 0)])
def test_past_autograd_is_the_reference(channels, degree, used):
    """Activations and their gradients inside the kernels against torch's, in float64."""
    fast = gradients_of(cloud(channels, degree), "cpu", used)
    agree(fast, gradients_of(cloud(channels, degree, torch.float64), "reference", used), Gaussians.names())


def agree(fast, exact, fields) -> None:
    """Compare two results of `gradients_of`, and the gradients of fields by themselves."""
    for a, b in zip(fast[0], exact[0], strict=True):
        assert (a - b).abs().max() < 1e-4
    for a, b in zip(fast[1:3], exact[1:3], strict=True):
        assert np.linalg.norm(a - b) < 1e-4 * np.linalg.norm(b)
    for column in [fast[4].columns_of(name).start for name in fields]:
        error = np.linalg.norm((fast[1] - exact[1])[:, column])
        assert np.linalg.norm(exact[1][:, column]) > 0 and error < 1e-3 * np.linalg.norm(exact[1][:, column])
    assert torch.equal(fast[3], exact[3])


FIELDS = [(("sh", "sh_rgb"), "opacity_logits"), (("sh_rgb",), "opacity_rgb"), (("sh_rgb", "sh"), "opacity_rgb")]


@pytest.mark.parametrize("fields", FIELDS)
@pytest.mark.parametrize(("channels", "degree", "used"), [(1, 3, 1), (3, 3, 3), (3, 3, 0)])
def test_rendered_fields_are_the_reference(channels, degree, used, fields):
    """Kernels that read other columns, of up to six channels, against float64."""
    of_view = {"hook": RenderedFields(*fields), "depth": False}
    given = with_rgb(cloud(channels, degree))
    assert isinstance(backward_pass(given, "cpu", used, **of_view).gradients, PendingGradients)
    doubles = given.map(torch.Tensor.double)
    fast, exact = (gradients_of(*on, used, **of_view) for on in ((given, "cpu"), (doubles, "reference")))
    agree(fast, exact, ["means", "quats", "log_scales", *fields[0], fields[1]])


def test_fields_that_the_kernels_do_not_take_pass_through_autograd():
    """Too many channels, three colour sets, one twice."""
    given, doubles = with_rgb(cloud(3, 1)), with_rgb(cloud(3, 1)).map(torch.Tensor.double)
    for colors, depth in ((("sh", "sh_rgb"), True), (("sh_rgb", "sh", "sh_rgb"), False), (("sh", "sh"), False)):
        of_view = {"hook": RenderedFields(colors), "depth": depth}
        assert isinstance(backward_pass(given, "cpu", 1, **of_view).gradients, Gradients)
        fast, exact = (gradients_of(*on, 1, **of_view) for on in ((given, "cpu"), (doubles, "reference")))
        agree(fast, exact, colors)
    for wrong in (RenderedFields(("sh",), "means"), RenderedFields(("sh_rgb", "opacity_rgb"))):
        with pytest.raises((RuntimeError, IndexError)):
            backward_pass(given, "cpu", 1, hook=wrong)


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
