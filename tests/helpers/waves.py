"""Views of sine waves."""

import numpy as np

from tdgbench.scenes import Camera, View


def view(image: np.ndarray, valid: np.ndarray | None = None, rgb: np.ndarray | None = None) -> View:
    height, width = image.shape[:2]
    camera = Camera(np.diag([100.0, 100.0, 1.0]), np.eye(4), width, height)
    load_valid, load_rgb = (None if a is None else (lambda a=a: a) for a in (valid, rgb))
    return View("v", camera, lambda: image, load_rgb, load_valid=load_valid)


def wave(period: float) -> np.ndarray:
    y, x = np.mgrid[:96, :128]
    return (0.5 + 0.4 * np.sin(2 * np.pi * (x + 0.7 * y) / period))[..., None].astype(np.float32)
