from io import StringIO

from rich.console import Console

from tdgbench.tables.build import build_tables
from tdgbench.tables.show import show
from tests.helpers.records import write


def test_prints_numbers_reasons_and_differences(tmp_path):
    write(tmp_path, scores={"lpips": None}, missing={"lpips": "no backbone"})
    out = StringIO()
    show(build_tables(tmp_path), Console(file=out, width=120))
    text = out.getvalue()
    assert "20.00" in text and "0:06:00" in text and "no backbone" in text
    assert "3 of 136 published numbers" in text and "psnr: ours − published -6.280" in text
    assert "1 undecided (unknown for 1)" in text and "psnr of msmg differs between papers by 0.47" in text
    assert "2.10 at Parterre" in text and "one of ThermalGaussian's three models" in text


def test_masked_test_pixels_are_named_in_one_line(tmp_path):
    for method in ("tdg", "msmg"):
        write(tmp_path, method, "Lion", "ThermalMix", masked={"train": 0.2, "test": 0.125})
        write(tmp_path, method, "Truck", masked={"train": 0.0, "test": 0.0})
    tables = build_tables(tmp_path)
    out = StringIO()
    show(tables, Console(file=out, width=120))
    assert out.getvalue().count("test pixels without a thermal value, which no score counts: Lion 12.5 %\n") == 1
    assert not any("masked" in path.read_text() for path in (tmp_path / "tables").glob("*.csv"))
