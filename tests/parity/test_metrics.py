"""SSIM, PSNR and LPIPS against the code that published tables were computed with."""

import numpy as np
import pytest
import torch

from tdgbench.scoring.lpips import LPIPS
from tdgbench.scoring.metrics.psnr import channel_psnr, psnr
from tdgbench.scoring.metrics.ssim import ssim
from tests.parity.originals import original

IMAGES = ("gray", "color", "flat")


@pytest.fixture(scope="module")
def theirs():
    return original("metrics")


@pytest.fixture(scope="module")
def vgg(vgg_weights) -> LPIPS:
    """LPIPS with the real trunk of published tables."""
    return LPIPS("vgg", "signed", str(vgg_weights))


def pair(theirs, name: str, kind: str) -> list[np.ndarray]:
    images = [theirs[f"{name}_{part}_{kind}"].transpose(1, 2, 0) for part in ("image", "target")]
    return [image.astype(np.float32) / 255 if kind == "8bit" else image for image in images]


@pytest.mark.parametrize("name", IMAGES)
def test_ssim(theirs, name):
    for kind in ("8bit", "float"):
        assert ssim(*pair(theirs, name, kind), "zero") == pytest.approx(float(theirs[f"{name}_ssim_{kind}"]), rel=1e-5)


@pytest.mark.parametrize("name", IMAGES)
def test_psnr_pooled(theirs, name):
    """metrics.py: over all channels of an image."""
    assert psnr(*pair(theirs, name, "8bit")) == pytest.approx(float(theirs[f"{name}_psnr_pooled_8bit"]), abs=1e-5)


@pytest.mark.parametrize("name", IMAGES)
def test_psnr_per_channel(theirs, name):
    """training_report: each channel of an image by itself, then their mean; metrics.py's number is another one."""
    for kind in ("8bit", "float"):
        expected = float(theirs[f"{name}_psnr_per_channel_{kind}"])
        assert channel_psnr(*pair(theirs, name, kind)) == pytest.approx(expected, abs=1e-5)
    pooled, apart = (float(theirs[f"{name}_psnr_{way}_8bit"]) for way in ("pooled", "per_channel"))
    assert (abs(pooled - apart) > 0.3) == (name != "gray")


def test_lpips_of_random_images(vgg):
    """The backbone's README gives these; on LPIPS's own example images it gives 0.5686 and 0.4217, as we do."""
    g = torch.Generator().manual_seed(42)
    a, b = (torch.rand(2, 3, 100, 100, generator=g) for _ in range(2))
    ours = [vgg(*(t[i].permute(1, 2, 0).numpy() for t in (a, b))) for i in range(2)]
    assert ours == pytest.approx([0.3582, 0.3456], abs=1e-4)
