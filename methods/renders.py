"""Renders made elsewhere: images of the test views that another program wrote, with a `run.json` that says how.

A folder has one file per test view, and nothing else but what its layout knows. Nothing is resized or left out.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, ValidationError
from pydantic_core import ErrorDetails

from methods.likeness import LEAST, details, fits_better
from tdgbench.scenes import Scene, SceneError, TemperatureRange, View
from tdgbench.scenes.formats import decode
from tdgbench.scenes.images import is_gray
from tdgbench.scenes.inputs import hash_of, listed, read_array, read_bytes
from tdgbench.scoring.scored_view import NotApplicableError
from tdgbench.splats.view import Render
from tdgbench.text import duration, meant, named, one_line
from tdgbench.training.context import Context
from tdgbench.training.method import Frame, Method
from tdgbench.training.part import Part, State

RUN = "run.json"
PLAUSIBLE = (-0.5, 1.5)  # the median of a render, as an image value
FLIPS = {"upside down": (0,), "mirrored": (1,), "turned by 180°": (0, 1)}  # axes of an image (H, W, C)
UNLIKE_SHARE = 0.2  # of renders like no image of the scene, above which they are doubted
FORMATS = {".png": "PNG", ".jpg": "JPEG"}  # of pictures, by suffix
Text = Annotated[str, Field(min_length=1)]


class Run(BaseModel):
    """`run.json`: the run that made the renders."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    system: Text
    repository: Text
    commit: Annotated[str, Field(pattern="^[0-9a-f]{7,40}$")] | None  # None: the code is not public
    command: Text
    split: Text  # as `data.split`
    value_range: Literal["unit", "degC"]  # of .npy files; pictures are `unit`
    checkpoint_rule: Literal["last", "best_training_view", "best_test_view"]
    wall_time: NonNegativeFloat | None  # s, of the training
    device: Text
    views: list[Text] | None = None  # test views in the order of the files, of layouts that number them


EXAMPLE = {  # of `run.json`, without split and views
    "system": "NAME OF THE METHOD", "repository": "https://ADDRESS OF ITS CODE", "commit": None,
    "command": "python train.py OPTIONS", "value_range": "unit", "checkpoint_rule": "last", "wall_time": None,
    "device": "NAME OF THE GPU",
}  # fmt: skip


class FileNames(NamedTuple):
    """Names of the files in a folder."""

    renders: str  # regular expression of the renders; its group `view` is the view's name, or `number` its place
    others: str  # regular expression of further files that the program writes, which are not read
    first: int = 0  # number of the first view


LAYOUTS = {
    "views": FileNames(r"(?P<view>.+)\.(npy|png)", r"(?!)"),
    # graphdeco-inria/gaussian-splatting, render.py, and all programs that follow it
    "3dgs": FileNames(r"(?P<number>\d{5})\.(png|npy)", r"(?!)"),
    # Schindler-EPFL-Lab/thermo-nerf c7ee7bec, thermo_nerf/evaluator/evaluator.py, save_images and save_metrics
    "thermonerf": FileNames(
        r"thermal_(?P<number>\d{5})\.(jpg|npy)",
        r"(img|thermal_combined|depth|accumulation)_\d{5}\.jpg|metrics\.json|psnr|ssim|lpips",
    ),
    # mert-o/ThermalNeRFs d822bd10, nerf/utils.py, lines 796 to 885; ep: the epoch, which must be one
    "oezer": FileNames(
        r"(?P<run>.+_ep\d{4})_(?P<number>\d{4})_temp\.npy", r".+_ep\d{4}_\d{4}_\w.*\.(png|npy)", first=1
    ),
}


class Images(Part):
    """The renders (H, W, C) by view: uint8, or float32 in which 0 and 1 are the ends of the scene's range."""

    needed_to_render = True

    def __init__(self, read: Callable[[], dict[str, torch.Tensor]]) -> None:
        self._read = read
        self._images: dict[str, torch.Tensor] | None = None  # a stored cell has its own, and no file is read for it

    def for_view(self, view: str) -> torch.Tensor:
        """Return the render of a view, float32. Raises NotApplicableError for one that is no test view."""
        image = self.state_dict().get(view)
        if image is None:
            raise NotApplicableError("the renders were made elsewhere, and there are none but of the test views")
        return image if image.is_floating_point() else image.float() / 255

    def state_dict(self) -> State:
        if self._images is None:
            self._images = self._read()
        return self._images

    def load_state_dict(self, saved: State) -> None:
        self._images = dict(saved)


