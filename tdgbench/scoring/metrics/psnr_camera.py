"""PSNR of what the thermal camera shows of a render: a vignette that training took out of the scene is added again."""

from __future__ import annotations

from dataclasses import replace

from tdgbench.scoring.metric import ViewMetric
from tdgbench.scoring.metrics.psnr import MAX_PSNR, psnr
from tdgbench.scoring.scored_view import NotApplicableError, ScoredView


def psnr_camera(shown: ScoredView) -> float:
    """PSNR (dB) of a view's render with the vignette and fixed pattern that training knows, as 8-bit pictures.

    `psnr` for an ideal camera. A test view's own offset and gain are unknown and not applied.
    """
    rendered = shown.rendered
    if rendered.added is None:
        raise NotApplicableError("what the thermal camera adds to this image is unknown")
    seen = replace(rendered, image=rendered.image + rendered.added[..., None])
    return psnr(*replace(shown, rendered=seen).pair("thermal").pixels)


METRIC = ViewMetric(
    name="psnr_camera",
    label="PSNR through the camera",
    meaning="PSNR of renders with the vignette and fixed pattern that training knows",
    order=41,
    unit="dB",
    digits=2,
    higher_is_better=True,
    limits=(0.0, MAX_PSNR),
    needs="images of the size and contrast that the camera was estimated from",
    of_view=psnr_camera,
)
