"""Which cells of the contracted world training views show (`mark_untrained_grid` of torch-ngp's renderer)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from tdgbench.fields.contraction import Region
from tdgbench.splats.view import CameraLike


def visible_cells(
    cells: int, region: Region, box: np.ndarray, cameras: Sequence[CameraLike], nears: Sequence[float]
) -> Tensor:
    """Return which cells of a ball, of as many along an axis, lie in a box and in some view; bool (cells³,), x first.

    box: (2, 3) smallest and largest world coordinates. nears: z before which a camera shows nothing, world units. By
    their centres, with half a cell around the box and a whole one beside an image, as torch-ngp's, and half a cell
    before `near`, since cells are larger here: surfaces lie there.
    """
    if region.is_cube:
        raise ValueError("the cells of a cube have other sizes")
    at = torch.arange(cells**3)
    places = torch.stack([at % cells, at // cells % cells, at // cells**2], dim=1)
    contracted = (places + 0.5).double() / cells
    step = 2 / cells  # half a cell of the contracted ball, whose radius is 2
    left = (2 - 4 * (contracted - 0.5).norm(dim=1)).clamp(max=1)  # of the way to infinity: 1 in the ball, 0 there
    result = left > step
    centres, left = region.expanded(contracted[result]), left[result]
    half = step * region.radius / (left * (left + step).clamp(max=1))  # towards the ball; outwards it is more
    low, high = torch.from_numpy(box)
    inside = ((centres > low - half[:, None]) & (centres < high + half[:, None])).all(dim=1)
    shown = torch.zeros_like(inside)
    for camera, near in zip(cameras, nears, strict=True):
        K, pose = camera.K, torch.from_numpy(camera.world_to_camera)
        x, y, z = (centres @ pose[:3, :3].T + pose[:3, 3]).T
        seen = z > near - half
        for along, size, focal, middle in ((x, camera.width, K[0, 0], K[0, 2]), (y, camera.height, K[1, 1], K[1, 2])):
            seen &= (along > -middle / focal * z - 2 * half) & (along < (size - middle) / focal * z + 2 * half)
        shown |= seen
    result[result.clone()] = inside & shown
    return result
