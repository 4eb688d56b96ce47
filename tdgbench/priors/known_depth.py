"""Known depth in a view's pixels, of the truth or of sparse points, and doubts about priors that contradict it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from tdgbench.priors.prior import DepthPrior
from tdgbench.priors.sfm_points import visible_points
from tdgbench.scenes import Scene, View
from tdgbench.text import first_few, named

GRID_WIDTH = 160  # columns of the grid on which points hide others, as in conf/prior/sfm_points.yaml
_OCCLUSION = 0.1  # as there
MOST_POINTS = 20_000  # that priors are compared with
FEWEST_POINTS = 20  # in a view that is compared
LEAST_RANK = 0.2  # of maps that are not doubted: Spearman's correlation with depth, median of the views
FAR = 0.4  # below that median, where a single view's is doubted
LEAST_SPREAD = 0.02  # of the 80 % of depths in the middle, share of their median; less is mostly the points' noise
MOST_COMPARED = 40  # views whose priors are compared with one another
MOST_POINTS_OF_A_PAIR = 500
RESIDUAL = 0.7  # of 1 − rank correlation: a prior that leaves less fits a view better than its own
LARGEST_RATIO = 3.0  # of a metric map's depth and that of points, median of the views


class KnownDepth(NamedTuple):
    """True z at pixels; all arrays have shape (N,)."""

    rows: np.ndarray
    columns: np.ndarray
    z: np.ndarray  # world units


def known_depth(view: View, points: np.ndarray) -> KnownDepth:
    """Return the known depth in a view's measured pixels. points: (N, 3), the truth."""
    depth, valid = view.true_depth, view.valid
    if depth is None:
        known = _of_points(view, points)
    else:
        rows, columns = np.nonzero(depth > 0)
        known = KnownDepth(rows, columns, depth[rows, columns].astype(np.float64))
    if valid is not None:
        known = KnownDepth(*(array[valid[known.rows, known.columns]] for array in known))
    return known


def _of_points(view: View, points: np.ndarray) -> KnownDepth:
    camera = view.camera
    width = min(GRID_WIDTH, camera.width)
    grid = camera.resized(width, max(1, round(camera.height * width / camera.width)))
    seen = visible_points(grid, points, _OCCLUSION)
    columns, rows = camera.project(points[seen.number])[0].astype(int).T
    inside = (columns < camera.width) & (rows < camera.height)
    return KnownDepth(rows[inside], columns[inside], seen.z[inside])


