"""Options: unusual values for every option of conf/, and words that Hydra does not understand."""

from __future__ import annotations

import random
import shutil
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, cast

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from benchmarks.fuzz import cells
from benchmarks.fuzz.case import Change, Kind, Programs
from benchmarks.fuzz.inputs import CELL, SCENE, copy_scene
from tdgbench.resources import conf_folder

GROUPS = ("backend", "budget", "dataset", "init", "method", "metrics", "prior", "skip", "thermal_camera")
PRIOR = "prior=sfm_points"  # of the captures; the default needs weights
NEED_MORE = ("prior=marigold", "prior=depth_anything", "prior=onnx", "prior=synthetic", "backend=cuda",
             "backend=reference", "dataset=paper", "dataset=rgbt_scenes", "dataset=thermalmix",
             "dataset=thermoscenes", "dataset=ti_nsd")  # fmt: skip
SMALL = {"dataset=synthetic": ("dataset.loader.width=32", "dataset.loader.height=24", "dataset.loader.views=6",
                               "dataset.loader.points=150", "scene=orbit")}  # fmt: skip
FREE = ("name", "results", "root", "scene", "label", "weights", "folder", "default_scene", "compared_with", "order",
        "device", "model")  # fmt: skip
LONG = (
    "budget.iterations",
    "dataset.loader.views",
    "budget.density.split_into",
)  # large values are legal, and take long
NOT_A_NUMBER = ("abc", "nan", "inf", "-inf", "[1,2]", "{a: 1}", "'1 2'", "1e999", "''", "${oc.env:HOME}")
NUMBERS = ("-1", "0", "null", "true", "0.5", "1e-320", "-0.0", "3", "99", "${nosuch}", "${", "1_000")
LARGE = ("1e308", "9223372036854775808", "1000000000")
NOT_A_SWITCH = ("maybe", "2", "[]", "nan", "''", "{}")
NOT_A_CHOICE = ("nosuch", "''", "3", "[a]", "null", "nan")
TEXTS = ("nosuch", "''", "3", "null", "[a]", "'a b'", "${nosuch}", "é", "'x\ny'", "a" * 300, "../..", "/dev/null/x")
WORDS = (  # arguments that are no KEY=VALUE, or of an unknown key
    ("budget.nosuch=3", "nosuch"), ("nosuch=3", "nosuch"), ("method=nosuch", "nosuch"), ("=3", "=3"), ("a=b=c", "a"),
    ("scene=[", "scene"), ("--nosuch", "nosuch"), ("-x", "-x"), ("~nosuch", "nosuch"), ("seed=0,abc", "abc"),
    ("seed=0,1", "seed"), ("method@x=tdg", "method"), ("+experiment=nosuch", "nosuch"), ("é", "é"), ("'", "'"),
    ("budget={", "budget"), ("scene=a;b", ";"), ("threads=0,1", "threads"), ("hydra/launcher=nosuch", "nosuch"),
)  # fmt: skip


class Option(NamedTuple):
    """An option: words that select its group, its key, a good value."""

    words: tuple[str, ...]
    key: str
    value: Any


class Options(Kind):
    """A tiny cell with one or more options of unusual values."""

    name, share = "options", 11

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        shutil.rmtree(folder / "data", ignore_errors=True)
        copy_scene(base, folder / "data" / SCENE)
        self.words: list[str] = [*CELL, "method=tdg", PRIOR, f"scene={SCENE}"]
        self.chosen: set[str] = set()

    def mutate(self, rng: random.Random) -> Change:
        if rng.random() < 0.08:
            word, name = rng.choice(WORDS)
            self.words.append(word)
            return Change(f"word {word}", (name,), harmful=True)
        option = rng.choice([one for one in options() if one.key not in self.chosen])
        self.chosen.add(option.key)
        value, harmful = _value(option, rng)
        self.words = [w for w in self.words if w.split("=")[0] != option.key]
        selected = [w for w in option.words if w not in self.words]
        self.words += [*selected, f"{option.key}={value}"]
        names = (option.key, option.key.split(".")[-1], "HOME", "not finite")  # the latter of a training that diverges
        return Change(f"{option.key}={value[:60]}", names, harmful)

    def run(self, programs: Programs) -> int:
        return cells.command_and_verify(programs, self.words, "out/single")

    def wrong(self) -> str:
        if self.chosen & {"name", "results", "scene", "data.root", "overwrite"}:  # results may be elsewhere
            return ""
        return cells.unverified(self.folder)


def _value(option: Option, rng: random.Random) -> tuple[str, bool]:
    """A value, and whether no program should accept it."""
    last, value = option.key.split(".")[-1], option.value
    if isinstance(value, bool):
        chosen = rng.choice((*NOT_A_SWITCH, "null", "${nosuch}"))
        return chosen, chosen in NOT_A_SWITCH
    if last in FREE:
        return rng.choice(TEXTS), False
    if isinstance(value, int | float) or value is None:
        chosen = rng.choice((*NOT_A_NUMBER, *NUMBERS, *(() if option.key in LONG else LARGE)))
        return chosen, chosen in NOT_A_NUMBER
    if isinstance(value, str):
        chosen = rng.choice(NOT_A_CHOICE)
        return chosen, chosen not in ("null", "3")
    return rng.choice(("3", "abc", "null", "[]")), False


@cache
def options() -> tuple[Option, ...]:
    """Every option of conf/config.yaml and of every choice of its groups."""
    found: dict[tuple[str, ...], Option] = {}
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        for word in ("", *_choices()):
            words = (word, *SMALL.get(word, ())) if word else ()
            cfg = compose("config", overrides=[PRIOR, *words])
            for key, value in _leaves(cfg):
                if not word or key.startswith(f"{word.split('=')[0]}."):
                    found.setdefault((word if key.split(".")[0] in GROUPS else "", key), Option(words, key, value))
    GlobalHydra.instance().clear()
    return tuple(found.values())


def _choices() -> list[str]:
    words = [f"{group}={path.stem}" for group in GROUPS for path in sorted((conf_folder() / group).glob("*.yaml"))]
    return [word for word in words if word not in NEED_MORE]


def _leaves(cfg: DictConfig) -> list[tuple[str, Any]]:
    """Dotted keys and values; an interpolation that only a whole run resolves is a text."""
    found: list[tuple[str, Any]] = []

    def visit(content: dict[str, Any], prefix: str) -> None:
        for name, value in content.items():
            if isinstance(value, dict):
                visit(value, f"{prefix}{name}.")
            elif not isinstance(value, list):
                found.append((prefix + name, _resolved(cfg, prefix + name, value)))

    visit(cast(dict[str, Any], OmegaConf.to_container(cfg, resolve=False)), "")
    return found


def _resolved(cfg: DictConfig, key: str, value: Any) -> Any:
    try:
        return OmegaConf.select(cfg, key)
    except OmegaConfBaseException:
        return value
