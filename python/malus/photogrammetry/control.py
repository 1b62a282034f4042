"""Frame of the model from the control points of a station file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from malus import _core
from malus.camera import Camera
from malus.photogrammetry.scale import Log

#: A coordinate's standard deviation that is worth a warning, as a share of the points' extent.
_LARGE = 0.005


def adjust_datum(
    points: Sequence[Mapping[str, Any]], cameras: Mapping[str, Camera], mark_sigma_px: float, log: Log
) -> dict[str, Any]:
    """How the model stands in the frame of the [[control]] tables: x_known = scale · rotation @ x_model + translation.

    cameras: registered photos by name, in the model's frame. Returns `scale`, `rotation` (3×3), `translation` (3), `sigma`
    (standard deviation of a coordinate), `doubtful` (a point that is likely wrong, or None) and `points`: name, check,
    offset (x, y, z of the model less the known ones) and rms_px of the marks. Points with fewer than two marks in
    registered photos are left out with a warning. Raises InputError for fewer than three others without check = true,
    for points on one line and for points that do not fit.
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
            log(
                level, f"[[control]] {point['name']} is marked {seen}, expected two or more: it does not give the frame"
            )
            continue
        known.append((point["name"], point["xyz"], marks, point["check"]))
    views = [(name, cameras[name].values()) for name in names]
    datum: dict[str, Any] = _core.adjust_datum(views, known)
    _warn(datum, known, log)
    return datum


def _warn(datum: Mapping[str, Any], known: Sequence[Any], log: Log) -> None:
    places = np.array([xyz for _, xyz, _, check in known if not check])
    extent = float(np.linalg.norm(np.ptp(places, axis=0)))
    if datum["sigma"] > _LARGE * extent:
        worst = max(datum["points"], key=lambda fit: 0.0 if fit["check"] else float(np.linalg.norm(fit["offset"])))
        log(
            "warning",
            f"[[control]]: coordinates and marks differ by {datum['sigma']:.3g} over {extent:.3g}; the worst is {worst['name']}",
        )
    if datum["doubtful"] is not None:
        log(
            "warning",
            f"[[control]] {datum['doubtful']}: without this point the others fit far better; are its marks and its "
            "coordinates right?",
        )


def move_model(source: Path, target: Path, datum: Mapping[str, Any]) -> None:
    """Copy a COLMAP model into the frame of a datum: `scale`, `rotation`, `translation`."""
    model = _core.ColmapModel.read(str(source))
    model.transform(float(datum["scale"]), np.array(datum["rotation"]), np.array(datum["translation"]))
    target.mkdir(parents=True, exist_ok=True)
    model.write(str(target))
