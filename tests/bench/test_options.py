"""Every option is checked where it enters; the message names it as it is typed."""

from __future__ import annotations

import pytest
from omegaconf import OmegaConf

from tdgbench.bench.options import (
    OptionError,
    check_cell_names,
    check_experiment_options,
    check_options,
    names_to_text,
)
from tdgbench.experiments.error_time import ErrorTimeOptions
from tdgbench.experiments.experiment import experiment_of
from tests.helpers.configs import config
from tests.helpers.paths import ROOT

GROUPS = ("dataset", "init", "prior", "method", "backend", "budget", "metrics", "skip", "thermal_camera")
EXPERIMENTS = sorted(path.stem for path in (ROOT / "conf" / "experiment").glob("*.yaml"))
LARGEST = {"seed": 2**63 - 1, "budget.iterations": 2**63 - 1, "checkpoint": 2**63 - 1, "dataset.loader.views": 1000}
WRONG = [
    ("data.width=0", "data.width=0: must be at least 1"),
    ("data.channels=2", "data.channels=2: must be auto, 1 or 3"),
    ("data.split=thirds", "data.split=thirds: must be eighty_twenty, every_8th or folder"),
    ("+data.depth=1", "data.depth=1: is no option"),
    ("+colour=red", "colour=red: is no option"),
    ("seed=-1", "seed=-1: must be at least 0"),
    ("seed=abc", "seed=abc: must be a valid integer"),
    *((f"{name}={2**63}", f"{name}={2**63}: must be at most {most}") for name, most in LARGEST.items()),
    (f"budget.iterations={10**23}", f"budget.iterations={10**23}: must be at most 9223372036854775807"),
    ("seed=-12345678901234567890123", "seed=-12345678901234567890123: must be at least 0"),
    ("overwrite=maybe", "overwrite=maybe: must be only-missing, always or never"),
    ("retry_failed=maybe", "retry_failed=maybe: must be a valid boolean"),
    ("checkpoint=-1", "checkpoint=-1: must be at least 0"),
    ("checkpoint=inf", "checkpoint=inf: must be a finite number"),
    ("threads=0", "threads=0: must be at least 1"),
    ("table=big", "table=big: must be main, ablation or readings"),
    ("backend.name=gpu", "backend.name=gpu: must be auto, cpu, cuda, reference or warp"),
    ("budget.iterations=0", "budget.iterations=0: must be greater than 0"),
    ("budget.iterations=12.5", "budget.iterations=12.5: must be a valid integer"),
    ("budget.iterations=nan", "budget.iterations=nan: must be a valid integer"),
    ("budget.iterations=???", "budget.iterations: is missing; set it with budget.iterations=VALUE"),
    ("budget.sh_every=0", "budget.sh_every=0: must be greater than 0"),
    ("budget.sh_degree=4", "budget.sh_degree=4: must be at most 3"),
    ("budget.rates.opacity_logits=nan", "budget.rates.opacity_logits=nan: must be a finite number"),
    ("budget.rates.means_final=0", "budget.rates.means_final=0: must be greater than 0"),
    ("budget.density.every=0", "budget.density.every=0: must be greater than 0"),
    ("budget.plateau.gain=-0.1", "budget.plateau.gain=-0.1: must be at least 0"),
    ("metrics.convention=nosuch", "metrics.convention=nosuch: must be 3dgs or standard"),
    ("metrics.ssim_border=nosuch", "metrics.ssim_border=nosuch: must be zero or valid"),
    ("metrics.lpips_range=nosuch", "metrics.lpips_range=nosuch: must be unit or signed"),
    ("metrics.lpips.net=nosuch", "metrics.lpips.net=nosuch: must be vgg, alex or squeeze"),
    ("metrics.extra=edges.EDGE", "metrics.extra=edges.EDGE: must be a valid list, such as metrics.extra=[edges.EDGE]"),
    ("~metrics._target_", "metrics: lacks `_target_`: begin its file with `defaults: [CHOICE, _self_]`"),
    ("metrics.lpips=null", "metrics.lpips: may not be null; set its options: metrics.lpips.net, metrics.lpips.weights"),
    ("thermal_camera.estimate=3", "thermal_camera.estimate=3: must be a valid boolean"),
    ("+thermal_camera.nosuch=3", "thermal_camera.nosuch=3: is no option; there are estimate"),
    ("skip.gray=3", "skip.gray=3: must be a valid boolean"),
    ("+skip.growth=false", "skip: growth is a rule of the budget: budget.growth=null switches it off"),
    ("+skip.night=true", "skip: there is no skip night; there are gray, rgb"),
    ("method.method.lambda_depth=inf", "method.method.lambda_depth=inf: must be a finite number"),
    ("method.method.lambda_ssim=1.5", "method.method.lambda_ssim=1.5: must be at most 1"),
    ("method.method.depth_reading=printed", "method.method.depth_reading=printed: must be written or released"),
    ("method.method.decay=cubic", "method.method.decay=cubic: must be linear or switch"),
    ("~method.method.smoothness_reading", "method.method.smoothness_reading: is missing"),
    ("+method.method.speed=1", "method.method.speed=1: is no option; there are lambda_ssim, lambda_smooth"),
    ("method.method._target_=no_such.Class", "method.method._target_=no_such.Class: cannot be imported"),
    ("prior.estimator.blur_px=-1", "prior.estimator.blur_px=-1: must be at least 0"),
    ("prior.made_from=clouds", "prior.made_from=clouds: must be thermal images, points, truth or files"),
    ("~prior.made_from", "prior.made_from: is missing"),
    ("+prior.made_form=points", "prior.made_form: is no option; did you mean prior.made_from?"),
    ("+method.compare_with=3dgs", "method.compare_with: is no option; did you mean method.compared_with?"),
    ("dataset.loader.views=0", "dataset.loader.views=0: must be at least 2"),
    ("data.root=${nowhere}", "data.root: Interpolation key 'nowhere' not found"),
    ("method.name=''", "method.name='': must not be empty"),
    ("init.name=''", "init.name='': must not be empty"),
    ("method.name='tdg fast'", "method.name=tdg fast: must be one word without brackets"),
    ("init.name='a(b)'", "init.name=a(b): must be one word without brackets"),
    ("name=''", "name='': must be the name of one folder"),
    ("name=a/b", "name=a/b: must be the name of one folder"),
    ("name=../x", "name=../x: must be the name of one folder"),
    ("name=.x", "name=.x: must be the name of one folder"),
    ("name=1e3", "name=1000.0: must be text; put it in quotes"),
    ("scene=1.10", "scene=1.1: must be text; put it in quotes"),
]


