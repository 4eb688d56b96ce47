"""Depth priors: depth maps of training views, made before training; one estimator per file."""

from tdgbench.priors.cache import estimate_all
from tdgbench.priors.prior import DepthEstimator, DepthPrior, PriorError

__all__ = ["DepthEstimator", "DepthPrior", "PriorError", "estimate_all"]
