"""Cameras of several stations in one model, kept in files so that each station runs by itself, wherever that is."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from malus._files import read_record, write_record
from malus.camera import Camera
from malus.errors import ExternalError, MalusError, error_of
from malus.photogrammetry.front_end import StationCameras
from malus.photogrammetry.model import SparseModel
from malus.photogrammetry.photos import Photo


def save_cameras(file: Path, cameras: StationCameras, model: Path) -> None:
    """Keep a station's cameras; `model` is the folder of their COLMAP model, which the file refers to by its content too."""
    digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(model.iterdir())]
    content = {
        "model": str(model.resolve()),
        "sha256": digests,
        "station": _described(cameras.station),
        "photos": [
            {"name": photo.name, "path": str(photo.path.resolve()), "camera": _described(camera)}
            for photo, camera in cameras.photos
        ],
        "figures": cameras.figures,
        "times": cameras.times,
    }
    write_record(file, content)


def save_failure(file: Path, error: MalusError) -> None:
    """Keep why a station has no cameras."""
    write_record(file, {"failure": str(error), "exit_code": error.exit_code})


def load_cameras(file: Path) -> StationCameras:
    """What `save_cameras` kept. Raises the error that `save_failure` kept, ExternalError if there is neither."""
    content = read_record(file)
    if content is None:
        raise ExternalError(f"{file}: the cameras of the station cannot be read; run the object again")
    if "failure" in content:
        raise error_of(content["exit_code"])(content["failure"])
    photos = []
    for said in content["photos"]:
        camera = Camera(**said["camera"])
        photos.append((Photo(said["name"], Path(said["path"]), camera.width, camera.height), camera))
    return StationCameras(
        station=Camera(**content["station"]),
        photos=photos,
        model=SparseModel.read(Path(content["model"])),
        figures=content["figures"],
        times=content["times"],
    )


def _described(camera: Camera) -> dict[str, Any]:
    model, width, height, params, rotation, translation = camera.values()
    return {
        "model": model, "width": width, "height": height, "params": params,
        "rotation": rotation.tolist(), "translation": translation.tolist(),
    }  # fmt: skip
