"""Masks, and scenes whose views have them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tdgbench.scenes import Scene, View


def masks(height: int, width: int) -> dict[str, np.ndarray]:
    """Masks of one size by name, bool (H, W)."""
    rng = np.random.default_rng(height * width)
    rows, corner, one = (np.zeros((height, width), bool) for _ in range(3))
    rows[height // 3 : height // 2 + 1] = True
    corner[: height // 2 + 1, : width // 2 + 1] = True
    one[height // 2, width // 2] = True
    board = np.indices((height, width)).sum(axis=0) % 2 == 0
    return {
        "some rows": rows, "a corner": corner, "one pixel": one, "a chessboard": board,
        "all but one": ~one if height * width > 1 else one, "at random": (rng.random((height, width)) < 0.7) | one,
        "all": np.ones((height, width), bool),
    }  # fmt: skip


def with_garbage(view: View, valid: np.ndarray, garbage: np.ndarray | float) -> View:
    """A view with a mask, whose image holds `garbage` at masked pixels."""
    image = view.load_thermal()
    spoilt = np.where(valid[..., None], image, np.float32(garbage)).astype(np.float32)
    return replace(view, load_thermal=lambda: spoilt, load_valid=lambda: valid)


def masked_scene(scene: Scene, garbage: str = "noise") -> Scene:
    """A scene whose views, but for the first of each part, are masked by a moving frame.

    garbage: `noise`, `nan` or `zeros` in masked pixels.
    """

    def masked(views: list[View]) -> list[View]:
        return [view if i == 0 else _framed(view, i, garbage) for i, view in enumerate(views)]

    return replace(scene, train=masked(scene.train), test=masked(scene.test))


def _framed(view: View, number: int, garbage: str) -> View:
    height, width = view.camera.height, view.camera.width
    valid = np.zeros((height, width), bool)
    valid[2 : height - number % 5, number : width - 7] = True
    valid[height // 2, width // 2 :] = False
    if garbage == "noise":
        noise = np.random.default_rng(number).normal(0.5, 3.0, view.load_thermal().shape)
        return with_garbage(view, valid, noise)
    return with_garbage(view, valid, np.nan if garbage == "nan" else 0.0)
