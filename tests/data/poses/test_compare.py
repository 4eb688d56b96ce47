import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tdgbench.data.poses.compare import compare
from tdgbench.scenes import SceneError
from tests.helpers.command import tdgbench_here
from tests.helpers.layouts import write_rgbt_scenes


def poses_at(positions, rotations):
    poses = {}
    for i, (position, rotation) in enumerate(zip(positions, rotations, strict=True)):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ position
        poses[f"view {i}"] = pose
    return poses


@pytest.fixture
def pair():
    """Positions and rotations (world to camera), and the same ones in another world."""
    rng = np.random.default_rng(1)
    positions, rotations = rng.normal(size=(20, 3)), Rotation.random(20, random_state=1).as_matrix()
    turn = Rotation.from_rotvec([0.3, -2, 1]).as_matrix()
    return (positions, rotations), (3.7 * positions @ turn.T + [1e3, -20, 5], rotations @ turn.T)


def test_a_similarity_is_recovered(pair):
    result = compare(poses_at(*pair[0]), poses_at(*pair[1]))
    assert result.scale == pytest.approx(3.7, rel=1e-12) and result.fitted == 20
    assert result.rotation.max() < 1e-9 and result.position.max() < 1e-9


def test_known_errors(pair):
    """One view is turned by 2 degrees, another moved far: neither moves the others."""
    (positions, rotations), other = pair
    rotations, positions = rotations.copy(), positions.copy()
    rotations[3] = Rotation.from_rotvec([0, np.radians(2), 0]).as_matrix() @ rotations[3]
    positions[5] += 10.0 / 3.7
    result = compare(poses_at(positions, rotations), poses_at(*other))
    assert result.fitted == 19 and np.delete(result.position, 5).max() < 1e-9
    assert result.position[5] * result.extent == pytest.approx(10 * np.sqrt(3))
    assert result.rotation[3] == pytest.approx(2) and np.delete(result.rotation, 3).max() < 1e-9
    distances = np.linalg.norm(other[0][:, None] - other[0], axis=2)
    assert result.extent == pytest.approx(distances.max())


def test_a_line_determines_no_rotation(pair):
    (positions, rotations), _ = pair
    line = positions * [1, 1e-4, 1e-4]
    assert compare(poses_at(line, rotations), poses_at(line, rotations)).rotation is None


def test_errors(pair):
    poses = poses_at(*pair[0])
    others = {f"{name}_T": pose for name, pose in poses.items()}
    with pytest.raises(SceneError, match=r"0 views have one name in both \(view 0, view 1 … against view 0_T"):
        compare(poses, others)
    with pytest.raises(SceneError, match="the common views have one position"):
        compare(poses, poses_at(np.ones((20, 3)), pair[0][1]))


def test_command(tmp_path, small_gray_scene):
    write_rgbt_scenes(small_gray_scene, tmp_path / "scene")
    run = tdgbench_here(tmp_path, "data", "poses", "scene", "scene/sparse/0")
    assert run.returncode == 0, run.stderr
    assert "views: 10 in both, of 10 and 11; similarity of 10" in run.stdout
    assert "focal length: " in run.stdout and "× the width" in run.stdout
