import numpy as np
import pytest
import torch

from tdgbench.splats.blending import AS_3DGS, Blending
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster import group as group_module
from tdgbench.splats.cpu.raster.group import (
    GROUP,
    KEEP,
    VALID,
    Z,
    box_of,
    copy_splat,
    ellipse_of,
    half_sides,
    project_group,
    turn_splats,
    write_boxes,
    write_channels,
)
from tdgbench.splats.cpu.raster.parameters import GATHERED, collect
from tdgbench.splats.cpu.raster.tiles import Ellipse
from tdgbench.splats.cpu.raster.types import (
    CHANNELS,
    FIRST_X,
    FIRST_Y,
    FLOATS,
    LAST_X,
    LAST_Y,
    OPACITY,
    Channels,
    pack_camera,
    pack_limits,
)
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.memory import aligned_floats, load, store
from tdgbench.splats.cpu.simd.reductions import any_positive
from tdgbench.splats.cpu.simd.registers import LANES, broadcast
from tests.helpers.gaussians import random_gaussians, turned_camera
from tests.splats.cpu.raster.forward_passes import source_of
from tests.splats.cpu.simd.arrays import aligned

F = np.float32
WIDTH, HEIGHT = 60, 44


@kernel()
def fill_group(parameters, channels, camera, limits, group):
    """The registers of the first LANES Gaussians; returns whether any is NaN."""
    gathered, basis = aligned_floats(GATHERED * LANES), aligned_floats(16 * LANES)
    collect(parameters, np.arange(LANES).astype(np.int32), 0, channels.colors, gathered)
    mean, has_nan = project_group(group, gathered, False, camera, limits, broadcast(F(0)))
    write_channels(group, gathered, channels, mean, camera, basis)
    return any_positive(has_nan)


def grouped(parameters, blending: Blending = AS_3DGS) -> tuple[np.ndarray, bool]:
    """Registers (GROUP, LANES) of Gaussians before the turned camera, with depth; whether any of them is NaN."""
    view, K = (t[0] for t in turned_camera(WIDTH, HEIGHT))
    camera = pack_camera(view, K, WIDTH, HEIGHT, 0.2, 1e10, 0.3)
    group = empty_aligned((GROUP * LANES,), F)
    channels = Channels(parameters[4].shape[1], -1, True)
    has_nan = fill_group(source_of(parameters).parameters, channels, camera, pack_limits(blending), group)
    return group.reshape(GROUP, LANES), bool(has_nan)


def some_gaussians(colors: int = 1) -> list[torch.Tensor]:
    """In sight and opaque enough to be drawn."""
    parameters = random_gaussians(LANES, 6, None, colors)
    parameters[0][:, :2] *= 0.3
    parameters[3].clamp_min_(0.1)
    return parameters


def test_colors_and_depth_are_the_channels():
    parameters = some_gaussians(3)
    group, has_nan = grouped(parameters)
    view = turned_camera(WIDTH, HEIGHT)[0][0].numpy()
    depth = parameters[0].numpy() @ view[2, :3] + view[2, 3]
    assert not has_nan and (group[VALID] == 1).all() and (group[KEEP] == 1).all()
    assert np.array_equal(group[CHANNELS : CHANNELS + 3], parameters[4].numpy().T)
    assert np.array_equal(group[CHANNELS + 3], group[Z]) and np.allclose(group[Z], depth, rtol=1e-6)


def test_what_cannot_be_seen_is_not_kept():
    parameters = some_gaussians()
    parameters[0][0, 2] = -4  # behind the camera
    parameters[0][1, 1] = 100  # below the image
    parameters[3][2] = 0.001  # too faint
    group, _ = grouped(parameters)
    assert group[VALID, :3].tolist() == [0, 1, 1] and group[KEEP, :3].tolist() == [0, 0, 0]
    assert (group[KEEP, 3:] == 1).all()


@pytest.mark.parametrize("parameter", [0, 1, 2, 3])
def test_nan_is_found_in_any_lane(parameter):
    parameters = some_gaussians()
    parameters[parameter].view(LANES, -1)[LANES - 3, -1] = float("nan")
    assert grouped(parameters)[1] and not grouped(some_gaussians())[1]


@kernel()
def sides(a, c, cut, out):
    wide, high = half_sides(load(a, 0), load(c, 0), load(cut, 0))
    store(out, 0, wide)
    store(out, LANES, high)


def test_half_sides_of_the_box():
    """Of the ellipse in which alpha is large enough."""
    rng = np.random.default_rng(0)
    axes, opacities = rng.normal(size=(LANES, 2, 2)) * 3, rng.uniform(0.05, 1, LANES)
    covariance = axes @ axes.transpose(0, 2, 1) + 0.3 * np.eye(2)
    out = empty_aligned((2 * LANES,), F)
    numbers = [covariance[:, 0, 0], covariance[:, 1, 1], np.log2(opacities / AS_3DGS.min_alpha)]
    sides(*map(aligned, numbers), out)
    reach = 2 * np.log(opacities / AS_3DGS.min_alpha)[:, None]
    wanted = np.sqrt(reach * np.diagonal(covariance, axis1=1, axis2=2)).T
    assert np.allclose(out.reshape(2, LANES), wanted, rtol=1e-4)


@kernel()
def read_lane(group, i, boxes, rows, splats, r):
    turn_splats(group, rows)
    copy_splat(rows, np.uint64(i), splats, np.uint64(r))
    write_boxes(group, boxes)
    return box_of(boxes, np.uint64(i)), ellipse_of(group, np.uint64(i))


@pytest.mark.parametrize("lane", [0, 5, LANES - 1])
def test_a_lane_is_read(lane):
    numbers = np.arange(GROUP * LANES).reshape(GROUP, LANES)
    rows, splats = empty_aligned((FLOATS * LANES,), F), empty_aligned((3, FLOATS), F)
    splats[:] = -1
    flat = aligned(numbers.reshape(-1))
    box, ellipse = read_lane(flat, lane, np.zeros(4 * LANES, np.int32), rows, splats.reshape(-1), 1)
    assert np.array_equal(splats[1], numbers[:FLOATS, lane]) and (splats[[0, 2]] == -1).all()
    assert tuple(box) == tuple(numbers[[FIRST_X, LAST_X, FIRST_Y, LAST_Y], lane])
    names = ("U_SINGLE", "V_SINGLE", "A_", "B_", "C_", "DET", "CUT", "WIDE", "HIGH", "SLOPE")
    assert isinstance(ellipse, Ellipse)
    assert tuple(ellipse) == tuple(numbers[[getattr(group_module, name) for name in names], lane])
    assert splats[1, OPACITY] == numbers[OPACITY, lane]
