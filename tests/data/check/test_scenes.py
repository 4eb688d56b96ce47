import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from PIL import Image

from tdgbench.data.check.registration import Offset, registration
from tdgbench.data.check.scenes import check_scenes, find_place, wrong_views
from tdgbench.data.prepare.prepare import PrepareOptions, prepare_scene
from tdgbench.scenes import ReadOptions
from tdgbench.scenes.colmap import read_model
from tdgbench.scenes.formats import PhotoMapping
from tdgbench.scenes.registry import SCENES
from tdgbench.scenes.synthetic import SyntheticDataset
from tests.helpers.layouts import write_downloaded_thermalmix, write_rgbt_scenes, write_thermalmix, write_thermoscenes


@pytest.fixture(scope="module")
def aligned_scene(tmp_path_factory):
    """Views that are large enough for an offset."""
    folder = str(tmp_path_factory.mktemp("synthetic"))
    return SyntheticDataset(folder, ReadOptions(), width=160, height=120, views=6, points=300, seed=0).load("turntable")


def checked(root, split="eighty_twenty"):
    begun = []
    place = find_place(root, split)
    return place, {check.name: check for check in check_scenes(place, begun.append)}, begun


def test_paper_scenes(tmp_path, small_scene, small_gray_scene):
    write_rgbt_scenes(small_scene, tmp_path / "RGBT-Scenes" / "road block")
    write_thermalmix(small_gray_scene, tmp_path / "ThermalMix" / "lion")
    place, checks, begun = checked(tmp_path)
    assert place.is_paper and list(checks) == [scene.name for scene in SCENES] and begun == ["RoadBlock", "Lion"]
    block, lion = checks["RoadBlock"], checks["Lion"]
    assert (block.status, block.layout, block.views) == ("ok", "RGBT-Scenes", 10)
    assert (block.train, block.test, block.views_with_rgb, block.channels, block.points) == (8, 2, 10, 3, 300)
    assert block.sizes_px == [(48, 36)] and block.temperature_degC is None and block.masked_share == 0
    assert (lion.status, lion.layout, lion.channels) == ("ok", "ThermalMix", 1)
    span = small_gray_scene.temperature
    assert span.min - 1 < lion.temperature_degC[0] < lion.temperature_degC[1] < span.max + 1
    assert checks["Pan"].status == "missing" and "tdgbench data get thermalmix" in checks["Pan"].problems[0]
    assert checked(tmp_path / "ThermalMix")[1].keys() == {"Laptop", "Pan", "Lion", "Hand", "Face"}


def test_the_folder_of_a_data_set(tmp_path, small_gray_scene, monkeypatch):
    """In whatever case, and named by a dot; what is missing is downloaded to where it belongs."""
    write_thermalmix(small_gray_scene, tmp_path / "thermalmix" / "lion")
    assert checked(tmp_path)[1]["Lion"].status == "ok"
    monkeypatch.chdir(tmp_path / "thermalmix")
    _, checks, begun = checked(Path())
    assert begun == ["Lion"] and checks["Pan"].problems[0].endswith(f"data get thermalmix {tmp_path}")


def test_other_data_sets_in_a_data_root(tmp_path, small_gray_scene):
    write_thermoscenes(small_gray_scene, tmp_path / "ThermoScenes" / "cup")
    place, checks, _ = checked(tmp_path)
    assert not place.is_paper and [(check.name, check.status) for check in checks.values()] == [("cup", "ok")]


@pytest.mark.parametrize("model", ["colmap_sparse/0", "sparse/0"])
def test_a_turned_view_of_thermalmix_is_named(tmp_path, small_gray_scene, model):
    folder = write_thermalmix(small_gray_scene, tmp_path / "scene", model=model, camera="PINHOLE")
    made = pycolmap.Reconstruction(folder / model)
    for image in made.images.values():
        seen = [(point.xyz, key) for key, point in made.points3D.items() if image.project_point(point.xyz) is not None]
        image.points2D = [pycolmap.Point2D(image.project_point(xyz), key) for xyz, key in seen]
    turn = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.0, 0.6, 0.0])), np.zeros(3))
    frame = made.frames[min(made.frames)]
    frame.rig_from_world = turn * frame.rig_from_world
    made.write(folder / model)
    (problem,) = checked(folder)[1]["scene"].problems
    assert "its pose or its camera" in problem


