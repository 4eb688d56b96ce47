"""Whether the rig pays: two short trainings, with and without it, are compared on training views that both hold out."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from tdgbench.training.context import Context
from tdgbench.training.curriculum import evenly_spread
from tdgbench.training.loop import train
from tdgbench.training.method import Method
from tdgbench.training.trainer import Trainer

ITERATIONS = 1000  # of either training, at most
SHARE = 1 / 8  # of the training views that is held out
FEWEST = 3  # held-out views; with less than four times as many training views there is no trial
GAIN = 0.5  # dB that the rig gains at least
_ERRORS = 2  # standard errors that the gain exceeds


@dataclass(frozen=True)
class RigTrial:
    """Gain of the rig in PSNR (dB) at each held-out view, whether it pays, and why."""

    gains: list[float]
    pays: bool
    reason: str


def try_rig(method: Method, whole: Context) -> RigTrial:
    """Train a method twice on all but some training views of a context, and compare its renders of these.

    The trainings are as long as the budget, at most 1 000 iterations, and have one seed. Test views are not read.
    """
    if not method.can_learn_rig:
        return RigTrial([], False, "the method cannot learn one")
    views = whole.scene.train
    if len(views) < 4 * FEWEST:
        return RigTrial([], False, f"{len(views)} training views are too few to hold out {FEWEST}")
    held_out = evenly_spread(views, max(FEWEST, round(SHARE * len(views))))
    chosen = {view.name for view in held_out}
    scene = replace(whole.scene, train=[view for view in views if view.name not in chosen], test=held_out)
    budget = whole.budget.for_trial(min(ITERATIONS, whole.budget.iterations))
    psnrs = []
    for learns_rig in (True, False):
        context = replace(whole, scene=scene, budget=budget, skips=deepcopy(whole.skips), learns_rig=learns_rig)
        trainer = Trainer(method, context)
        train(trainer)
        psnrs.append([trainer.psnr_of(view) for view in held_out])
    gains = np.array(psnrs[0]) - np.array(psnrs[1])
    mean, error = float(gains.mean()), float(gains.std(ddof=1)) / len(gains) ** 0.5
    reason = f"{mean:+.2f} ± {error:.2f} dB at {len(gains)} held-out training views"
    return RigTrial([round(float(gain), 3) for gain in gains], mean >= max(GAIN, _ERRORS * error), reason)