def error_of(*overrides: str) -> str:
    """Message of the error of a configuration."""
    with pytest.raises(OptionError) as caught:
        check_options(config(*overrides))
    return str(caught.value)


def test_an_option_that_a_method_inherits_from_another_module():
    assert error_of("method=mmone", "method.method.lambda_ssim=2") == "method.method.lambda_ssim=2: must be at most 1"


@pytest.mark.parametrize(("override", "message"), WRONG)
def test_an_option_that_is_not_allowed(override, message):
    error = error_of(override)
    assert error.startswith(message) and "\n" not in error and error.count(": ") <= 3


def test_all_problems_are_in_one_message_once():
    error = error_of("data.width=0", "seed=-1", "method.method.lambda_ssim=nan")
    assert sorted(error.split("; ")) == [
        "data.width=0: must be at least 1",
        "method.method.lambda_ssim=nan: must be a finite number",
        "seed=-1: must be at least 0",
    ]


CHOICES = {group: sorted(path.stem for path in (ROOT / "conf" / group).glob("*.yaml")) for group in GROUPS}
OF_FILES = {"renders": "++method.folder=DIR", "model": "++method.ply=FILE"}  # without a default


@pytest.mark.parametrize("number", range(max(map(len, CHOICES.values()))))
def test_every_choice_of_every_group_is_allowed(number):
    chosen = {group: found[number % len(found)] for group, found in CHOICES.items()}
    words = [f"{group}={choice}" for group, choice in chosen.items()]
    check_options(config(*words, *filter(None, [OF_FILES.get(chosen["method"])])))


