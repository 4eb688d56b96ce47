"""Radiance fields on a GPU, where all is plain torch."""

import numpy as np
import pytest

from tdgbench.splats.backends import ON_GPU, load_backend
from tdgbench.training.loop import train
from tests.helpers.training import ready_to_train

SIZE = ("budget.field.rays=256", "budget.field.samples=[16,16]", "budget.field.log2_rows=12")
NAMES = (
    "thermonerf", "depth_prior_nerf", "oezer_scratch", "oezer_second_branch", "oezer_separate", "oezer_finetune",
)  # fmt: skip


@pytest.mark.cuda
@pytest.mark.parametrize("name", NAMES)
def test_a_gpu_trains_and_renders_as_the_cpu(small_gray_scene, name):
    backend = next((one for one in ON_GPU if load_backend(one).why_not() is None), None)
    if backend is None:
        pytest.skip("no backend runs on the GPU")
    on_cpu, on_gpu = (ready_to_train(small_gray_scene, name, 20, *SIZE, f"backend={one}") for one in ("cpu", backend))
    losses = [np.array([line.loss for line in train(trainer).lines]) for trainer in (on_cpu, on_gpu)]
    assert on_gpu.method.field.density.grid.table.device.type == load_backend(backend).device
    assert np.allclose(losses[0][:3], losses[1][:3], rtol=1e-3) and np.allclose(losses[0], losses[1], rtol=0.2)
    on_cpu.load_state_dict(on_gpu.state_dict())
    for modality in on_cpu.method.modalities:
        images = [
            trainer.method.render(trainer.context.frame(small_gray_scene.test[0]), modality).cpu()
            for trainer in (on_cpu, on_gpu)
        ]
        assert np.allclose(images[0].image, images[1].image, atol=1e-3)
        assert np.allclose(images[0].depth, images[1].depth, rtol=1e-2)
