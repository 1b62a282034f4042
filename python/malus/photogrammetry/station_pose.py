"""Places stations among the photos: registers their images, with their own known lenses, to the photos' finished model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.camera import Camera
from malus.errors import DataError
from malus.photogrammetry import database, diagnosis
from malus.photogrammetry.bench import Bench
from malus.photogrammetry.features import find_features
from malus.photogrammetry.journal import digest
from malus.photogrammetry.model import SparseModel, reader_options
from malus.photogrammetry.photo_cameras import SELF_CALIBRATED, PhotoCameras, placing
from malus.photogrammetry.photos import to_bytes

#: Name of the station's image in COLMAP's database and models. No photo has it: hidden files are none.
STATION_IMAGE = ".malus_station.png"
#: The station's intensity is encoded like a photo, with the inverse of this power.
GAMMA = 2.2
#: A station that sees fewer of the model's points counts as not placed.
_LEAST_POINTS = 12


@dataclass(frozen=True)
class StationView:
    """The station's image as the front end needs it."""

    unpolarized: NDArray[np.float32]
    """H×W, linear; NaN = no value."""
    lens: Camera | None
    """Lens of the undistorted image; None = the lens is unknown, and the image is not undistorted."""
    shared_with: str | None = None
    """If the lens is unknown: name of a photo with the same camera, lens and focal length."""
    mask: NDArray[np.uint8] | None = None
    """H×W, features outside of it (zero) do not count; None = all count."""
    title: str = "the station"
    """Its name in messages, because users do not know the name of its image."""


def titled(image: str, stations: Mapping[str, StationView]) -> str:
    """How messages call an image: by its title if its name is that of a station's image, else by the photo's name."""
    return stations[image].title if image in stations else image


@dataclass(frozen=True)
class PlacedStations:
    """The photos' model with stations in it."""

    folder: Path
    model: SparseModel
    matches: dict[str, dict[str, int]]
    """Image name of the station → other image → number of verified matches."""

    def has(self, image: str) -> bool:
        """Whether the station of this image was placed and sees enough points."""
        placed = self.model.images.get(image)
        return placed is not None and placed.observations >= _LEAST_POINTS


def station_image(number: int) -> str:
    """Image name of one of several stations in COLMAP's database and models."""
    return f".malus_station_{number}.png"


def place_stations(bench: Bench, photos: PhotoCameras, stations: Mapping[str, StationView]) -> PlacedStations:
    """Register the stations' images (by image name), triangulate with them and adjust poses and points, all lenses held fixed.

    For an unknown lens the photos' lens is taken if the camera is the same, else the lens is calibrated here. Raises DataError
    if no station can be placed; `has` tells which stations were.
    """
    pixels = {image: to_bytes(view.unpolarized, gamma=GAMMA) for image, view in stations.items()}
    inputs = {
        "stations": {
            image: {
                "image": digest(pixels[image]),
                "lens": None if view.lens is None else [view.lens.model, *map(float, view.lens.params)],
                "shared_with": view.shared_with,
                **({} if view.mask is None else {"mask": digest(view.mask != 0)}),
            }
            for image, view in stations.items()
        },
        "max_features": bench.options.photos.max_features,
        "max_error_px": bench.options.photos.max_error_px,
    }
    outputs = ["station.db", "station", "placed", *(f"images/{image}" for image in stations)]
    notes = bench.journal.stage("station", inputs, outputs, lambda: _place(bench, photos, stations, pixels))
    folder = bench.folder / "placed"
    return PlacedStations(folder, SparseModel.read(folder), notes["matches"])


