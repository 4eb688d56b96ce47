"""Which file is which view: the same scene under other names has the poses and pixels of the original."""

from __future__ import annotations

import shutil
import unicodedata
from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from PIL import Image

from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap import write_model
from tests.helpers.scenes import load


def renamed(folder, in_model, on_disk=None, kinds=("thermal", "rgb")):
    """Rename images of a scene: model and files, without folders."""
    model = pycolmap.Reconstruction(str(folder / "sparse" / "0"))
    for image in model.images.values():
        image.name = in_model(image.name)
    model.write(str(folder / "sparse" / "0"))
    for kind in kinds:
        for path in list((folder / kind).iterdir()):
            target = folder / kind / (on_disk or in_model)(path.name)
            target.parent.mkdir(parents=True, exist_ok=True)
            path.rename(target)


def same(scene, original, count=10):
    """Whether views in the order of their names show those of the original."""
    assert len(scene.views) == count
    for view, other in zip(scene.views, original.views[-count:], strict=True):
        assert np.allclose(view.camera.world_to_camera, other.camera.world_to_camera, atol=1e-9)
        assert np.array_equal(view.thermal, other.thermal) and np.array_equal(view.rgb, other.rgb)
        assert view.thermal_path.is_file()


def number(name):
    return int(name[4:7])


def in_two(name):
    return f"{'left' if number(name) < 5 else 'right'}/{number(name) % 5:04d}.png"


NAMES = {
    "decomposed": (
        lambda name: "Gebäude " + name,
        lambda name: unicodedata.normalize("NFD", "Gebäude ") + name,
        "Gebäude view000",
    ),
    "upper": (lambda name: name, lambda name: name.replace(".png", ".PNG"), "view000"),
    "dots": (lambda name: f"2024.05.01_{name[:-4]}.0.png", None, "2024.05.01_view000.0"),
    "no extension": (lambda name: "flight." + name[:-4], lambda name: "flight." + name, "flight.view000"),
    "folders": (
        lambda name: f"images/{number(name) // 5}/{name}",
        lambda name: f"{number(name) // 5}/{name}",
        "view000",
    ),
    "windows": (lambda name: in_two(name).replace("/", "\\"), in_two, "left_0000"),
    "equal base names": (in_two, None, "left_0000"),
    "flat": (in_two, lambda name: in_two(name).replace("/", "_"), "left_0000"),
}


@pytest.mark.parametrize("kind", NAMES)
def test_names(folder, kind):
    original = load(folder)
    _ = [(view.thermal, view.rgb) for view in original.views]
    in_model, on_disk, first = NAMES[kind]
    renamed(folder, in_model, on_disk)
    scene = load(folder)
    same(scene, original)
    assert scene.views[0].name == first and scene.notes == original.notes and "names" not in scene.assumed


def test_pairs_across_folders_are_told(folder):
    original = load(folder)
    _ = [view.rgb for view in original.views]
    renamed(folder, lambda name: f"tuesday/{name}", lambda name: f"monday/{name}")
    scene = load(folder)
    same(scene, original)
    assert scene.assumed["names"] == "paired by base names: files in monday/, poses of tuesday/"


def test_names_that_do_not_pair_say_why(folder):
    renamed(folder, lambda name: name, lambda name: "VIEW" + name[4:])
    with pytest.raises(SceneError, match=r"in case alone differ \['VIEW000', 'view000'\]; rename them"):
        load(folder)
    renamed(folder, in_two, lambda name: f"{number(name) % 5:04d}.png" if number(name) < 5 else name)
    with pytest.raises(SceneError, match="0000 may be left/0000 or right/0000; put images into folders as the poses"):
        load(folder)


def test_a_copy_in_a_subfolder_is_no_view(folder):
    """Small copies beside the images: they stand for no image that is missing."""
    original = load(folder)
    shutil.copytree(folder / "thermal", folder / "thermal" / "small")
    (folder / "thermal" / "view000.png").unlink()
    scene = load(folder)
    same(scene, original, 9)
    assert "10 thermal images have no pose and are omitted: small/view000" in scene.notes[-2]


