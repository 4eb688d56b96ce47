"""The settings of scores in a record, checked, and the scorer that they describe."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NotRequired

from pydantic import ConfigDict, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict  # pydantic refuses that of typing before Python 3.12

from tdgbench.cells.paths import RECORD_FILE
from tdgbench.scoring import LPIPSOptions, Scorer
from tdgbench.scoring.backbones import NAME_IT, Net, own_weights
from tdgbench.scoring.lpips import Range
from tdgbench.scoring.scored_view import Border, ConventionName, check_convention
from tdgbench.text import shortened

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
        found = TypeAdapter(MetricSettings).validate_python(metrics)
        check_convention(found["convention"], found["ssim_border"], found["lpips_range"])
        return found
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(["config.metrics", *(str(part) for part in first["loc"])])
        raise ValueError(f"{RECORD_FILE}: {place}: {first['msg']}") from error


def scorer_of(
    settings: MetricSettings, download: bool = False, weights: Path | None = None, extra: list[str] | None = None
) -> Scorer:
    """Return the scorer of settings in a record.

    download: whether a missing backbone of LPIPS may be downloaded. weights: its file, which the command line names;
    one that a record names is not opened. Without the weights of the record, LPIPS is n/a, with the reason. extra:
    metrics of the user, which the command line trusts.
    """
    net = settings["lpips"]["net"]
    lpips = LPIPSOptions(net, None if weights is None else str(weights), download)
    scorer = Scorer(settings["convention"], settings["ssim_border"], settings["lpips_range"], lpips, extra)
    scorer.no_lpips = why_no_lpips(settings["lpips"], weights)
    return scorer


def why_no_lpips(stated: LPIPSSettings, weights: Path | None) -> str:
    """Return why weights that the command line names, or none, are not those of a record; empty if they are."""
    if weights is None and "weights_sha256" in stated:
        file = shortened(Path(stated["weights"] or "").name, 80)
        return f"its backbone is a file of its own, {file}; name it: {NAME_IT}"
    if weights is None:
        return ""
    if not weights.is_file():
        return f"{weights} is not there, or no file"
    if own_weights(stated["net"], str(weights)) != stated.get("weights_sha256", ""):
        return f"{weights} is not the file that the scores were made with"
    return ""