def test_thermalmix_as_downloaded(tmp_path, small_gray_scene):
    """Gray images, whose range is published for scenes of these names only; a damaged one is named."""
    for name in ("lion", "panel", "kettle", "pan"):
        write_downloaded_thermalmix(small_gray_scene, tmp_path / name, frame=5)
    for view in small_gray_scene.views[2:4]:
        (tmp_path / "pan" / "warped_thermal" / f"{view.name}.jpg").write_bytes(b"no image")
    checks = checked(tmp_path)[1]
    assert {name: check.status for name, check in checks.items()} == {
        "lion": "ok", "panel": "ok", "kettle": "broken", "pan": "broken",
    }  # fmt: skip
    lion = checks["lion"]
    assert (lion.layout, lion.views, lion.channels, lion.temperature_degC) == ("ThermalMix", 10, 1, (16.8, 48.3))
    assert lion.masked_share == pytest.approx(8 / 48) and lion.views_with_rgb == 10
    assert checks["panel"].temperature_degC == (22.7, 55.8)
    assert any("set data.temperature=[min,max] in °C" in problem for problem in checks["kettle"].problems)
    assert len(checks["pan"].problems) == 2 and all("warped_thermal/view00" in p for p in checks["pan"].problems)


def test_masked_pixels_and_missing_photos(tmp_path, small_gray_scene):
    def with_nan(degC, number):
        degC = degC.copy()
        degC[:, :12] = np.nan
        return degC

    folder = write_thermalmix(small_gray_scene, tmp_path / "scene", change=with_nan, camera="PINHOLE")
    (folder / "rgb" / f"{small_gray_scene.views[0].name}.jpg").unlink()
    _, checks, _ = checked(tmp_path)
    check = checks["scene"]
    assert check.status == "ok" and check.masked_share == pytest.approx(0.25, abs=0.03) and check.views_with_rgb == 9
    assert any("1 views have no RGB image" in note for note in check.notes)
    assert any(note.startswith("whether RGB and thermal images are registered is not known") for note in check.notes)


def test_unregistered_pairs_are_doubtful_and_the_command_mends_them(tmp_path, aligned_scene, monkeypatch):
    """Thermal images are moved to the right and up; each remedy that is named brings them back."""
    shutil.copytree(aligned_scene.folder, tmp_path / "scene")
    monkeypatch.chdir(tmp_path)
    aligned = checked(Path("scene"))[1]["scene"]
    assert aligned.status == "ok" and aligned.edge_offset.px < 0.5
    for path in Path("scene", "thermal").iterdir():
        Image.fromarray(np.roll(np.asarray(Image.open(path)), (-3, 4), axis=(0, 1))).save(path)
    check = checked(Path("scene"))[1]["scene"]
    moved = (check.edge_offset.x - aligned.edge_offset.x, check.edge_offset.y - aligned.edge_offset.y)
    assert check.status == "doubtful" and moved == pytest.approx((4, -3), abs=0.4)
    assert check.doubts[0].startswith(f"thermal edges lie {check.edge_offset.x:.1f} px right of and ")
    poses = PrepareOptions(poses=Path("scene"))
    prepare_scene(Path("scene"), Path("prepared"), poses)
    for place, said in (("capture", check), ("made", checked(Path("prepared"))[1]["prepared"])):
        command = shlex.split(said.doubts[0].partition("Try: tdgbench data prepare ")[2].partition(",")[0])
        assert command[:2] == ["scene", "NEW"] and command[-4:-2] == ["--mapping", "1"]
        numbers = [float(number) for number in command[-2:]]
        assert numbers == pytest.approx((-4, 3), abs=0.5)
        prepare_scene(Path("scene"), Path(place), replace(poses, mapping=PhotoMapping(1, *numbers)))
        mended = checked(Path(place))[1][place]
        assert mended.status == "ok" and mended.edge_offset.px < 0.5


def test_remedies_without_a_command_and_offsets_that_may_be_chance(tmp_path, aligned_scene):
    scene = replace(aligned_scene, folder=write_rgbt_scenes(aligned_scene, tmp_path / "scene"))
    (doubt,), notes = registration(scene, Offset(-2.0, 1.1, 1.2, 9))
    assert "2.0 px left of and 1.1 px below" in doubt and "moved by +2.0, -1.1 px" in doubt and notes == []
    doubts, (note,) = registration(scene, Offset(-2.0, 1.1, 2.0, 9))
    assert doubts == [] and "may be chance" in note
    assert registration(scene, Offset(-0.6, 0.6, 0.1, 9)) == ([], [])


