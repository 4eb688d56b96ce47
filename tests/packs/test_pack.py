"""Packs: equal bytes, what they hold, and that every tampering with one is found."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from tdgbench.cells.record import read_each
from tdgbench.files import MB
from tdgbench.packs import manifest, opened_pack, pack, unpack
from tdgbench.packs.checklist import FEWEST_SEEDS, checklist
from tdgbench.tables import comparisons
from tdgbench.verify import verify
from tests.helpers.command import tdgbench_here

CELL = "cells/tdg/synthetic/turntable/colmap/seed0"
Entries = dict[str, bytes]


@pytest.fixture(scope="module")
def packed(small_results, tmp_path_factory) -> Path:
    return pack(small_results, tmp_path_factory.mktemp("packs") / "a.zip", keep_paths=True)[0]


def entries(path: Path) -> Entries:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write(path: Path, content: Entries) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


def fits(content: Entries) -> Entries:
    """The content with the manifest of its files."""
    stated = json.loads(content[manifest.MANIFEST_FILE])
    stated["files"] = {
        name: {"size": len(data), "sha256": manifest.sha256(data)}
        for name, data in content.items()
        if name != manifest.MANIFEST_FILE
    }
    return {**content, manifest.MANIFEST_FILE: json.dumps(stated).encode()}


def test_its_content_alone_decides_its_bytes(small_results, packed, tmp_path):
    copy = Path(shutil.copytree(small_results, tmp_path / small_results.name))
    for path in copy.rglob("*"):
        path.touch()
    again, name = pack(copy, keep_paths=True)
    assert again == tmp_path / f"{small_results.name}-{name[:12]}.zip"
    assert again.read_bytes() == packed.read_bytes()


def test_unpacked_it_is_the_experiment(small_results, packed, tmp_path):
    content, name = unpack(packed, tmp_path / "theirs")
    assert name == manifest.sha256(entries(packed)[manifest.MANIFEST_FILE]) and content.experiment == small_results.name
    for path in (small_results / "cells").rglob("*"):
        there = tmp_path / "theirs" / path.relative_to(small_results)
        if path.is_file() and "failure" not in path.read_text(errors="ignore"):
            assert there.read_bytes() == path.read_bytes()
    assert verify(tmp_path / "theirs") == verify(small_results)


def test_tracebacks_stay_at_home(small_results, packed):
    records = [json.loads(data) for name, data in entries(packed).items() if name.endswith("record.json")]
    failures = [record["failure"] for record in records if record["failure"]]
    assert failures and all(failure["error"] and failure["traceback"] == "" for failure in failures)


def test_paths_of_a_machine_are_refused(small_results, tmp_path):
    copy = Path(shutil.copytree(small_results, tmp_path / "a"))
    record = copy / CELL / "record.json"
    record.write_text(record.read_text().replace('"notes": []', '"notes": ["/home/ada/data is old"]'))
    with pytest.raises(ValueError, match=r"record\.json holds '/home/ada/data', a path of this machine"):
        pack(copy)
    assert pack(copy, keep_paths=True)[0].exists()
    shutil.copy(small_results / CELL / "record.json", record)
    lpips = {"net": "vgg", "weights": "/home/ada/vgg.npz", "weights_sha256": "0"}
    record.write_bytes(edited(lambda content: content["config"]["metrics"].update(lpips=lpips))(record.read_bytes()))
    command = f"score {copy} {copy}-shared metrics.convention=3dgs metrics.lpips.net=vgg metrics.lpips.weights=vgg.npz "
    with pytest.raises(ValueError, match=command):
        pack(copy)


def edited(change: Callable[[dict], object]) -> Callable[[bytes], bytes]:
    """A change of a JSON file."""

    def act(data: bytes) -> bytes:
        content = json.loads(data)
        change(content)
        return json.dumps(content, indent=1, sort_keys=True).encode() + b"\n"

    return act


def at(name: str, change: Callable[[bytes], bytes]) -> Callable[[Entries], Entries]:
    return lambda content: {**content, name: change(content[name])}


def without(name: str) -> Callable[[Entries], Entries]:
    return lambda content: {key: data for key, data in content.items() if key != name}


def added(name: str) -> Callable[[Entries], Entries]:
    return lambda content: {**content, name: b"x"}


def score(record: dict) -> None:
    record["scores"]["psnr"] += 1.0


RECORD, RENDER = f"{CELL}/record.json", f"{CELL}/renders/view000.png"
TAMPERINGS = {  # those of a cell are in tests/verify/test_cell.py
    "a score": at(RECORD, edited(score)),
    "no render": without(RENDER),
    "a file more": added(f"{CELL}/masks/view000.png"),
}


@pytest.mark.parametrize("tamper", TAMPERINGS.values(), ids=TAMPERINGS)
def test_tampering_is_found(packed, tmp_path, tamper):
    """Where the manifest fits by `verify`; and the hash of the pack is another one."""
    changed = write(tmp_path / "b.zip", tamper(entries(packed)))
    with pytest.raises(ValueError, match=r"b\.zip is no pack, or damaged or changed: "):
        unpack(changed, tmp_path / "theirs")
    assert not (tmp_path / "theirs").exists()
    changed = write(tmp_path / "c.zip", fits(tamper(entries(packed))))
    with opened_pack(packed) as whole, opened_pack(changed) as folder:
        assert set(verify(folder).problems) - set(verify(whole).problems)


def of_manifest(change: Callable[[dict], object]) -> Callable[[Entries], Entries]:
    return at(manifest.MANIFEST_FILE, edited(change))


def renamed(name: str) -> Callable[[Entries], Entries]:
    return lambda content: fits({**without(RENDER)(content), name: content[RENDER]})


BROKEN = {
    "a way out": (renamed("../view.png"), "no place in the pack"),
    "a way out on Windows": (renamed("..\\view.png"), "no place in the pack"),
    "an absolute path": (renamed("/tmp/view.png"), "no place in the pack"),
    "an experiment that leads out": (of_manifest(lambda m: m.update(experiment="../x")), "experiment"),
    "a format of the future": (of_manifest(lambda m: m.update(format=2)), "format"),
    "no manifest": (without(manifest.MANIFEST_FILE), "has no manifest"),
    "a manifest that is none": (at(manifest.MANIFEST_FILE, lambda data: b"[]"), "manifest"),
    "a smaller size": (of_manifest(lambda m: m["files"][RENDER].update(size=9)), "not what the manifest states"),
    "a larger size": (of_manifest(lambda m: m["files"][RENDER].update(size=10**7)), "not what the manifest states"),
}


@pytest.mark.parametrize(("tamper", "why"), BROKEN.values(), ids=BROKEN)
def test_broken_packs_are_one_error(packed, tmp_path, tamper, why):
    with pytest.raises(ValueError, match=why):
        unpack(write(tmp_path / "b.zip", tamper(entries(packed))), tmp_path / "theirs")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.zip"]


def test_two_files_of_one_name(packed, tmp_path):
    shutil.copy(packed, tmp_path / "b.zip")
    with zipfile.ZipFile(tmp_path / "b.zip", "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr(RECORD, b"{}")
    with pytest.raises(ValueError, match="two files of one name"):
        unpack(tmp_path / "b.zip", tmp_path / "theirs")


STRANGERS = ["mine.py", f"{CELL}/mine.py", f"{CELL}/model.so", f"{CELL}/renders/a.pth", f"{CELL}/more/renders/a.png",
             "cells/record.json", "record.json", "cells/a b/c/d/e/f/record.json", f"{CELL}/renders/a\nb.png",
             f"{CELL}/renders/{'a' * 300}.png", "cells/$(x)/c/d/e/f/record.json", "checkpoints/a.pt"]  # fmt: skip


@pytest.mark.parametrize("name", STRANGERS)
def test_files_that_no_cell_has_are_refused(packed, name):
    content = fits({manifest.MANIFEST_FILE: entries(packed)[manifest.MANIFEST_FILE], name: b"x"})
    with pytest.raises(ValueError, match=r"manifest\.json: "):
        manifest.read_manifest(content[manifest.MANIFEST_FILE])


@pytest.mark.parametrize("name", ["a\nb", "a;b", "$(b)", "`b`", "-rf", ".a", "a'b", "a" * 200, ""])
def test_names_of_experiments_are_of_an_alphabet(packed, name):
    content = of_manifest(lambda m: m.update(experiment=name))(entries(packed))
    with pytest.raises(ValueError, match=r"manifest\.json\.experiment"):
        manifest.read_manifest(content[manifest.MANIFEST_FILE])


@pytest.mark.parametrize(
    ("name", "plain"),
    [("it's; mine", "it_s_ mine"), ("+x", "_+x"), ("test\u00b2", "test_"), (120 * "n", 100 * "n")],
    ids=["signs", "plus", "digit", "long"],
)
def test_an_experiment_with_another_name_is_packed_under_a_plain_one(small_results, tmp_path, name, plain):
    copy = Path(shutil.copytree(small_results, tmp_path / name))
    content, _ = unpack(pack(copy, keep_paths=True)[0], tmp_path / "theirs")
    assert content.experiment == plain


def bomb(path: Path, packed: Path, name: str, size: int) -> Path:
    """A pack in which a file has so many zeros."""
    content = fits({**entries(packed), name: bytes(size)})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, data in content.items():
            archive.writestr(entry, data)
    return path


def test_limits_are_checked_before_anything_is_unpacked(packed, tmp_path, monkeypatch):
    """Bytes against those of the pack, files, each kind of file, and the disk."""
    model = f"{CELL}/model.ply"
    with pytest.raises(ValueError, match=r"it would unpack to 2\d\d MB, more than 64 MB"):
        unpack(bomb(tmp_path / "a.zip", packed, model, 200 * MB), tmp_path / "theirs")
    with pytest.raises(ValueError, match=r"record\.json has 17 MB, more than 4 MB"):
        unpack(bomb(tmp_path / "b.zip", packed, RECORD, 17 * MB), tmp_path / "theirs")
    monkeypatch.setattr(manifest, "MOST_FILES", 10)
    with pytest.raises(ValueError, match="files, more than 10"):
        unpack(packed, tmp_path / "theirs")
    monkeypatch.undo()
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=100))
    with pytest.raises(ValueError, match="the disk has 100 bytes left"):
        unpack(packed, tmp_path / "theirs")
    assert not (tmp_path / "theirs").exists()


def test_links_out_of_the_results_and_files_of_no_cell_are_not_packed(small_results, tmp_path):
    copy = Path(shutil.copytree(small_results, tmp_path / "a"))
    (tmp_path / "secret.ply").write_text("mine")
    (copy / CELL / "model.ply").unlink()
    for target in ("/etc/passwd", "../../../../../../../secret.ply"):
        (copy / CELL / "model.ply").symlink_to(target)
        with pytest.raises(ValueError, match=r"model\.ply cannot be packed: it leads out of its folder"):
            pack(copy, keep_paths=True)
        (copy / CELL / "model.ply").unlink()
    (copy / CELL / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match=r"notes\.txt cannot be packed: .* is no file of a cell"):
        pack(copy, keep_paths=True)


@pytest.mark.parametrize("content", [b'{"a": ', b"[1]", b"\xff", b'{"failure": "lost"}'])
def test_a_damaged_record_is_named(small_results, tmp_path, content):
    copy = Path(shutil.copytree(small_results, tmp_path / "copy"))
    (copy / RECORD).write_bytes(content)
    with pytest.raises(ValueError, match=r"record\.json cannot be packed: it is no record"):
        pack(copy, tmp_path / "a.zip", keep_paths=True)


def test_the_checklist_names_what_is_missing(small_results, tmp_path):
    missing = {item.title: item.missing for item in checklist(small_results)}
    assert FEWEST_SEEDS == comparisons.FEWEST_SEEDS == 3
    assert "seed" not in missing["2 of 3 seeds of each cell"] and "turntable" in missing["2 of 3 seeds of each cell"]
    assert missing["all planned cells"] == f"1 of {len(read_each(small_results))}"
    assert missing["renders of all test views"] == missing["one protocol"] == missing["a log of each training"] == ""

    copy = Path(shutil.copytree(small_results, tmp_path / "a"))
    record = copy / CELL / "record.json"
    record.write_bytes(edited(lambda content: content["hashes"].pop("renders/view000.png"))(record.read_bytes()))
    foreign = edited(lambda content: content.update(environment={"git": "f00"}))
    record.write_bytes(foreign(record.read_bytes()))
    missing = {item.title: item.missing for item in checklist(copy)}
    assert missing["a commit of tdgbench without changes"]
    assert missing["renders of all test views"] == "tdg on synthetic/turntable, colmap, seed 0"
    assert missing["files as the records state them"] == ""
    (copy / CELL / "model.ply").write_bytes(b"ply")
    assert {item.title: item.missing for item in checklist(copy)}["files as the records state them"] == (
        "tdg on synthetic/turntable, colmap, seed 0"
    )


def test_the_commands(small_results, packed, tmp_path):
    shutil.copytree(small_results, tmp_path / "results" / "mine")
    (tmp_path / "results" / "mine" / "skips.csv").write_text("skip\n")
    run = tdgbench_here(tmp_path, "pack", "results/mine", "--out", "mine.zip", "--keep-paths")
    assert "not in the pack: skips.csv" in run.stdout
    assert run.returncode == 0 and "missing: 2 of 3 seeds of each cell" in run.stdout and "SHA-256" in run.stdout
    run = tdgbench_here(tmp_path, "unpack", "mine.zip", "results/theirs")
    assert run.returncode == 0 and "files of mine" in run.stdout
    assert "0 problems" in tdgbench_here(tmp_path, "verify", "mine.zip").stdout
    assert tdgbench_here(tmp_path, "compare", "mine.zip", "results/theirs").returncode == 0
    (tmp_path / "none.zip").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("mine")
    run = tdgbench_here(tmp_path, "pack", "results/mine", "--keep-paths", "--out", "notes.txt")
    assert run.returncode == 1 and "must end in .zip" in run.stderr and (tmp_path / "notes.txt").read_text() == "mine"
    for words in (("pack", "results"), ("unpack", "none.zip", "x"), ("verify", "none.zip")):
        run = tdgbench_here(tmp_path, *words)
        assert run.returncode == 1 and f"tdgbench {words[0]}: " in run.stderr
