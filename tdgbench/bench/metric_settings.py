"""The settings of scores in a record, checked, and the scorer that they describe."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NotRequired

from pydantic import ConfigDict, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict  # pydantic refuses that of typing before Python 3.12

from tdgbench.bench.record import FILE
from tdgbench.scoring import LPIPSOptions, Scorer
from tdgbench.scoring.lpips import Net, Range
from tdgbench.scoring.scored_view import Border, ConventionName

IGNORE = ConfigDict(extra="ignore", strict=True)


@with_config(IGNORE)
class LPIPSSettings(TypedDict):
    """Settings of LPIPS that a record keeps."""

    net: Net
    weights: str | None
    weights_sha256: NotRequired[str]  # of a file of one's own


@with_config(IGNORE)
class MetricSettings(TypedDict):
    """Settings that scores depend on."""

    convention: ConventionName
    ssim_border: Border
    lpips_range: Range
    lpips: LPIPSSettings


def metric_settings(metrics: Mapping[str, Any] | None) -> MetricSettings:
    """Return the settings in `config.metrics` of a record. Raises ValueError for any that this version does not know.

    >>> metric_settings({"convention": "mine"})
    Traceback (most recent call last):
    ValueError: record.json: config.metrics.convention: Input should be '3dgs' or 'standard'
    """
    try:
        return TypeAdapter(MetricSettings).validate_python(metrics)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(["config.metrics", *(str(part) for part in first["loc"])])
        raise ValueError(f"{FILE}: {place}: {first['msg']}") from error


def scorer_of(settings: MetricSettings, download: bool = False) -> Scorer:
    """Return the scorer of settings. download: whether a missing backbone of LPIPS may be downloaded."""
    lpips = LPIPSOptions(settings["lpips"]["net"], settings["lpips"]["weights"], download)
    return Scorer(settings["convention"], settings["ssim_border"], settings["lpips_range"], lpips)
