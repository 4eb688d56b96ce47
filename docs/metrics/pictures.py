"""`python docs/metrics/pictures.py`: draw the pictures of the pages of the metrics, on a made thermal image."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from scipy.ndimage import gaussian_filter

from tdgbench.scoring.metrics.psnr import best_gain_and_offset, psnr, psnr_affine
from tdgbench.scoring.metrics.ssim import ssim

matplotlib.use("Agg")
from matplotlib import pyplot as plt

FOLDER = Path(__file__).parent
INK = "#808890"  # readable on white and on black


def thermal_image() -> np.ndarray:
    """Return a warm disk and a window in a wall that is cooler at its top, (96, 128, 1) in [0, 1]."""
    x, y = np.meshgrid(np.arange(128), np.arange(96))
    image = 0.25 + 0.002 * y
    image = np.where(np.hypot(x - 44, y - 52) < 26, 0.75 - 0.004 * np.abs(x - 40), image)
    image = np.where((x > 84) & (x < 114) & (y > 20) & (y < 60), 0.12, image)
    return gaussian_filter(image, 1.0)[..., None]


def with_psnr(truth: np.ndarray, change: np.ndarray, value: float) -> np.ndarray:
    """Return the image with a change, scaled so that its PSNR is `value` dB; not clipped."""
    return truth + change * 10 ** (-value / 20) / np.sqrt(np.mean(change**2))


def panels(name: str, images: dict[str, np.ndarray]) -> None:
    """Write images side by side, with their titles."""
    figure, axes = plt.subplots(1, len(images), figsize=(1.9 * len(images), 1.75), layout="constrained")
    for ax, (title, image) in zip(axes, images.items(), strict=True):
        ax.imshow(image[..., 0], cmap="inferno", vmin=0, vmax=1)
        ax.set_title(title, fontsize=8, color=INK)
        ax.set_axis_off()
    save(figure, name)


def save(figure, name: str) -> None:
    figure.savefig(FOLDER / name, dpi=85, transparent=True, metadata={"Software": None})
    plt.close(figure)


def draw() -> None:
    truth = thermal_image()
    noise = np.random.default_rng(0).normal(size=truth.shape)
    panels("psnr.png", {"ground truth": truth} | {f"{db} dB": with_psnr(truth, noise, db) for db in (40, 30, 20)})

    blur = gaussian_filter(truth, (3, 3, 0))
    level = psnr(blur, truth)
    offset = with_psnr(truth, np.ones_like(truth), level)
    same = {"offset": offset, "blur": blur, "noise": with_psnr(truth, noise, level)}
    titles = {f"{what}: {psnr(i, truth):.1f} dB, SSIM {ssim(i, truth, 'zero'):.2f}": i for what, i in same.items()}
    panels("ssim.png", {"ground truth": truth} | titles)

    drifted = with_psnr(0.8 * truth + 0.2, noise, 38)
    fitted = best_gain_and_offset(drifted, truth).applied_to(drifted)
    panels(
        "psnr_affine.png",
        {
            "ground truth": truth,
            f"render: PSNR {psnr(drifted, truth):.1f} dB": drifted,
            f"after gain and offset: {psnr_affine(drifted, truth):.1f} dB": fitted,
        },
    )

    x = np.arange(160)
    surface = np.where((x > 60) & (x < 110), 2.0, 3.2)
    rendered = surface + np.random.default_rng(0).normal(0, 0.05, x.size)
    rendered[20:32] -= 1.4 * np.hanning(12)
    figure, ax = plt.subplots(figsize=(6.3, 2.2), layout="constrained")
    ax.fill_between(x, 0.9 * surface, 0, color="#d05030", alpha=0.15, lw=0)
    ax.plot(x, surface, color=INK, label="true depth")
    ax.plot(x, rendered, color="#3478b8", lw=1, label="rendered depth")
    found = rendered < 0.9 * surface
    ax.plot(x[found], rendered[found], ".", color="#d05030", label=f"floaters: {found.mean():.3f}")
    ax.set(xlabel="column, px", ylabel="z, m", ylim=(1.2, 3.6), xlim=(0, 159))
    ax.tick_params(colors=INK)
    for text in (ax.xaxis.label, ax.yaxis.label):
        text.set_color(INK)
    for spine in ax.spines.values():
        spine.set_color(INK)
    ax.legend(frameon=False, labelcolor=INK, fontsize=8, ncols=3, loc="upper right")
    save(figure, "floaters.png")


if __name__ == "__main__":
    draw()
