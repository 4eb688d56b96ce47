"""Pictures of a textured relief, which COLMAP registers: a wall and a board before it, from places side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

FOCAL, WIDTH, HEIGHT = 200.0, 200, 160  # px
WALL, BOARD = 6.0, 4.5  # distances in m
TEXELS = 60  # per m


def places(columns: int, rows: int) -> np.ndarray:
    """Return camera centres (columns · rows, 3) in m, on a grid of 0.4 m, in the order of a flight."""
    grid = [(c if r % 2 == 0 else columns - 1 - c, r) for r in range(rows) for c in range(columns)]
    return np.array([(0.4 * c, 0.4 * r, 0.1 * ((c + r) % 2)) for c, r in grid])


def write_relief(folder: Path, centres: np.ndarray) -> list[Path]:
    """Write float TIFF in °C, as cameras at the centres see it that look along z."""
    folder.mkdir(parents=True)
    texture = gaussian_filter(np.random.default_rng(0).normal(size=(2, 1000, 1000)), (0, 1.2, 1.2), mode="wrap")
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    paths = []
    for index, centre in enumerate(centres):
        on_board, on_wall = ([(distance - centre[2]) / FOCAL * a + c for a, c in ((x, centre[0]), (y, centre[1]))]
                             for distance in (BOARD, WALL))  # fmt: skip
        hit = np.hypot(on_board[0] % 2.5 - 1, on_board[1] % 2.5 - 1) < 0.8
        board, wall = (map_coordinates(layer, [TEXELS * place[1], TEXELS * place[0]], order=1, mode="grid-wrap")
                       for layer, place in zip(texture, (on_board, on_wall), strict=True))  # fmt: skip
        paths.append(folder / f"{index:02}.tiff")
        Image.fromarray((20 + 10 * np.where(hit, board, wall)).astype(np.float32)).save(paths[-1])
    return paths
