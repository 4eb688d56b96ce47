"""The synthetic scenes: one per group of the paper's table, three surveys of a surface, and a building.

`orbit`: day light, pseudo-colour, cameras around a table. `night`: nearly black RGB, warm machines in front of a wall
with a heat leak. `turntable`: a full circle, gray thermal. `facade`: forward-facing, gray thermal.

`half_seen`: a building photographed from one side; test views are taken from all around it.

The surveys go line after line: `field`: nadir flight over flat ground. `hills`: the same flight over
undulating ground. `wall`: a camera along a wall. A point of a flat surface lies in the image where it lies from the
camera: image = focal (point − camera) / distance. So a vignette that is linear in the image, offsets of the views that
are linear in the camera's position and a linear gradient of the surface's temperature cancel: images do not tell them
apart. Relief breaks this by its share of the distance. The heading is the same in all lines; turns at their ends would
break it, too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tdgbench.scenes.synthetic.render import World
from tdgbench.scenes.synthetic.surfaces import (
    Cuboid,
    Cylinder,
    Hills,
    Material,
    Patches,
    Rectangle,
    Solid,
    Sphere,
    Spot,
    Waves,
)

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
ASPHALT, PIPE_STEEL = ((0.30, 0.30, 0.30), (0.42, 0.41, 0.39)), (0.55, 0.57, 0.60)
VIEWS_PER_LINE = 2.5  # × number of lines
STRAY = 0.003  # standard deviation of the cameras' places, × distance to the surface
TILT = 0.001  # of their directions, radians
HEIGHT, HALF_FLIGHT, HALF_LINES = 20.0, 14.0, 7.0  # m; of the flight, half its lines' length, half its width
APART = 5  # every so manieth view of half_seen is from elsewhere: those that the split eighty_twenty tests
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
        pipe = Material(PIPE_STEEL, GLASS[1], wave(40 + number, 1.5), rng.uniform(22.0, 27.0), 2.0)
        objects.append((Cylinder((x, -0.12, -3.0), 0.07, 12.0), pipe))
    cable = Material(PIPE_STEEL, GLASS[0], wave(50, 1.5), 9.0, 1.5)
    objects.append((Cuboid((0.0, -0.04, 2.15), (40.0, 0.04, 0.04)), cable))
    cameras = _lines((0, -4.0, 3.0), np.array([2.8, 0, 0]), np.array([0, 0, 1.4]), np.array([0, 4.0, 0]))
    return World("", False, objects, cameras, (4.0, 32.0), 0.95, (0.3, -0.8, 0.5), length=2 * 2.8 + 4.0 / 0.95)


def _ring(radius: float, height: float, target: tuple[float, float, float], arc: float, center_angle: float = 0.0):
    """Return cameras on an arc (radians) about the vertical axis, at two alternating heights, looking at `target`."""

    def cameras(count: int, rng: np.random.Generator):
        whole = arc >= 2 * np.pi
        steps = np.arange(count) / (count if whole else max(count - 1, 1)) - (0.0 if whole else 0.5)
        result = []
        for i, step in enumerate(steps):
            angle = center_angle + arc * step
            eye = np.array([np.cos(angle), np.sin(angle), 0]) * radius
            eye[2] = height * (1.0 + 0.25 * (i % 2)) + rng.normal(0, 0.02)
            result.append((eye + np.array([target[0], target[1], 0]), np.array(target)))
        return result

    return cameras


def _one_side(radius: float, height: float, target: tuple[float, float, float], arc: float, center_angle: float):
    """Return cameras on an arc as `_ring` does, but every `APART`th, from the first on, on the whole ring."""
    side, around = (_ring(radius, height, target, angle, center_angle) for angle in (arc, 2 * np.pi))

    def cameras(count: int, rng: np.random.Generator):
        tests = iter(around(-(-count // APART), rng))
        trained = iter(side(count - -(-count // APART), rng))
        return [next(trained if i % APART else tests) for i in range(count)]

    return cameras


def _grid(distance: float, half_width: float, half_height: float, height: float):
    """Return cameras on a wavy grid in front of a wall at y = 0, looking along +y."""

    def cameras(count: int, rng: np.random.Generator):
        columns = int(np.ceil(np.sqrt(count * half_width / half_height)))
        rows = int(np.ceil(count / columns))
        result = []
        for i in range(count):
            u = 2 * (i % columns) / max(columns - 1, 1) - 1
            v = 2 * (i // columns) / max(rows - 1, 1) - 1
            jitter = rng.normal(0, 0.03, 3)
            eye = np.array([u * half_width, -distance, height + v * half_height]) + jitter
            result.append((eye, np.array([0.6 * eye[0], 0.0, height + 0.3 * (eye[2] - height)])))
        return result

    return cameras


def _orbit(seed: int) -> World:
    wave = lambda k, f: Waves(seed * 100 + k, f)  # noqa: E731
    on_table, on_box = Spot((0.5, 0.2, 0.5), (0.4, 0.4, 0.4), 9.0), Spot((-0.35, 0.1, 0.9), (0.2, 0.2, 0.2), 8.0)
    box = Material(STEEL, PAINT, wave(4, 2.0), 29.0, 3.0, spots=(on_box,))
    objects: list[tuple[Solid, Material]] = [
        (Sphere((0, 0, 0), 9.0), Material(*SKY, wave(1, 0.10), 12.0, 3.0)),
        (Rectangle((0, 0, 0), (8.7, 0, 0), (0, 8.7, 0)), Material(*MEADOW, wave(2, 0.6), 17.0, 4.0)),
        (Cylinder((0, 0, 0), 1.3, 0.5), Material(WOOD, DARK_WOOD, wave(3, 1.5), 20.0, 2.5, spots=(on_table,))),
        (Cuboid((-0.35, 0.35, 0.8), (0.35, 0.28, 0.3), 0.5), box),
        (Sphere((0.45, 0.25, 0.78), 0.28), Material(CERAMIC, GLAZE, wave(5, 2.0), 40.0, 2.0, -6.0)),
        (Cylinder((0.1, -0.55, 0.5), 0.2, 0.55), Material(GLAZE, CERAMIC, wave(6, 2.5), 8.0, 2.0, 6.0)),
    ]
    return World("day", True, objects, _ring(3.2, 1.7, (0, 0, 0.6), 2 * np.pi), (5.0, 42.0), 0.95)


def _night(seed: int) -> World:
    wave = lambda k, f: Waves(seed * 100 + k, f)  # noqa: E731
    leak, on_machine = Spot((1.3, 3.0, 1.2), (0.35, 1.0, 0.9), 12.0), Spot((-0.5, 0.5, 0.6), (0.4, 0.4, 0.3), 16.0)
    wall = Material(BRICK, MORTAR, wave(3, 1.2), 11.0, 2.5, 0.8, (leak,))
    machine = Material(PAINT, STEEL, wave(4, 1.4), 18.0, 2.5, spots=(on_machine,))
    objects: list[tuple[Solid, Material]] = [
        (Sphere((0, 0, 0), 14.0), Material((0.20, 0.22, 0.30), (0.12, 0.13, 0.20), wave(1, 0.08), 2.0, 2.0)),
        (Rectangle((0, 0, 0), (13.5, 0, 0), (0, 13.5, 0)), Material(*ASPHALT, wave(2, 0.5), 7.0, 3.0)),
        (Rectangle((0, 3.0, 1.6), (4.0, 0, 0), (0, 0, 1.6)), wall),
        (Cuboid((-0.8, 0.9, 0.55), (0.7, 0.45, 0.55), 0.3), machine),
        (Cylinder((0.9, 0.6, 0.0), 0.35, 1.3), Material(STEEL, STAIN, wave(5, 1.6), 24.0, 2.0, 5.0)),
        (Sphere((0.1, -0.3, 0.3), 0.3), Material(CERAMIC, STAIN, wave(6, 1.8), 33.0, 2.0, -5.0)),
    ]
    cameras = _ring(4.2, 1.5, (0, 0.9, 0.8), np.radians(110), np.radians(-90))
    return World("dark", True, objects, cameras, (0.0, 36.0), 0.9, (0.2, -0.6, 0.75), exposure=0.05, point_share=0.6)


def _turntable(seed: int) -> World:
    wave = lambda k, f: Waves(seed * 100 + k, f)  # noqa: E731
    on_table, on_side = Spot((0, 0, 0), (0.8, 0.8, 0.5), 5.0), Spot((0.4, 0.3, 0.2), (0.3, 0.3, 0.2), 8.0)
    table = Material(DARK_WOOD, WOOD, wave(2, 0.7), 20.0, 2.5, spots=(on_table,))
    objects: list[tuple[Solid, Material]] = [
        (Sphere((0, 0, 0), 6.0), Material(PLASTER, STAIN, wave(1, 0.15), 21.0, 2.0)),
        (Rectangle((0, 0, 0), (5.7, 0, 0), (0, 5.7, 0)), table),
        (Cylinder((0, 0, 0), 0.55, 0.7), Material(STEEL, STAIN, wave(3, 1.8), 38.0, 2.0, 9.0, (on_side,))),
        (Sphere((0.0, 0.0, 0.95), 0.38), Material(CERAMIC, GLAZE, wave(4, 1.6), 33.0, 4.0)),
        (Cuboid((0.95, -0.5, 0.25), (0.28, 0.2, 0.25), 0.8), Material(PAINT, CERAMIC, wave(5, 2.0), 27.0, 3.0, 4.0)),
        (Cuboid((-0.7, 0.85, 0.2), (0.22, 0.3, 0.2), -0.4), Material(GLAZE, WOOD, wave(6, 2.0), 17.0, 2.0)),
    ]
    return World("360", False, objects, _ring(2.8, 1.4, (0, 0, 0.5), 2 * np.pi), (14.0, 50.0), 0.95)


def _facade(seed: int) -> World:
    wave = lambda k, f: Waves(seed * 100 + k, f)  # noqa: E731
    leaks = (Spot((1.1, 0.0, 2.3), (0.25, 1.0, 0.5), 6.0), Spot((-1.2, 0.0, 0.9), (0.5, 1.0, 0.22), 8.0))
    wall = Material(PLASTER, BRICK, wave(1, 0.9), 12.0, 2.0, 0.6, leaks)
    window = Material((0.25, 0.32, 0.38), (0.45, 0.52, 0.58), wave(2, 1.2), 17.0, 2.0, 0.8)
    objects: list[tuple[Solid, Material]] = [
        (Rectangle((0, 0.0, 1.8), (6.0, 0, 0), (0, 0, 4.0)), wall),
        (Cuboid((-0.7, 0.0, 2.1), (0.45, 0.12, 0.6)), window),
        (Cuboid((0.6, -0.05, 1.2), (0.4, 0.25, 0.35)), Material(STEEL, PAINT, wave(3, 1.6), 24.0, 3.0, 3.0)),
        (Cylinder((1.35, -0.5, 0.2), 0.16, 2.0), Material(STEEL, STAIN, wave(4, 1.6), 30.0, 2.0, -3.0)),
        (Sphere((-0.35, -0.6, 0.85), 0.25), Material(CERAMIC, GLAZE, wave(5, 1.8), 8.0, 2.0, 2.0)),
    ]
    return World("forward", False, objects, _grid(3.2, 0.9, 0.5, 1.5), (4.0, 34.0), 0.95, (0.3, -0.8, 0.5))


def _half_seen(seed: int) -> World:
    wave = lambda k, f: Waves(seed * 100 + k, f)  # noqa: E731
    leaks = (
        Spot((0.2, -1.3, 0.9), (0.4, 0.3, 0.3), 7.0), Spot((-1.8, 0.5, 0.6), (0.3, 0.5, 0.4), 8.0),
        Spot((-0.2, 1.3, 1.6), (0.5, 0.3, 0.4), 9.0), Spot((1.8, 0.2, 1.2), (0.3, 0.4, 0.5), 6.0),
    )  # fmt: skip
    objects: list[tuple[Solid, Material]] = [
        (Sphere((0, 0, 0), 16.0), Material(*SKY, wave(1, 0.08), 2.0, 2.0)),
        (Rectangle((0, 0, 0), (15.5, 0, 0), (0, 15.5, 0)), Material(*GROUND[0], wave(2, 0.4), 9.0, 3.0)),
        (Cuboid((0, 0, 1.1), (1.8, 1.3, 1.1)), Material(BRICK, MORTAR, wave(3, 1.0), 14.0, 2.5, 0.6, leaks)),
        (Cuboid((0, 0, 2.3), (2.0, 1.5, 0.1)), Material(DARK_WOOD, WOOD, wave(4, 0.9), 6.0, 2.0)),
        (Cuboid((-1.0, 0.6, 2.8), (0.22, 0.22, 0.5)), Material(BRICK, STAIN, wave(5, 1.5), 19.0, 3.0, 3.0)),
        (Cylinder((2.6, 1.2, 0.0), 0.35, 1.2), Material(STEEL, PAINT, wave(6, 1.4), 22.0, 2.0, 3.0)),
        (Sphere((-1.6, -2.3, 0.4), 0.4), Material(GLAZE, CERAMIC, wave(7, 1.4), 18.0, 3.0)),
        (Cuboid((-0.8, 1.9, 0.45), (0.5, 0.25, 0.45), 0.2), Material(STEEL, PAINT, wave(8, 1.6), 25.0, 3.0)),
    ]
    for number, (x, y) in enumerate(((-1.0, -1.3), (1.0, -1.3), (-0.9, 1.3), (0.9, 1.3))):
        window = Material(GLASS[0], GLASS[1], wave(10 + number, 1.4), 19.0 + number, 2.0)
        objects.append((Cuboid((x, y, 1.3), (0.35, 0.06, 0.45)), window))
    cameras = _one_side(6.0, 2.6, (0, 0, 1.1), np.radians(140), np.radians(-90))
    return World("", False, objects, cameras, (-1.0, 33.0), 0.95, (0.3, -0.6, 0.75), apart=APART)


WORLDS: dict[str, Callable[[int], World]] = {
    "orbit": _orbit,
    "night": _night,
    "turntable": _turntable,
    "facade": _facade,
    "field": lambda seed: _flight(seed, Rectangle((0, 0, 0), (500, 0, 0), (0, 500, 0))),
    "hills": _hills,
    "wall": _wall,
    "half_seen": _half_seen,
}
