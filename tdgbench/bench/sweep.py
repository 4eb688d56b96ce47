"""What a Hydra sweep goes over."""

from __future__ import annotations

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf


def swept(config: DictConfig, key: str) -> list[str]:
    """The values that a sweep gives to a key (its command line, else its experiment file); empty: it is not swept."""
    params = OmegaConf.select(config, "hydra.sweeper.params") or {}
    written = [f"{k}={v}" for k, v in params.items()] + list(config.hydra.overrides.task)
    values: list[str] = []
    for override in OverridesParser.create().parse_overrides(written):
        if override.key_or_group == key and override.is_sweep_override():
            values = [_plain(v) for v in override.sweep_iterator()]
    return values


def _plain(value: object) -> str:
    return Override._get_value_element_as_str(value) if not isinstance(value, str) else value  # type: ignore[arg-type]
