import numpy as np
from hydra.utils import instantiate

from tests.helpers.configs import config


def make(name: str, **overrides):
    """The estimator of `prior=name`."""
    return instantiate(
        config(f"prior={name}", *(f"prior.estimator.{k}={v}" for k, v in overrides.items())).prior.estimator
    )


def correlation(a, b) -> float:
    return float(np.corrcoef(np.ravel(a), np.ravel(b))[0, 1])