@pytest.mark.parametrize("moved", [0.0, 0.1])
def test_a_model_of_rgb_and_thermal_images(folder, moved):
    """Thermal images have their own poses; RGB images of other poses are no registered pairs."""
    original = load(folder)
    _ = [view.rgb for view in original.views]
    poses = []
    for view in original.views:
        shifted = view.camera.world_to_camera.copy()
        shifted[0, 3] += moved
        poses += [(f"rgb/{view.name}.png", replace(view.camera, world_to_camera=shifted))]
    poses += [(f"thermal/{view.name}.png", view.camera) for view in original.views]
    write_model(folder / "sparse" / "0", poses, original.points)
    scene = load(folder)
    if not moved:
        same(scene, original)
    else:
        assert all(view.load_rgb is None for view in scene.views) and scene.notes[0].startswith("10 RGB images have no")
        for view, other in zip(scene.views, original.views, strict=True):
            assert np.allclose(view.camera.world_to_camera, other.camera.world_to_camera, atol=1e-9)


def test_the_largest_of_several_models(folder):
    original = load(folder)
    whole = pycolmap.Reconstruction(str(folder / "sparse" / "0"))
    for part, kept in ((0, range(3)), (1, range(3, 10))):
        model = pycolmap.Reconstruction(whole)
        for image in list(model.images.values()):
            if number(image.name) not in kept:
                model.deregister_frame(image.frame_id)
        (folder / "sparse" / str(part)).mkdir(exist_ok=True)
        model.write(str(folder / "sparse" / str(part)))
    scene = load(folder)
    same(scene, original, 7)
    assert scene.assumed["model"] == "sparse/1: 7 of 10 thermal images, of 2 models (0: 3, 1: 7)"
    assert "to read another one, remove or rename sparse/1" in scene.notes[0]
    shutil.rmtree(folder / "sparse" / "0")
    assert len(load(folder).views) == 7


def test_files_that_are_not_read_are_named(folder):
    original = load(folder)
    _ = original.views[-1].rgb
    for path in list((folder / "rgb").iterdir()):
        if number(path.name) < 3:
            path.rename(path.with_suffix(".heic"))
        else:
            Image.open(path).save(path.with_suffix(".webp"), lossless=True)
            path.unlink()
    scene = load(folder)
    assert "rgb/ holds 3 files that are not read (view000.heic, view001.heic, view002.heic); convert them to PNG" in (
        scene.notes
    )
    assert np.array_equal(scene.views[-1].rgb, original.views[-1].rgb)
    for path in list((folder / "thermal").iterdir()):
        path.rename(path.with_suffix(".seq"))
    with pytest.raises(SceneError, match=r"holds no image; .*thermal/ holds 10 files that are not read \(view000\.seq"):
        load(folder)


def save_mask(path, dark, inverted=False):
    path.parent.mkdir(exist_ok=True)
    levels = np.full((36, 48), 0 if inverted else 255, np.uint8)
    levels[:, :dark] = 255 if inverted else 0
    Image.fromarray(levels).save(path)


@pytest.mark.parametrize(
    ("file", "inverted"),
    [("masks/{}.png", False), ("masks/{}.png.png", False), ("masks/{}.jpg", False), ("rgb/dynamic_mask_{}.png", True),
     ("thermal/dynamic_mask_{}.png", True)],
)  # fmt: skip
def test_masks(folder, file, inverted):
    before = load(folder).fingerprint
    for n in range(4):
        save_mask(folder / file.format(f"view{n:03d}"), 8 * (n + 1), inverted)
    scene = load(folder)
    for n, view in enumerate(scene.views):
        expected = np.arange(48) >= 8 * (n + 1) if n < 4 else np.ones(48, bool)
        assert np.array_equal(np.ones((36, 48), bool) if view.valid is None else view.valid, np.tile(expected, (36, 1)))
    assert "4 files" in scene.assumed["masks"] and scene.notes == [] and scene.fingerprint != before
    save_mask(folder / "masks" / "nobody.png", 8)
    assert "1 masks belong to no view and are not used: nobody" in load(folder).notes
    save_mask(folder / "masks" / "view000.bmp", 8)
    with pytest.raises(SceneError, match=r"are both (masks of )?view"):
        load(folder)