def _place(
    bench: Bench, photos: PhotoCameras, stations: Mapping[str, StationView], pixels: Mapping[str, NDArray[np.uint8]]
) -> dict[str, Any]:
    source = bench.folder / "station.db"
    database.copy(photos.database, source)
    bench.images.mkdir(exist_ok=True)
    bench.report("station", 0.0, "features of the station's image")
    for image, view in stations.items():
        _core.write_png(str(bench.images / image), pixels[image])
        find_features(bench, "station", source, [image], _reader(view, source))
        database.keep_features(source, image, bench.options.photos.max_features, view.mask)
    matches = _match(bench, source, photos, list(stations))
    best = max(matches.values(), key=lambda found: max(found.values(), default=0))
    of_titles = {titled(image, stations): count for image, count in best.items()}
    failure = DataError(diagnosis.station_not_registered(of_titles, bench.options.photos.min_inliers))
    if not best:
        raise failure

    work = bench.folder / "station"
    mapper, adjust_lenses = _lens_options(stations, photos.calibrated)
    registered, triangulated, placed = work / "registered", work / "triangulated", bench.folder / "placed"
    for folder in (registered, triangulated, placed):
        folder.mkdir(parents=True)
    log = bench.log_file("station")
    bench.report("station", 0.5, "position of the station")
    bench.colmap.run(
        "image_registrator",
        {"database_path": source, "input_path": photos.folder, "output_path": registered, **mapper,
         "Mapper.min_num_matches": bench.options.photos.min_inliers, **placing(bench, photos.sparing)},
        log,
    )  # fmt: skip
    if not any(image in SparseModel.read(registered).images for image in stations):
        raise failure
    bench.report("station", 0.7, "points that the station sees")
    bench.colmap.run(
        "point_triangulator",
        {"database_path": source, "image_path": bench.images, "input_path": registered, "output_path": triangulated,
         "clear_points": 0, **mapper},
        log,
    )  # fmt: skip
    bench.report("station", 0.8, "adjustment with the station")
    bench.adjust("station", triangulated, placed, lens=adjust_lenses)
    result = PlacedStations(placed, SparseModel.read(placed), matches)
    if not any(result.has(image) for image in stations):
        raise failure
    for image, view in stations.items():
        _check_lens(result.model, image, view)
    return {"matches": matches}


def _lens_options(stations: Mapping[str, StationView], calibrated: bool) -> tuple[dict[str, object], bool]:
    """Options by which a station's unknown lens is found with its pose, and whether lenses change in the adjustment of all images.

    calibrated: the photos' lens was given and must not change. COLMAP's adjustment cannot hold one lens fixed and change another: the
    station's lens is then adjusted by `match_windows` alone.
    """
    refine = any(view.lens is None and view.shared_with is None for view in stations.values())
    found: dict[str, object] = {
        "Mapper.ba_refine_focal_length": int(refine),
        "Mapper.ba_refine_extra_params": int(refine),
    }
    return found, refine and not calibrated


def _reader(station: StationView, source: Path) -> dict[str, object]:
    if station.lens is not None:
        return reader_options(station.lens)
    if station.shared_with is not None:
        return {"existing_camera_id": database.camera_of(source, station.shared_with)}
    return {"camera_model": SELF_CALIBRATED}


def _match(bench: Bench, source: Path, photos: PhotoCameras, stations: list[str]) -> dict[str, dict[str, int]]:
    """Verified matches of each station's image with the photos and with the other stations' images."""
    bench.report("station", 0.1, "matches of the station's image")
    pairs = [*product(sorted(photos.model.images), stations), *combinations(stations, 2)]
    bench.match("station", source, pairs, guided=photos.sparing or bench.options.photos.guided_matching)
    found: dict[str, dict[str, int]] = {image: {} for image in stations}
    for (first, second), count in database.verified_pairs(source).items():
        for image, other in ((first, second), (second, first)):
            if image in found:
                found[image][other] = count
    return found


def _check_lens(model: SparseModel, image: str, station: StationView) -> None:
    """DataError if the known lens of a station was changed."""
    placed = model.images.get(image)
    if placed is None or station.lens is None:
        return
    if not np.allclose(placed.camera.params, station.lens.params, rtol=1e-6):
        raise DataError(
            f"the station's lens changed from {list(station.lens.params)} to {list(placed.camera.params)} although it is "
            "known; this version of COLMAP does not hold it fixed"
        )


def lens_of_raster(lens: Camera) -> Camera:
    """The lens of a station's undistorted raster, in one of COLMAP's models, without pose."""
    return Camera("PINHOLE", lens.width, lens.height, lens.undistorted().params)


def placed_at(lens: Camera, camera: Camera) -> Camera:
    """A lens with the pose of another camera."""
    return replace(lens, rotation=camera.rotation, translation=camera.translation)