def test_broken_scenes_do_not_end_the_check(tmp_path, small_gray_scene):
    for name in "abcd":
        write_rgbt_scenes(small_gray_scene, tmp_path / name)
    first, second, *_ = sorted((tmp_path / "a" / "thermal" / "train").iterdir())
    for path in (first, second):
        path.write_bytes(path.read_bytes()[:200])
    photo = next((tmp_path / "b" / "rgb" / "train").iterdir())
    photo.write_bytes(b"no image")
    shutil.rmtree(tmp_path / "c" / "sparse")
    _, checks, _ = checked(tmp_path)
    assert {name: check.status for name, check in checks.items()} == {
        "a": "broken", "b": "broken", "c": "broken", "d": "ok",
    }  # fmt: skip
    said = "\n".join(checks["a"].problems)
    assert len(checks["a"].problems) == 2 and first.name in said and second.name in said  # not the first one alone
    assert len(checks["b"].problems) == 1 and photo.name in checks["b"].problems[0] and checks["b"].views == 10
    assert "no COLMAP model" in checks["c"].problems[0]


def test_one_scene_is_a_place(tmp_path, small_gray_scene):
    place, checks, _ = checked(write_rgbt_scenes(small_gray_scene, tmp_path / "mine"), split="every_8th")
    assert not place.is_paper and checks["mine"].test == 2
    assert json.dumps(checks["mine"].notes)  # plain text


def made(lens="SIMPLE_RADIAL", params=(1280.0, 512.0, 384.0, 0.0)):
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=1, num_cameras_per_rig=1, num_frames_per_rig=6, num_points3D=100
    )
    options.camera_model_id, options.camera_params = getattr(pycolmap.CameraModelId, lens), params
    pycolmap.set_random_seed(0)
    return pycolmap.synthesize_dataset(options)


@pytest.fixture
def model():
    return made()


def found(folder):
    """The wrong views of a scene of this model."""
    return wrong_views(SimpleNamespace(model=folder, points=read_model(folder).points, origin=(0, 0, 0)))


@pytest.mark.parametrize(
    ("lens", "params"),
    [
        ("PINHOLE", (1280, 1280, 512, 384)),
        ("OPENCV", (1280, 1280, 512, 384, 0.05, 0.01, 0.01, 0)),
        ("OPENCV_FISHEYE", (640, 640, 512, 384, 0.05, 0.01, 0, 0)),
    ],
)
@pytest.mark.parametrize("suffix", ["binary", "text"])
def test_errors_are_those_of_pycolmap(tmp_path, lens, params, suffix):
    model = made(lens, params)
    for number, degrees in enumerate((1, 5, 10, 40, 180), start=1):
        turn = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.0, np.radians(degrees), 0.0])), np.zeros(3))
        model.frames[number].rig_from_world = turn * model.frames[number].rig_from_world
    getattr(model, f"write_{suffix}")(tmp_path)
    expected = {}
    for image in model.images.values():
        shown = [(point.xy, model.points3D[point.point3D_id].xyz) for point in image.get_observation_points2D()]
        places = [(xy, image.project_point(xyz)) for xy, xyz in shown]
        errors = [np.inf if place is None else np.linalg.norm(xy - place) for xy, place in places]
        share = np.median(errors) / np.hypot(1024, 768)
        if share > 0.05:
            expected[image.name] = f"{share:.0%} of the diagonal off" if share < np.inf else "lie behind it"
    named = dict(problem.split(": ", 1) for problem in found(tmp_path))
    assert named.keys() == expected.keys() and len(named) >= 3
    assert all(expected[name] in problem for name, problem in named.items())


def test_what_is_not_read(model, tmp_path):
    assert wrong_views(SimpleNamespace(model=None, points=None)) == []
    model.write_binary(tmp_path)
    points, images = read_model(tmp_path).points, tmp_path / "images.bin"
    images.write_bytes(images.read_bytes()[:-1])
    assert wrong_views(SimpleNamespace(model=tmp_path, points=points, origin=(0, 0, 0))) == []


def test_a_sample_of_the_points_suffices(model, tmp_path, monkeypatch):
    monkeypatch.setattr("tdgbench.data.check.scenes.MOST", 20)
    model.write(tmp_path)
    assert found(tmp_path) == []
    for camera in model.cameras.values():
        camera.params = [camera.params[0] * 1.5, *camera.params[1:]]
    model.write(tmp_path)
    assert len(found(tmp_path)) == 6


def test_a_model_from_which_points_were_removed(model, tmp_path):
    model.write_text(tmp_path)
    points = tmp_path / "points3D.txt"
    rows = [line for line in points.read_text().splitlines() if not line.startswith("#")]
    points.write_text("\n".join(rows[:-5]) + "\n")
    assert found(tmp_path) == []