class Renders(Method):
    """Images of the test views from a folder, without depth."""

    renders_plain_gaussians = False
    trains = False

    def __init__(self, folder: str, layout: Literal["views", "3dgs", "thermonerf", "oezer"]) -> None:
        """folder: of the renders of one scene, with `run.json`. layout: how the files are named, see LAYOUTS."""
        self.folder, self.layout = Path(folder), LAYOUTS[layout]

    def made_elsewhere(self, scene: Scene) -> dict[str, Any]:
        run = read_run(self.folder / RUN, scene)
        digest = hashlib.sha256(hash_of(self.folder / RUN))
        for view, path in self._files(scene, run).items():
            digest.update(view.encode() + b"\0" + hash_of(path))
        return {**run.model_dump(), "files": digest.hexdigest()[:16], "summary": summary_of(run)}

    def setup(self, context: Context) -> None:
        scene = context.scene
        self.images = context.add_part("renders", Images(lambda: self._read(scene)))
        self._names = {frame.index: name for name, frame in context.frames.items()}

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        image = self.images.for_view(self._names.get(frame.index, ""))
        return Render(image, None, torch.zeros(image.shape[:2]))

    def doubts(self, scene: Scene) -> list[str]:
        """Doubt renders that are flipped, show another view than the one they are named after, or another scene."""
        views = [*scene.test, *scene.train]
        masks, shown = [view.valid for view in views], details((v.thermal for v in views), [v.valid for v in views])
        files, masks = [self.images.for_view(view.name).numpy() for view in scene.test], masks[: len(scene.test)]
        alike = details(files, masks) @ shown.T
        own, best = alike.diagonal(), alike.argmax(axis=1)
        turned = np.stack([
            (details((np.flip(file, axes) for file in files), masks) * shown[: len(own)]).sum(axis=1)
            for axes in FLIPS.values()
        ])  # fmt: skip
        is_flipped, doubts, count = fits_better(turned.max(axis=0), np.abs(own)), list[str](), len(own)
        for flip, is_this in zip(FLIPS, turned.argmax(axis=0) == np.arange(len(FLIPS))[:, None], strict=True):
            these = [view.name for view, one in zip(scene.test, is_flipped & is_this, strict=True) if one]
            which = f" ({named(sorted(these))})" * (len(these) < count)
            if these:
                doubts.append(
                    f"{self.name}: {len(these)} of {count} renders look more like their image {flip}{which}; flip them"
                )
        if is_flipped.sum() > count / 2:
            return doubts
        if np.median(own) < -LEAST:
            return [f"{self.name}: the renders are dark where the images are bright; is their palette inverted?"]
        others = fits_better(alike.max(axis=1), own) & ~is_flipped
        unlike = (own < LEAST) & ~others & ~is_flipped
        if others.any():
            pairs = [f"{views[i].name} shows {views[best[i]].name}" for i in np.flatnonzero(others)]
            doubts.append(
                f"{self.name}: {others.sum()} of {count} renders look more like another view than like their own "
                f"({named(sorted(pairs))}); are their names, or `views` in {RUN}, in the right order, and are "
                "they of this scene?"
            )
        if unlike.sum() > UNLIKE_SHARE * count:
            doubts.append(
                f"{self.name}: {unlike.sum()} of {count} renders are like no image of {scene.name} (correlation of "
                f"detail below {LEAST}); are they of this scene?"
            )
        return doubts

    def _read(self, scene: Scene) -> dict[str, torch.Tensor]:
        run = read_run(self.folder / RUN, scene)
        files = self._files(scene, run)
        views = {view.name: view for view in scene.test}
        images, faults = dict[str, torch.Tensor](), list[str]()
        for name, path in files.items():
            try:
                images[name] = torch.from_numpy(read_render(path, run, scene, views[name]))
            except SceneError as error:
                faults.append(str(error))
        if faults:
            more = f" ({len(faults)} of {len(files)} files cannot be used; this is the first)" if faults[1:] else ""
            raise SceneError(faults[0] + more)
        return images

    def _files(self, scene: Scene, run: Run) -> dict[str, Path]:
        """Return the file of each test view. Raises SceneError for files and views without each other."""
        views = [view.name for view in scene.test]
        if "<number>" in self.layout.renders and sorted(run.views or ()) != sorted(views):
            faults = f"wrong: {named(sorted(set(views) ^ set(run.views or ()))) or 'a name is there twice'}"
            raise SceneError(
                f"{self.folder / RUN}: views must name the {len(views)} test views of {scene.name} in the order of the "
                f"files, which have numbers; {faults if run.views else f'by name they are {json.dumps(sorted(views))}'}"
            )
        by_view, unknown, runs = defaultdict[str, list[Path]](list), list[str](), set[str]()
        for path in listed(self.folder):
            match = re.fullmatch(self.layout.renders, path.name)
            if match is not None:
                runs.add(match.groupdict().get("run", ""))
                by_view[self._view_of(match, run)].append(path)
            elif path.name != RUN and not re.fullmatch(self.layout.others, path.name):
                unknown.append(path.name)
        if len(runs) > 1:
            raise SceneError(f"{self.folder} has renders of several epochs ({named(sorted(runs))}); keep those of one")
        for view in views:
            if len(by_view[view]) > 1:
                first, second = by_view[view][:2]
                raise SceneError(f"{second} and {first.name} are both of view {view}; keep one of them")
        missing = {view for view in views if not by_view[view]}
        unknown += [path.name for view in sorted(by_view.keys() - set(views)) for path in by_view[view]]
        if missing or unknown:
            problems = [f"test views without a file: {named(sorted(missing))}"] * bool(missing)
            problems += [f"files of no test view of {scene.name}: {named(sorted(unknown))}"] * bool(unknown)
            remedy = self._remedy(unknown) or "there must be one file per test view"
            raise SceneError(f"{self.folder}: {'; '.join(problems)}; {remedy}")
        if "<view>" in self.layout.renders and run.views not in (None, views, list(by_view)):
            raise SceneError(
                f"{self.folder / RUN}: views contradicts the files, which are named by their views; remove "
                f"`views` from {RUN}"
            )
        return {view: path for view, (path,) in by_view.items()}  # in the order of the files, as they are hashed

    def _remedy(self, unknown: list[str]) -> str:
        """Return what to do with files that have other names than the layout's; empty if that is not known."""
        others = [key for key, names in LAYOUTS.items() if key != "views" and names is not self.layout]
        numbered = [key for key in others if any(re.fullmatch(LAYOUTS[key].renders, name) for name in unknown)]
        if numbered:
            return (
                f"method.layout={numbered[0]} reads files with such numbers, and `views` in {RUN} names their views in "
                "the files' order; or name each file after its view"
            )
        if any(name.lower().endswith((".jpg", ".jpeg")) for name in unknown):
            return "JPEG changes pixels, and so scores; save renders as VIEW.png or, without rounding, as VIEW.npy"
        return ""

    def _view_of(self, match: re.Match[str], run: Run) -> str:
        """Return the view that a file's name states, by its name or its number; empty for a number of no view."""
        groups, order = match.groupdict(), run.views or []
        place = int(groups.get("number", 0)) - self.layout.first
        return groups.get("view") or (order[place] if 0 <= place < len(order) else "")


