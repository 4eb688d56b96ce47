"""One set of cameras, written as each program writes it, is read back."""

import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tdgbench.data.export import export_scene
from tdgbench.data.poses.metashape import TABLE, lenses, read_xml
from tdgbench.data.poses.references import read_reference
from tdgbench.scenes import Camera, FolderDataset, PointCloud, ReadOptions, SceneError
from tdgbench.scenes.colmap import write_model
from tests.helpers.layouts import write_rgbt_scenes

LENS = "<f>741.5</f><cx>10</cx><cy>8</cy><k1>-0.02</k1><k2>0.2</k2><k3>0.1</k3><p1>0.008</p1><p2>0.003</p2>"
SENSOR = f"""<sensor id="0"><resolution width="640" height="512"/>
  <calibration type="frame" class="initial"><resolution width="640" height="512"/><f>9</f></calibration>
  <calibration type="frame" class="adjusted"><resolution width="640" height="512"/>{LENS}</calibration></sensor>"""


@pytest.fixture
def poses():
    """World to camera (4, 4) of five views."""
    rng = np.random.default_rng(0)
    poses = {}
    for i in range(5):
        poses[f"IMG_{i}.1"] = np.eye(4)
        poses[f"IMG_{i}.1"][:3, :3] = Rotation.random(random_state=i).as_matrix()
        poses[f"IMG_{i}.1"][:3, 3] = rng.normal(size=3)
    return poses


def numbers(values):
    return " ".join(map(repr, np.ravel(values).tolist()))


def metashape(poses, ending=".JPG"):
    """A chunk: the given poses, one camera that was not aligned, and one of another component."""
    cameras = [
        f'<camera id="{i}" sensor_id="0" component_id="1" label="{name}{ending}"><transform>'
        f"{numbers(np.linalg.inv(pose))}</transform></camera>"
        for i, (name, pose) in enumerate(poses.items())
    ]
    elsewhere = f"<transform>{numbers(np.eye(4))}</transform>"
    cameras.append(f'<camera id="9" sensor_id="0" component_id="2" label="other">{elsewhere}</camera>')
    cameras.append('<camera id="8" sensor_id="0" label="lost"/>')
    return f"<chunk><sensors>{SENSOR}</sensors><cameras><group>{''.join(cameras)}</group></cameras></chunk>"


def same(path, poses, focal=None, width=None):
    found = read_reference(path)
    assert list(found.poses) == list(poses)
    assert np.allclose(list(found.poses.values()), list(poses.values()), atol=1e-9)
    lenses = [(lens.params[0], lens.width) for lens in found.lenses()]
    assert lenses == ([] if focal is None else [(pytest.approx(focal), width)])


def test_metashape(tmp_path, poses):
    (tmp_path / "cameras.xml").write_text(f'<document version="2.0.0">{metashape(poses)}</document>')
    same(tmp_path / "cameras.xml", poses, 741.5, 640)
    with zipfile.ZipFile(tmp_path / "chunk.zip", "w") as archive:
        archive.writestr("doc.xml", metashape(poses, ""))
    same(tmp_path / "chunk.zip", poses, 741.5, 640)


def test_table_of_metashape(tmp_path, poses):
    rows = []
    for name, pose in poses.items():
        position = -pose[:3, :3].T @ pose[:3, 3]
        rotation = np.diag([1, -1, -1]) @ pose[:3, :3]
        rows.append("\t".join([f"{name}.jpg", *numbers([*position, 0, 0, 0, *rotation.ravel()]).split()]))
    (tmp_path / "cameras.txt").write_text("\n".join(["# Cameras (5)", TABLE, *rows]))
    same(tmp_path / "cameras.txt", poses)


def test_lens_of_metashape(tmp_path):
    """The principal point is from the centre, and p1 and p2 are OpenCV's p2 and p1."""
    (tmp_path / "cameras.xml").write_text(f"<document><chunk>{SENSOR}</chunk></document>")
    (lens,) = lenses(read_xml(tmp_path / "cameras.xml"), tmp_path)
    assert lens[1:4] == ("FULL_OPENCV", 640, 512)
    assert lens.params == (741.5, 741.5, 330, 264, -0.02, 0.2, 0.003, 0.008, 0.1, 0, 0, 0)


def test_opensfm_takes_the_largest_model(tmp_path, poses):
    cameras = {"v2": {"projection_type": "brown", "width": 640, "height": 512, "focal_x": 1.25, "focal_y": 1.25,
                      "c_x": 0.01, "c_y": -0.01, "k1": 0.1, "p2": 0.02, "k3": 0.3}}  # fmt: skip
    shots = {
        f"{name}.tif": {"rotation": Rotation.from_matrix(pose[:3, :3]).as_rotvec().tolist(),
                        "translation": pose[:3, 3].tolist(), "camera": "v2"}
        for name, pose in poses.items()
    }  # fmt: skip
    models = [{"cameras": {}, "shots": {}}, {"cameras": cameras, "shots": shots, "points": {}}]
    (tmp_path / "reconstruction.json").write_text(json.dumps(models))
    same(tmp_path / "reconstruction.json", poses, 800, 640)
    (lens,) = read_reference(tmp_path / "reconstruction.json").lenses()
    assert lens.params == pytest.approx((800, 800, 326.4, 256 - 6.4, 0.1, 0, 0, 0.02, 0.3, 0, 0, 0))
    cameras["v2"]["projection_type"] = "spherical"
    (tmp_path / "reconstruction.json").write_text(json.dumps(models))
    with pytest.raises(SceneError, match=r"camera 'v2' cannot be read: .*it is none of perspective"):
        read_reference(tmp_path / "reconstruction.json").lenses()


