"""Marks of known distances and control points while they are set: their epipolar lines from other photos, and how well they agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import malus
from malus import _core
from malus.camera import Camera
from malus.errors import InputError, MalusError
from malus.options import Options
from malus.photogrammetry.control import adjust_datum
from malus.photogrammetry.model import SparseModel
from malus.photogrammetry.scale import adjust_scale
from malus.photogrammetry.station_pose import STATION_IMAGE
from malus.studio.pictures import Lens, cached, distorting

#: Shown in place of lines and residuals.
_NO_CAMERAS = "The photos' cameras are not known yet; after the first run lines and residuals are shown here."


def model_of(station: Path, camera: Mapping[str, Any], works: Sequence[Path]) -> Path | None:
    """Folder of a model with the photos' cameras: the station's own model, or one made by a run of the station; None if there is none."""
    folders = [station.parent / camera["colmap_model"]] if "colmap_model" in camera else []
    folders += [work / "prior" / "colmap" / "model" for work in works]
    return next((folder for folder in folders if folder.is_dir()), None)


def _lens_beside(cameras: Path) -> Lens | None:
    station = SparseModel.read(cameras.parent).cameras.get(STATION_IMAGE)
    return None if station is None else distorting(vars(station))


_lens_of = cached(_lens_beside, 4)


def calibrated_lens(model: Path) -> Lens | None:
    """The station's lens, if it has distortion, as the run that made this model calibrated it; None if the model does not tell."""
    try:
        return _lens_of(model / "cameras.bin")
    except InputError:
        return None


def lines(cameras: Mapping[str, Camera], image: str, marks: Sequence[Mapping[str, Any]]) -> list[list[tuple[float, float]]]:  # fmt: skip
    """For each mark of one end in another photo, the epipolar line in `image` on which this end lies (pixels)."""
    if image not in cameras:
        return []
    return [
        _core.epipolar_line(cameras[mark["image"]].values(), mark["x"], mark["y"], cameras[image].values())
        for mark in marks
        if mark["image"] != image and mark["image"] in cameras
    ]


def residuals(cameras: Mapping[str, Camera], bars: Sequence[Mapping[str, Any]], options: Options) -> dict[str, Any]:
    """How well the [[scale]] tables fit each other and the cameras: `fits` by position in the list, from 1, of the tables with both
    ends marked in two photos or more; `problem` says why there are no fits.
    """
    filled = [{"targets": None, "check": False, "a": [], "b": [], **bar} for bar in bars]
    marked = [place for place, bar in enumerate(filled) if all(sum(mark["image"] in cameras for mark in bar[end]) > 1 for end in "ab")]  # fmt: skip
    if not marked:
        return {"problem": "Mark both ends of a distance in two photos or more; how well they fit is then shown here.", "fits": {}}  # fmt: skip
    try:
        found = adjust_scale([filled[place] for place in marked], [], cameras, options, lambda _level, _message: None)
    except MalusError as error:
        return {"problem": str(error), "fits": {}}
    fits = {marked[int(fit["name"].split()[-1]) - 1] + 1: fit for fit in found["distances"]} if found else {}
    return {"problem": "", "fits": fits}


def examined(model: Path | None, bars: Sequence[Mapping[str, Any]], image: str, distance: int, end: str, options: Options) -> dict[str, Any]:  # fmt: skip
    """Epipolar lines for the end that is being marked in `image`, and the residuals of all distances."""
    if model is None:
        return {"lines": [], "fits": {}, "problem": _NO_CAMERAS}
    cameras = SparseModel.read(model).cameras
    marks = bars[distance].get(end, []) if 0 <= distance < len(bars) else []
    return {"lines": lines(cameras, image, marks), **residuals(cameras, bars, options)}


def control(station: Path, model: Path | None, image: str, name: str, options: Options) -> dict[str, Any]:
    """How well the control points of a station file fit. image: photo that is shown; name: point that is being marked in this photo.

    Returns `problem` (what is wrong or missing), `lines` (epipolar lines of the point in the photo, from its marks in other photos),
    `image` (fit of the marks in the polarized image: use, rms_px, center_sigma, doubtful, points; None without such marks) and
    `datum` (fit of the marks in the photos; None without the photos' cameras).
    """
    said: dict[str, Any] = {"problem": "", "lines": [], "image": None, "datum": None}
    try:
        description = malus.Station.load(station).describe()
    except MalusError as error:
        return {**said, "problem": str(error).replace(str(station), station.name)}
    points = description["control"]
    said["image"] = description["control_image"]
    if description["prior"] != "photos":
        return said
    if model is None:
        return {**said, "problem": _NO_CAMERAS}
    cameras = SparseModel.read(model).cameras
    said["lines"] = lines(cameras, image, next((point["marks"] for point in points if point["name"] == name), []))
    try:
        datum = adjust_datum(points, cameras, options.photos.mark_sigma_px, lambda _level, _message: None)
        said["datum"] = {name: datum[name] for name in ("sigma", "doubtful", "points")}
    except MalusError as error:
        said["problem"] = str(error)
    return said