def read_run(path: Path, scene: Scene) -> Run:
    """Read `run.json`. Raises SceneError, which names all that is wrong, also with another split than the scene's.

    Of a file that is not there it shows an example with the split and the test views of the scene.
    """
    if not path.parent.is_dir():
        raise SceneError(f"{path.parent} is not there; method.folder=DIR names the folder of the renders")
    if not path.exists():
        views = [view.name for view in scene.test]
        example = json.dumps({**EXAMPLE, "split": scene.split, "views": views}, ensure_ascii=False)
        raise SceneError(
            f"{path}, which says what made the renders, is missing; fill in the example for {scene.name} that follows "
            f"`failed:` at the end, or that of docs/other-programs.md\n{example}"
        )
    try:
        run = Run.model_validate_json(read_bytes(path))
    except ValidationError as error:
        raise SceneError(f"{path}: {'; '.join(_in_words(fault) for fault in error.errors())}") from error
    unfilled = [key for key in ("system", "repository", "command", "device") if getattr(run, key) == EXAMPLE[key]]
    if unfilled:
        raise SceneError(f"{path}: {unfilled[0]} is still the example's text; fill it in")
    if run.split != scene.split:
        raise SceneError(f"{path}: split is {run.split}, that of {scene.name} is {scene.split}; set data.split")
    return run


def _in_words(fault: ErrorDetails) -> str:
    key, text = ".".join(map(str, fault["loc"])), one_line(fault["msg"])
    if fault["type"] == "extra_forbidden":
        text = f"is no key{meant(key, Run.model_fields)}"
    elif fault["type"] == "missing":
        text = "is missing"
    elif key == "wall_time":
        text += ": seconds, or null"
    return f"{key}: {text}" if key else text


