"""Synthetic scenes of a camera that moves along a surface and faces it, line after line, as in a survey.

`field`: nadir flight over flat ground. `hills`: the same flight over undulating ground. `wall`: a camera along a wall.

A point of a flat surface lies in the image where it lies from the camera: image = focal (point − camera) / distance. So
a vignette that is linear in the image, offsets of the views that are linear in the camera's position and a linear
gradient of the surface's temperature cancel: images do not tell them apart. Relief breaks this by its share of the
distance. The heading is the same in all lines; turns at their ends would break it, too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tdgbench.scenes.synthetic.materials import Material, Patches, Spot, Waves
from tdgbench.scenes.synthetic.raycast import Cuboid, Cylinder, Hills, Rectangle, Solid
from tdgbench.scenes.synthetic.render import World

GROUND = (  # pairs of colours
    ((0.36, 0.46, 0.22), (0.50, 0.55, 0.30)), ((0.52, 0.42, 0.30), (0.40, 0.31, 0.22)),
    ((0.76, 0.68, 0.42), (0.62, 0.55, 0.34)), ((0.34, 0.34, 0.36), (0.48, 0.47, 0.46)),
)  # fmt: skip
STUCCO, GLASS = ((0.80, 0.76, 0.66), (0.66, 0.58, 0.48)), ((0.22, 0.30, 0.36), (0.44, 0.52, 0.58))
STEEL = (0.55, 0.57, 0.60)
VIEWS_PER_LINE = 2.5  # × number of lines
STRAY = 0.003  # standard deviation of the cameras' places, × distance to the surface
TILT = 0.001  # of their directions, radians
HEIGHT, HALF_FLIGHT, HALF_LINES = 20.0, 14.0, 7.0  # m; of the flight, half its lines' length, half its width
RELIEF = 0.15  # of the hills, highest to lowest, × HEIGHT


def _lines(center: tuple[float, float, float], along: np.ndarray, across: np.ndarray, facing: np.ndarray):
    """Return cameras on parallel lines, one forth and the next one back, which all face one way.

    center: of the lines. along: from there to the end of a line. across: to the outer lines. facing: to the surface.
    """
    distance = float(np.linalg.norm(facing))

    def cameras(count: int, rng: np.random.Generator):
        lines = int(np.ceil(np.sqrt(count / VIEWS_PER_LINE)))
        per_line = int(np.ceil(count / lines))
        result = []
        for i in range(count):
            line, step = divmod(i, per_line)
            u = (2 * step / max(per_line - 1, 1) - 1) * (-1) ** line
            v = 2 * line / max(lines - 1, 1) - 1
            eye = np.array(center) + u * along + v * across + rng.normal(0, STRAY * distance, 3)
            result.append((eye, eye + facing + rng.normal(0, TILT * distance, 3)))
        return result

    return cameras


def _flight(seed: int, ground: Solid) -> World:
    """Return a nadir flight over ground of patches, each with a temperature and a texture of its own."""
    rng = np.random.default_rng([seed, 7])
    columns, rows = np.meshgrid(np.arange(-5, 6), np.arange(-4, 5))
    sites = 5.5 * (np.stack([columns.ravel(), rows.ravel()], axis=1) + rng.uniform(-0.4, 0.4, (columns.size, 2)))
    materials = [
        Material(*GROUND[rng.integers(len(GROUND))], Waves(seed * 100 + k, 0.35), rng.uniform(15.0, 29.0), 4.0)
        for k in range(len(sites))
    ]
    cameras = _lines(
        (0, 0, HEIGHT), np.array([HALF_FLIGHT, 0, 0]), np.array([0, HALF_LINES, 0]), np.array([0, 0, -HEIGHT])
    )
    return World(
        "", False, [(ground, Patches(sites, materials))], cameras, (10.0, 34.0), 0.95, (0.5, 0.3, 0.8),
        up=(0.0, 1.0, 0.0), length=2 * HALF_FLIGHT + HEIGHT / 0.95,
    )  # fmt: skip


def _field(seed: int) -> World:
    return _flight(seed, Rectangle((0, 0, 0), (500, 0, 0), (0, 500, 0)))


def _hills(seed: int) -> World:
    rng = np.random.default_rng([seed, 8])
    lengths, angles = rng.uniform(14.0, 22.0, 3), rng.uniform(0, np.pi / 3, 3) + np.arange(3) * np.pi / 3
    numbers = 2 * np.pi / lengths
    sizes = RELIEF * HEIGHT / 2 * np.array([0.5, 0.3, 0.2])
    waves = zip(sizes, numbers * np.cos(angles), numbers * np.sin(angles), rng.uniform(0, 2 * np.pi, 3), strict=True)
    return _flight(seed, Hills(tuple(waves)))


def _wall(seed: int) -> World:
    wave = lambda k, f: Waves(seed * 100 + k, f)  # noqa: E731
    rng = np.random.default_rng([seed, 9])
    leaks = tuple(
        Spot((x, 0.0, z), (rng.uniform(0.2, 0.6), 1.0, rng.uniform(0.2, 0.6)), rng.uniform(3.0, 7.0))
        for x, z in ((-3.6, 2.2), (-1.4, 4.0), (0.9, 1.9), (2.2, 4.2), (4.0, 2.6))
    )
    objects: list[tuple[Solid, Material | Patches]] = [
        (Rectangle((0, 0, 3), (40, 0, 0), (0, 0, 40)), Material(*STUCCO, wave(1, 1.6), 12.0, 3.0, spots=leaks))
    ]
    for row, z in enumerate((1.3, 3.0, 4.7)):
        for column in range(4):
            glass = Material(*GLASS, wave(2 + 10 * row + column, 1.8), rng.uniform(13.0, 19.0), 2.0)
            objects.append((Cuboid((2.1 * (column - 1.5), 0.0, z), (0.5, 0.08, 0.55)), glass))
    for number, x in enumerate((-4.2, -0.2, 2.2)):
        pipe = Material(STEEL, GLASS[1], wave(40 + number, 1.5), rng.uniform(22.0, 27.0), 2.0)
        objects.append((Cylinder((x, -0.12, -3.0), 0.07, 12.0), pipe))
    cable = Material(STEEL, GLASS[0], wave(50, 1.5), 9.0, 1.5)
    objects.append((Cuboid((0.0, -0.04, 2.15), (40.0, 0.04, 0.04)), cable))
    cameras = _lines((0, -4.0, 3.0), np.array([2.8, 0, 0]), np.array([0, 0, 1.4]), np.array([0, 4.0, 0]))
    return World("", False, objects, cameras, (4.0, 32.0), 0.95, (0.3, -0.8, 0.5), length=2 * 2.8 + 4.0 / 0.95)


SURVEYS: dict[str, Callable[[int], World]] = {"field": _field, "hills": _hills, "wall": _wall}
