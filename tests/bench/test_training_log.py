from tdgbench.bench.training_log import write_log
from tdgbench.training.loop import LogLine, TrainingLog


def test_one_row_per_line_and_one_column_per_term(tmp_path):
    lines = [LogLine(1, 0.12345, 0.5, 20.0, 10, {"b": 1.0}), LogLine(2, 1.0, 0.25, 21.0, 12, {"a": 2.0, "b": 3.0})]
    write_log(tmp_path / "log.csv", TrainingLog(lines))
    assert (tmp_path / "log.csv").read_text().splitlines() == [
        "iteration,seconds,loss,train_psnr,gaussians,loss_a,loss_b",
        "1,0.123,0.5,20.0,10,,1.0",
        "2,1.0,0.25,21.0,12,2.0,3.0",
    ]