def summary_of(run: Run) -> str:
    """Return who made the renders, the training time that is stated, and what a reader of scores must know."""
    time = "no training time" if run.wall_time is None else f"a training time of {duration(run.wall_time)}"
    chosen = "; its checkpoint was chosen by test views" if run.checkpoint_rule == "best_test_view" else ""
    return f"made elsewhere by {one_line(run.system)}, which states {time} on {one_line(run.device)}{chosen}"


def read_render(path: Path, run: Run, scene: Scene, view: View) -> np.ndarray:
    """Return a render (H, W, C): uint8 of a picture, float32 of an array. Raises SceneError for what does not fit."""
    values = _array(path, run, scene) if path.suffix == ".npy" else _picture(path, run)
    size = view.camera.height, view.camera.width
    if values.shape[:2] != size:
        found, expected = (f"{width}×{height} px" for height, width in (values.shape[:2], size))
        raise SceneError(f"{path} has {found}, its view {expected}; render it at that size, or set data.width")
    gray = is_gray(values)
    if gray and np.ptp(values) > 0 and not is_gray(view.thermal):
        raise SceneError(
            f"{path} is gray, the thermal image of view {view.name} of {scene.name} is coloured; render all three of "
            "its channels, or compare in gray with data.channels=1"
        )
    if scene.channels == 1 and gray:
        values = values[..., :1]
    elif scene.channels == 3 and values.shape[2] == 1:
        values = values.repeat(3, axis=2)
    if values.shape[2] != scene.channels:
        raise SceneError(
            f"{path} is coloured, the thermal images of {scene.name} are gray; write gray, or set data.channels=3"
        )
    return np.array(values)


def _picture(path: Path, run: Run) -> np.ndarray:
    decoded = decode(path, as_picture=True)
    kind, depth = decoded.header.format, decoded.header.depth
    if kind != FORMATS[path.suffix] or depth != "8-bit" or decoded.valid is not None:
        alpha = " and transparent" if decoded.valid is not None else ""
        raise SceneError(f"{path} is {kind} of {depth}{alpha}; write {FORMATS[path.suffix]} of 8 bits, gray or RGB")
    if run.value_range != "unit":
        raise SceneError(f"{path} is a picture, and value_range in {RUN} is {run.value_range}; write °C as .npy")
    return decoded.values


def _array(path: Path, run: Run, scene: Scene) -> np.ndarray:
    values = read_array(path)
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim != 3 or values.shape[2] not in (1, 3) or values.dtype.kind != "f" or not values.size:
        raise SceneError(
            f"{path} holds {values.dtype} {values.shape}; it must hold floats (H, W), (H, W, 1) or (H, W, 3)"
        )
    if not np.isfinite(values).all():
        raise SceneError(
            f"{path} has {np.count_nonzero(~np.isfinite(values))} values that are not finite; write a number at every "
            "pixel, also where the scene's masks hide it"
        )
    if run.value_range == "degC":
        span = scene.temperature
        if span is None or scene.channels != 1:
            raise SceneError(f"{path} holds °C, and {scene.name} has no range of °C; write values in [0, 1]")
        return _of_degrees(values, span, path)
    median = float(np.median(values))
    if not PLAUSIBLE[0] <= median <= PLAUSIBLE[1]:
        what = f"{median:.3g} in its median, where images are in [0, 1]"
        raise SceneError(f"{path} is {what}; is value_range=unit in {RUN} right?")
    return values.astype(np.float32)


def _of_degrees(values: np.ndarray, span: TemperatureRange, path: Path) -> np.ndarray:
    """Return °C as image values. Raises SceneError for those of another unit."""
    width, median = span.max - span.min, float(np.median(values))
    scene, right = f"{span.min:g} to {span.max:g} °C", f"is value_range=degC in {RUN} right?"

    def is_plausible(value: float) -> bool:
        return PLAUSIBLE[0] <= (value - span.min) / width <= PLAUSIBLE[1]

    if not is_plausible(median):
        remedy = "is it in kelvin?" if is_plausible(median - 273.15) else right
        raise SceneError(f"{path} is {median:.3g} °C in its median, the scene {scene}; {remedy}")
    if values.max() < span.min or values.min() > span.max:
        raise SceneError(f"{path} lies wholly outside the scene's {scene}; {right} (`unit`: values in [0, 1])")
    return ((values.astype(np.float64) - span.min) / width).astype(np.float32)
