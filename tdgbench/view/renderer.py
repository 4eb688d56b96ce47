"""Render a look at some cells from a camera: pixel values, and the picture in colours that the browser shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from tdgbench.cells.renders import background_of
from tdgbench.present.colour_scale import in_range
from tdgbench.present.colours import colored, expected_depth, shaded
from tdgbench.scenes import Camera
from tdgbench.scenes.modalities import LABELS, OTHERS, THERMAL
from tdgbench.scoring import to_8bit
from tdgbench.splats.determinacy import Determinacy
from tdgbench.splats.render import render_view
from tdgbench.splats.view import GaussianTensors, Pinhole
from tdgbench.view.cells import ViewedCell

COLOR_MAPS = ("inferno", "gray", "viridis", "magma", "plasma", "turbo", "coolwarm")
GEOMETRY = ("depth", "alpha")
QUANTITIES = (THERMAL, "depth", *OTHERS, "alpha")  # what a look may show: the image of a modality, or geometry
DEPTH_VIEWS, DEPTH_WIDTH, DEPTH_TAILS = 5, 96, (2, 98)  # cameras, px, percentiles that the depth range is found from


def wiped(left: np.ndarray, right: np.ndarray, share: float) -> np.ndarray:
    """Join two pictures (H, W, 3) of one size in one, divided by a white line after `share` of the width.

    >>> wiped(np.zeros((1, 4, 3), np.uint8), np.full((1, 4, 3), 9, np.uint8), 0.5)[0, :, 0].tolist()
    [0, 0, 255, 9]
    """
    divide = round(share * left.shape[1])
    joined = np.concatenate([left[:, :divide], right[:, divide:]], axis=1)
    if 0 < divide < left.shape[1]:
        joined[:, divide] = 255
    return joined


def labelled(picture: np.ndarray, share: float, left: str = "", right: str = "") -> np.ndarray:
    """Return a picture (H, W, 3) uint8 with names at the bottom, left and right of a share of its width."""
    image = Image.fromarray(picture)
    draw, divide, gap = ImageDraw.Draw(image), share * image.width, image.height / 80
    font = ImageFont.load_default(max(8.0, image.height / 36))
    for text, x, anchor in ((left, divide - gap, "rb"), (right, divide + gap, "lb")):
        draw.text((x, image.height - gap), text, "white", font, anchor, stroke_width=1, stroke_fill="black")
    return np.asarray(image)


class Look(NamedTuple):
    """A choice of what the viewer shows."""

    cell: str
    quantity: str = THERMAL
    colors: str = "inferno"  # matplotlib's colour map of gray thermal images, depth and alpha
    span: tuple[float, float] = (0.0, 1.0)  # part of the quantity's range that the colour map covers
    beside: str = ""  # cell to the right of the divide
    divide: float = 0.5  # share of the width
    guesses: bool = False  # whether pixels are blue where the model guesses


@dataclass(frozen=True)
class CellRender:
    """A cell's render of one quantity."""

    values: np.ndarray  # (H, W, C) float32; depth is NaN where there is no surface
    picture: np.ndarray  # (H, W, 3) uint8
    cell: str


@dataclass(frozen=True)
class RenderedLook:
    """A rendered look. parts: the cell, and the one to the right of the divide."""

    look: Look
    parts: tuple[CellRender, ...]
    whole: tuple[float, float] | None  # the quantity's whole range in the first part

    @property
    def picture(self) -> np.ndarray:
        """The picture (H, W, 3) uint8, with the names of the cells if the look has two."""
        first, last, divide = self.parts[0], self.parts[-1], self.look.divide
        if len(self.parts) == 2:
            return labelled(wiped(first.picture, last.picture, divide), divide, first.cell, last.cell)
        return labelled(first.picture, 0.0, right=first.cell) if self.look.beside else first.picture

    def at(self, x: float, y: float) -> list[tuple[str, np.ndarray]]:
        """Return each cell's values (C,) at a place; x and y are shares of the width and height."""
        height, width = self.parts[0].values.shape[:2]
        row, column = min(int(y * height), height - 1), min(int(x * width), width - 1)
        return [(part.cell, part.values[max(row, 0), max(column, 0)]) for part in self.parts]


