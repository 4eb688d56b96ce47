"""The Depth Anything adapter with the real classes of transformers, of tiny random networks."""

import numpy as np
import pytest
import torch

from tdgbench.priors import PriorUnavailableError, prepare
from tdgbench.priors.depth_anything import DepthAnythingPrior

transformers = pytest.importorskip("transformers", reason="the extra `depth` is not installed")


@pytest.fixture(scope="module")
def tiny_model(tmp_path_factory) -> str:
    """A Depth Anything model on disk with some ten thousand random weights, and a processor like the published one."""
    from transformers.models.dpt.image_processing_pil_dpt import DPTImageProcessorPil

    folder = tmp_path_factory.mktemp("depth_anything")
    torch.manual_seed(0)
    backbone = transformers.Dinov2Config(
        hidden_size=16, num_hidden_layers=4, num_attention_heads=2, mlp_ratio=2, image_size=28, patch_size=14,
        out_features=["stage1", "stage2", "stage3", "stage4"], reshape_hidden_states=False, apply_layernorm=True,
    )  # fmt: skip
    config = transformers.DepthAnythingConfig(
        backbone_config=backbone, patch_size=14, reassemble_hidden_size=16, neck_hidden_sizes=[4, 8, 16, 16],
        fusion_hidden_size=8, head_hidden_size=8,
    )  # fmt: skip
    transformers.DepthAnythingForDepthEstimation(config).save_pretrained(str(folder))
    DPTImageProcessorPil(
        size={"height": 28, "width": 28}, ensure_multiple_of=14, keep_aspect_ratio=True,
        image_mean=[0.485, 0.456, 0.406], image_std=[0.229, 0.224, 0.225],
    ).save_pretrained(str(folder))  # fmt: skip
    return str(folder)


@pytest.mark.parametrize("kind", ["small_scene", "small_gray_scene"])
def test_gives_a_disparity_of_the_image_s_size(tiny_model, request, kind):
    scene = request.getfixturevalue(kind)
    view = scene.train[0]
    prior = DepthAnythingPrior(tiny_model, "cpu").estimate(scene, view).check(view)
    assert prior.kind == "disparity" and prior.values.shape == (36, 48) and prior.values.dtype == np.float32
    assert prior.values.std() > 0


def test_is_what_transformers_own_pipeline_gives(tiny_model, small_gray_scene):
    """The pipeline `depth-estimation` with the same processor, on the same 8-bit picture."""
    from PIL import Image

    view = small_gray_scene.train[0]
    prior = DepthAnythingPrior(tiny_model, "cpu")
    processor, network = prior._network
    pipeline = transformers.pipeline("depth-estimation", model=network, image_processor=processor, device="cpu")
    picture = Image.fromarray(np.clip(view.thermal[..., 0] * 255 + 0.5, 0, 255).astype(np.uint8)).convert("RGB")
    theirs = pipeline(picture)["predicted_depth"].numpy()
    assert np.allclose(prior.estimate(small_gray_scene, view).values, theirs, atol=1e-6)


def test_a_folder_without_weights_is_named(tmp_path):
    with pytest.raises(PriorUnavailableError, match=f"prior=depth_anything is not available: no weights of {tmp_path}"):
        prepare(DepthAnythingPrior(str(tmp_path), "cpu"))
