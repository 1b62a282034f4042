"""The station among the photos: its image is registered to their finished model with its own, known lens."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.camera import Camera
from malus.errors import DataError
from malus.photogrammetry import database, diagnosis
from malus.photogrammetry.bench import Bench
from malus.photogrammetry.model import SparseModel, colmap_params
from malus.photogrammetry.photo_cameras import SELF_CALIBRATED, PhotoCameras
from malus.photogrammetry.photos import to_bytes

#: Name of the station's image in COLMAP's database and models.
STATION_IMAGE = "malus_station.png"
#: The station's intensity is coded like a photo's, by this power.
GAMMA = 2.2


@dataclass(frozen=True)
class StationView:
    """The station's image as the front end needs it."""

    unpolarized: NDArray[np.float32]
    """H×W, linear; NaN = none."""
    lens: Camera | None
    """Its lens without distortion if it is known, else None: the image is as taken."""
    shared_with: str | None = None
    """With an unknown lens: a photo of the same camera, lens and focal length."""


@dataclass(frozen=True)
class PlacedStation:
    """The photos' model with the station in it."""

    folder: Path
    model: SparseModel
    camera: Camera
    """Lens and pose of the station's image."""
    matches: dict[str, int]
    """Verified matches with each photo."""


def place_station(bench: Bench, photos: PhotoCameras, station: StationView) -> PlacedStation:
    """Register the station's image, triangulate with it and adjust poses and points, all lenses held fixed.

    A lens that is not known is that of the photos if the camera is the same, else it is calibrated here. Raises DataError
    when the station finds no position.
    """
    pixels = to_bytes(station.unpolarized, gamma=GAMMA)
    inputs = {
        "image": hashlib.sha256(pixels.tobytes()).hexdigest(),
        "lens": None if station.lens is None else [station.lens.model, *map(float, station.lens.params)],
        "shared_with": station.shared_with,
        "max_features": bench.options.photos.max_features,
        "max_error_px": bench.options.photos.max_error_px,
    }
    notes = bench.journal.stage(
        "station", inputs, ["station.db", "station", "placed"], lambda: _place(bench, photos, station, pixels)
    )
    folder = bench.folder / "placed"
    model = SparseModel.read(folder)
    return PlacedStation(folder, model, model.images[STATION_IMAGE].camera, notes["matches"])


def _place(bench: Bench, photos: PhotoCameras, station: StationView, pixels: NDArray[np.uint8]) -> dict[str, Any]:
    source = bench.folder / "station.db"
    database.copy(photos.database, source)
    bench.images.mkdir(exist_ok=True)
    _core.write_png(str(bench.images / STATION_IMAGE), pixels)
    bench.report("station", 0.0, "features of the station's image")
    bench.extract_features("station", source, [STATION_IMAGE], _reader(station, source, pixels.shape))
    matches = _match(bench, source, sorted(photos.model.images))
    least = bench.options.photos.min_inliers
    failure = DataError(diagnosis.station_not_registered(matches, least))
    if not matches:
        raise failure

    work = bench.folder / "station"
    refine = int(station.lens is None and station.shared_with is None)
    mapper = {"Mapper.ba_refine_focal_length": refine, "Mapper.ba_refine_extra_params": refine}
    registered, triangulated, placed = work / "registered", work / "triangulated", bench.folder / "placed"
    for folder in (registered, triangulated, placed):
        folder.mkdir(parents=True)
    log = bench.log_file("station")
    bench.report("station", 0.5, "position of the station")
    bench.colmap.run(
        "image_registrator",
        {"database_path": source, "input_path": photos.folder, "output_path": registered, **mapper,
         "Mapper.min_num_matches": least},
        log,
    )  # fmt: skip
    if STATION_IMAGE not in SparseModel.read(registered).images:
        raise failure
    bench.report("station", 0.7, "points that the station sees")
    bench.colmap.run(
        "point_triangulator",
        {"database_path": source, "image_path": bench.images, "input_path": registered, "output_path": triangulated,
         "clear_points": 0, **mapper},
        log,
    )  # fmt: skip
    bench.report("station", 0.8, "adjustment with the station")
    bench.adjust(
        "station",
        triangulated,
        placed,
        {
            "BundleAdjustment.refine_focal_length": refine,
            "BundleAdjustment.refine_extra_params": refine,
            "BundleAdjustment.refine_principal_point": 0,
        },
    )
    _check(SparseModel.read(placed), station, failure)
    return {"matches": matches}


def _reader(station: StationView, source: Path, shape: tuple[int, ...]) -> dict[str, object]:
    if station.lens is not None:
        params = ",".join(repr(float(p)) for p in colmap_params(station.lens))
        return {"camera_model": station.lens.model, "camera_params": params}
    if station.shared_with is not None:
        return {"existing_camera_id": database.camera_of(source, station.shared_with)}
    return {"camera_model": SELF_CALIBRATED}


def _match(bench: Bench, source: Path, names: list[str]) -> dict[str, int]:
    bench.report("station", 0.1, "matches of the station's image")
    bench.match("station", source, [(name, STATION_IMAGE) for name in names])
    found: dict[str, int] = {}
    for pair, count in database.verified_pairs(source).items():
        if STATION_IMAGE in pair:
            found[pair[0] if pair[1] == STATION_IMAGE else pair[1]] = count
    return found


def _check(model: SparseModel, station: StationView, failure: DataError) -> None:
    """A registered station must see points and must have kept its lens."""
    placed = model.images.get(STATION_IMAGE)
    if placed is None or placed.observations < 12:
        raise failure
    if station.lens is not None and not np.allclose(placed.camera.params, station.lens.params, rtol=1e-6):
        raise DataError(
            f"the station's lens changed from {list(station.lens.params)} to {list(placed.camera.params)} although it is "
            "known; this version of COLMAP does not hold it fixed"
        )


def lens_of_raster(lens: Camera | None) -> Camera | None:
    """The lens of a station's undistorted raster, in one of COLMAP's models, without pose."""
    if lens is None:
        return None
    return Camera("PINHOLE", lens.width, lens.height, lens.undistorted().params)
