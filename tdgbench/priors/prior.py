"""The contract of depth priors: maps, estimators, and the cache of their maps on disk by image and estimator."""

from __future__ import annotations

import hashlib
import importlib
import json
import logging
import pkgutil
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, get_args

import numpy as np
import torch

from tdgbench.files import opened, whole_file
from tdgbench.resources import PACKAGE
from tdgbench.scenes import Scene, View
from tdgbench.scenes.images import resize
from tdgbench.scenes.inputs import hash_of, is_hidden, is_there
from tdgbench.text import one_line, shortened

Kind = Literal["depth", "disparity", "metric"]
KINDS: tuple[Kind, ...] = get_args(Kind)
CODE = ("priors", "scenes")  # packages of tdgbench whose code estimates depth, and reads the images for it
LOG = logging.getLogger(__name__)


class PriorError(Exception):
    """No prior is available. The message names the view and the remedy."""


class PriorUnavailableError(PriorError):
    """An estimator cannot work for any scene: a package, weights or a model file are missing.

    The message's lines: what is missing, what to do, and the other priors with what they mean for TDg.

    >>> print(str(PriorUnavailableError("marigold", "diffusers is not installed", "pip install it")).splitlines()[0])
    prior=marigold is not available: diffusers is not installed
    """

    def __init__(self, prior: str, reason: str, remedy: str) -> None:
        others = [f"    prior={name} {words}" for name, words in offers().items() if name != prior]
        first = f"prior={prior} is not available: {one_line(reason)}"
        super().__init__("\n".join([first, f"  {remedy}", "  or choose another:", *others]))


def offers() -> dict[str, str]:
    """Return the priors for real scenes: the OFFER of each module of this package that has one, by name.

    An offer says what else to add to the command line, and what TDg then is.
    """
    names = [module.name for module in pkgutil.iter_modules([str(Path(__file__).parent)])]
    modules = {name: importlib.import_module(f"tdgbench.priors.{name}") for name in names}
    return {name: module.OFFER for name, module in modules.items() if hasattr(module, "OFFER")}


@dataclass(frozen=True)
class DepthPrior:
    """Depth prior of one view.

    values: (H, W) float32, NaN where unknown. kind: `depth` (affine-invariant; larger is farther), `disparity`
    (affine-invariant inverse depth; larger is nearer) or `metric` (z in world units).
    """

    values: np.ndarray
    kind: Kind

    def check(self, view: View) -> DepthPrior:
        """Return self. Raises PriorError if the shape differs from the view's or no value is finite."""
        expected = (view.camera.height, view.camera.width)
        if self.kind not in KINDS:
            raise PriorError(f"the prior of view {view.name} has kind {self.kind!r}; it must be one of {KINDS}")
        if self.values.shape != expected:
            raise PriorError(
                f"the depth prior of view {view.name} is {self.values.shape}, its image {expected} (height, width)"
            )
        if not np.isfinite(self.values).any():
            raise PriorError(f"the depth prior of view {view.name} has no finite value")
        return self

    def resized(self, width: int, height: int) -> DepthPrior:
        """Return the map at another size: means of the known values in a pixel's area, unknown where it has none.

        >>> values = np.array([[1.0, 3.0, np.nan, np.nan, np.nan, 4.0]], np.float32)
        >>> DepthPrior(values, "depth").resized(3, 1).values.tolist()
        [[2.0, nan, 4.0]]
        """
        if self.values.shape == (height, width):
            return self
        known = np.isfinite(self.values)
        share = resize(known[..., None].astype(np.float32), width, height)[..., 0]
        sums = resize(np.where(known, self.values, np.float32(0))[..., None], width, height)[..., 0]
        unknown = np.float32(np.nan)
        return DepthPrior(np.divide(sums, share, out=np.full_like(sums, unknown), where=share > 0), self.kind)

    def of_view(self, view: View) -> DepthPrior:
        """Return the map in the size of the view's image, unknown at its masked pixels."""
        found = self.resized(view.camera.width, view.camera.height)
        if view.valid is None:
            return found
        return DepthPrior(np.where(view.valid, found.values, np.float32(np.nan)), self.kind)


class DepthEstimator(Protocol):
    """D = f(I_thermal): TDg, eq. 2."""

    def identity(self, scene: Scene) -> dict[str, object]:
        """Return everything the maps depend on besides the images, for the cache key and the record.

        `files`: hash of the files that the estimator reads, if any.
        """

    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        """Return the prior of a training view. Raises PriorError."""


def prepare(estimator: DepthEstimator) -> None:
    """Get what an estimator needs besides the scene, such as a package, by its method `prepare` if it has one.

    Raises PriorUnavailableError.
    """
    getattr(estimator, "prepare", lambda: None)()


@contextmanager
def unavailable(prior: str, reason: str, remedy: str) -> Iterator[None]:
    """Turn what fails in this context, in any library, into PriorUnavailableError."""
    try:
        yield
    except (MemoryError, PriorError):
        raise
    except Exception as error:
        raise PriorUnavailableError(
            prior, f"{reason} ({type(error).__name__}: {shortened(str(error))})", remedy
        ) from error


