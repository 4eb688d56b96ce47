"""Scenes whose training views have known errors of a thermal camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tdgbench.scenes import Scene, View


def with_response(scene: Scene, offsets: np.ndarray, gains: np.ndarray) -> Scene:
    """The scene as a drifting camera shows its training views, in image values; nothing is clipped.

    offsets, gains: (V,) of the training views, about an image value of 0.5.
    """
    train = [_shown(view, *one) for view, *one in zip(scene.train, offsets, gains, strict=True)]
    return replace(scene, train=train)


def _shown(view: View, offset: float, gain: float) -> View:
    image = 0.5 + gain * (view.thermal - 0.5) + offset
    return replace(view, load_thermal=lambda: image.astype(np.float32))


def drift(count: int, size: float, seed: int = 0) -> np.ndarray:
    """Offsets (count,) of mean 0 whose root mean square is `size`."""
    values = np.random.default_rng(seed).normal(size=count)
    values -= values.mean()
    return size * values / np.sqrt(np.mean(values**2))