def test_options_without_what_they_belong_to():
    must = "must be options with a _target_, or null; choose a configuration that has them"
    assert error_of("budget=short", "+budget.growth=4").startswith(f"budget.growth=4: {must}")
    assert error_of("budget=short", "+budget.growth.views=4").startswith(f"budget.growth: {must}")


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_the_options_of_every_experiment_are_allowed(name):
    cfg = config(f"+experiment={name}")
    experiment_of(cfg).check(cfg)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("study.samples=1", "study.samples=1: must be at least 2"),
        ("study.scenes=orbit", "study.scenes=orbit: must be a valid list"),
        ("study.runs=[{label: a, method: tdg, share: inf}]", "study.runs[0].share=inf: must be a finite number"),
        ("+study.speed=1", "study.speed=1: is no option; there are methods, scenes"),
    ],
)
def test_an_option_of_an_experiment_that_is_not_allowed(override, message):
    with pytest.raises(OptionError) as caught:
        check_experiment_options(config("+experiment=error_time", override), ErrorTimeOptions)
    assert str(caught.value).startswith(message)


def test_names_may_be_whole_numbers():
    cfg = names_to_text(config("name=2024", "scene=1", "results=7", "data.root=3"))
    assert (cfg.name, cfg.scene, cfg.results, cfg.data.root) == ("2024", "1", "7", "3")
    check_options(cfg)


def test_parameters_of_a_plug_in_without_annotations_must_be_finite(tmp_path, monkeypatch):
    code = "from tdgbench.training.method import Method\n"
    code += "class Mine(Method):\n    def __init__(self, weight, other=()):\n        pass\n"
    (tmp_path / "mine_without.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    cfg = config()
    OmegaConf.update(cfg, "method.method", {"_target_": "mine_wihtout.Mine", "weight": 1.0}, merge=False)
    with pytest.raises(OptionError, match=r"No module named 'mine_wihtout'; did you mean mine_without\?"):
        check_options(cfg)
    OmegaConf.update(cfg, "method.method._target_", "mine_without.Mine")
    check_options(cfg)
    OmegaConf.update(cfg, "method.method.weight", [1.0, float("nan")])
    with pytest.raises(OptionError, match=r"method\.method\.weight\[1\]=nan: must be a finite number"):
        check_options(cfg)


def test_the_file_of_a_method_of_the_user_is_named(tmp_path):
    (tmp_path / "method").mkdir()
    file = tmp_path / "method" / "mine.yaml"
    file.write_text("name: mine\n")
    of_command = {"provider": "command-line", "path": str(tmp_path)}
    hydra = {"runtime": {"config_sources": [of_command], "choices": {"method": "mine"}}, "overrides": {"task": []}}

    def composed(*words):
        return OmegaConf.create({**config(f"results={tmp_path}", *words), "hydra": hydra})

    with pytest.raises(OptionError, match=f"order=first: must be a valid integer .in {file}"):
        check_options(composed("method.order=first"))
    (tmp_path / "method" / "broken.yaml").write_text("name: a: b\n")
    with pytest.raises(OptionError, match=f"is no method, .*; did you mean 3dgs. .in {file}"):
        check_cell_names(composed("method.compared_with=3dg"), {})
    for baseline in ("3dgs", "mine", "broken"):
        check_cell_names(composed(f"method.compared_with={baseline}"), {})


@pytest.mark.parametrize(
    "given",
    [["metrics.convention=standard"], ["metrics.ssim_border=valid"], ["metrics=standard", "metrics.lpips_range=unit"]],
)
def test_a_convention_is_what_its_name_says(given):
    check_options(config("metrics=standard"))
    with pytest.raises(OptionError, match="choose metrics=3dgs or metrics=standard"):
        check_options(config(*given))
