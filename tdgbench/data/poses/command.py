"""`tdgbench data poses SCENE REFERENCE`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tdgbench.data.poses.compare import compare
from tdgbench.data.poses.references import READ, Reference, read_reference
from tdgbench.scenes import SceneError
from tdgbench.terminal import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, metavar="SCENE", help="the scene's folder, in any layout")
    parser.add_argument("reference", type=Path, metavar="REFERENCE", help=READ)


def run(arguments: argparse.Namespace) -> int:
    """Print how far the scene's poses are from the reference's."""
    scene, reference = read_reference(arguments.scene), read_reference(arguments.reference)
    result = compare(scene.poses, reference.poses)
    total = f"{len(scene.poses)} and {len(reference.poses)}"
    say(f"views: {len(result.position)} in both, of {total}; similarity of {result.fitted}")
    for note in (*scene.notes, *reference.notes):
        say(f"note: {note}")
    if result.rotation is None:
        say("rotation: n/a (the positions lie on a line, about which they determine no rotation)")
    else:
        say(f"rotation: {_spread(result.rotation)} degrees")
    say(f"position: {_spread(100 * result.position)} % of the extent, {result.extent:.6g} in the reference's units")
    say(f"focal length: {_focal(scene)}; reference: {_focal(reference)}")
    return 0


def _spread(errors: np.ndarray) -> str:
    return f"median {np.median(errors):.3g}, 90 % below {np.percentile(errors, 90):.3g}, largest {errors.max():.3g}"


def _focal(reference: Reference) -> str:
    """Return the cameras' focal lengths, also as shares of the width, which resizing leaves as they are."""
    try:
        known = sorted({(one.params[0], one.width) for one in reference.lenses()})
    except SceneError as error:
        return f"n/a ({error})"
    shown = [f"{focal:.1f} px of {width} ({focal / width:.4f} × the width)" for focal, width in known[:2]]
    return (", ".join(shown) + " …" * (len(known) > 2)) or "n/a (not stated)"
