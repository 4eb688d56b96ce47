"""Gradients by the camera's pose, against finite differences and on every kind of colour."""

import pytest
import torch
from scipy.spatial.transform import Rotation

from tdgbench.splats.geometry import multiply_quaternions, quaternion_of_rotation
from tdgbench.splats.render import rasterization

WIDTH, HEIGHT = 40, 32
STEP = 1e-7  # so small that no pixel leaves a Gaussian's footprint
K = torch.tensor([[[40.0, 0, 20], [0, 40, 16], [0, 0, 1]]], dtype=torch.float64)


def generators() -> list[torch.Tensor]:
    """The six directions (4, 4) in which a pose can move: three turns, three shifts."""
    found = []
    for axis in range(3):
        turn = torch.zeros(4, 4, dtype=torch.float64)
        turn[(axis + 2) % 3, (axis + 1) % 3], turn[(axis + 1) % 3, (axis + 2) % 3] = 1, -1
        found.append(turn)
    for axis in range(3):
        shift = torch.zeros(4, 4, dtype=torch.float64)
        shift[axis, 3] = 1
        found.append(shift)
    return found


@pytest.mark.parametrize(("sh_degree", "mode"), [(None, "RGB"), (2, "RGB+D")])
def test_the_gradient_by_the_pose_is_that_of_finite_differences(sh_degree: int | None, mode: str) -> None:
    draw = torch.Generator().manual_seed(3)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=draw, dtype=torch.float64)

    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = torch.from_numpy(Rotation.from_euler("xyz", [0.4, -0.6, 2.0]).as_matrix())
    pose[:3, 3] = torch.tensor([1.0, 0.5, 0.8])
    to_camera_space = 2 * uniform(30, 3) + torch.tensor([-1.0, -1.0, 3.0], dtype=torch.float64)
    means = (to_camera_space - pose[:3, 3]) @ pose[:3, :3]
    colors = uniform(30, 2) if sh_degree is None else uniform(30, 9, 2) - 0.5
    gaussians = (means, uniform(30, 4) - 0.5, 0.05 + 0.2 * uniform(30, 3), 0.8 * uniform(30), colors)
    weights = uniform(HEIGHT, WIDTH, 2 + ("D" in mode))

    def loss(viewmat: torch.Tensor, like: torch.Tensor, backend: str) -> torch.Tensor:
        views = (viewmat[None].to(like), K.to(like))
        options = {"sh_degree": sh_degree, "render_mode": mode, "backend": backend}
        image = rasterization(*(part.to(like) for part in gaussians), *views, WIDTH, HEIGHT, **options)[0][0]
        return (image.double() * weights).mean()

    expected = []
    for direction in generators():
        step = STEP * direction
        ahead, behind = (loss(torch.matrix_exp(s * step) @ pose, means, "reference") for s in (1, -1))
        expected.append((ahead - behind).item() / (2 * STEP))
    for backend, like, close in (("reference", means, 1e-5), ("cpu", means.float(), 1e-3)):
        asked = pose.clone().requires_grad_()
        value = loss(asked, like, backend)
        assert value.item() == pytest.approx(loss(pose, like, backend).item(), rel=1e-5)
        value.backward()
        found = [(asked.grad * (direction @ pose)).sum().item() for direction in generators()]
        assert found == pytest.approx(expected, rel=close, abs=1e-2 * close)


def test_quaternions_of_all_turns() -> None:
    turns = Rotation.random(200, random_state=1)
    for a, b in zip(turns[:100], turns[100:], strict=True):
        qa, qb = (quaternion_of_rotation(torch.from_numpy(turn.as_matrix())) for turn in (a, b))
        both = multiply_quaternions(qa, qb)
        assert Rotation.from_quat(both.tolist(), scalar_first=True).approx_equal(a * b, atol=1e-9)
