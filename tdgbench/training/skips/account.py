"""After training: which of the skips that work during training were taken, why, and what they saved."""

from __future__ import annotations

from tdgbench.scenes import Scene
from tdgbench.training.budget import Budget
from tdgbench.training.loop import TrainingLog
from tdgbench.training.method import Method
from tdgbench.training.skips.skip import Skips


def note_training(skips: Skips, scene: Scene, method: Method, budget: Budget, log: TrainingLog) -> None:
    """Write reasons and savings of a training into its skips."""
    views = len(scene.train) + len(scene.test)
    gray = scene.channels == 1
    reason = f"all {views} thermal images are gray" if gray else "the thermal images are coloured"
    skips.gray.decide(gray, reason, "2 of 3 channels")
    _note_harmonics(skips, method, budget, log)
    work = [model.work for model in method.models().values()]
    rows, touched = sum(w.rows for w in work), sum(w.touched for w in work)
    pairs, blended = sum(w.pairs for w in work), sum(w.blended for w in work)
    share = touched / max(rows, 1)
    skips.unseen.decide(
        touched < rows, f"a step touched {share:.0%} of the Gaussians", f"{1 - share:.0%} of the rows"
    )  # fmt: skip
    share = blended / max(pairs, 1)
    reason = f"{share:.1%} of the pairs came before their tile's end" if pairs else "the backend does not tell"
    skips.saturated.decide(blended < pairs, reason, f"{1 - share:.1%} of the pairs")
    left = budget.iterations - log.iterations
    rule = "the budget has no plateau rule" if budget.plateau is None else "the loss went on falling"
    reason = rule if left == 0 else f"the loss no longer fell by {budget.plateau.gain:.2%} a window"  # type: ignore[union-attr]
    skips.plateau.decide(left > 0, reason, f"{left} of {budget.iterations} iterations")
    if not skips.depth.reason:
        skips.depth.decide(False, f"{method.name} has no depth loss")
    if not skips.prior.reason:
        skips.prior.decide(False, f"{method.name} uses no prior")
    if not skips.rgb.reason:
        skips.rgb.decide(False, f"{method.name} trains on RGB images" if method.needs_rgb else "there are none")


def _note_harmonics(skips: Skips, method: Method, budget: Budget, log: TrainingLog) -> None:
    wanted = budget.active_degree(log.iterations)
    shown = {name: model.view_dependence for name, model in method.models().items()}
    held = [model for model in method.models().values() if model.degree < wanted]
    said = ", ".join(f"{name} {value:.1%}" for name, value in shown.items() if value is not None)
    reason = f"direction explains of the residuals: {said}" if said else "the degree never came to grow"
    coefficients = sum((wanted + 1) ** 2 - (model.degree + 1) ** 2 for model in held)
    of = (wanted + 1) ** 2 * len(shown)
    skips.sh.decide(bool(held), reason, f"{coefficients} of {of} coefficients")
