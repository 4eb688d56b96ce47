"""The `warp` backend on Warp's CPU device: accuracy, equal bytes, block-wise sums, and what is compiled for CUDA."""

import importlib.util
import re
import subprocess
import sys

import pytest
import torch

from tdgbench.bench.backend_check.check import COMPARED, check
from tdgbench.bench.backend_check.compare import cloud as checked_cloud
from tdgbench.bench.backend_check.compare import expected, render
from tdgbench.splats import rasterization
from tdgbench.splats.backends import warp
from tdgbench.splats.backends.backend import StateOptions
from tdgbench.splats.backends.warp import import_problem
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.render import render_state
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import Blending, Pinhole
from tests.helpers.gaussians import RATES, random_gaussians, turned_camera
from tests.helpers.training import trained
from tests.helpers.waits import Reads
from tests.splats.backward_passes import backward_pass, cloud

REASON = warp.BACKEND.why_not()
needs_warp = pytest.mark.skipif(REASON is not None, reason=str(REASON))


def opaque(channels: int):
    """Walls of nearly opaque Gaussians, harmonics of degree 1: almost no light passes the first of them."""
    scene = checked_cloud(300, seed=5, width=60, height=44, degree=1, channels=channels)
    scene.opacities[:] = 0.95 + 0.05 * torch.rand(300, generator=torch.Generator().manual_seed(1))
    scene.scales *= 2.0
    return scene


@needs_warp
@pytest.mark.parametrize("channels", [1, 3])
def test_opaque_scenes_are_as_exact_as_others(channels):
    """A backward pass that begins at 1 − alpha is wrong by 1e-4 here; this one keeps the transmittance."""
    scene = opaque(channels)
    want = expected(scene, "warp")
    assert (want.rendered.image[..., -1] > 0.999).double().mean() > 0.5
    errors, of_cpu = (want.errors(render(scene, name, want.weights), COMPARED) for name in ("warp", "cpu"))
    assert errors.image < 2e-6 and errors.gradients < 5e-6
    assert errors.gradients < 4 * of_cpu.gradients


@needs_warp
def test_it_passes_the_check():
    verdict = check("warp")
    assert not verdict.reason and verdict.spread == 0 and verdict.gradients < 1e-5


@needs_warp
def test_seven_channels_in_one_pass():
    """More than a colour: features have no limit."""
    scene = checked_cloud(100, seed=8, channels=7)
    want = expected(scene, "warp")
    errors = want.errors(render(scene, "warp", want.weights), COMPARED)
    assert errors.image < 5e-6 and errors.gradients < 1e-5


@needs_warp
def test_a_zero_min_alpha_is_refused():
    with pytest.raises(ValueError, match="min_alpha above 0"):
        rasterization(
            *random_gaussians(3, 0, None, 1), *turned_camera(8, 8), 8, 8, backend="warp", blending=Blending(min_alpha=0)
        )


@needs_warp
def test_other_numbers_of_threads_are_refused(monkeypatch):
    monkeypatch.setenv("TDGBENCH_WARP_LANES", "48")
    with pytest.raises(ValueError, match="TDGBENCH_WARP_LANES is '48'; it must be one of 1, 2, 4"):
        rasterization(*random_gaussians(3, 0, None, 1), *turned_camera(8, 8), 8, 8, backend="warp")


@needs_warp
@pytest.mark.parametrize(("channels", "absgrad"), [(1, False), (3, True)])
def test_a_state_has_the_gradients_of_the_reference(channels, absgrad):
    got = backward_pass(cloud(channels, 2), "warp", 1, absgrad=absgrad)
    want = backward_pass(cloud(channels, 2, torch.float64), "reference", 1, absgrad=absgrad)
    for found, exact in zip(got.gradients.rows(), want.gradients.rows(), strict=True):
        assert (found - exact).double().norm() <= 1e-5 * exact.double().norm() > 0
    assert torch.equal(got.gradients.radii, want.gradients.radii)


