"""From photos and the station's image to the station's pose: the main path to the cameras.

photos → their cameras (photo_cameras) → the station among them (station_pose) → more accurate image points in all
images (window_matching) → metric scale (scale) or frame (control) → depth in the station's view (station_sweep). All files
are kept below one folder, and finished stages are not repeated (journal).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.camera import Camera
from malus.errors import DataError, InputError
from malus.options import Options
from malus.photogrammetry import diagnosis
from malus.photogrammetry.bench import Bench
from malus.photogrammetry.control import adjust_datum, move_model, require_control_points
from malus.photogrammetry.diagnosis import Log, silent
from malus.photogrammetry.journal import Journal
from malus.photogrammetry.marks import marks_in_files, require_marks_in_photos
from malus.photogrammetry.model import SparseModel
from malus.photogrammetry.photo_cameras import PhotoCameras, doubts_of_lenses, enough_photos_of, solve_photos
from malus.photogrammetry.photos import Photo, describe_photo, require_usable_masks
from malus.photogrammetry.program import Colmap
from malus.photogrammetry.scale import adjust_scale, require_scale
from malus.photogrammetry.station_pose import (
    STATION_IMAGE,
    PlacedStations,
    StationView,
    lens_of_raster,
    place_stations,
    placed_at,
    station_image,
)
from malus.photogrammetry.window_matching import match_windows
from malus.threads import ALL_CORES

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class StationCameras:
    """Cameras in the world of the result: the control points' frame, or COLMAP's scaled to the station's unit."""

    station: Camera
    """Lens (that of the undistorted raster if a lens was given, else the calibrated one) and pose."""
    photos: list[tuple[Photo, Camera]]
    model: SparseModel
    figures: dict[str, Any]
    """For quality.json: `photogrammetry`, `scale`, and `control` if there are control points."""
    times: dict[str, Any]
    """`seconds`, `cpu_seconds` and `peak_mb` of all stages together, and of each stage (`stages`)."""
    warnings: list[str] = field(default_factory=list)
    """Warnings from the joint search for the cameras of several stations, for this station's report."""
    silhouettes: list[tuple[str, Path, Camera]] = field(default_factory=list)
    """Outlines of the object beside those of `photos`: image name, mask, and camera of the image that the mask belongs to."""


@dataclass(frozen=True)
class Outline:
    """A station's mask, which shows all of the object that is in view."""

    mask: NDArray[np.uint8]
    """H×W of the undistorted image, non-zero = object."""
    file: Path
    """The mask of the images as taken."""


def find_cameras(
    station: Mapping[str, Any],
    unpolarized: NDArray[np.float32],
    folder: Path,
    *,
    options: Options | None = None,
    threads: int = ALL_CORES,
    progress: Report = silent,
    log: Log = silent,
) -> StationCameras:
    """Cameras of a station's photos and of the station itself.

    station: as `Station.describe` returns it. unpolarized: H×W intensity of the station's view, linear, undistorted if its
    lens is known. folder: where COLMAP's files, logs and marks of finished stages are kept. progress: share done, message. log: level
    (info, warning), message.

    Raises InputError for wrong files, DataError with advice on what to photograph if the photos do not suffice, and
    ExternalError if COLMAP is missing or fails.
    """
    bench = _bench(folder, options, threads, progress, log)
    photos, solved = _solved(bench, station)
    lens = lens_of_raster(Camera.from_description(station["camera"])) if "camera" in station else None
    shared = None if lens is not None else _photo_of_same_camera(station, photos, solved.model, unpolarized.shape, log)
    view = StationView(unpolarized, lens, shared)
    placed, model, figures = _placed_and_scaled(bench, photos, solved, {STATION_IMAGE: view}, station)
    figures["photogrammetry"]["station"] = {
        **_station_figures(placed, STATION_IMAGE),
        "lens": "given" if lens is not None else "of the photos" if shared is not None else "self-calibrated",
    }
    return StationCameras(
        station=model.images[STATION_IMAGE].camera,
        photos=[(photo, model.images[photo.name].camera) for photo in photos if photo.name in model.images],
        model=model,
        figures=figures,
        times=bench.journal.total_times(),
    )


