"""Adam's steps, density control's statistics, L1 and SSIM of each backend, against torch in float64."""

import dataclasses

import pytest
import torch
from hydra.utils import instantiate

from tdgbench.splats.backends import cpu, reference, warp
from tdgbench.splats.backends.backend import Backend
from tdgbench.splats.density import DensityControl
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tdgbench.splats.torch_losses import LossWeights
from tests.helpers.configs import config
from tests.helpers.gaussians import RATES
from tests.helpers.waits import Reads
from tests.splats.backward_passes import COUNT, cloud

REASON = warp.BACKEND.why_not()
ON_WARP = pytest.mark.skipif(REASON is not None, reason=str(REASON))
OWNERS = [
    pytest.param(cpu.BACKEND, "cpu", id="cpu"),
    *(pytest.param(reference.BACKEND, device, id=f"torch on {device}", marks=marks)
      for device, marks in (("cpu", []), ("cuda", [pytest.mark.cuda]))),
    pytest.param(warp.BACKEND, "cpu", id="warp on cpu", marks=ON_WARP),
    pytest.param(warp.BACKEND, "cuda", id="warp on cuda", marks=[ON_WARP, pytest.mark.cuda]),
]  # fmt: skip
EXACT = (reference.BACKEND, "cpu", torch.float64)


def state_of(backend: Backend, device: str, dtype: torch.dtype, degree: int = 0) -> TrainingState:
    return TrainingState(cloud(3, degree, dtype).map(lambda t: t.to(device)), backend)


def stepped(backend: Backend, device: str, dtype: torch.dtype) -> list[torch.Tensor]:
    """Values and moments, float64 on the CPU, after eight steps; then a step with an infinite gradient is refused."""
    state = state_of(backend, device, dtype, degree=2)
    optimizer, g = Adam(state, RATES, 2.0), torch.Generator().manual_seed(1)
    sizes = 10.0 ** -(torch.arange(state.values.shape[1]) % 16)  # of gradients, by column
    radii = torch.zeros(COUNT, dtype=torch.int32, device=device)
    for iteration in range(1, 9):
        gradients = (sizes * torch.randn(state.values.shape, generator=g)).to(state.values)
        bad = optimizer.step(Gradients.dense(gradients, gradients[:, :2], radii), iteration)
        assert (bad() if callable(bad) else bad) is None
    optimizer.flush()
    left = [t.double().cpu().clone() for t in (state.values, state.first, state.second)]
    gradients[5, state.columns_of("quats").start] = torch.inf
    bad = optimizer.step(Gradients.dense(gradients, gradients[:, :2], radii), iteration)
    assert callable(bad) == (device != "cpu") and (bad() if callable(bad) else bad) == "quats"
    return left


@pytest.mark.parametrize(("backend", "device"), OWNERS)
def test_steps_are_those_of_torch_in_float64(backend, device):
    found = [stepped(backend, device, torch.float32) for _ in range(2)]
    for first, again, want in zip(*found, stepped(*EXACT), strict=True):
        assert torch.equal(first, again) and ((first - want).norm(dim=0) <= 1e-6 * want.norm(dim=0)).all()


def view(number: int, dense: bool, absolute: bool) -> Gradients:
    """Gradients, float64, of 120 Gaussians, of which about a third are not visible; or rows of 80, in two spans."""
    g = torch.Generator().manual_seed(number)
    grads, absolutes = torch.randn(2, COUNT, 2, generator=g, dtype=torch.float64) * 1e-5
    radii = (torch.randint(-9, 20, (COUNT,), generator=g)).clamp_min(0).int()
    found = Gradients.dense(torch.zeros(COUNT, 16), grads, radii, absolutes.abs() if absolute else None)
    if dense:
        return found
    rows = torch.randperm(COUNT, generator=g)[:80].int()
    spans = [(0, 30), (40, 40)]
    return Gradients(spans, rows, torch.zeros(80, 16), found.image[rows], spans, rows, radii[rows])


def observed(backend: Backend, device: str, dtype: torch.dtype, dense: bool, absolute: bool) -> dict:
    """What density control has accumulated over three views."""
    rules = instantiate(config("budget=paper").budget.density)
    if absolute:
        rules = dataclasses.replace(rules, gradient="absolute")
    control = DensityControl(rules, 1.0, state_of(backend, device, dtype), 1000)
    for number in range(3):
        given = view(number, dense, absolute)
        for name in ("index", "values", "image", "projected", "radii"):
            tensor = getattr(given, name)
            setattr(given, name, tensor.to(device, dtype if tensor.is_floating_point() else None))
        control.observe_visible(given)
        control.observe_gradients(given, 100, 50)
    return {name: sums for name, sums in control.state_dict().items() if name in control.accumulated}


@pytest.mark.parametrize(("backend", "device"), OWNERS)
@pytest.mark.parametrize("absolute", [False, True])
@pytest.mark.parametrize("dense", [True, False])
def test_statistics_are_those_of_torch_in_float64(backend, device, dense, absolute):
    exact = observed(*EXACT, dense, absolute)
    first, again = (observed(backend, device, torch.float32, dense, absolute) for _ in range(2))
    assert set(first) == set(exact) and ("absolute_sum" in first) == absolute
    for name, want in exact.items():
        assert torch.equal(first[name], again[name]), name
        if name in ("view_counts", "max_radii"):
            assert torch.equal(first[name].double(), want) and 0 < (want > 0).sum() < COUNT
        else:
            assert ((first[name] - want).abs() <= 1e-6 * want.max()).all() and want.max() > 0


@pytest.mark.parametrize(("backend", "device"), OWNERS)
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("shape", [(40, 30, 1), (37, 53, 3), (11, 11, 1), (1, 1, 3), (5, 90, 1)])
def test_losses_are_those_of_torch_in_float64(backend, device, shape, masked):
    g, weights = torch.Generator().manual_seed(0), LossWeights(0.8, 0.2)
    target = torch.rand(shape, generator=g)
    image = (target + 0.2 * torch.randn(shape, generator=g)).clamp(0, 1)
    valid = None
    if masked:
        valid = torch.rand(shape[:2], generator=g) < 0.7
        valid[0, 0] = True
        target = torch.where(valid[..., None], target, torch.nan)
    exact = image.double().requires_grad_()
    expected = reference.BACKEND.image_loss(exact, target.double(), weights, valid)
    (3 * expected).backward()
    image, target = image.to(device).requires_grad_(), target.to(device)
    valid = None if valid is None else valid.clone().to(device)
    bytes_of, waits = [], []
    for _ in range(2):
        image.grad = None
        with Reads() as reads:
            found = backend.image_loss(image, target, weights, valid)
            (3 * found).backward()
        bytes_of.append((found.detach().cpu().numpy().tobytes(), image.grad.cpu().numpy().tobytes()))
        waits.append(len(reads.found))
    assert found.item() == pytest.approx(expected.item(), abs=1e-6)
    assert (image.grad.cpu() - exact.grad).norm() < 1e-5 * exact.grad.norm()
    assert bytes_of[0] == bytes_of[1]
    if backend is warp.BACKEND:
        assert waits == [int(masked), 0]  # the number of a mask's valid pixels, once