@needs_warp
def test_the_host_waits_for_the_number_of_pairs_alone(monkeypatch):
    """In a step, from the state in training to its gradients; the camera is on the host."""
    import warp as wp

    monkeypatch.setattr(wp.array, "numpy", lambda array: pytest.fail("the host reads an array"))
    monkeypatch.setattr(wp, "synchronize", lambda: pytest.fail("the host waits"))
    view, K = (t[0].double() for t in turned_camera(50, 40))
    state, collected = TrainingState(cloud(1, 1)), []
    optimizer = Adam(state, RATES, 1.0)
    background = torch.full((1,), 0.5)
    with Reads() as reads:
        rendered = render_state(
            state, optimizer, Pinhole(view, K, 50, 40), StateOptions(1, True, background=background, absgrad=True),
            collected.append, "warp",
        )  # fmt: skip
        (rendered.image.sum() + rendered.depth.sum()).backward()
    assert reads.found == ["_local_scalar_dense"] and collected[0].values.any()


@needs_warp
@pytest.mark.parametrize("method", ["tdg", "msmg"])
def test_two_trainings_have_equal_bytes(small_gray_scene, method):
    left = []
    for _ in range(2):
        trainer, _ = trained(small_gray_scene, method, 30, backend="warp")
        state = getattr(trainer.method, "thermal" if method == "msmg" else "model").state
        left.append([tensor.cpu().numpy().tobytes() for tensor in (state.values, state.second)])
    assert left[0] == left[1]


BLOCKS = """
import os, torch, warp
warp.config.enable_cpu_blocks = True
from tdgbench.bench.backend_check.compare import cloud, expected, render
scene = cloud(150, seed=2, width=53, height=37, degree=1, channels=3)
want = expected(scene, "warp")
found = []
for lanes in ("1", "256"):
    os.environ["TDGBENCH_WARP_LANES"] = lanes
    found.append(render(scene, "warp", want.weights))
    errors = want.errors(found[-1])
    assert errors.gradients < 1e-5, (lanes, errors)
for name, gradient in found[0].gradients.items():
    assert torch.allclose(gradient, found[1].gradients[name], rtol=1e-5, atol=1e-5 * gradient.abs().max().item()), name
print("agree")
"""


@needs_warp
def test_a_block_of_threads_adds_up_the_same_gradient():
    """256 threads per tile, with the block-wise reduction that CUDA uses, as fibers on the CPU; in a new process."""
    run = subprocess.run([sys.executable, "-c", BLOCKS], capture_output=True, text=True, timeout=300)
    assert run.returncode == 0 and run.stdout.strip().endswith("agree"), run.stderr


@needs_warp
@pytest.mark.parametrize("name", ["projection", "blend", "gradient", "losses", "adam", "statistics"])
def test_it_compiles_for_cuda_without_atomics(tmp_path, name):
    """Sums in a fixed order: no instruction adds floats to memory that threads share. Blocks add up in the blend."""
    import warp as wp

    from tdgbench.splats.warp import blend, gradient, projection, training
    from tdgbench.splats.warp import losses as image_losses

    kernel = {
        "projection": projection.project,
        "blend": blend.backward_blend(3, 256, True).kernel,
        "gradient": gradient.add_pairs,
        "losses": image_losses.similarity,
        "adam": training.step_values,
        "statistics": training.add_lengths,
    }[name]
    kernel.module.options["block_dim"] = 256
    (path,) = wp.compile_aot_module(kernel.module, arch=[75], module_dir=tmp_path, use_ptx=True)
    text = path.read_text()
    assert ".target sm_75" in text and not re.search(r"\b(atom|red)\.\S*(global|\.f)", text)
    assert ("shfl.sync" in text) == (name == "blend")


def test_without_the_package_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert import_problem.__wrapped__(False) == "warp-lang is not installed: pip install -e '.[warp]'"


@needs_warp
def test_an_old_driver_is_named(monkeypatch):
    """On a machine whose GPU torch can use, and Warp cannot."""
    import warp as wp

    monkeypatch.setattr(wp, "is_cuda_available", lambda: False)
    reason = import_problem.__wrapped__(True)
    assert "driver is too old" in reason and "580" in reason
