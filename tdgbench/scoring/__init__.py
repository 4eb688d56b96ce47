"""Scores of rendered views in the conventions of the published tables and of the literature."""

from tdgbench.scoring.registry import METRICS, TRAIN_METRICS
from tdgbench.scoring.scored_view import RenderedImages, to_8bit
from tdgbench.scoring.scorer import LPIPSOptions, Scorer, Scores, mean_scores

__all__ = ["METRICS", "TRAIN_METRICS", "LPIPSOptions", "RenderedImages", "Scorer", "Scores", "mean_scores", "to_8bit"]
