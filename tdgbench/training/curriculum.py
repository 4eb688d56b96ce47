"""What a training shows its models at an iteration: which training views, at which resolution."""

from __future__ import annotations

from tdgbench.scenes import View
from tdgbench.training.pixels import shrunk


class Curriculum:
    """The training views at the current iteration. Without steps and held-out views: all of them, as they are."""

    def __init__(self, steps: list[tuple[int, int]] | None = None, held: list[View] | None = None) -> None:
        """steps: (last iteration, scale) of each resolution below the full one. held: views to leave out at first."""
        self.steps = steps or []
        self.held = held or []
        self.is_holding = bool(self.held)
        self._names = {view.name for view in self.held}
        self._scale = 1
        self._shrunk: dict[str, View] = {}

    def begin(self, iteration: int) -> None:
        """Set the resolution of an iteration (1-based)."""
        scale = next((scale for last, scale in self.steps if iteration <= last), 1)
        if scale != self._scale:
            self._scale, self._shrunk = scale, {}

    def fold_back(self) -> None:
        """Train on the views that were held out, too."""
        self.is_holding = False

    def shows(self, view: View) -> bool:
        """Whether a view is trained on."""
        return not (self.is_holding and view.name in self._names)

    def at_resolution(self, view: View) -> View:
        """The view at the current resolution."""
        if self._scale == 1:
            return view
        if view.name not in self._shrunk:
            self._shrunk[view.name] = shrunk(view, self._scale)
        return self._shrunk[view.name]

    @property
    def last_reduced(self) -> int:
        """The last iteration with less than the full resolution; 0 if there is none."""
        return self.steps[-1][0] if self.steps else 0
