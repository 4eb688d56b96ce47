"""Multi-camera systems, disabled cameras and chunks with a transform of their own."""

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tdgbench.data.poses.references import read_reference
from tdgbench.data.prepare.prepare import PrepareOptions, prepare_scene
from tdgbench.data.prepare.sfm import SfmOptions
from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap import read_model
from tests.helpers.command import tdgbench_here
from tests.helpers.relief import FOCAL, HEIGHT, WIDTH, places

TURN, OFFSET = Rotation.from_euler("xyz", [1, -2, 3], degrees=True).as_matrix(), np.array([0.05, -0.02, 0.01])
RGB, THERMAL = 0, 1


def words(values):
    return " ".join(map(repr, np.ravel(values).tolist()))


def sensor(number, focal, rest=""):
    size = f'<resolution width="{WIDTH}" height="{HEIGHT}"/>'
    lens = f'<calibration type="frame" class="adjusted">{size}<f>{focal}</f></calibration>' if focal else ""
    master = " master_id='0'" if rest else ""
    return f'<sensor id="{number}"{master}>{lens}{rest}</sensor>'


def camera(number, label, to_chunk=None, more=""):
    transform = "" if to_chunk is None else f"<transform>{words(to_chunk)}</transform>"
    return f'<camera id="{number}" label="{label}" {more}>{transform}</camera>'


def rig(path, centres, focal=FOCAL, tail="", offset=None):
    """Write RGB cameras that look along z, and thermal ones at `centres` that they carry, without transforms."""
    offset = f"<rotation>{words(TURN)}</rotation><location>{words(OFFSET)}</location>" if offset is None else offset
    cameras = []
    for index, centre in enumerate(centres):
        to_chunk = np.eye(4)
        to_chunk[:3, :3], to_chunk[:3, 3] = TURN.T, centre - TURN.T @ OFFSET  # so that the thermal one is not turned
        cameras.append(camera(2 * index, f"{index:02}_V.jpg", to_chunk, f'sensor_id="{RGB}"'))
        cameras.append(
            camera(2 * index + 1, f"{index:02}.tiff", None, f'sensor_id="{THERMAL}" master_id="{2 * index}"')
        )
    sensors = sensor(RGB, 2 * FOCAL) + sensor(THERMAL, focal, offset)
    path.write_text(
        f"<document><chunk><sensors>{sensors}</sensors><cameras>{''.join(cameras)}</cameras>{tail}</chunk></document>"
    )


def test_slaves_are_placed_by_their_masters(tmp_path):
    """A thermal camera sees what it would see from `centre`, without a turn; RGB cameras stay where they are."""
    rig(tmp_path / "a.xml", places(4, 3), tail="<transform><scale>12.5</scale></transform>")
    found = read_reference(tmp_path / "a.xml")
    assert len(found.poses) == 24 and [len(note) > 0 for note in found.notes] == [True, True]
    assert found.notes[0].startswith("12 cameras are slaves") and "georeference and scale are not" in found.notes[1]
    for index, centre in enumerate(places(4, 3)):
        expected = np.eye(4)
        expected[:3, 3] = -centre
        assert np.allclose(found.poses[f"{index:02}"], expected, atol=1e-12)
        assert not np.allclose(found.poses[f"{index:02}_V"], expected, atol=0.01)
    assert [found.lenses([found.lens_ids[name]])[0].params[0] for name in ("00", "00_V")] == [FOCAL, 2 * FOCAL]


def test_a_scene_of_the_slaves_has_their_lens(tmp_path):
    """Both sensors have the same size, and other focal lengths."""
    (tmp_path / "camera").mkdir()
    for index in range(3):
        slope = np.tile(np.linspace(20, 21, WIDTH, dtype=np.float32), (HEIGHT, 1))  # without features, so no points
        Image.fromarray(slope).save(tmp_path / "camera" / f"{index:02}.tiff")
    rig(tmp_path / "a.xml", places(4, 3))
    options = PrepareOptions(sfm=SfmOptions("thermal", threads=1), poses=tmp_path / "a.xml")
    report = prepare_scene(tmp_path / "camera", tmp_path / "scene", options)
    assert report.is_complete and "12 cameras are slaves" in report.text()
    model = read_model(tmp_path / "scene" / "sparse" / "0")
    for index, centre in enumerate(places(4, 3)[:3]):
        assert model.images[f"{index:02}"].camera.K[0, 0] == FOCAL
        assert model.images[f"{index:02}"].camera.center == pytest.approx(centre)
    rig(tmp_path / "a.xml", places(4, 3), focal=None)
    with pytest.raises(SceneError, match=r"a\.xml states no lens: say it by --calibration"):
        prepare_scene(tmp_path / "camera", tmp_path / "other", options)


def test_disabled_cameras_and_slaves_of_their_own_place(tmp_path):
    elsewhere = np.eye(4)
    elsewhere[:3, 3] = 7
    cameras = [camera(0, "a", np.eye(4)), camera(1, "b", np.eye(4), 'enabled="0"'),
               camera(2, "c", np.eye(4), 'enabled="false"'), camera(3, "d", elsewhere, 'master_id="0" enabled="1"'),
               camera(4, "e", None, 'master_id="9"')]  # fmt: skip
    (tmp_path / "a.xml").write_text(f"<chunk>{''.join(cameras)}</chunk>")
    found = read_reference(tmp_path / "a.xml")
    assert list(found.poses) == ["a", "d"] and (found.poses["d"][:3, 3] == -7).all()
    assert found.notes == ["2 cameras are disabled, and left out"]
    run = tdgbench_here(tmp_path, "data", "poses", "a.xml", "a.xml")
    assert run.returncode == 1 and "2 views have one name in both" in run.stderr


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("<location>", "<place>", "camera 00.tiff is the slave of 00_V.jpg, but its sensor states no rotation and"),
        ("master_id='0'", "master_id='7'", "is the slave of 00_V.jpg, but its sensor states no rotation"),
        (f"<location>{words(OFFSET)}", "<location>1 2", "location of its sensor must be 3 finite numbers"),
        ("</chunk>", "</chunk><chunk/>", "a.xml holds 2 chunks; export the cameras of one"),
        ("00_V.jpg", "00.tiff", "two cameras labelled 00.tiff; disable those of one sensor"),
    ],
)
def test_errors_name_the_camera(tmp_path, old, new, what):
    rig(tmp_path / "a.xml", places(4, 3))
    text = (tmp_path / "a.xml").read_text()
    text = text.replace(old, new).replace("</location>", "</place>" if "place" in new else "</location>")
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(SceneError, match=what):
        read_reference(tmp_path / "a.xml")
