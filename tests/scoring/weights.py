"""Random weights of LPIPS backbones."""

import torch

from tdgbench.scoring.backbones import make_trunk


def random_state(net: str) -> dict[str, torch.Tensor]:
    torch.manual_seed(0)
    return make_trunk(net).state_dict()
