import numpy as np
import pytest
from PIL import Image

from tdgbench.data.prepare.sources import find_sources
from tdgbench.scenes import SceneError
from tests.helpers.flir import FlirCamera, write_flir

CELSIUS = np.linspace(10, 30, 12 * 16, dtype=np.float32).reshape(12, 16)
COUNTS = FlirCamera().counts(CELSIUS)
PHOTO = np.zeros((24, 32, 3), np.uint8)


def tiff(path):
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(CELSIUS).save(path)


def photo(path):
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(PHOTO).save(path)


def names(sources):
    return [(v.view, v.thermal.name, None if v.rgb is None else v.rgb.name) for v in sources.views]


def test_flir_files_bring_their_photos(tmp_path):
    write_flir(tmp_path / "a.jpg", COUNTS, PHOTO)
    write_flir(tmp_path / "b.jpg", COUNTS, PHOTO)
    photo(tmp_path / "b.png")  # a better photo of the same view
    lonely = [f"lonely{number}" for number in range(6)]
    for name in lonely:
        photo(tmp_path / f"{name}.png")
    found = find_sources(tmp_path)
    assert names(found) == [("a", "a.jpg", None), ("b", "b.jpg", "b.png")]
    # in order: in another one, the key of a stage would differ, and a second run would begin again
    left_out = [(path.stem, reason) for path, reason in found.left_out.items()]
    assert left_out == [(name, f"no thermal image is named {name}") for name in lonely]


def test_folders_and_equal_names(tmp_path):
    (tmp_path / "raw_images").mkdir()
    write_flir(tmp_path / "raw_images" / "a.jpg", COUNTS, PHOTO)
    photo(tmp_path / "thumbnail.jpg")
    assert names(find_sources(tmp_path)) == [("a", "a.jpg", None)]
    for view in "ab":
        tiff(tmp_path / "thermal" / f"{view}.tiff")
    photo(tmp_path / "rgb" / "b.jpg")
    found = find_sources(tmp_path)
    assert names(found) == [("b", "b.tiff", "b.jpg")]
    assert list(found.left_out.values()) == ["no RGB image is named a"]


def test_patterns(tmp_path):
    for view in ("DJI 1", "DJI 2"):
        tiff(tmp_path / f"{view}_T.tiff")
        photo(tmp_path / "wide" / f"{view}_V.jpg")
    found = find_sources(tmp_path, ("*_T.tiff", "wide/*_V.jpg"))
    assert names(found) == [(v, f"{v}_T.tiff", f"{v}_V.jpg") for v in ("DJI 1", "DJI 2")]
    for wrong in ("no_star.tiff", "*_*.tiff", "../*.tiff", "/*.tiff"):
        with pytest.raises(SceneError, match="--pairs"):
            find_sources(tmp_path, (wrong, "wide/*_V.jpg"))


def test_nothing_found_names_the_remedy(tmp_path):
    tiff(tmp_path / "1_T.tiff")
    photo(tmp_path / "1_V.jpg")
    with pytest.raises(SceneError, match=r"1_T\.tiff: no RGB image is named 1_T.*--pairs '\*_T\.tiff'"):
        find_sources(tmp_path)
    with pytest.raises(SceneError, match="must match files of equal view names"):
        find_sources(tmp_path, ("*_X.tiff", "*_V.jpg"))
    with pytest.raises(SceneError, match="is no folder"):
        find_sources(tmp_path / "nowhere")
