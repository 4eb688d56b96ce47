"""PSNR, SSIM, LPIPS and °C error, in the conventions of the published tables and of the literature."""

from tdgbench.scoring.scorer import METRICS, TRAIN_METRICS, LPIPSOptions, RenderedImages, Scorer, mean_scores, to_8bit

__all__ = ["METRICS", "TRAIN_METRICS", "LPIPSOptions", "RenderedImages", "Scorer", "mean_scores", "to_8bit"]
