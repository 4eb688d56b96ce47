import json

import pytest
from hydra.utils import instantiate

from methods.gaussian_splatting import GaussianSplatting
from tdgbench.bench.setup import loader_of
from tdgbench.cells.key import cell_key, relevant_config, why_differs
from tdgbench.cells.record import Failure, Record
from tests.helpers.configs import SMALL, config
from tests.helpers.paths import ROOT


def record(*overrides, method="3dgs", data="d", code="c"):
    cfg = config(*SMALL, f"method={method}", *overrides)
    plug_in = GaussianSplatting(0.2, 0.0, "released", 1.0)
    plug_in.needs_prior = method == "tdg"
    made = Record(method, "synthetic", "orbit", "colmap", int(cfg.seed), "e", "")
    made.config, made.data, made.code = relevant_config(cfg, plug_in), data, code
    made.key = cell_key(made)
    return made


def test_the_key_covers_what_matters_and_nothing_else():
    base = record().key
    same = ("results=elsewhere", "threads=1", "overwrite=always", "data.root=/x", "prior=synthetic",
            "metrics.lpips.download=true", "retry_failed=true", "method.label=Mine")  # fmt: skip
    assert record(*same).key == base
    for other in ("seed=1", "method.method.lambda_ssim=0.3", "budget.iterations=9", "init=random", "metrics=standard",
                  "data.width=20", "backend=reference", "skip.gray=false"):  # fmt: skip
        assert record(other).key != base, other
    tdg = record(method="tdg").key  # with the default prior of the built-in scenes
    assert record("prior=synthetic", method="tdg").key == tdg != record("prior=sfm_points", method="tdg").key
    assert record("prior.made_from=points", method="tdg").key != tdg
    assert record(data="e").key != base and record(code="e").key != base


def test_what_changed_is_named():
    base = record()
    assert why_differs(base, record("results=elsewhere")) == []
    assert why_differs(base, record("budget.iterations=9")) == ["budget.iterations: 3000 → 9"]
    both = why_differs(base, record("seed=1", "init=random"))
    assert "seed: 0 → 1" in both and 'init.name: "colmap" → "random"' in both
    assert "init.points.count: nothing → 100000" in both
    assert why_differs(base, record(data="e", code="e")) == ["the scene's files changed", "the code changed"]
    renders = "the files of its renders, model or prior changed"
    assert why_differs(record(data="d-1"), record(data="d-2")) == [renders]
    base.failure, base.key, base.data, base.code = Failure("load", "no run.json", ""), "", "", ""
    assert why_differs(base, record()) == ["what failed in load"]


@pytest.mark.parametrize("dataset", sorted(path.stem for path in (ROOT / "conf" / "dataset").glob("*.yaml")))
def test_every_data_set_has_a_key_without_its_folder_and_channels_without_the_skip(dataset):
    """A loader may name a data set (`dataset=paper`), or read another loader's scenes (`dataset=drifting`)."""
    keys = []
    for root in ("here", "there"):
        cfg = config(f"dataset={dataset}", f"data.root={root}", "method=3dgs")
        keys.append(relevant_config(cfg, instantiate(cfg.method.method)))
    assert keys[0] == keys[1] and '"here"' not in json.dumps(keys[0])
    loader = loader_of(cfg, instantiate(config("skip=none").skip))
    options = loader.inner.options if "inner" in loader else loader.options
    assert options.channels == 3
