import numpy as np
import pytest
import torch

from tdgbench.scenes import Camera
from tdgbench.splats import Gaussians
from tdgbench.splats.render import render_view
from tdgbench.splats.view import Pinhole
from tdgbench.training.evidence import halves, look_at


def camera() -> Camera:
    pose = np.eye(4)
    pose[2, 3] = 4.0
    return Camera(np.array([[40.0, 0, 16], [0, 40.0, 16], [0, 0, 1]]), pose, 32, 32)


def long_and_short() -> Gaussians:
    """The first is long in x; the second stands behind it, to the right, and is round."""
    return Gaussians(
        means=torch.tensor([[0.0, 0.0, 0.0], [0.8, 0.0, 1.0]]),
        log_scales=torch.tensor([[0.5, 0.1, 0.1], [0.2, 0.2, 0.2]]).log(),
        quats=torch.tensor([[1.0, 0, 0, 0], [1.0, 0, 0, 0]]),
        opacity_logits=torch.tensor([0.6, 0.9]).logit(), sh=torch.zeros(2, 1, 1),
    )  # fmt: skip


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_weights_are_those_of_the_blend(backend):
    gaussians = long_and_short()
    seen = look_at(gaussians, camera(), torch.ones(32, 32, 1), None, backend)
    for index in range(2):
        parts = halves(gaussians)
        colors = torch.zeros(4, 1)
        colors[[index, index + 2]] = 1.0
        image = render_view(parts._replace(colors=colors), Pinhole.of(camera()), backend=backend).image
        assert seen.weight[index].item() == pytest.approx(image.sum().item(), rel=1e-4)
    assert torch.allclose(seen.residual[:, 0], seen.weight) and seen.visible.all()


def test_the_difference_is_that_of_the_halves_along_the_longest_axis():
    across, along = torch.ones(32, 32, 1), torch.ones(32, 32, 1)
    along[:, 16:] = -1.0
    across[16:] = -1.0
    by_columns, by_rows = (look_at(long_and_short(), camera(), r, None, "cpu") for r in (along, across))
    assert abs(by_columns.difference[0]) > 0.5 * by_columns.weight[0]
    assert abs(by_columns.residual[0]) < 1e-3 * by_columns.weight[0]
    assert abs(by_rows.difference[0]) < 1e-3 * by_rows.weight[0]


def test_halves_have_the_mass_and_the_spread_of_the_whole():
    gaussians = long_and_short()
    parts = halves(gaussians)
    mass = parts.opacities * parts.scales.prod(dim=1)
    assert torch.allclose(mass[:2] + mass[2:], gaussians.opacities * gaussians.scales.prod(dim=1))
    offset = (parts.means[:2] - parts.means[2:]).norm(dim=1) / 2
    longest = gaussians.scales.amax(dim=1)
    assert torch.allclose(offset.square() + parts.scales[:2, 0].square(), longest.square())


def test_masked_pixels_count_nothing():
    valid = torch.ones(32, 32, dtype=torch.bool)
    valid[:, :16] = False
    residual = torch.ones(32, 32, 1)
    residual[:, :16] = float("nan")
    seen = look_at(long_and_short(), camera(), residual, valid, "cpu")
    whole = look_at(long_and_short(), camera(), torch.ones(32, 32, 1), None, "cpu")
    assert seen.weight[0].item() == pytest.approx(whole.weight[0].item() / 2, rel=1e-3)
    assert torch.allclose(seen.residual[:, 0], seen.weight)


def test_a_gaussian_out_of_sight_says_nothing():
    gaussians = long_and_short()
    gaussians.means[1] = torch.tensor([0.0, 0.0, -9.0])
    seen = look_at(gaussians, camera(), torch.ones(32, 32, 1), None, "cpu")
    assert seen.visible.tolist() == [True, False] and seen.weight[1] == 0
