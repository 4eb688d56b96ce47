"""Loss terms that methods share: the 3DGS photometric loss, thermal smoothness in both readings, min-max normalisation.

Images are (H, W, C) in [0, 1]; losses are scalars. Only the first argument gets a gradient. The fast backend for the
tensors computes them: fused kernels on the CPU, and for L1 and SSIM on a GPU that Warp can use; else plain torch.

A mask `valid`, bool (H, W), takes pixels out of a loss where it is false: both images are 0 there, as in 3DGS
(`alpha_mask` in train.py), nerfstudio (splatfacto.py) and gsplat (examples/simple_trainer.py). Means are over the valid
pixels, while those three divide by the number of all pixels. None: every pixel counts. A loss raises ValueError if no
pixel is valid.
"""

from __future__ import annotations

import torch

from tdgbench.splats import torch_losses
from tdgbench.splats.backends import backend_for
from tdgbench.splats.torch_losses import LossWeights


def l1(image: torch.Tensor, target: torch.Tensor, valid: torch.Tensor | None = None) -> torch.Tensor:
    """Return the mean absolute error of images (H, W, C).

    >>> l1(torch.full((4, 4, 1), 0.75), torch.full((4, 4, 1), 0.5)).item()
    0.25
    """
    return l1_and_dssim(image, target, 1.0, 0.0, valid)


def ssim(image: torch.Tensor, target: torch.Tensor, valid: torch.Tensor | None = None) -> torch.Tensor:
    """Return the mean SSIM of images (H, W, C) with zero padding, as in 3DGS.

    >>> image = torch.rand(16, 16, 3)
    >>> round(ssim(image, image).item(), 4)
    1.0
    """
    return 1.0 - l1_and_dssim(image, target, 0.0, 1.0, valid)


def photometric(
    image: torch.Tensor, target: torch.Tensor, lambda_ssim: float, valid: torch.Tensor | None = None
) -> torch.Tensor:
    """Return (1 − λ) L1 + λ (1 − SSIM) of images (H, W, C): 3DGS, eq. 7."""
    return l1_and_dssim(image, target, 1 - lambda_ssim, lambda_ssim, valid)


def thermal_loss(
    image: torch.Tensor,
    target: torch.Tensor,
    lambda_ssim: float,
    lambda_smooth: float,
    reading: str,
    valid: torch.Tensor | None = None,
) -> torch.Tensor:
    """Return the thermal loss (TDg, eq. 5, after ThermalGaussian) of images (H, W, C).

    (1 − λ_ssim) L1 + λ_ssim (1 − SSIM) + λ_smooth L_smooth, the last in one of the readings of `smoothness`.

    >>> image = torch.full((8, 8, 1), 0.5)
    >>> round(thermal_loss(image, image - 0.25, 0.0, 0.6, "written").item(), 4)
    0.25
    """
    _check_reading(reading)
    return _image_loss(image, target, LossWeights(1 - lambda_ssim, lambda_ssim, lambda_smooth, reading), valid)


def l1_and_dssim(
    image: torch.Tensor, target: torch.Tensor, l1_weight: float, dssim_weight: float, valid: torch.Tensor | None = None
) -> torch.Tensor:
    """Return l1_weight · L1 + dssim_weight · (1 − SSIM) of images (H, W, C); raise ValueError if the shapes differ."""
    return _image_loss(image, target, LossWeights(l1_weight, dssim_weight), valid)


def _image_loss(
    image: torch.Tensor, target: torch.Tensor, weights: LossWeights, valid: torch.Tensor | None
) -> torch.Tensor:
    if image.shape != target.shape:
        raise ValueError(f"the images to compare are {tuple(image.shape)} and {tuple(target.shape)}")
    if valid is not None and valid.shape != image.shape[:2]:
        raise ValueError(f"the mask is {tuple(valid.shape)}, the images to compare are {tuple(image.shape)}")
    return backend_for(image).image_loss(image, target, weights, valid)


def smoothness(image: torch.Tensor, reading: str, valid: torch.Tensor | None = None) -> torch.Tensor:
    """Return the mean difference of neighbouring pixels of an image (H, W, C), in one of two readings.

    `written` (TDg, eq. 6): sum over the 4 neighbours inside the image, divided by 4 M (M: pixels and channels).
    `released` (ThermalGaussian's code): not divided by 4; neighbours wrap around at the border and are constants.
    With a mask, the sum is over neighbours that are both valid, and M counts valid pixels.

    >>> image = torch.tensor([[[0.0], [1.0]]])
    >>> smoothness(image, "written").item(), smoothness(image, "released").item()
    (0.25, 2.0)
    """
    _check_reading(reading)
    return torch_losses.smoothness(image, reading, valid)


def _check_reading(reading: str) -> None:
    if reading not in ("written", "released"):
        raise ValueError(f"smoothness reading is {reading!r}; it must be 'written' or 'released'")


def min_max(values: torch.Tensor) -> torch.Tensor:
    """Normalise a map (H, W) to [0, 1] by its extremes (TDg, before eq. 4), which get gradients, too.

    A map without range becomes zero, with zero gradient.

    >>> min_max(torch.tensor([[1.0, 2.0], [3.0, 5.0]])).tolist()
    [[0.0, 0.25], [0.5, 1.0]]
    """
    return backend_for(values).min_max(values)


def inverse_expected_depth(depth: torch.Tensor, transmittance: torch.Tensor, min_alpha: float) -> torch.Tensor:
    """Return 1 / (expected z) = alpha / accumulated z, maps (H, W); 0, infinitely far, where alpha ≤ min_alpha.

    >>> inverse_expected_depth(torch.tensor([[1.0, 0.0]]), torch.tensor([[0.5, 1.0]]), 1e-3).tolist()
    [[0.5, 0.0]]
    """
    return backend_for(depth).inverse_expected_depth(depth, transmittance, min_alpha)
