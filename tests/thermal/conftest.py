from dataclasses import replace
from functools import partial

import pytest

from tdgbench.scenes import ReadOptions, Scene
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset, ThermalErrors
from tdgbench.thermal import ThermalCamera, estimate_camera

SIZE = {"width": 96, "height": 72, "views": 15}


@pytest.fixture(scope="session")
def make_scene(tmp_path_factory):
    """A function that makes a scene whose thermal camera has the given errors."""
    root = tmp_path_factory.mktemp("thermal")

    def make(name="turntable", points=1500, **errors) -> Scene:
        capture = CaptureErrors(thermal_camera=ThermalErrors(**{"encoding": "degC", **errors}))
        return SyntheticDataset(str(root), ReadOptions(), **SIZE, points=points, errors=capture).load(name)

    return make


@pytest.fixture(scope="session")
def clean_scene(make_scene) -> Scene:
    """Temperatures with noise alone."""
    return make_scene()


@pytest.fixture(scope="session")
def drifting_scene(make_scene) -> Scene:
    """Offsets of ±4 °C, gains of ±5 %, 2.6 °C of vignette."""
    return make_scene(points=2500, walk_degC=4.0, shutter_views=6, gain=0.05, vignette_degC=2.6)


@pytest.fixture(scope="session")
def drifting_camera(drifting_scene) -> ThermalCamera:
    """As estimated, without test views, none of which can be read."""
    refuse = partial(pytest.fail, "a test view is read")
    unread = [replace(view, load_thermal=refuse) for view in drifting_scene.test]
    camera = estimate_camera(replace(drifting_scene, test=unread))
    assert isinstance(camera, ThermalCamera)
    return camera
