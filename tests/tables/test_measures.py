from tdgbench.tables.measures import ABLATION, COLUMNS, MAIN_COLUMNS, further, known_measures, measure_of
from tdgbench.tables.published import published_ablation, published_main


def test_the_paper_s_columns():
    assert MAIN_COLUMNS == tuple(dict.fromkeys(published_main()["metric"])) == ("psnr", "ssim", "lpips", "train_hours")
    assert list(ABLATION[:2]) == list(dict.fromkeys(published_ablation()["metric"]))
    assert [measure_of(name).title for name in MAIN_COLUMNS] == ["PSNR, dB ↑", "SSIM ↑", "LPIPS ↓", "time ↓"]


def test_the_order_of_rows_on_disk():
    assert (*COLUMNS, *further()) == (
        "psnr", "psnr_right_half", "ssim", "lpips", "train_hours", "channel_psnr", "psnr_affine", "psnr_true",
        "rgb_psnr", "rgb_ssim", "rgb_lpips", "mae_degC", "mae_degC_without_offset", "depth_abs_rel", "floaters",
        "depth_inconsistency", "barely_seen",
        "train_psnr", "train_ssim",
    )  # fmt: skip
    assert set(ABLATION) <= set(known_measures())
