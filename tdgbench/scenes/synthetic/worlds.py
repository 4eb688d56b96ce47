"""The synthetic scenes, which docs/built-in-scenes.md describes.

Along a flat surface, image = focal (point − camera) / distance. So a vignette linear in the image, offsets of the views
linear in the camera's position and a linear gradient of the surface's temperature cancel. The relief of `hills` breaks
this by its share of the distance; so would turns, which the lines of `field`, `hills` and `wall` have not.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.random import Generator

from tdgbench.scenes.synthetic.render import FOCAL, World
from tdgbench.scenes.synthetic.surfaces import Cuboid, Cylinder, Hills, Material, Patches, Sphere, Spot, Vector

BRICK, MORTAR = (0.62, 0.30, 0.22), (0.72, 0.68, 0.62)
WOOD, DARK_WOOD = (0.65, 0.47, 0.28), (0.38, 0.25, 0.14)
STEEL, PAINT = (0.55, 0.58, 0.62), (0.20, 0.38, 0.62)
CERAMIC, GLAZE = (0.90, 0.88, 0.82), (0.25, 0.52, 0.45)
PLASTER, STAIN = (0.78, 0.76, 0.70), (0.55, 0.52, 0.47)
GROUND = (  # pairs of colours
    ((0.36, 0.46, 0.22), (0.50, 0.55, 0.30)), ((0.52, 0.42, 0.30), (0.40, 0.31, 0.22)),
    ((0.76, 0.68, 0.42), (0.62, 0.55, 0.34)), ((0.34, 0.34, 0.36), (0.48, 0.47, 0.46)),
)  # fmt: skip
STUCCO, GLASS = ((0.80, 0.76, 0.66), (0.66, 0.58, 0.48)), ((0.22, 0.30, 0.36), (0.44, 0.52, 0.58))
SKY, MEADOW = ((0.55, 0.70, 0.90), (0.80, 0.85, 0.90)), ((0.45, 0.50, 0.33), (0.60, 0.57, 0.45))
NIGHT_SKY, ASPHALT = ((0.20, 0.22, 0.30), (0.12, 0.13, 0.20)), ((0.30, 0.30, 0.30), (0.42, 0.41, 0.39))
WINDOW, PIPE_STEEL = ((0.25, 0.32, 0.38), (0.45, 0.52, 0.58)), (0.55, 0.57, 0.60)
VIEWS_PER_LINE = 2.5  # × number of lines
STRAY = 0.003  # standard deviation of the cameras' places, × distance to the surface
TILT = 0.001  # of their directions, radians
HEIGHT, HALF_FLIGHT, HALF_LINES = 20.0, 14.0, 7.0  # m; of the flight, half its lines' length, half its width
TO_WALL, HALF_WALK, HALF_RISE = 4.0, 2.8, 1.4  # m; from the camera to `wall`, half its lines' length, half their height
APART = 5  # every n-th view of half_seen is from elsewhere: the test views of the split eighty_twenty
CIRCLE = 2 * np.pi  # radians
RELIEF = 0.15  # of the hills, highest to lowest, × HEIGHT

Places = tuple[np.ndarray, np.ndarray]  # eyes and targets (V, 3) of cameras


def _lines(count: int, rng: Generator, center: Vector, along: Vector, across: Vector, facing: Vector) -> Places:
    """Place cameras on parallel lines, one forth and the next one back, which all face one way.

    center: of the lines. along: from there to the end of a line. across: to the outer lines. facing: to the surface.
    """
    lines = int(np.ceil(np.sqrt(count / VIEWS_PER_LINE)))
    per_line = int(np.ceil(count / lines))
    line, step = np.divmod(np.arange(count)[:, None], per_line)
    u, v = _spread(step, per_line) * (-1.0) ** line, _spread(line, lines)
    deviations = np.array([[STRAY], [TILT]]) * np.linalg.norm(facing)
    stray, tilt = rng.normal(0, deviations, (count, 2, 3)).transpose(1, 0, 2)
    eyes = np.array(center) + u * along + v * across + stray
    return eyes, eyes + facing + tilt


def _ring(count: int, rng: Generator, radius: float, height: float, target: Vector, arc=CIRCLE, middle=0.0) -> Places:
    """Place cameras on an arc about the vertical axis, at two alternating heights, looking at `target`.

    arc, middle: length of the arc and direction of its middle, radians.
    """
    index = np.arange(count)
    angle = middle + arc * (index / count if arc >= CIRCLE else index / max(count - 1, 1) - 0.5)
    z = height * (1.0 + 0.25 * (index % 2)) + rng.normal(0, 0.02, count)
    eyes = np.column_stack([np.cos(angle) * radius + target[0], np.sin(angle) * radius + target[1], z])
    return eyes, np.tile(target, (count, 1))


def _one_side(count: int, rng: Generator, arc: float, **ring: Any) -> Places:
    """Place cameras on an arc as `_ring` does, but every `APART`th, from the first on, on the whole ring."""
    is_apart = np.arange(count) % APART == 0
    places = np.empty((2, count, 3))
    for chosen, angle in ((is_apart, CIRCLE), (~is_apart, arc)):
        places[:, chosen] = _ring(int(chosen.sum()), rng, arc=angle, **ring)
    return places[0], places[1]


def _grid(count: int, rng: Generator) -> Places:
    """Place cameras on a wavy grid 3.2 m in front of a wall at y = 0, looking along +y."""
    columns = int(np.ceil(np.sqrt(count * 0.9 / 0.5)))
    row, column = np.divmod(np.arange(count), columns)
    places = [_spread(column, columns) * 0.9, np.full(count, -3.2), 1.5 + _spread(row, -(-count // columns)) * 0.5]
    eyes = np.stack(places, axis=1) + rng.normal(0, 0.03, (count, 3))
    return eyes, np.stack([0.6 * eyes[:, 0], np.zeros(count), 1.5 + 0.3 * (eyes[:, 2] - 1.5)], axis=1)


def _spread(index: np.ndarray, count: int) -> np.ndarray:
    """Return places number `index` of `count` even places from −1 to 1."""
    return 2 * index / max(count - 1, 1) - 1


def _objects(seed: int, *rows: tuple[Any, ...], first: int = 1) -> list[tuple[Any, Any]]:
    """Return solids and their materials. first: number of the first one's pattern.

    rows: a solid, and all of its material but the pattern's seed.
    """
    return [(solid, Material(colors, 100 * seed + k, *more)) for k, (solid, colors, *more) in enumerate(rows, first)]


def orbit(seed: int) -> World:
    on_table, on_box = Spot((0.5, 0.2, 0.5), (0.4, 0.4, 0.4), 9.0), Spot((-0.35, 0.1, 0.9), (0.2, 0.2, 0.2), 8.0)
    objects = _objects(
        seed,
        (Sphere((0, 0, 0), 9.0), SKY, 0.10, 12.0, 3.0),
        (Cuboid((0, 0, 0), (8.7, 8.7, 0)), MEADOW, 0.6, 17.0, 4.0),
        (Cylinder((0, 0, 0), 1.3, 0.5), (WOOD, DARK_WOOD), 1.5, 20.0, 2.5, 0.0, (on_table,)),
        (Cuboid((-0.35, 0.35, 0.8), (0.35, 0.28, 0.3), 0.5), (STEEL, PAINT), 2.0, 29.0, 3.0, 0.0, (on_box,)),
        (Sphere((0.45, 0.25, 0.78), 0.28), (CERAMIC, GLAZE), 2.0, 40.0, 2.0, -6.0),
        (Cylinder((0.1, -0.55, 0.5), 0.2, 0.55), (GLAZE, CERAMIC), 2.5, 8.0, 2.0, 6.0),
    )
    cameras = partial(_ring, radius=3.2, height=1.7, target=(0, 0, 0.6))
    return World(objects, cameras, (5.0, 42.0), group="day", pseudo_color=True)


def night(seed: int) -> World:
    leak, on_machine = Spot((1.3, 3.0, 1.2), (0.35, 1.0, 0.9), 12.0), Spot((-0.5, 0.5, 0.6), (0.4, 0.4, 0.3), 16.0)
    objects = _objects(
        seed,
        (Sphere((0, 0, 0), 14.0), NIGHT_SKY, 0.08, 2.0, 2.0),
        (Cuboid((0, 0, 0), (13.5, 13.5, 0)), ASPHALT, 0.5, 7.0, 3.0),
        (Cuboid((0, 3.0, 1.6), (4.0, 0, 1.6)), (BRICK, MORTAR), 1.2, 11.0, 2.5, 0.8, (leak,)),
        (Cuboid((-0.8, 0.9, 0.55), (0.7, 0.45, 0.55), 0.3), (PAINT, STEEL), 1.4, 18.0, 2.5, 0.0, (on_machine,)),
        (Cylinder((0.9, 0.6, 0.0), 0.35, 1.3), (STEEL, STAIN), 1.6, 24.0, 2.0, 5.0),
        (Sphere((0.1, -0.3, 0.3), 0.3), (CERAMIC, STAIN), 1.8, 33.0, 2.0, -5.0),
    )
    cameras = partial(_ring, radius=4.2, height=1.5, target=(0, 0.9, 0.8), arc=np.radians(110), middle=np.radians(-90))
    return World(
        objects, cameras, (0.0, 36.0), group="dark", pseudo_color=True, focal=0.9, light=(0.2, -0.6, 0.75),
        exposure=0.05, point_share=0.6,
    )  # fmt: skip


def turntable(seed: int) -> World:
    on_table, on_side = Spot((0, 0, 0), (0.8, 0.8, 0.5), 5.0), Spot((0.4, 0.3, 0.2), (0.3, 0.3, 0.2), 8.0)
    objects = _objects(
        seed,
        (Sphere((0, 0, 0), 6.0), (PLASTER, STAIN), 0.15, 21.0, 2.0),
        (Cuboid((0, 0, 0), (5.7, 5.7, 0)), (DARK_WOOD, WOOD), 0.7, 20.0, 2.5, 0.0, (on_table,)),
        (Cylinder((0, 0, 0), 0.55, 0.7), (STEEL, STAIN), 1.8, 38.0, 2.0, 9.0, (on_side,)),
        (Sphere((0.0, 0.0, 0.95), 0.38), (CERAMIC, GLAZE), 1.6, 33.0, 4.0),
        (Cuboid((0.95, -0.5, 0.25), (0.28, 0.2, 0.25), 0.8), (PAINT, CERAMIC), 2.0, 27.0, 3.0, 4.0),
        (Cuboid((-0.7, 0.85, 0.2), (0.22, 0.3, 0.2), -0.4), (GLAZE, WOOD), 2.0, 17.0, 2.0),
    )
    cameras = partial(_ring, radius=2.8, height=1.4, target=(0, 0, 0.5))
    return World(objects, cameras, (14.0, 50.0), group="360")


def facade(seed: int) -> World:
    leaks = (Spot((1.1, 0.0, 2.3), (0.25, 1.0, 0.5), 6.0), Spot((-1.2, 0.0, 0.9), (0.5, 1.0, 0.22), 8.0))
    objects = _objects(
        seed,
        (Cuboid((0, 0.0, 1.8), (6.0, 0, 4.0)), (PLASTER, BRICK), 0.9, 12.0, 2.0, 0.6, leaks),
        (Cuboid((-0.7, 0.0, 2.1), (0.45, 0.12, 0.6)), WINDOW, 1.2, 17.0, 2.0, 0.8),
        (Cuboid((0.6, -0.05, 1.2), (0.4, 0.25, 0.35)), (STEEL, PAINT), 1.6, 24.0, 3.0, 3.0),
        (Cylinder((1.35, -0.5, 0.2), 0.16, 2.0), (STEEL, STAIN), 1.6, 30.0, 2.0, -3.0),
        (Sphere((-0.35, -0.6, 0.85), 0.25), (CERAMIC, GLAZE), 1.8, 8.0, 2.0, 2.0),
    )
    return World(objects, _grid, (4.0, 34.0), group="forward", light=(0.3, -0.8, 0.5))


def field(seed: int) -> World:
    return _flight(seed, Cuboid((0, 0, 0), (500, 500, 0)))


def hills(seed: int) -> World:
    rng = np.random.default_rng([seed, 8])
    lengths, angles = rng.uniform(14.0, 22.0, 3), rng.uniform(0, np.pi / 3, 3) + np.arange(3) * np.pi / 3
    sizes, numbers = RELIEF * HEIGHT / 2 * np.array([0.5, 0.3, 0.2]), 2 * np.pi / lengths
    phases = rng.uniform(0, 2 * np.pi, 3)
    return _flight(seed, Hills(np.array([sizes, numbers * np.cos(angles), numbers * np.sin(angles), phases])))


def _flight(seed: int, ground: Cuboid | Hills) -> World:
    """Return a nadir flight over ground of patches, each with a temperature and a texture of its own."""
    rng = np.random.default_rng([seed, 7])
    columns, rows = np.meshgrid(np.arange(-5, 6), np.arange(-4, 5))
    sites = 5.5 * (np.stack([columns.ravel(), rows.ravel()], axis=1) + rng.uniform(-0.4, 0.4, (columns.size, 2)))
    materials = [
        Material(GROUND[rng.integers(len(GROUND))], 100 * seed + k, 0.35, rng.uniform(15.0, 29.0), 4.0)
        for k in range(len(sites))
    ]
    along, across = (HALF_FLIGHT, 0, 0), (0, HALF_LINES, 0)
    return World(
        [(ground, Patches(sites, materials))],
        partial(_lines, center=(0, 0, HEIGHT), along=along, across=across, facing=(0, 0, -HEIGHT)),
        (10.0, 34.0), light=(0.5, 0.3, 0.8), up=(0.0, 1.0, 0.0), length=2 * HALF_FLIGHT + HEIGHT / FOCAL,
    )  # fmt: skip


def wall(seed: int) -> World:
    rng = np.random.default_rng([seed, 9])
    leaks = tuple(
        Spot((x, 0.0, z), (rng.uniform(0.2, 0.6), 1.0, rng.uniform(0.2, 0.6)), rng.uniform(3.0, 7.0))
        for x, z in ((-3.6, 2.2), (-1.4, 4.0), (0.9, 1.9), (2.2, 4.2), (4.0, 2.6))
    )
    objects = _objects(seed, (Cuboid((0, 0, 3), (40, 0, 40)), STUCCO, 1.6, 12.0, 3.0, 0.0, leaks))
    for row, z in enumerate((1.3, 3.0, 4.7)):
        panes = [Cuboid((2.1 * (column - 1.5), 0.0, z), (0.5, 0.08, 0.55)) for column in range(4)]
        glazing = [(pane, GLASS, 1.8, rng.uniform(13.0, 19.0), 2.0) for pane in panes]
        objects += _objects(seed, *glazing, first=2 + 10 * row)
    pipes = [Cylinder((x, -0.12, -3.0), 0.07, 12.0) for x in (-4.2, -0.2, 2.2)]
    plumbing = [(pipe, (PIPE_STEEL, GLASS[1]), 1.5, rng.uniform(22.0, 27.0), 2.0) for pipe in pipes]
    cable = (Cuboid((0.0, -0.04, 2.15), (40.0, 0.04, 0.04)), (PIPE_STEEL, GLASS[0]), 1.5, 9.0, 1.5)
    objects += _objects(seed, *plumbing, first=40) + _objects(seed, cable, first=50)
    along, across = (HALF_WALK, 0, 0), (0, 0, HALF_RISE)
    cameras = partial(_lines, center=(0, -TO_WALL, 3.0), along=along, across=across, facing=(0, TO_WALL, 0))
    return World(objects, cameras, (4.0, 32.0), light=(0.3, -0.8, 0.5), length=2 * HALF_WALK + TO_WALL / FOCAL)


def half_seen(seed: int) -> World:
    leaks = (
        Spot((0.2, -1.3, 0.9), (0.4, 0.3, 0.3), 7.0), Spot((-1.8, 0.5, 0.6), (0.3, 0.5, 0.4), 8.0),
        Spot((-0.2, 1.3, 1.6), (0.5, 0.3, 0.4), 9.0), Spot((1.8, 0.2, 1.2), (0.3, 0.4, 0.5), 6.0),
    )  # fmt: skip
    objects = _objects(
        seed,
        (Sphere((0, 0, 0), 16.0), SKY, 0.08, 2.0, 2.0),
        (Cuboid((0, 0, 0), (15.5, 15.5, 0)), GROUND[0], 0.4, 9.0, 3.0),
        (Cuboid((0, 0, 1.1), (1.8, 1.3, 1.1)), (BRICK, MORTAR), 1.0, 14.0, 2.5, 0.6, leaks),
        (Cuboid((0, 0, 2.3), (2.0, 1.5, 0.1)), (DARK_WOOD, WOOD), 0.9, 6.0, 2.0),
        (Cuboid((-1.0, 0.6, 2.8), (0.22, 0.22, 0.5)), (BRICK, STAIN), 1.5, 19.0, 3.0, 3.0),
        (Cylinder((2.6, 1.2, 0.0), 0.35, 1.2), (STEEL, PAINT), 1.4, 22.0, 2.0, 3.0),
        (Sphere((-1.6, -2.3, 0.4), 0.4), (GLAZE, CERAMIC), 1.4, 18.0, 3.0),
        (Cuboid((-0.8, 1.9, 0.45), (0.5, 0.25, 0.45), 0.2), (STEEL, PAINT), 1.6, 25.0, 3.0),
    )
    windows = [Cuboid((x, y, 1.3), (0.35, 0.06, 0.45)) for x, y in ((-1.0, -1.3), (1.0, -1.3), (-0.9, 1.3), (0.9, 1.3))]
    glazing = [(window, GLASS, 1.4, 19.0 + number, 2.0) for number, window in enumerate(windows)]
    objects += _objects(seed, *glazing, first=10)
    arc, middle = np.radians([140, -90])
    cameras = partial(_one_side, radius=6.0, height=2.6, target=(0, 0, 1.1), arc=arc, middle=middle)
    return World(objects, cameras, (-1.0, 33.0), light=(0.3, -0.6, 0.75), apart=APART)


MAKERS = orbit, night, turntable, facade, field, hills, wall, half_seen
WORLDS: dict[str, Callable[[int], World]] = {make.__name__: make for make in MAKERS}