def importing(prior: str, extra: str = "depth") -> AbstractContextManager[None]:
    """Turn errors of importing the packages of an extra into PriorUnavailableError."""
    remedy = f"pip install -e '.[{extra}]'"
    if extra == "depth":
        remedy += "; a torchvision of another build than torch's breaks them: pip uninstall it"
    return unavailable(prior, "a package is missing or broken", remedy)


def loading(prior: str, model: str) -> AbstractContextManager[None]:
    """Turn errors of getting a model from the Hugging Face hub into PriorUnavailableError."""
    remedy = "connect to the Hugging Face hub once, or name a copy: HF_HOME=CACHE, or prior.estimator.model=FOLDER"
    return unavailable(prior, f"no weights of {model}", remedy)


def model_identity(model: str) -> dict[str, object]:
    """Return a model's name on the hub; of a folder, which may change, the hash of its files that are not hidden, too.

    It reads gigabytes: keep it.
    """
    folder = Path(model)
    if not folder.is_dir():
        return {"model": model}
    digest = hashlib.sha256()
    for name in sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file()):
        if not any(is_hidden(part) for part in name.parts):
            digest.update(name.as_posix().encode() + hash_of(folder / name))
    return {"model": model, "files": digest.hexdigest()[:16]}


def chosen_device(name: str) -> torch.device:
    """Return the device of a name; `auto` is the GPU, where there is one."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    return torch.device(name)


def estimate_all(
    estimator: DepthEstimator, scene: Scene, cache: Path | None, report: Callable[[int, int], None] | None = None
) -> tuple[dict[str, DepthPrior], int]:
    """Return priors of the training views by name, and how many of them were not in the cache.

    cache: folder of the maps; None disables it. report: called with (views done, views).
    """
    priors, made = {}, 0
    identity = json.dumps([_classes(estimator), estimator.identity(scene)], sort_keys=True)
    for index, view in enumerate(scene.train, start=1):
        prior, is_new = _cached(estimator, identity, scene, view, cache)
        priors[view.name], made = prior.check(view), made + is_new
        if report is not None:
            report(index, len(scene.train))
    return priors, made


def _classes(estimator: DepthEstimator) -> list[tuple[str, str]]:
    """Return the names of an estimator's class and of its bases with the hashes of their code.

    Of a class of tdgbench it is that of all code that estimates or reads images, as it calls more than its module.
    """
    kinds = type(estimator).__mro__[:-1]
    files = [Path(str(getattr(sys.modules.get(kind.__module__), "__file__", None))) for kind in kinds]
    hashes = [_hash_of_code(file) if file.is_file() else "" for file in files]
    return [(f"{kind.__module__}.{kind.__qualname__}", digest) for kind, digest in zip(kinds, hashes, strict=True)]


def _hash_of_code(file: Path) -> str:
    own = any(file.is_relative_to(PACKAGE / name) for name in CODE)
    files = sorted(path for name in CODE for path in (PACKAGE / name).rglob("*.py")) if own else [file]
    return hashlib.sha256(b"".join(map(hash_of, files))).hexdigest()[:16]


def _cached(
    estimator: DepthEstimator, identity: str, scene: Scene, view: View, cache: Path | None
) -> tuple[DepthPrior, bool]:
    """Return the prior of a view, and whether it is new."""
    if cache is None:
        return estimator.estimate(scene, view), True
    digest = hashlib.sha256(identity.encode())
    digest.update(f"{scene.fingerprint}/{view.name}/{view.camera.width}x{view.camera.height}".encode())
    digest.update(view.camera.K.tobytes() + view.camera.world_to_camera.tobytes())
    digest.update(np.ascontiguousarray(view.thermal).tobytes())
    path = cache / f"{digest.hexdigest()[:32]}.npz"
    stored = _read(path, view) if is_there(path) else None
    if stored is not None:
        return stored, False
    prior = estimator.estimate(scene, view).check(view)
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as part:
            np.savez(part, values=prior.values, kind=prior.kind)  # compressing takes 20 × as long, for a fifth less
    except OSError as error:
        LOG.warning("the prior %s was not cached: %s", path, error)
    return prior, True


def _read(path: Path, view: View) -> DepthPrior | None:
    """Return a stored prior; None, and a warning, for a file that is damaged: cut, changed, or of another shape.

    The archive holds checksums of its members, so changed bytes are found.
    """
    try:
        with opened(path) as file:
            with zipfile.ZipFile(file) as archive:
                largest = 4 * view.camera.width * view.camera.height + 4096  # before a shape is believed
                if any(member.file_size > largest for member in archive.infolist()):
                    raise ValueError("it is larger than a prior of its view")
            file.seek(0)
            with np.load(file, allow_pickle=False) as stored:
                values, kind = stored["values"], str(stored["kind"])
        if values.dtype != np.float32:
            raise ValueError(f"it holds {values.dtype}")
        return DepthPrior(values, kind).check(view)  # type: ignore[arg-type]
    except MemoryError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise many kinds
        LOG.warning("the cached prior %s is damaged and made again: %s", path, error)
        return None
