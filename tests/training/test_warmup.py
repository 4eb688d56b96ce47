from hydra.utils import instantiate

from tdgbench.splats.cpu.losses.photometric import photometric_band
from tdgbench.splats.cpu.raster.blend import make_blend
from tdgbench.splats.cpu.raster.blend_backward import make_blend_backward
from tdgbench.training.warmup import compile_kernels
from tests.helpers.configs import config


def test_compiles_what_a_gray_scene_needs():
    compile_kernels({1}, instantiate(config("budget=demo").budget), "auto")
    for depth in (False, True):
        assert make_blend(1, depth).signatures and make_blend_backward(1, depth, False).signatures


def test_compiles_what_masks_need():
    """The kernels without a mask are compiled apart."""
    compile_kernels({1}, instantiate(config("budget=demo").budget), "auto", masked=True)
    kinds = {str(signature[3]) for signature in photometric_band.signatures}
    assert len(kinds) == 2 and sum("none" in kind for kind in kinds) == 1