def doubts_of(priors: Mapping[str, DepthPrior], scene: Scene) -> Iterator[str]:
    """Yield why the priors of a scene's training views may be wrong: they are constant, or unlike its sparse points."""
    constant = [name for name, prior in priors.items() if np.nanmin(prior.values) == np.nanmax(prior.values)]
    if constant:
        yield f"{len(constant)} of {len(priors)} depth priors have one value only, no shape: {first_few(constant)}"
    if scene.points is None:
        return
    points, kind = scene.points.points, priors[scene.train[0].name].kind
    sign = -1 if kind == "disparity" else 1
    known = {view.name: _of_points(view, points[:: len(points) // MOST_POINTS + 1]) for view in scene.train}
    ranks = {name: sign * _rank(priors[name].values, known[name]) for name in known}
    ranks = {name: rank for name, rank in ranks.items() if np.isfinite(rank) and _spread(known[name].z) > LEAST_SPREAD}
    if not ranks:
        rank, count = _pooled_rank(priors, known)
        if sign * rank < LEAST_RANK:
            yield (
                f"the depth prior, of kind {kind}, has a rank correlation of {sign * rank:.2f} with the depth of the "
                f"{count} sparse points of all views: are its kind, its files' names and its orientation right?"
            )
        return
    rank, where = float(np.median([*ranks.values()])), f"of the sparse points (median of {len(ranks)} views)"
    if rank < LEAST_RANK:
        yield (
            f"the depth prior, of kind {kind}, has a rank correlation of {rank:.2f} with the depth {where}: are its "
            "kind, its files' names and its orientation right?"
        )
        return
    yield from _doubted_views(priors, known, ranks, sign)
    if kind == "metric":
        ratio = float(
            np.median([np.nanmedian(_at(priors[name].values, known[name]) / known[name].z) for name in ranks])
        )
        if not 1 / LARGEST_RATIO <= ratio <= LARGEST_RATIO:
            yield f"the depth prior, of kind metric, is {ratio:.3g} × the depth {where}: is it in the scene's units?"


def _doubted_views(
    priors: Mapping[str, DepthPrior], known: Mapping[str, KnownDepth], ranks: Mapping[str, float], sign: int
) -> Iterator[str]:
    """Yield which priors are upside down, of another view or of none. ranks: of each with its own view's points."""
    flipped = [n for n in ranks if _fits_better(sign * _rank(priors[n].values[::-1], known[n]), ranks[n])]
    upright = [name for name in ranks if name not in flipped]
    some = upright[:: len(upright) // (MOST_COMPARED + 1) + 1]
    steps = {name: len(known[name].z) // MOST_POINTS_OF_A_PAIR + 1 for name in some}
    few = {name: KnownDepth(*(array[:: steps[name]] for array in known[name])) for name in some}
    fits = {(a, b): sign * _rank(priors[b].values, few[a]) for a in some for b in some}
    better = {(a, b) for a, b in fits if _fits_better(fits[a, b], fits[a, a])}  # of a, the prior of b
    moved = {a for a, _ in better}
    if len(moved) > len(some) / 2:
        yield (
            f"the depth priors of {len(moved)} of {len(some)} compared views fit the sparse points worse than the "
            "prior of another view: are their files' names right?"
        )
        return
    exchanged = [a for a in some if any((a, b) in better and (b, a) in better for b in some)]
    rank = float(np.median([*ranks.values()]))
    unlike = [n for n in upright if ranks[n] < min(LEAST_RANK, rank - FAR) and n not in exchanged]
    for names, what in (
        (flipped, "fit the sparse points better upside down ({}); flip them"),
        (exchanged, "fit the sparse points of another view, whose prior fits theirs ({}); exchange their files"),
        (unlike, f"do not fit the sparse points (rank correlation below {LEAST_RANK}, median {rank:.2f}): {{}}"),
    ):
        if names:
            yield f"{len(names)} of {len(ranks)} depth priors {what.format(named(names))}"


def _fits_better(rank: float, own: float) -> bool:
    """Return whether a prior with this rank correlation fits a view better than the view's own prior."""
    return rank >= LEAST_RANK and 1 - rank < RESIDUAL * (1 - own)


def _spread(z: np.ndarray) -> float:
    nearest, median, farthest = np.quantile(z, (0.1, 0.5, 0.9))
    return float((farthest - nearest) / median)


def _at(values: np.ndarray, known: KnownDepth) -> np.ndarray:
    """Return a map's values where depth is known, NaN where the map is unknown or does not reach."""
    height, width = values.shape
    inside = (known.rows < height) & (known.columns < width)
    found = np.where(inside, values[np.minimum(known.rows, height - 1), np.minimum(known.columns, width - 1)], np.nan)
    return np.where(np.isfinite(found), found, np.nan)


def _beside(values: np.ndarray, known: KnownDepth) -> tuple[np.ndarray, np.ndarray]:
    """Return a map's values and known depth where both are known, (M,)."""
    found = _at(values, known)
    return found[np.isfinite(found)], known.z[np.isfinite(found)]


def _rank(values: np.ndarray, known: KnownDepth) -> float:
    """Return Spearman's correlation of a map with known depth; NaN of too few points or of one value."""
    found, z = _beside(values, known)
    if len(z) < FEWEST_POINTS or not np.ptp(found) or not np.ptp(z):
        return np.nan
    return float(np.corrcoef(_ranks(found), _ranks(z))[0, 1])


def _pooled_rank(priors: Mapping[str, DepthPrior], known: Mapping[str, KnownDepth]) -> tuple[float, int]:
    """Return the correlation of ranks within views, over the points of all views, and their number.

    NaN of too few points, and of views that are all flat.
    """
    pairs = []
    for name, one in known.items():
        found, z = _beside(priors[name].values, one)
        if len(z) > 1 and np.ptp(found) and np.ptp(z) and _spread(z) > LEAST_SPREAD:
            pairs.append([(_ranks(each) - (len(z) + 1) / 2) / len(z) for each in (found, z)])
    if sum(len(a) for a, _ in pairs) < FEWEST_POINTS:
        return np.nan, 0
    a, b = (np.concatenate(side) for side in zip(*pairs, strict=True))
    return float(np.corrcoef(a, b)[0, 1]), len(a)


def _ranks(values: np.ndarray) -> np.ndarray:
    """Return the rank of each value, of equal ones their mean (scipy.stats would take long to import).

    >>> _ranks(np.array([5.0, 7.0, 5.0])).tolist()
    [1.0, 2.5, 1.0]
    """
    _, number, counts = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(counts) - counts / 2)[number])
