"""TDg as released: decay, depth render, depth maps, and the whole loss of a step."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from PIL import Image

from methods.tdg import DepthTarget, DepthTargets, released_depth
from tdgbench.priors import DepthPrior, PriorError
from tdgbench.priors.files import FilePrior
from tdgbench.scenes import Camera, Scene, View
from tdgbench.splats import Gaussians
from tests.helpers.configs import config
from tests.helpers.training import ready_to_train
from tests.parity.originals import original, relative
from tests.parity.standing import Still, standing_view

LIMIT = 1e-5
FILES = ("bits8", "bits16")


@pytest.mark.parametrize("length", [500, 503, 1000, 10_000])
def test_decay(small_gray_scene, length):
    """w = 1 at the first iteration, 0 from half of them on."""
    method = ready_to_train(small_gray_scene, "tdg", length).method
    ours = [method._decay(iteration) for iteration in range(1, length + 1)]
    assert np.abs(np.array(ours) - original("decay")[f"w_decay_{length}"]).max() < 1e-12


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_depth_render(backend):
    """Normalised over Gaussians, blended, divided by alpha; theirs was blended by our reference in double."""
    theirs = original("depth_render")
    assert 0 < theirs["valid"].sum() < len(theirs["valid"])
    height, width = theirs["render_vis"].shape
    tensors = {name: torch.from_numpy(theirs[name]) for name in ("means", "log_scales", "quats", "opacity_logits")}
    gaussians = Gaussians(**tensors, sh=torch.zeros(len(theirs["means"]), 1, 1))
    focal = width / (2 * np.tan(theirs["fov_x"].item() / 2))
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    ours = released_depth(gaussians, Camera(K, theirs["world_to_camera"].astype(np.float64), width, height), backend)
    assert theirs["render_vis"].max() > 0.3 and relative(ours, theirs["render_vis"]) < 1e-6


@pytest.mark.parametrize("size", [(12, 16)])
@pytest.mark.parametrize("name", FILES)
def test_depth_maps(tmp_path, name, size):
    """A PNG becomes the target of the loss: resized, valid where above 0, min-max over that, 0 elsewhere."""
    target = DepthTarget.from_prior(prior_of(tmp_path, name, size), torch.device("cpu"))
    theirs = original("depth_maps")[f"{name}_target_{size[0]}x{size[1]}"]
    assert np.abs(target.normalised.numpy() - theirs).max() < 1e-6


@pytest.mark.parametrize(
    ("name", "why"), [("empty", "no known value"), ("constant", "one value"), ("ones", "one value")]
)
def test_a_depth_map_without_depth_is_refused(tmp_path, name, why):
    """The release trains against a map of zeros, or of one value; here whoever made the map is told."""
    assert name != "empty" or not original("depth_maps")["empty_target_12x16"].any()
    with pytest.raises(PriorError, match=why):
        prior_of(tmp_path, name, (12, 16))


def prior_of(scene_folder: Path, name: str, size: tuple[int, int]) -> DepthPrior:
    """What the prior `files` makes of one of the fixture's maps, for a view of a size (height, width)."""
    folder = scene_folder / "depthesti" / "train"
    folder.mkdir(parents=True)
    Image.fromarray(original("depth_maps")[f"{name}_file"]).save(folder / "view.png")
    view = View("view", Camera(np.eye(3), np.eye(4), size[1], size[0]), load_thermal=lambda: None)
    scene = Scene("s", "d", "", [view], [], None, None, "folder", "", 1, folder=scene_folder)
    return FilePrior(None, "depth").estimate(scene, view).check(view)


def test_whole_loss_of_tdg():
    """0.8 L1 + 0.2 (1 − SSIM) + 0.6 smoothness, without depth, which has no gradient there."""
    theirs = original("totals")
    method = instantiate(config("method=tdg_released").method.method)
    method.model, method.views, method.skips_depth = Still("thermal", 10), standing_view(), True
    method.depth_end, method.targets = 1, DepthTargets({}, torch.device("cpu"))
    step = method.step(1)
    step.loss.backward()
    assert step.loss.item() == pytest.approx(float(theirs["tdg"]), rel=LIMIT)
    assert relative(method.model.image.grad.permute(2, 0, 1), theirs["tdg_gradient"]) < LIMIT


@pytest.mark.parametrize("case", [0, 1, 2])
def test_whole_loss_of_msmg(case):
    """Each loss is weighted with the other model's share of the Gaussians."""
    theirs = original("totals")
    counts = theirs["msmg_counts"][case]
    method = instantiate(config("method=msmg").method.method)
    method.rgb, method.thermal = Still("rgb", int(counts[0])), Still("thermal", int(counts[1]))
    method.rgb_views = method.thermal_views = standing_view()
    step = method.step(1)
    step.loss.backward()
    assert step.loss.item() == pytest.approx(float(theirs[f"msmg_{case}"]), rel=LIMIT)
    for name, model in {"rgb": method.rgb, "thermal": method.thermal}.items():
        gradient = theirs[f"msmg_{case}_gradient_{name}"]
        assert relative(model.image.grad.permute(2, 0, 1), gradient) < LIMIT