def find_object_cameras(
    shared: Mapping[str, Any],
    stations: Mapping[str, tuple[Camera, NDArray[np.float32]]],
    folder: Path,
    *,
    outlines: Mapping[str, Outline] | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
    progress: Report = silent,
    log: Log = silent,
) -> dict[str, StationCameras]:
    """Cameras of an object's photos and of its stations in one model, by the stations' names.

    shared: `path`, `photos`, `scale` and `control` as in `Station.describe`. stations: lens and H×W unpolarized intensity, undistorted.
    Stations that cannot be placed are left out. For each station, the images of the other stations count as photos. outlines: of an
    object that turned before a fixed camera, by the names of the stations that have a mask. Features then count only inside the masks of
    photos and stations, and the stations' outlines are silhouettes as those of the photos are. Raises the errors of `find_cameras`.
    """
    bench = _bench(folder, options, threads, progress, log, inside_masks=outlines is not None)
    outlines = outlines or {}
    photos, solved = _solved(bench, shared)
    images = {name: station_image(number) for number, name in enumerate(stations)}
    views = {
        images[name]: StationView(
            unpolarized,
            lens_of_raster(lens),
            mask=outlines[name].mask if name in outlines else None,
            title=f"station {name}",
        )
        for name, (lens, unpolarized) in stations.items()
    }
    placed, model, figures = _placed_and_scaled(bench, photos, solved, views, shared)
    pictures = list(photos)
    for image, view in views.items():
        height, width = view.unpolarized.shape
        pictures.append(Photo(image, bench.images / image, width, height))
    silhouettes = {
        name: (images[name], outline.file, placed_at(stations[name][0], model.images[images[name]].camera))
        for name, outline in outlines.items()
        if placed.has(images[name])
    }
    found = {}
    for name, image in images.items():
        if placed.has(image):
            own = {**figures["photogrammetry"], "station": {**_station_figures(placed, image), "lens": "given"}}
            found[name] = StationCameras(
                station=model.images[image].camera,
                photos=[
                    (picture, model.images[picture.name].camera)
                    for picture in pictures
                    if picture.name in model.images
                    and picture.name != image
                    and (picture.name not in views or placed.has(picture.name))
                ],
                model=model,
                figures={**figures, "photogrammetry": own},
                times=bench.journal.total_times(),
                silhouettes=[silhouette for other, silhouette in silhouettes.items() if other != name],
            )
    return found


def _bench(
    folder: Path, given: Options | None, threads: int, progress: Report, log: Log, *, inside_masks: bool = False
) -> Bench:
    options = given or Options()
    folder.mkdir(parents=True, exist_ok=True)
    colmap = Colmap(threads, options.photos.backend)
    journal = Journal(folder, log, colmap)
    return Bench(colmap, folder, journal, options, progress, journal.log, inside_masks)


def _solved(bench: Bench, said: Mapping[str, Any]) -> tuple[list[Photo], PhotoCameras]:
    """The photos that [photos] names, and their cameras. said: `path`, `photos`, `scale` and `control`."""
    photos = enough_photos_of(said["photos"], bench.log)
    said = marks_in_files(said, photos)
    require_marks_in_photos(said, photos)
    names = [photo.name for photo in photos]
    require_control_points(said, names)
    require_scale(said, names)
    bench.report("copies", 0.0, "masks of the photos")
    require_usable_masks(photos)
    known = known_lens(said["photos"]["camera"], bench.log)
    for doubt in doubts_of_lenses(photos, known):
        bench.log("warning", doubt)
    solved = solve_photos(bench, photos, known)
    relief = solved.model.relief()
    if not solved.calibrated and relief < diagnosis.FLAT_RELIEF:
        raise DataError(diagnosis.unknown_focal_on_flat_scene(relief))
    return photos, solved


