"""Read image files: 8-bit gray and colour and 16-bit gray as float32 arrays in [0, 1], or pixels as they are stored."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from PIL import Image, UnidentifiedImageError
from scipy.ndimage import distance_transform_edt

from tdgbench.files import opened
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import decoding, read_bytes, regular_file
from tdgbench.scenes.temperature import TEMPERATURES, Radiometry
from tdgbench.scenes.validate import MAX_PIXELS

if TYPE_CHECKING:
    from tdgbench.scenes.scene import View

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
FORMATS = ("PNG", "JPEG", "TIFF", "BMP")  # Pillow's names
TO_GRAY = ("1", "LA", "La")  # modes of Pillow that are converted
TO_COLOR = ("P", "PA", "RGBA", "RGBa", "RGBX", "CMYK", "YCbCr", "HSV", "LAB")
COUNT_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I")
FLOAT_MODE = "F"
READ_AS_THEY_ARE = ("L", "RGB", FLOAT_MODE, *COUNT_MODES)
MOST_COUNTS = 65535  # of 16 bits
LFS_POINTER = b"version https://git-lfs"  # how such a file begins

Storage = Literal["8-bit", "16-bit", "float"]


@contextmanager
def opened_image(path: Path, content: bytes | None = None) -> Iterator[Image.Image]:
    """Open an image whose header is checked and whose pixels are not yet decoded. Raises SceneError naming the file.

    Errors of decoding inside the context become SceneError, too. Pillow's warnings are silent there: they are of
    metadata, which nothing here reads, and of sizes that are refused. content: of the file, if it has been read.
    """
    remedy = f"copy it again, or export it as {', '.join(FORMATS)}"
    with (
        decoding(path, "an image", remedy),
        warnings.catch_warnings(),
        opened(regular_file(path)) if content is None else io.BytesIO(content) as source,
    ):
        warnings.filterwarnings("ignore", module=r"PIL\.")
        try:
            found = Image.open(source, formats=FORMATS)
        except UnidentifiedImageError:
            raise _not_an_image(path, remedy) from None
        with found as image:
            if image.width * image.height > MAX_PIXELS:
                size = f"{image.width}×{image.height}"
                raise SceneError(f"{path} is {size} px; an image may have {MAX_PIXELS} pixels. Resize it")
            _check_one_picture(image, path)
            yield image


def _not_an_image(path: Path, remedy: str) -> SceneError:
    """Return the error of a file whose first bytes are of no known format."""
    with opened(path) as file:
        head = file.read(len(LFS_POINTER))
    if not head:
        return SceneError(f"{path} is empty; copy it again")
    if head == LFS_POINTER:
        return SceneError(f"{path} is a pointer of Git LFS, not the file itself; get that with git lfs pull")
    return SceneError(f"{path} cannot be read as an image: its content is of no known format; {remedy}")


def _check_one_picture(image: Image.Image, path: Path) -> None:
    """Raise SceneError for an animation or a stack, whose pages have one size; previews are smaller."""
    if image.format == "MPO" or getattr(image, "n_frames", 1) == 1:
        return
    size = image.size
    image.seek(1)
    if image.size == size:
        raise SceneError(f"{path} holds {image.n_frames} pictures; a view is one. Save one of them")  # type: ignore[attr-defined]
    image.seek(0)


def storage(path: Path) -> Storage:
    """Return how an image stores its pixels, read from its header. Raises SceneError naming the file."""
    with opened_image(path) as image:
        return "float" if image.mode == FLOAT_MODE else "16-bit" if image.mode in COUNT_MODES else "8-bit"


@contextmanager
def whole_image(path: Path) -> Iterator[Image.Image]:
    """Open an image as `opened_image`; its file is read once, and its format's checksums are right."""
    content = read_bytes(path)
    with opened_image(path, content) as image:
        if image.format == "PNG":
            image.verify()  # the checksums, which decoding ignores; the image is closed then
    with opened_image(path, content) as image:
        yield image


