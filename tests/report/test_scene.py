from tdgbench.bench.record import read_all
from tdgbench.report.scene import scene_section
from tdgbench.tables.cell import finished_cells


def test_a_scene_shows_the_middle_view_of_every_method(small_results):
    cells = [c for c in finished_cells(small_results, read_all(small_results)) if c.record.scene == "turntable"]
    section = scene_section("synthetic", "turntable", cells)
    names = sorted(path.stem for path in (cells[0].folder / "renders").glob("*.png"))
    assert section["view"] == names[len(names) // 2]
    assert sorted(method["label"] for method in section["methods"]) == ["MSMG", "TDg"]
    assert section["temperature"] == ["14", "50"] and section["curves"].startswith("<svg")
    psnr = {method["label"]: method["psnr"] for method in section["methods"]}
    scores = {cell.record.method: cell.record.scores["psnr"] for cell in cells}
    assert psnr == {"MSMG": f"{scores['msmg']:.2f} dB", "TDg": f"{scores['tdg']:.2f} dB"}
