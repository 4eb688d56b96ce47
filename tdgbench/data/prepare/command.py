"""`tdgbench data prepare CAMERA_FILES OUT`."""

from __future__ import annotations

import argparse
import math
import re
import shlex
from pathlib import Path
from typing import get_args

from tdgbench.data.prepare.calibration import read_calibration
from tdgbench.data.prepare.prepare import PrepareOptions, prepare_scene
from tdgbench.data.prepare.report import Report
from tdgbench.data.prepare.sfm import CAMERA_MODELS, Matching, SfmOptions
from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import PhotoMapping
from tdgbench.scenes.temperature import CountScale
from tdgbench.terminal import say

FEW = 0.5  # of the files: with fewer views the command does not say how to train


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `tdgbench data prepare`, whose help fits on a screen of 24 lines and 80 columns."""
    parser.usage = "tdgbench data prepare [options] CAMERA_FILES OUT"
    parser.description = "Make a scene, the new folder OUT, of the files in the folder CAMERA_FILES."
    add = parser.add_argument
    add("source", type=Path, metavar="CAMERA_FILES", help=argparse.SUPPRESS)
    add("out", type=Path, metavar="OUT", help=argparse.SUPPRESS)
    add("--pairs", nargs=2, metavar=("THERMAL", "RGB"), help="names of files, * is the view: '*_T.tiff' '*_V.jpg'")
    add("--degC-per-count", type=number, metavar="A", help="of 16-bit or DJI's counts: degC = counts × A + B")
    add("--degC-at-zero", type=number, default=0.0, metavar="B")
    place = parser.add_mutually_exclusive_group().add_argument
    place("--mapping", nargs=3, type=number, metavar=("RATIO", "X", "Y"),
        help="thermal covers 1/RATIO of the RGB width, X, Y px off")  # fmt: skip
    place("--homography", type=Path, metavar="FILE", help="9 numbers, from RGB to thermal px (OpenCV)")
    add("--sfm", choices=("rgb", "thermal"), default="rgb", help="images that COLMAP sees; thermal needs no RGB images")
    model = parser.add_mutually_exclusive_group().add_argument
    model("--poses", type=Path, metavar="FILE", help="of these images, by another program (docs/prepare.md)")
    lens = parser.add_mutually_exclusive_group().add_argument
    lens("--focal", type=number, metavar="PX", help="focal length of these images; default: estimated")
    lens("--calibration", type=Path, metavar="FILE", help="lens of these images (docs/prepare.md)")
    add("--refine", action="store_true", help="begin with that lens, or --poses'; default: it is kept")
    model("--no-sfm", action="store_true", help="stop after extraction, without a COLMAP model")
    add("--matching", choices=get_args(Matching), default="exhaustive", metavar="HOW",
        help="exhaustive, sequential (by name), nearest (GPS, poses)")  # fmt: skip
    add("--camera-model", choices=CAMERA_MODELS, default="SIMPLE_RADIAL", metavar="NAME", help=", ".join(CAMERA_MODELS))
    add("--seed", type=int, default=0, metavar="N", help="of COLMAP; equal results need --threads 1, too")
    add("--threads", type=int, metavar="N", help="of COLMAP; default: all processors")


def run(arguments: argparse.Namespace) -> int:
    """Prepare a scene and print its report. Exit status 0 if every file is in the scene, else 1."""
    report = prepare_scene(arguments.source, arguments.out, _options(arguments))
    say(report.text().rstrip())
    if not arguments.no_sfm:
        for line in next_steps(str(arguments.out), report):
            say(line)
    return 0 if report.is_complete else 1


def next_steps(out: str, report: Report) -> list[str]:
    """Return what to do with a scene, in commands that a shell and Hydra take; or what to do first."""
    if len(report.written) < FEW * len(report.files):
        return [
            "Most views are missing. Pictures must overlap by two thirds, from moving positions, and show texture; "
            "--matching nearest or sequential tries fewer wrong pairs, --focal PX keeps a lens from running away."
        ]
    plain = re.fullmatch(r"[\w./-]+", out, re.ASCII)
    root = out if plain else '"{}"'.format(out.replace('"', '\\"'))
    return [
        f"check: tdgbench data check {shlex.quote(out)}",
        f"train: tdgbench method=3dgs dataset=folder {shlex.quote(f'data.root={root}')}",
    ]


def _options(given: argparse.Namespace) -> PrepareOptions:
    """Return the options of a preparation. Raises SceneError for options that contradict each other."""
    for name in ("focal", "threads"):
        if (value := getattr(given, name)) is not None and value <= 0:
            raise SceneError(f"--{name} {value} is not positive")
    if given.degC_per_count == 0:
        raise SceneError("--degC-per-count is 0; it must be the °C of one count")
    if given.degC_at_zero != 0 and given.degC_per_count is None:
        raise SceneError("--degC-at-zero needs --degC-per-count: degC = counts × A + B")
    if given.sfm == "thermal" and (given.mapping or given.homography):
        raise SceneError("--sfm thermal has no RGB images: --mapping and --homography are about them")
    if given.refine and not (given.focal or given.calibration or given.poses):
        raise SceneError("--refine is about --focal, --calibration or the lens of --poses; give one of them")
    calibration = () if given.calibration is None else read_calibration(given.calibration)
    return PrepareOptions(
        pairs=given.pairs and (given.pairs[0], given.pairs[1]),
        counts=CountScale(given.degC_per_count, given.degC_at_zero),
        mapping=given.mapping and PhotoMapping(*given.mapping),
        homography=given.homography,
        sfm=SfmOptions(
            given.sfm, given.focal, given.matching, given.camera_model, given.seed, given.threads, calibration,
            given.refine,
        ),
        poses=given.poses,
        extracts_only=given.no_sfm,
    )  # fmt: skip


def number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not finite")
    return value
