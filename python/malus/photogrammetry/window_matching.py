"""Measures the placed model again by least-squares matching and adjusts the model to these measurements."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.photogrammetry import database
from malus.photogrammetry.bench import Bench
from malus.photogrammetry.diagnosis import Log, listed, silent
from malus.photogrammetry.journal import digest
from malus.photogrammetry.model import SparseModel
from malus.photogrammetry.photo_cameras import MIN_PHOTOS_PRINCIPAL_POINT, PhotoCameras
from malus.photogrammetry.photos import Photo
from malus.photogrammetry.station_pose import GAMMA, PlacedStations, StationView, titled

#: A given lens is doubted if the images show a focal length that differs by more than this share and so many standard deviations.
_OTHER_FOCAL, _OTHER_SIGMAS = 0.01, 8.0


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
    their features; if that station is among them, the model does not change. Others name given lenses whose focal lengths are not those
    that the images show. Returns the stations in the adjusted model, and figures for quality.json; None if windows are not to be matched.
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
        preferred = next(filter(placed.has, views))

        def refined(lenses: Mapping[str, str], log: Log) -> dict[str, Any]:
            return model.refine(pictures, preferred, dict(lenses), bench.options.to_json(), bench.colmap.threads, log)

        figures = refined(quoted, bench.log)
        target = bench.folder / "matched"
        if figures["status"] == "too few matches":
            shutil.copytree(placed.folder, target)
        else:
            target.mkdir(parents=True)
            model.write(str(target))
            given = (
                [database.quoted(min(solved.model.images.keys() & placed.model.images))] if solved.calibrated else []
            )
            given += [image for image, view in views.items() if view.lens is not None and placed.has(image)]
            if given:
                bench.report("windows", 0.5, "comparing given lenses with what the images show")
                figures["given_lenses"] = _compared(model, given, lambda lenses: refined(quoted | lenses, silent))
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


def _compared(
    model: _core.ColmapModel, given: Sequence[str], refined: Callable[[dict[str, str]], dict[str, Any]]
) -> list[dict[str, Any]]:
    """Focal lengths of the given lenses, by the name of one image of each, and those that the images show. Residuals do not show a wrong
    one: all other cameras and points adapt to it, and nearly fit. The model is changed.
    """

    def focal_lengths() -> dict[str, float]:
        images = model.images()
        return {name: float(images[name][0][3][0]) for name in given}

    before = focal_lengths()
    free = refined(dict.fromkeys(given, "without_principal_point"))
    after = focal_lengths()
    sigmas = free["lens_sigma"] if free["status"] == "converged" else {}
    return [
        {
            "image": database.unquoted(name),
            "focal_px": before[name],
            "found_px": after[name],
            "sigma_px": float(sigmas[name][0]),
        }
        for name in given
        if name in sigmas
    ]


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
    for lens in figures.get("given_lenses", ()):
        off = abs(lens["found_px"] - lens["focal_px"])
        if off > max(_OTHER_FOCAL * lens["focal_px"], _OTHER_SIGMAS * lens["sigma_px"]):
            image = lens["image"]
            table = f"[camera] of {titled(image, stations)}" if image in stations else "[photos].camera"
            bench.log(
                "warning",
                f"{table} has a focal length of "
                f"{lens['focal_px']:.0f} px, but the images show one of {lens['found_px']:.0f} px (± {lens['sigma_px']:.2g} px). With a "
                "wrong one the surface is stretched: is it the calibration of this camera, at this zoom and focus, and for images of "
                "this size?",
            )
    for lens in figures["lens_sigma"]:
        if lens["image"] in stations:
            bench.log(
                "warning",
                f"the station's lens was calibrated from its one image: its focal length is known to {lens['sigma'][0]:.2g} px "
                "(one standard deviation), and its distance from the object no better",
            )
