"""Which cells cameras show, against cells that lie well inside or well outside of all that is asked."""

import numpy as np
import torch

from tdgbench.fields.contraction import Region
from tdgbench.fields.visible import visible_cells
from tdgbench.scenes import Camera

REGION = Region((0.5, -1.0, 2.0), 1.5, 0.1, 50.0)
CELLS, NEAR = 24, 2.0
EVERYTHING = np.array([[-1e9] * 3, [1e9] * 3])
K = np.array([[40.0, 0, 30], [0, 50, 20], [0, 0, 1]])


def camera_at(x: float, y: float, z: float) -> Camera:
    """A camera that looks along z, of 64×48 px."""
    pose = np.eye(4)
    pose[:3, 3] = -x, -y, -z
    return Camera(K, pose, 64, 48)


def cells_at() -> tuple[np.ndarray, np.ndarray]:
    """World positions (cells³, 3) of the centres, and distances (cells³,) to neighbours; inf where nothing is."""
    z, y, x = np.unravel_index(np.arange(CELLS**3), (CELLS,) * 3)
    contracted = torch.from_numpy((np.stack([x, y, z], axis=1) + 0.5) / CELLS)
    middle, along = REGION.expanded(contracted).numpy(), []
    for axis in np.eye(3) / CELLS:
        along.append(np.linalg.norm(REGION.expanded(contracted + torch.from_numpy(axis)).numpy() - middle, axis=1))
    is_beyond = (contracted - 0.5).norm(dim=1).numpy() > 0.5 - 0.5 / CELLS
    return middle, np.where(is_beyond, np.inf, np.max(along, axis=0))


def test_cells_in_view_beyond_the_near_depth_are_visible_and_others_not():
    cameras = [camera_at(0.5, -1.0, -2.0), camera_at(1.5, -1.0, -2.0)]
    found = visible_cells(CELLS, REGION, EVERYTHING, cameras, [NEAR, NEAR]).numpy()
    centres, size = cells_at()
    shown, far_off = np.zeros(len(found), bool), np.ones(len(found), bool)
    for camera in cameras:
        pixels, z = camera.project(centres)
        shown |= camera.holds(pixels, z) & (z > NEAR)
        margin = 4 * size * np.diag(K)[:2, None] / np.abs(z)  # px
        middle = np.array([[32], [24]])
        far_off &= (z < NEAR - size) | (np.abs(pixels.T - middle) > middle + margin).any(axis=0)
    shown &= np.isfinite(size)
    assert shown.sum() > 500 and found[shown].all()
    assert far_off.sum() > 300 and not found[far_off].any()
    assert not found[~np.isfinite(size)].any()


def test_no_cell_is_visible_outside_of_the_box_or_before_the_near_depth():
    camera, box = camera_at(0.5, -1.0, -6.0), np.array([[-0.5, -2.0, 1.0], [1.5, 0.0, 3.0]])
    centres, size = cells_at()
    found = visible_cells(CELLS, REGION, box, [camera], [NEAR]).numpy()
    outside = (np.abs(centres - box.mean(axis=0)) > np.ptp(box, axis=0) / 2 + 2 * size[:, None]).any(axis=1)
    inside = ((centres > box[0]) & (centres < box[1])).all(axis=1) & np.isfinite(size)
    assert inside.sum() > 50 and found[inside].all() and not found[outside].any()
    found = visible_cells(CELLS, REGION, box, [camera], [8.5]).numpy()
    assert found[inside & (centres[:, 2] > 2.5)].all() and not found[centres[:, 2] < 2.5 - size].any()


def test_without_cameras_nothing_is_visible():
    assert not visible_cells(CELLS, REGION, EVERYTHING, [], []).any()


def test_surfaces_at_the_near_depth_are_visible():
    """Of a flat scene, points lie at the depth that nothing is nearer than, wherever cells have their centres."""
    for z in np.linspace(2.0, 2.3, 7):
        camera = camera_at(0.5, -1.0, z - 3.0)
        found = visible_cells(CELLS, REGION, EVERYTHING, [camera], [3.0])
        x, y = np.meshgrid(np.linspace(-0.5, 1.5, 20), np.linspace(-1.8, -0.2, 20))
        points = np.stack([x.ravel(), y.ravel(), np.full(x.size, z + 1e-6)], axis=1)
        at = (REGION.contracted(torch.from_numpy(points)) * CELLS).long()
        assert camera.shows(points).all() and found[at[:, 0] + CELLS * (at[:, 1] + CELLS * at[:, 2])].all()
