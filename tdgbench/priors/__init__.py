"""What is guessed: depth maps estimated from thermal images (or from what else is there), one estimator a file."""

from tdgbench.priors.cache import estimate_all
from tdgbench.priors.prior import DepthEstimator, DepthPrior, PriorError

__all__ = ["DepthEstimator", "DepthPrior", "PriorError", "estimate_all"]