def _placed_and_scaled(
    bench: Bench,
    photos: list[Photo],
    solved: PhotoCameras,
    views: Mapping[str, StationView],
    said: Mapping[str, Any],
) -> tuple[PlacedStations, SparseModel, dict[str, Any]]:
    """Place the stations among the photos, measure by windows, and scale the model to the station unit or, with control
    points, move it into their frame. said: `scale` and `control`, and the `path` of their file. Returns the placed
    stations, the model and its figures.
    """
    placed, windows = match_windows(bench, photos, solved, views, place_stations(bench, solved, views))
    registered = {name: camera for name, camera in placed.model.cameras.items() if name not in views}
    scale, datum = None, None
    said = marks_in_files(said, photos)
    try:
        if said["control"]:
            bench.report("scale", 0.0, "frame from control points")
            datum = adjust_datum(said["control"], registered, bench.options.photos.mark_sigma_px, bench.log)
        else:
            bench.report("scale", 0.0, "scale from known distances")
            scale = adjust_scale(said["scale"], photos, registered, bench.options, bench.log)
    except (InputError, DataError) as error:
        raise type(error)(f"{said['path']}: {error}") from error
    bench.journal.require_unchanged()
    factor = 1.0 if scale is None else float(scale["scale"])
    unmoved = {"scale": factor, "rotation": np.eye(3), "translation": np.zeros(3)}
    move_model(placed.folder, bench.folder / "model", datum or unmoved)
    model = SparseModel.read(bench.folder / "model")
    figures = {
        "photogrammetry": {
            "program": bench.colmap.title,
            "photos": len(photos),
            "registered": len(registered),
            "unregistered": [photo.name for photo in photos if photo.name not in registered],
            "self_calibrated": not solved.calibrated,
            "reprojection_px": model.mean_error_px,
            "points": len(model.points),
            "relief": solved.model.relief(),
            "windows": windows,
            "files": solved.hashes,
        },
        "scale": scale,
    }
    if datum is not None:
        figures["control"] = {"datum": {**datum, "rotation": datum["rotation"].tolist()}}
    bench.progress(1.0, f"{len(registered)} of {len(photos)} photos")
    return placed, model, figures


def _station_figures(placed: PlacedStations, image: str) -> dict[str, Any]:
    matches = placed.matches[image]
    return {
        "matches": sum(matches.values()),
        "photos_matched": len(matches),
        "points_seen": placed.model.images[image].observations,
    }


def known_lens(said: Mapping[str, Any] | None, log: Log) -> Camera | None:
    """The photos' calibrated lens in one of COLMAP's models."""
    if said is None:
        return None
    values, rms_px = _core.as_colmap_camera(Camera.from_description(said).values())
    if rms_px > 0.05:
        log(
            "warning",
            f"COLMAP has no lens model like that of [photos].camera; the nearest one differs by {rms_px:.2f} px",
        )
    return Camera(*values)


def _photo_of_same_camera(
    station: Mapping[str, Any], photos: list[Photo], model: SparseModel, shape: tuple[int, ...], log: Log
) -> str | None:
    """Name of a registered photo with the camera, lens and focal length of the station, by the data in the files; None if there is none."""
    first = describe_photo(Path(station["images"][0]), "station") if station["images"] else None
    if first is not None and (first.height, first.width) == shape:
        for photo in photos:
            if photo.name in model.images and photo.may_share_lens(first):
                log(
                    "warning",
                    f"the station's lens is not given ([camera] is missing); that of the photos is used, since {photo.name} "
                    "is of the same size and says nothing else. If focus or zoom differ, the surface is wrong: calibrate",
                )
                return photo.name
    log(
        "warning",
        "the station's lens is not given ([camera] is missing) and is no photo's: it is calibrated from this one image, "
        "which determines its focal length and distance badly; give [camera] model, width, height and params",
    )
    return None
