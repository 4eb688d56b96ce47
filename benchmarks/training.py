"""`python -m benchmarks.training [hydra overrides]`: the parts of a training step; they add up to the step.

The same configuration as `python -m tdgbench` (dataset, method, budget …); `--steps` of warm-up, then as many measured.
Then steps and bare renders (forward, and backward from a constant gradient) take turns, for the ratio of the two.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections import defaultdict
from pathlib import Path

import pandas as pd
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from tdgbench.bench.setup import set_up
from tdgbench.scenes import Scene
from tdgbench.splats.cpu import pool
from tdgbench.splats.density import DensityControl
from tdgbench.splats.optimizer import Adam
from tdgbench.training.loop import train
from tdgbench.training.method import Method
from tdgbench.training.warmup import compile_kernels

CONF = Path(__file__).resolve().parents[1] / "conf"


class Parts:
    """Seconds per named part; a part inside another counts for itself only."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._inside: list[float] = []

    def wrap(self, owner: object, attribute: str, name: str) -> None:
        """Replace a function by one that times itself."""
        original = getattr(owner, attribute)

        @functools.wraps(original)
        def timed(*args, **kwargs):
            self._inside.append(0.0)
            start = time.perf_counter()
            try:
                return original(*args, **kwargs)
            finally:
                spent = time.perf_counter() - start
                self.seconds[name] += spent - self._inside.pop()
                if self._inside:
                    self._inside[-1] += spent

        setattr(owner, attribute, timed)

    def wrap_kernels(self) -> None:
        """Time the pool's work under the names of its kernels."""
        names = {
            "cull": "project", "project_and_list": "project",
            "count_digits": "bin", "move_by_digit": "bin", "count_pairs": "bin", "fill_lists": "bin",
            "blend": "blend", "blend_backward": "blend backward", "projection_backward": "projection backward",
            "coast_candidates": "Adam", "touched_rows": "Adam", "settle_rows": "Adam",
            "observe_seen": "density control", "observe_gradients": "density control",
        }  # fmt: skip
        original = pool.run

        def timed(function, arguments):
            start = time.perf_counter()
            try:
                return original(function, arguments)
            finally:
                spent = time.perf_counter() - start
                self.seconds[names.get(function.__name__, "losses")] += spent
                if self._inside:
                    self._inside[-1] += spent

        pool.run = timed  # type: ignore[assignment]


def measure(overrides: list[str], steps: int) -> pd.DataFrame:
    """Milliseconds per step of each part, and of the whole."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("config", overrides=overrides)
    scene = instantiate(cfg.dataset.loader).load(cfg.scene)
    method, budget = instantiate(cfg.method.method), instantiate(cfg.budget)
    set_up(method, cfg, scene, budget, cfg.backend.name)
    compile_kernels({scene.channels, *([3] if method.needs_rgb else [])}, budget, cfg.backend.name)
    train(method, steps)
    parts = Parts()
    run = pool.run
    parts.wrap_kernels()
    parts.wrap(Adam, "step", "Adam")
    parts.wrap(DensityControl, "observe", "density control")
    parts.wrap(DensityControl, "update", "density control")
    start = time.perf_counter()
    train(method, steps)
    whole = time.perf_counter() - start
    pool.run = run
    rows = [{"part": name, "ms": 1e3 * s / steps} for name, s in parts.seconds.items()]
    rest = whole - sum(parts.seconds.values())
    rows.append({"part": "Python and torch", "ms": 1e3 * rest / steps})
    table = pd.DataFrame(rows).sort_values("ms", ascending=False)
    table["share"] = table["ms"] / (1e3 * whole / steps)
    table.attrs["gaussians"] = sum(len(m) for m in method.models().values())
    table.attrs["step"], table.attrs["render"] = _steps_and_renders(method, scene, steps)
    return table


def _steps_and_renders(method: Method, scene: Scene, steps: int) -> tuple[float, float]:
    """Milliseconds of a training step, and of rendering every model forward and backward, turn by turn."""
    models, seconds = method.models(), {"step": 0.0, "render": 0.0}
    deep = method.step(1).thermal.depth is not None
    for turn in range(max(1, steps // len(scene.train))):
        for view in scene.train:  # a round of steps shows every view once, as do the renders
            start = time.perf_counter()
            for model in models.values():
                model.begin(1)
            method.step(1).loss.backward()
            for model in models.values():
                model.finish(1)
            middle = time.perf_counter()
            for model in models.values():
                render = model.render(view.camera, depth=deep)
                outputs = [render.image, *([render.depth] if render.depth is not None else [])]
                torch.autograd.backward(outputs, [torch.ones_like(o) for o in outputs])
                model.forget_views()
            end = time.perf_counter()
            if turn > 0 or steps < 2 * len(scene.train):
                seconds["step"] += middle - start
                seconds["render"] += end - middle
    count = len(scene.train) * max(1, steps // len(scene.train) - 1)
    return 1e3 * seconds["step"] / count, 1e3 * seconds["render"] / count


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.training", description=__doc__)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    table = measure(args.overrides, args.steps)
    for row in table.itertuples():
        print(f"{row.part:<20}{row.ms:8.2f} ms {100 * row.share:6.1f} %")
    step, render = table.attrs["step"], table.attrs["render"]
    print(f"{'whole step':<20}{table['ms'].sum():8.2f} ms")
    print(f"in turns: step {step:.2f} ms, render forward + backward {render:.2f} ms, ratio {step / render:.2f}")
    print(f"{table.attrs['gaussians']} Gaussians, {pool.get_threads()} threads")
    args.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(args.out / "training.csv", index=False)


if __name__ == "__main__":
    main()
