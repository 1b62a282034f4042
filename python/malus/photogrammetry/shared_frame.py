"""Cameras of several stations in one model, stored in files so that each station can run by itself."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from malus._files import read_record, sha256_of, write_record
from malus.camera import Camera
from malus.errors import ExternalError, InputError, MalusError, error_of
from malus.photogrammetry.front_end import StationCameras
from malus.photogrammetry.model import SparseModel
from malus.photogrammetry.photos import Photo


def save_cameras(file: Path, cameras: StationCameras, model: Path) -> None:
    """Store a station's cameras. model: folder of their COLMAP model, of which the file keeps the path and the hashes."""
    content = {
        "model": str(model.resolve()),
        "sha256": _digests(model),
        "station": cameras.station.description(),
        "photos": [
            {
                "name": photo.name,
                "path": str(photo.path.resolve()),
                "sha256": sha256_of(photo.path),
                "mask": None if photo.mask is None else str(photo.mask.resolve()),
                "mask_sha256": None if photo.mask is None else sha256_of(photo.mask),
                "camera": camera.description(),
            }
            for photo, camera in cameras.photos
        ],
        "silhouettes": [
            {"name": name, "path": str(mask.resolve()), "sha256": sha256_of(mask), "camera": camera.description()}
            for name, mask, camera in cameras.silhouettes
        ],
        "figures": cameras.figures,
        "times": cameras.times,
        "warnings": cameras.warnings,
    }
    write_record(file, content)


def save_failure(file: Path, error: MalusError) -> None:
    """Store why a station has no cameras."""
    write_record(file, {"failure": str(error), "exit_code": error.exit_code})


def content_of(file: Path) -> str:
    """SHA-256 of the cameras in a file, without the paths of model and photos and without the times; of an empty record without a file."""
    content = read_record(file) or {}
    said = {key: value for key, value in content.items() if key not in ("model", "times")}
    for images in ("photos", "silhouettes"):
        said[images] = [{**image, "path": "", "mask": ""} for image in content.get(images, ())]
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()


def load_cameras(file: Path) -> StationCameras:
    """The cameras that `save_cameras` stored. Raises the error that `save_failure` stored, ExternalError if nothing was stored, and
    InputError if the model or a photo has changed since: the cameras would belong to other images.
    """
    content = read_record(file)
    if content is None:
        raise ExternalError(f"{file}: the cameras of the station cannot be read; run the object again")
    if "failure" in content:
        raise error_of(content["exit_code"])(content["failure"])
    model = Path(content["model"])
    if _digests(model) != content["sha256"]:
        raise InputError(f"{model} was changed since the cameras were found; run the object again")
    photos = []
    for said in content["photos"]:
        _require_unchanged(said["path"], said["sha256"])
        if said["mask"] is not None:
            _require_unchanged(said["mask"], said["mask_sha256"])
        camera = Camera.from_description(said["camera"])
        mask = None if said["mask"] is None else Path(said["mask"])
        photos.append((Photo(said["name"], Path(said["path"]), camera.width, camera.height, mask=mask), camera))
    for said in content["silhouettes"]:
        _require_unchanged(said["path"], said["sha256"])
    return StationCameras(
        station=Camera.from_description(content["station"]),
        photos=photos,
        model=SparseModel.read(model),
        figures=content["figures"],
        times=content["times"],
        warnings=content["warnings"],
        silhouettes=[
            (said["name"], Path(said["path"]), Camera.from_description(said["camera"]))
            for said in content["silhouettes"]
        ],
    )


def _require_unchanged(path: str, digest: str) -> None:
    if sha256_of(Path(path)) != digest:
        raise InputError(f"{path} was changed since its camera was found; run the object again")


def _digests(model: Path) -> list[str]:
    return [sha256_of(path) for path in sorted(model.iterdir())]