class Renderer:
    """A renderer of cells of one scene with the splat core; not for several threads at a time."""

    def __init__(self, cells: dict[str, ViewedCell]) -> None:
        self.cells = cells
        self.forget()

    def forget(self) -> None:
        """Read the cells anew."""
        self._models: dict[tuple[str, str], GaussianTensors] = {}
        self._determinacy: dict[str, Determinacy] = {}
        self._depth_range: tuple[float, float] | None = None

    def prepare(self) -> None:
        """Compile the kernels of every look, and find the depth range, so that no browser waits for them."""
        self.depth_range()
        for name, cell in self.cells.items():
            camera = _shrunk(next(iter(cell.cameras.values())))
            for quantity in QUANTITIES:
                if self.has(name, quantity):
                    self.values(name, quantity, camera)

    def render(self, look: Look, camera: Camera) -> RenderedLook:
        """Render a look from a camera. A cell that lacks the quantity is left out. Raises ValueError if both do."""
        names = [name for name in dict.fromkeys([look.cell, look.beside]) if self.has(name, look.quantity)]
        if not names:
            raise ValueError(f"no cell has {LABELS.get(look.quantity, look.quantity)}")
        parts = tuple(self._part(name, look, camera, names[0]) for name in names)
        return RenderedLook(look, parts, self.range_of(names[0], look.quantity))

    def has(self, name: str, quantity: str) -> bool:
        """Return whether there is such a cell and it has a quantity."""
        return name in self.cells and (quantity in GEOMETRY or quantity in self.cells[name].modalities)

    def range_of(self, name: str, quantity: str) -> tuple[float, float] | None:
        """Return the values at the ends of a quantity's whole range; None if its pictures are colours already."""
        if quantity == "depth":
            return self.depth_range()
        cell = self.cells[name]
        is_gray = cell.models.get(THERMAL, cell.record).channels == 1
        return (0.0, 1.0) if quantity == "alpha" or (quantity == THERMAL and is_gray) else None

    def depth_range(self) -> tuple[float, float]:
        """Return z between which nearly all surfaces lie, in world units, as the first cell's cameras see them."""
        if self._depth_range is None:
            name, cell = next(iter(self.cells.items()))
            cameras = list(cell.cameras.values())
            some = cameras[:: max(1, len(cameras) // DEPTH_VIEWS)][:DEPTH_VIEWS]
            seen = [self.values(name, "depth", _shrunk(camera)) for camera in some]
            known = np.concatenate([z[np.isfinite(z)] for z in seen])
            low, high = np.percentile(known, DEPTH_TAILS) if len(known) else (0.0, 1.0)
            self._depth_range = (float(low), float(max(high, low + 1e-6)))
        return self._depth_range

    @torch.no_grad()
    def values(self, name: str, quantity: str, camera: Camera) -> np.ndarray:
        """Return a cell's values from a camera, (H, W, C) float32: image values, z in world units, or alpha."""
        is_geometry = quantity in GEOMETRY
        modality = THERMAL if is_geometry else quantity
        cell = self.cells[name]
        if cell.method is not None:
            render = cell.method.render_from(camera, modality)
        else:
            gaussians, background = self._model(name, modality), background_of(cell.record, modality)
            if is_geometry:  # colours are not used; the kernels with one channel or more are there from training
                gaussians = gaussians._replace(sh_degree=0)
            render = render_view(gaussians, Pinhole.of(camera), depth=is_geometry, background=background)
        if quantity == "alpha":
            return render.alpha[..., None].numpy()
        if quantity == "depth":
            return expected_depth(render)[..., None]
        image: np.ndarray = render.image.numpy()
        return cell.response.temperatures(image) if modality == THERMAL else image

    def determinacy(self, name: str, camera: Camera) -> np.ndarray:
        """Return the determinacy (H, W) of a cell's pixels from a camera; the first time, of all training views."""
        if name not in self._determinacy:
            cell = self.cells[name]
            self._determinacy[name] = Determinacy.of_model(cell.models[THERMAL], cell.train.values())
        determinacy: np.ndarray = self._determinacy[name].image(camera).numpy()
        return determinacy

    def _part(self, name: str, look: Look, camera: Camera, first: str) -> CellRender:
        """Render a cell; equal °C, where they are known, have the colours that they have in the cell `first`."""
        values = self.values(name, look.quantity, camera)
        whole = self.range_of(name, look.quantity)
        if whole is None:
            picture = to_8bit(values)
        else:
            low, high = (whole[0] + share * (whole[1] - whole[0]) for share in look.span)
            known = [self.cells[one].degC for one in (first, name)]
            if look.quantity == THERMAL and None not in known:  # else each has the colours of its own range
                low, high = in_range(low, high, *known)
            picture = colored(values[..., 0], look.colors, low, high)
        if look.guesses and THERMAL in self.cells[name].models:  # what is a guess is known of Gaussians
            picture = shaded(picture, self.determinacy(name, camera))
        return CellRender(values, picture, name)

    def _model(self, name: str, modality: str) -> GaussianTensors:
        """Return the activated Gaussians of a model, kept for the next frames."""
        if (name, modality) not in self._models:
            gaussians = self.cells[name].models[modality]
            self._models[name, modality] = gaussians.activated(gaussians.sh_degree)
        return self._models[name, modality]


def _shrunk(camera: Camera) -> Camera:
    width = min(DEPTH_WIDTH, camera.width)
    return camera.resized(width, max(1, round(camera.height * width / camera.width)))