def test_equal_base_names_are_named_by_their_folders(tmp_path, poses):
    """As in COLMAP models, so that both compare; and only extensions of images are dropped."""
    given = dict(
        zip(["a/left/1.v0.JPG", "a/right/1.v0.JPG", "a/left/2", "a/right/2.tif"], poses.values(), strict=False)
    )
    shots = {name: {"rotation": Rotation.from_matrix(pose[:3, :3]).as_rotvec().tolist(),
                    "translation": pose[:3, 3].tolist(), "camera": "c"} for name, pose in given.items()}  # fmt: skip
    (tmp_path / "reconstruction.json").write_text(json.dumps([{"cameras": {}, "shots": shots}]))
    camera = Camera(np.diag([50, 50, 1.0]), np.eye(4), 64, 48)
    views = [(name, replace(camera, world_to_camera=pose)) for name, pose in given.items()]
    write_model(tmp_path / "model", views, PointCloud(np.zeros((0, 3)), np.zeros((0, 3), np.float32)))
    expected = dict(zip(["left_1.v0", "right_1.v0", "left_2", "right_2"], given.values(), strict=True))
    for path in (tmp_path / "reconstruction.json", tmp_path / "model"):
        found = read_reference(path).poses
        assert set(found) == set(expected)
        assert all(np.allclose(found[name], pose, atol=1e-9) for name, pose in expected.items())


def test_scenes_models_and_nerfstudio(tmp_path, poses, small_gray_scene):
    K = np.array([[500, 0, 320], [0, 500, 256], [0, 0, 1.0]])
    views = [(f"{name}.png", Camera(K, pose, 640, 512)) for name, pose in poses.items()]
    write_model(tmp_path / "model", views, PointCloud(np.zeros((1, 3)), np.zeros((1, 3), np.float32)))
    same(tmp_path / "model", poses, 500, 640)
    model = read_reference(tmp_path / "model")
    assert model.lenses() == [(1, "PINHOLE", 640, 512, (500, 500, 320, 256))] and len(model.points.points) == 1
    folder = write_rgbt_scenes(small_gray_scene, tmp_path / "scene")
    scene = FolderDataset(str(folder), ReadOptions()).load(None)
    export_scene(scene, tmp_path / "export", "nerfstudio")
    cameras = {view.name: view.camera for view in scene.views}
    known, _, points, *_ = read_reference(tmp_path / "export" / "transforms.json")
    assert np.allclose(points.points, scene.points.points)
    assert set(known) == set(read_reference(folder).poses) == set(cameras)
    for name, camera in cameras.items():
        assert np.allclose(known[name], camera.world_to_camera, atol=1e-6)


SHOT = '[{"cameras": {}, "shots": {"x": {"rotation": [0, 0%s], "translation": [0, 0, 0], "camera": "c"}}}]'
STILL = metashape({"x": np.eye(4)})


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("a.xml", "<document><chunk>", "a.xml cannot be read as Metashape's XML: .* export it again"),
        ("a.xml", "<document/>", "a.xml has no registered view; align the images first"),
        ("a.xml", STILL.replace("1.0 0.0", "1.0 zero", 1), "camera x.JPG must be 16 finite numbers"),
        ("a.xml", STILL.replace("1.0 0.0", "2.0 0.0", 1), "a.xml: view x has a pose whose 3×3 part is no rotation"),
        ("a.zip", "no archive", "a.zip cannot be read"),
        ("a.txt", "# PhotoID, X\n", "a.txt is no list of poses that is read here; Metashape's begins with"),
        ("a.json", SHOT % "", "a.json cannot be read as a reconstruction.json .*rot_vec"),
        ("a.json", SHOT % ", NaN", "view x has a pose that is not finite"),
        ("a.json", "[", "a.json cannot be read as a reconstruction.json"),
        ("a.csv", "", "a.csv holds no poses that are read here; give a scene"),
    ],
)
def test_errors_name_the_file(tmp_path, name, content, what):
    (tmp_path / name).write_text(content)
    with pytest.raises(SceneError, match=what):
        read_reference(tmp_path / name)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("<k3>0.1</k3>", "<k4>0.1</k4><b2>1</b2>", "the coefficients k4, b2; optimise the cameras again"),
        ("frame", "fisheye", "no frame camera"),
        ("<f>741.5</f>", "<fx>741.5</fx>", "f of the calibration must be 1 finite"),
    ],
)
def test_lenses_that_opencv_cannot_say(tmp_path, old, new, what):
    (tmp_path / "a.xml").write_text(f"<document>{SENSOR.replace(old, new)}</document>")
    with pytest.raises(SceneError, match=what):
        lenses(read_xml(tmp_path / "a.xml"), tmp_path / "a.xml")
