"""Every call that opens a file, imports by name or starts a program, with what can reach it. A new one must be named.

Files of others are opened by `tdgbench.files` alone; what is listed here takes an opened file, or one of our own.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

from tests.helpers.paths import ROOT

BUILT_IN = {"open", "exec", "eval", "compile", "__import__"}
NAMES = {"import_module", "instantiate", "get_class", "get_object", "get_method", "loadtxt", "genfromtxt", "fromfile",
         "memmap", "read_csv", "read_parquet", "read_pickle", "imread", "ZipFile", "InferenceSession", "Reconstruction",
         "load_state_dict_from_url", "TiffFile", "png_decode", "Popen", "check_output", "system", "Unpickler",
         "read_text", "read_bytes", "open"}  # fmt: skip
WHOLE = {"np.load", "torch.load", "onnx.load", "OmegaConf.load", "subprocess.run", "pickle.load", "pickle.loads"}
SAFE = {"os.open", "webbrowser.open"}  # of our own log files; of an address that we print

OURS = "a file of tdgbench or of the system, or one that the same run has written"
CHOSEN = "what the user asks to run: configuration, plug-ins, networks, programs; never a record"
OPENED = "what `tdgbench.files` has opened and the code here has checked: data, packs, records, models"
NAMED = "a file that the command line or torch's cache names; never a record"
DOORS = {
    "tdgbench/archives.py": {"zipfile.ZipFile": OPENED, "archive.open": OPENED},
    "tdgbench/bench/cell_phases.py": {"instantiate": CHOSEN},
    "tdgbench/bench/commit.py": {
        "distribution('tdgbench').read_text": OURS,
        "subprocess.run": "git, in tdgbench's checkout",
    },
    "tdgbench/bench/environment.py": {"path.read_bytes": OURS},
    "tdgbench/cells/known_classes.py": {
        "get_class": "names of conf/, and of --trust and --config-dir, that a record's `_target_` equals",
        "OmegaConf.load": "YAML of conf/ and of --config-dir",
    },
    "tdgbench/bench/machine.py": {"file.read_text": OURS, "subprocess.run": "nvidia-smi and the like"},
    "tdgbench/cells/read_files.py": {"Image.open": OPENED},
    "tdgbench/bench/setup.py": {"instantiate": CHOSEN},
    "tdgbench/bench/signature.py": {"OmegaConf.load": OURS},
    "tdgbench/children.py": {"subprocess.Popen": CHOSEN},
    "tdgbench/data/command.py": {"importlib.import_module": "a name of a table of ours"},
    "tdgbench/data/export.py": {"instantiate": CHOSEN},
    "tdgbench/data/get/sources.py": {"target.open": OURS},
    "tdgbench/data/poses/metashape.py": {"zipfile.ZipFile": OPENED},
    "tdgbench/data/prepare/capture.py": {"np.load": OURS},
    "tdgbench/data/prepare/known_poses.py": {"pycolmap.Reconstruction": OURS, "pycolmap.Database.open": OURS},
    "tdgbench/data/prepare/prepare.py": {"(place / 'capture.json').read_bytes": OURS},
    "tdgbench/data/prepare/sfm.py": {"pycolmap.Database.open": OURS},
    "tdgbench/experiments/error_time.py": {"instantiate": CHOSEN},
    "tdgbench/experiments/experiment.py": {"instantiate": CHOSEN, "get_class": CHOSEN},
    "tdgbench/experiments/prior_accuracy.py": {"instantiate": CHOSEN},
    "tdgbench/experiments/priors.py": {"instantiate": CHOSEN},
    "tdgbench/experiments/stress/training.py": {"instantiate": CHOSEN},
    "tdgbench/experiments/sweep/plan.py": {"instantiate": CHOSEN},
    "tdgbench/experiments/thermal_camera.py": {"instantiate": CHOSEN},
    "tdgbench/new.py": {"(PACKAGE / 'templates' / template).read_text": OURS},
    "tdgbench/priors/onnx.py": {"onnx.load": NAMED, "onnxruntime.InferenceSession": NAMED},
    "tdgbench/priors/prior.py": {
        "zipfile.ZipFile": OPENED,
        "np.load": OPENED,
        "importlib.import_module": "the modules of this package",
    },
    "tdgbench/scenes/colmap/model.py": {"pycolmap.Reconstruction": "nothing: an empty model that is written"},
    "tdgbench/scenes/formats/flir.py": {"Image.open": OPENED},
    "tdgbench/scenes/formats/pictures.py": {"Image.open": OPENED, "imagecodecs.png_decode": OPENED},
    "tdgbench/scenes/formats/tiff.py": {"TiffFile": OPENED},
    "tdgbench/scenes/inputs.py": {"np.load": OPENED},
    "tdgbench/scenes/synthetic/dataset.py": {"p.read_bytes": OURS},
    "tdgbench/scoring/backbones.py": {
        "np.load": NAMED,
        "torch.load": NAMED,
        "torch.hub.load_state_dict_from_url": NAMED,
    },
    "tdgbench/scoring/lpips.py": {"torch.load": "the lpips package"},
    "tdgbench/scoring/registry.py": {"importlib.import_module": "modules of scoring/metrics, and the user's"},
    "tdgbench/site/site_pages.py": {"path.read_text": OURS},
    "tdgbench/splats/backends/__init__.py": {"importlib.import_module": "a name of a table of ours"},
    "tdgbench/splats/backends/cuda.py": {"importlib.import_module": "gsplat"},
    "tdgbench/splats/cpu/cache.py": {"path.read_bytes": OURS},
    "tdgbench/splats/cpu/pool.py": {"(cgroup / name).read_text": OURS},
    "tdgbench/splats/cpu/precompile.py": {"subprocess.Popen": "Python, on a module of ours"},
    "tdgbench/splats/ply.py": {"np.fromfile": OPENED},
    "tdgbench/tables/claims/__init__.py": {"OmegaConf.load": OURS},
    "tdgbench/cells/plan.py": {"OmegaConf.load": CHOSEN},
    "tdgbench/tables/overrides.py": {"OmegaConf.load": OURS},
    "tdgbench/tables/published_setup.py": {"OmegaConf.load": OURS},
    "tdgbench/tables/published.py": {"pd.read_csv": OURS, "OmegaConf.load": OURS},
    "tdgbench/tables/seed_spreads.py": {"OmegaConf.load": OURS},
    "tdgbench/tables/verdicts.py": {"OmegaConf.load": OURS},
    "tdgbench/tensors.py": {"zipfile.ZipFile": OPENED, "torch.load": OPENED},
    "tdgbench/tools.py": {"importlib.import_module": "a name of a table of ours", "path.read_text": OURS},
}


def calls(tree: ast.AST) -> Iterator[str]:
    """The dotted names of calls that open to read, import or run."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            name = ast.unparse(node.func)
            last = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            is_known = name in BUILT_IN | WHOLE | (NAMES - {"read_text", "read_bytes"}) or last in NAMES
            if is_known and name not in SAFE and not writes(node):
                yield name


def writes(call: ast.Call) -> bool:
    """Whether it opens a file to write it alone."""
    words = [*call.args, *(keyword.value for keyword in call.keywords if keyword.arg == "mode")]
    return any(isinstance(word, ast.Constant) and word.value in ("w", "wb", "xb", "r+b") for word in words)


def test_every_door_is_known():
    found = {}
    for folder in ("tdgbench", "methods"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            if path.name != "files.py" and (names := {*calls(ast.parse(path.read_text(encoding="utf-8")))}):
                found[path.relative_to(ROOT).as_posix()] = names
    assert found == {place: {*doors} for place, doors in DOORS.items()}


def test_a_new_door_is_seen():
    text = "import pickle\npickle.load(open('a'))\n(x / 'b').open()\ny.read_bytes()\neval('1')\nread_text(z)\n"
    text += "path.open('wb')\nre.compile('a')\n"
    assert [*calls(ast.parse(text))] == ["pickle.load", "(x / 'b').open", "y.read_bytes", "eval", "open"]
