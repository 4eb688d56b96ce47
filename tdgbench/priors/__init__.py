"""Depth priors: depth maps of training views, made before training; one estimator per file."""

from tdgbench.priors.prior import DepthEstimator, DepthPrior, PriorError, PriorUnavailableError, estimate_all, prepare

__all__ = ["DepthEstimator", "DepthPrior", "PriorError", "PriorUnavailableError", "estimate_all", "prepare"]
