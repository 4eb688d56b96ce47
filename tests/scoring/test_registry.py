import pytest

from tdgbench.scenes.modalities import LABELS
from tdgbench.scoring import METRICS, TRAIN_METRICS, metrics, registry
from tdgbench.scoring.registry import find_metrics

MADE_UP = """
from tdgbench.scoring.metric import ImageMetric

METRIC = ImageMetric(name="bias", label="bias", of_images=lambda pair: float((pair.image - pair.target).mean()))
"""


def test_a_file_is_a_metric(tmp_path, monkeypatch):
    monkeypatch.setattr(metrics, "__path__", [*metrics.__path__, str(tmp_path)])
    (tmp_path / "made_up_bias.py").write_text(MADE_UP)
    assert list(find_metrics()) == [*METRICS, "bias"]
    (tmp_path / "made_up_empty.py").write_text("")
    with pytest.raises(TypeError, match="made_up_empty defines no metric"):
        find_metrics()


def test_training_views_get_the_cheap_metrics():
    assert list(TRAIN_METRICS) == ["psnr", "ssim"]


def test_a_new_modality_has_the_metrics_of_every_modality(monkeypatch):
    monkeypatch.setitem(LABELS, "nir", "NIR")
    monkeypatch.setattr(registry, "OTHERS", ("rgb", "nir"))
    found = find_metrics()
    assert set(found) - set(METRICS) == {"nir_psnr", "nir_ssim", "nir_lpips"}
    assert found["nir_ssim"].title == "SSIM of the NIR model ↑" and found["nir_ssim"].modality == "nir"