def read_pixels(path: Path) -> np.ndarray:
    """Read pixels (H, W, 1 or 3) as stored: uint8, counts up to 65 535, or float. Raises SceneError."""
    with whole_image(path) as opened:
        image: Image.Image = opened
        if image.mode in (*TO_GRAY, *TO_COLOR):
            image = image.convert("L" if image.mode in TO_GRAY else "RGB")
        if image.mode not in READ_AS_THEY_ARE:
            raise SceneError(f"{path} has mode {image.mode}; save it as 8- or 16-bit gray, 8-bit colour or float")
        values, mode = np.asarray(image), image.mode
    if mode in COUNT_MODES and (values.min() < 0 or values.max() > MOST_COUNTS):
        raise SceneError(f"{path} (mode {mode}) has values outside 0 to {MOST_COUNTS}")
    return values[:, :, None] if values.ndim == 2 else values


def read_image(path: Path, radiometry: Radiometry | None = None) -> np.ndarray:
    """Read an image of 8 or 16 bits as float32 (H, W, 1 or 3) in [0, 1].

    8-bit values are divided by 255. 16-bit values are divided by 65 535, or mapped to °C where `radiometry` says how,
    and these to its range. Raises SceneError naming the file.
    """
    values = read_pixels(path)
    if values.dtype == np.uint8:
        result = values.astype(np.float32)
        result /= np.float32(255)
        return result
    if np.issubdtype(values.dtype, np.floating):
        raise SceneError(f"{path} holds float values, as thermal images in °C alone may; save it with 8 or 16 bits")
    if radiometry is None or not radiometry.scale.is_known:
        return (values / float(MOST_COUNTS)).astype(np.float32)
    degC = radiometry.scale.degC(values)
    wrong = ~((degC >= TEMPERATURES[0]) & (degC <= TEMPERATURES[1]))
    if wrong.any():
        raise SceneError(
            f"{path} holds {int(wrong.sum())} pixels that are outside {TEMPERATURES[0]} to {TEMPERATURES[1]:g} °C; is "
            "degC_per_count in temperature.json right?"
        )
    low, high = radiometry.range.min, radiometry.range.max
    return np.clip((degC - low) / (high - low), 0, 1).astype(np.float32)


def is_gray(image: np.ndarray) -> bool:
    """Return whether all channels of an image (H, W, C) are equal.

    >>> is_gray(np.full((2, 2, 3), 0.5)), is_gray(np.array([[[0.1, 0.2, 0.3]]]))
    (True, False)
    """
    return image.shape[2] == 1 or bool((image == image[..., :1]).all())


def in_pseudo_colour(views: Iterable[View]) -> list[str]:
    """Return names of the views whose thermal images are pseudo-colour: their values are no temperatures."""
    return [view.name for view in views if not is_gray(view.thermal)]


def with_channels(image: np.ndarray, channels: int) -> np.ndarray:
    """Return an image (H, W, C) with 1 or 3 channels: gray is repeated, colours are averaged.

    >>> with_channels(np.array([[[0.0, 0.5, 1.0]]]), 1).tolist(), with_channels(np.array([[[0.5]]]), 3).tolist()
    ([[[0.5]]], [[[0.5, 0.5, 0.5]]])
    """
    if image.shape[2] == channels:
        return image
    return np.repeat(image, 3, axis=2) if channels == 3 else image.mean(axis=2, keepdims=True)


def nearest_valid(image: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Replace each masked pixel of an image (H, W) or (H, W, C) by the nearest valid one; None: all are valid.

    >>> nearest_valid(np.array([[1.0, 9.0, 2.0]]), np.array([[True, False, False]])).tolist()
    [[1.0, 1.0, 1.0]]
    """
    if valid is None or not valid.any():
        return image
    nearest = distance_transform_edt(~valid, return_distances=False, return_indices=True)
    return image[tuple(nearest)]


def resize(image: np.ndarray, width: int, height: int, method: Image.Resampling | None = None) -> np.ndarray:
    """Resample an image (H, W, C) to (height, width, C): area average to shrink, bilinear to grow, or by a method.

    >>> resize(np.array([[[0.0], [1.0]], [[1.0], [2.0]]], np.float32), width=1, height=1)
    array([[[1.]]], dtype=float32)
    """
    if image.shape[:2] == (height, width):
        return image
    shrinks = width <= image.shape[1] and height <= image.shape[0]
    if method is None:
        method = Image.Resampling.BOX if shrinks else Image.Resampling.BILINEAR
    planes = [Image.fromarray(np.ascontiguousarray(image[..., c])) for c in range(image.shape[2])]
    return np.stack([np.asarray(plane.resize((width, height), method)) for plane in planes], axis=-1)
