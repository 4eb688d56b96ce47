"""Batches of rays through random pixels of the training views, for methods that render pixels instead of images."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tdgbench.fields import Rays, rays_of
from tdgbench.scenes import View
from tdgbench.training.curriculum import Curriculum
from tdgbench.training.images import MODALITIES, THERMAL
from tdgbench.training.part import RandomStream


class RayBatch(NamedTuple):
    """Rays with the pixels that they go through."""

    rays: Rays
    pixels: dict[str, Tensor]  # (R, C) by modality, or by the name of a further map
    views: Tensor  # (R,) numbers of the training views


class _Pixels(NamedTuple):
    """The pixels of several views, one view after the other, each row by row."""

    numbers: Tensor  # (V,) of the views among all training views
    starts: Tensor  # (V,) number of a view's first pixel
    widths: Tensor  # (V,) px
    valid: Tensor | None  # (M,) numbers of the pixels that count; None: all
    number: int  # of pixels that count
    K: Tensor  # (V, 3, 3)
    viewmats: Tensor  # (V, 4, 4)
    values: dict[str, Tensor]  # (pixels, C) by modality or map


class RayBatches(RandomStream):
    """Draws pixels uniformly among all of the training views, with replacement; of thermal images, those that count."""

    def __init__(
        self,
        views: Sequence[View],
        seed: int,
        curriculum: Curriculum,
        modalities: Sequence[str],
        device: torch.device,
        maps: Mapping[str, Callable[[View], Tensor]] | None = None,
    ) -> None:
        """curriculum: which of the views, and at which resolution. modalities: whose pixels are read.

        maps: further values (H, W, C) of a view, in the size of its image, by name.
        """
        super().__init__(seed)
        self.views, self.curriculum, self.modalities, self.device = views, curriculum, modalities, device
        self.maps = maps or {}
        self._pixels: tuple[tuple[int, bool], _Pixels] | None = None  # of a scale, and whether views are held out

    def next(self, count: int) -> RayBatch:
        """Return the next rays."""
        state = self.curriculum.scale, self.curriculum.is_holding
        if self._pixels is None or self._pixels[0] != state:
            self._pixels = state, self._read()
        pixels = self._pixels[1]
        drawn = torch.randint(pixels.number, (count,), generator=self.generator).to(self.device)
        if pixels.valid is not None:
            drawn = pixels.valid[drawn]
        view = torch.searchsorted(pixels.starts, drawn, right=True) - 1
        place, width = drawn - pixels.starts[view], pixels.widths[view]
        at = torch.stack([place % width, place // width], dim=1)
        rays = rays_of(at, pixels.K[view], pixels.viewmats[view])
        values = {name: values[drawn] for name, values in pixels.values.items()}
        return RayBatch(rays, values, pixels.numbers[view])

    def _read(self) -> _Pixels:
        """Read the pixels of all views that are shown, at the curriculum's resolution."""
        shown = [(n, self.curriculum.at_resolution(v)) for n, v in enumerate(self.views) if self.curriculum.shows(v)]
        views = [view for _, view in shown]
        sizes = np.array([view.camera.width * view.camera.height for view in views])
        valid, masks = None, [THERMAL.valid(view) if THERMAL.name in self.modalities else None for view in views]
        if any(mask is not None for mask in masks):
            full = [np.ones(size, bool) if m is None else m.ravel() for m, size in zip(masks, sizes, strict=True)]
            valid = torch.from_numpy(np.concatenate(full)).nonzero().squeeze(1).to(self.device)
        values = {
            name: torch.cat([MODALITIES[name].tensors_of(v, self.device)[0].flatten(0, 1) for v in views])
            for name in self.modalities
        }
        for name, map_of in self.maps.items():
            values[name] = torch.cat([map_of(view).to(self.device).flatten(0, 1) for view in views])
        K, viewmats = (
            torch.from_numpy(np.stack(arrays).astype(np.float32)).to(self.device)
            for arrays in ([v.camera.K for v in views], [v.camera.world_to_camera for v in views])
        )
        numbers, starts, widths = (
            torch.tensor(list(column), device=self.device)
            for column in ([n for n, _ in shown], np.cumsum(sizes) - sizes, [v.camera.width for v in views])
        )
        count = int(sizes.sum()) if valid is None else len(valid)
        return _Pixels(numbers, starts, widths, valid, count, K, viewmats, values)
