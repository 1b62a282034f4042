"""Frame of the model from the control points of a station file."""

from __future__ import annotations

import filecmp
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from malus import _core
from malus._files import scratch_folder
from malus.camera import Camera
from malus.columns import number
from malus.errors import InputError
from malus.photogrammetry.diagnosis import Log

#: Least number of points that determine a similarity.
_LEAST_POINTS = 3
#: A larger standard deviation of a coordinate, as a share of the points' extent, gives a warning.
_LARGE = 0.005

#: Points lie in one plane if they spread less across it than this share of their spread along it: exchanged axes fit them, too.
_FLAT = 0.02


def require_control_points(said: Mapping[str, Any], photos: Sequence[str]) -> None:
    """Check that the control points of `Station.describe` can give a frame to these photos, before hours go into matching the photos.

    Raises InputError if fewer than three points that are not held out are marked in two of the photos.
    """
    if not said["control"]:
        return
    known = set(photos)
    counts = [sum(mark["image"] in known for mark in point["marks"]) for point in said["control"] if not point["check"]]
    enough = sum(count > 1 for count in counts)
    if enough < _LEAST_POINTS:
        raise InputError(
            f"{said['path']}: [[control]]: {enough} point{'s' * (enough != 1)} without check = true "
            f"{'are' if enough != 1 else 'is'} marked in two photos or more, expected at least {_LEAST_POINTS} to find the "
            "frame and the size; [[scale]] gives the size alone"
        )


def adjust_datum(
    points: Sequence[Mapping[str, Any]], cameras: Mapping[str, Camera], mark_sigma_px: float, log: Log
) -> dict[str, Any]:
    """Similarity from the model to the frame of the [[control]] tables: x_known = scale · rotation @ x_model + translation.

    cameras: registered photos by name, in the model's frame. Returns `scale`, `rotation` (3×3), `translation` (3), `sigma`
    (standard deviation of a coordinate), `check_rms` (RMS offset of a coordinate of the held-out points, or None), `doubtful` (a point
    that is likely wrong, or None) and `points`: name, check, offset (x, y, z of the model minus the known ones) and rms_px of the
    marks. Points with fewer than two marks in registered photos are left out with a warning. Raises InputError if fewer than three
    other points are without check = true, if the points lie on one line and if they do not fit.
    """
    names = sorted(cameras)
    index = {name: number for number, name in enumerate(names)}
    known = []
    for point in points:
        marks = [
            (index[mark["image"]], mark["x"], mark["y"], mark_sigma_px)
            for mark in point["marks"]
            if mark["image"] in index
        ]
        if len(marks) < 2:
            seen = "in the polarized image alone" if not point["marks"] else f"in {len(marks)} photos with a position"
            level = "info" if not point["marks"] else "warning"
            lost = "it checks nothing" if point["check"] else "it does not give the frame"
            log(level, f"[[control]] {point['name']} is marked {seen}, expected two or more: {lost}")
            continue
        known.append((point["name"], point["xyz"], marks, point["check"]))
    views = [(name, cameras[name].values()) for name in names]
    datum: dict[str, Any] = _core.adjust_datum(views, known)
    _warn(datum, known, log)
    if _seen_from_below(datum, known, cameras):
        log(
            "warning",
            "[[control]]: all points lie in one plane, and the photos were taken from below it, where Z is smaller. Are X and Y exchanged, "
            "so that the surface is turned inside out? A point outside of the plane would show it",
        )
    return datum


def _warn(datum: Mapping[str, Any], known: Sequence[Any], log: Log) -> None:
    places = np.array([xyz for _, xyz, _, check in known if not check])
    extent = float(np.linalg.norm(np.ptp(places, axis=0)))
    if datum["sigma"] > _LARGE * extent:
        worst = max(datum["points"], key=lambda fit: 0.0 if fit["check"] else float(np.linalg.norm(fit["offset"])))
        log(
            "warning",
            f"[[control]]: coordinates and marks differ by {number(datum['sigma'])} over {number(extent)}; the worst is {worst['name']}",
        )
    if datum["doubtful"] is not None:
        log(
            "warning",
            f"[[control]] {datum['doubtful']}: without this point the others fit far better; are its marks and its "
            "coordinates right?",
        )


def _seen_from_below(datum: Mapping[str, Any], known: Sequence[Any], cameras: Mapping[str, Camera]) -> bool:
    """Whether the points lie in a plane that is rather level, and all cameras below it."""
    places = np.array([xyz for _, xyz, _, check in known if not check])
    center = places.mean(axis=0)
    _, spread, axes = np.linalg.svd(places - center)
    up = axes[2] * np.sign(axes[2, 2])
    if spread[2] > _FLAT * spread[0] or up[2] < np.sqrt(0.5):
        return False
    poses = [camera.pose() for camera in cameras.values()]
    stands = np.array([-rotation.T @ translation for rotation, translation in poses])
    heights = (datum["scale"] * stands @ np.transpose(datum["rotation"]) + datum["translation"] - center) @ up
    return bool((heights < 0).all())


def move_model(source: Path, target: Path, datum: Mapping[str, Any]) -> None:
    """Copy a COLMAP model into the frame of a datum: `scale`, `rotation`, `translation`. Files of the target that would not change stay,
    since stations of another shard may be reading them.
    """
    model = _core.ColmapModel.read(str(source))
    model.transform(float(datum["scale"]), np.array(datum["rotation"]), np.array(datum["translation"]))
    target.mkdir(parents=True, exist_ok=True)
    with scratch_folder(target) as scratch:
        written = scratch / "model"
        written.mkdir()
        model.write(str(written))
        for file in sorted(written.iterdir()):
            if not ((target / file.name).is_file() and filecmp.cmp(file, target / file.name, shallow=False)):
                file.replace(target / file.name)
