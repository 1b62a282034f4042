"""Measures the placed model again by least-squares matching and adjusts the model to these measurements."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.photogrammetry import database
from malus.photogrammetry.bench import Bench
from malus.photogrammetry.diagnosis import listed
from malus.photogrammetry.journal import digest
from malus.photogrammetry.model import SparseModel
from malus.photogrammetry.photo_cameras import MIN_PHOTOS_PRINCIPAL_POINT, PhotoCameras
from malus.photogrammetry.photos import Photo
from malus.photogrammetry.station_pose import GAMMA, PlacedStations, StationView, titled


def match_windows(
    bench: Bench,
    photos: Sequence[Photo],
    solved: PhotoCameras,
    stations: Mapping[str, StationView],
    placed: PlacedStations,
) -> tuple[PlacedStations, dict[str, Any] | None]:
    """Locate the model's points in all images to hundredths of a pixel and adjust lenses, poses and points to them.

    Lenses of stations (by image name) are held fixed if they are known, and the photos' lens if it was given. For points that the
    first placed station sees, the windows are taken from its image. A warning names images with few matches, which follow the others by
    their features; if that station is among them, the model does not change. Returns the stations in the adjusted model, and figures for quality.json; None if windows are not to be matched.
    """
    options = bench.options.photos
    if not options.match_windows:
        return placed, None
    views = {image: view for image, view in stations.items() if image in placed.model.images}
    freedom = _freedom(solved, views, placed.model)
    inputs = {
        "images": {image: digest(view.unpolarized) for image, view in views.items()},
        "freedom": freedom,
        "options": [options.match_points_a_photo, options.match_radius, options.match_range_px,
                    options.match_min_correlation, options.match_floor_px],
    }  # fmt: skip

    def run() -> dict[str, Any]:
        bench.report("windows", 0.0, "matching windows of all photos")
        pictures: dict[str, str | NDArray[np.float32]] = {
            database.quoted(photo.name): str(photo.path) for photo in photos if photo.name in placed.model.images
        }
        pictures |= {image: coded(view.unpolarized) for image, view in views.items()}
        model = _core.ColmapModel.read(str(placed.folder))
        quoted = {database.quoted(name): what for name, what in freedom.items()}
        figures = model.refine(
            pictures, next(filter(placed.has, views)), quoted, bench.options.to_json(), bench.colmap.threads, bench.log
        )
        target = bench.folder / "matched"
        if figures["status"] == "too few matches":
            shutil.copytree(placed.folder, target)
        else:
            target.mkdir(parents=True)
            model.write(str(target))
        figures["lens_sigma"] = [
            {"image": database.unquoted(name), "sigma": sigma} for name, sigma in figures["lens_sigma"].items()
        ]
        figures["with_few_matches"] = [database.unquoted(name) for name in figures["with_few_matches"]]
        return {"figures": figures}

    notes = bench.journal.stage("windows", inputs, ["matched"], run)
    figures: dict[str, Any] = notes["figures"]
    _warn(bench, figures, views)
    folder = bench.folder / "matched"
    return replace(placed, folder=folder, model=SparseModel.read(folder)), figures


def coded(unpolarized: NDArray[np.float32]) -> NDArray[np.float32]:
    """The station's linear intensity with the encoding of photos; 0 where there is no intensity."""
    return np.power(np.clip(np.nan_to_num(unpolarized), 0, 1), 1 / GAMMA, dtype=np.float32)


def _freedom(solved: PhotoCameras, stations: Mapping[str, StationView], model: SparseModel) -> dict[str, str]:
    """Which parameters of a lens may change, by the name of one image of each lens that is not fixed."""
    free: dict[str, str] = {}
    if not solved.calibrated:
        photos: dict[tuple[object, ...], list[str]] = {}
        for name in sorted(solved.model.images):
            if name in model.images:
                photos.setdefault(model.images[name].camera_group, []).append(name)
        for names in photos.values():
            enough = len(names) >= MIN_PHOTOS_PRINCIPAL_POINT
            free[names[-1]] = "all" if enough else "without_principal_point"
    for image, station in stations.items():
        if station.lens is None and station.shared_with is None:
            free[image] = "without_principal_point"
    return free


def _warn(bench: Bench, figures: dict[str, Any], stations: Mapping[str, StationView]) -> None:
    if figures["status"] == "too few matches":
        bench.log(
            "warning",
            "least-squares matching found too few windows in the station's image, or in all images but one; the cameras are as COLMAP "
            "left them, and the station may be turned about the object by some hundredths of a degree",
        )
    elif figures["status"] != "converged":
        bench.log(
            "warning",
            "the cameras' places were still changing when their adjustment to the matched windows ended: the station may be turned "
            "about the object by some hundredths of a degree",
        )
    if figures["status"] != "too few matches" and figures["with_few_matches"]:
        few = [titled(image, stations) for image in figures["with_few_matches"]]
        bench.log(
            "warning",
            f"least-squares matching found too few windows in {listed(few)}: placed by features alone, so that "
            "they may be turned about the object by some hundredths of a degree",
        )
    for lens in figures["lens_sigma"]:
        if lens["image"] in stations:
            bench.log(
                "warning",
                f"the station's lens was calibrated from its one image: its focal length is known to {lens['sigma'][0]:.2g} px "
                "(one standard deviation), and its distance from the object no better",
            )
