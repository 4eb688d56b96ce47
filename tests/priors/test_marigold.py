"""The Marigold adapter with the real diffusers pipeline, of tiny random networks."""

import json

import numpy as np
import pytest
import torch

from tdgbench.priors.marigold import MarigoldPrior

diffusers = pytest.importorskip("diffusers", reason="the extra `depth` is not installed")
transformers = pytest.importorskip("transformers", reason="the extra `depth` is not installed")


@pytest.fixture(scope="module")
def tiny_model(tmp_path_factory) -> str:
    """A Marigold pipeline on disk whose networks have a few thousand random weights."""
    folder = tmp_path_factory.mktemp("marigold")
    torch.manual_seed(0)
    unet = diffusers.UNet2DConditionModel(
        block_out_channels=(8, 16), layers_per_block=1, sample_size=8, in_channels=8, out_channels=4,
        down_block_types=("DownBlock2D", "CrossAttnDownBlock2D"), up_block_types=("CrossAttnUpBlock2D", "UpBlock2D"),
        cross_attention_dim=16, attention_head_dim=4, norm_num_groups=4,
    )  # fmt: skip
    vae = diffusers.AutoencoderKL(
        block_out_channels=[8, 16], in_channels=3, out_channels=3, latent_channels=4, norm_num_groups=4,
        down_block_types=["DownEncoderBlock2D"] * 2, up_block_types=["UpDecoderBlock2D"] * 2,
    )  # fmt: skip
    scheduler = diffusers.DDIMScheduler(
        prediction_type="v_prediction", set_alpha_to_one=False, steps_offset=1, clip_sample=False
    )
    text = transformers.CLIPTextModel(
        transformers.CLIPTextConfig(
            hidden_size=16, intermediate_size=16, num_attention_heads=2, num_hidden_layers=1, vocab_size=8,
            max_position_embeddings=8, bos_token_id=0, eos_token_id=1, pad_token_id=1,
        )
    )  # fmt: skip
    words = folder / "words"
    words.mkdir()
    vocabulary = ["<|startoftext|>", "<|endoftext|>", "a", "b", "a</w>", "b</w>", "ab", "ab</w>"]
    (words / "vocab.json").write_text(json.dumps({word: i for i, word in enumerate(vocabulary)}))
    (words / "merges.txt").write_text("#version: 0.2\na b\na b</w>\n")
    tokenizer = transformers.CLIPTokenizer.from_pretrained(str(words), model_max_length=8)
    pipeline = diffusers.MarigoldDepthPipeline(
        unet, vae, scheduler, text, tokenizer, prediction_type="depth", default_denoising_steps=2,
        default_processing_resolution=32,
    )  # fmt: skip
    pipeline.save_pretrained(str(folder / "model"))
    return str(folder / "model")


def make(model: str, seed: int = 0) -> MarigoldPrior:
    return MarigoldPrior(model, steps=None, ensemble=1, resolution=None, device="cpu", seed=seed)


@pytest.mark.parametrize("kind", ["small_scene", "small_gray_scene"])
def test_gives_a_depth_map_of_the_image_s_size(tiny_model, request, kind):
    scene = request.getfixturevalue(kind)
    view = scene.train[0]
    prior = make(tiny_model).estimate(scene, view).check(view)
    assert prior.kind == "depth" and prior.values.shape == (36, 48) and prior.values.dtype == np.float32
    assert prior.values.min() >= 0 and prior.values.max() <= 1 and prior.values.std() > 0


def test_same_seed_same_map(tiny_model, small_scene):
    view = small_scene.train[0]
    a, b, c = (make(tiny_model, seed).estimate(small_scene, view).values for seed in (0, 0, 1))
    assert np.array_equal(a, b) and not np.array_equal(a, c)
