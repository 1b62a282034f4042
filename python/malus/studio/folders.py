"""The content of a folder: images with the time they were taken, station files, results, and the angles of the images."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from PIL.ExifTags import Base

from malus import _core, exif, station_import
from malus._files import as_text, is_utf8, natural, open_regular, read_regular, resolved
from malus.errors import InputError
from malus.photogrammetry.photos import photo_files
from malus.raw import is_image, is_raw
from malus.scans import is_scan
from malus.studio.access import Root
from malus.workspace import is_result

#: Most folders and files that are searched for stations, results, clouds and models, and most levels of folders.
_SEARCHED = 20_000
_SEARCH_DEPTH = 8
#: What the page suggests if the angles cannot be found.
_INSTEAD = "another source above, or the angles typed into the table"
#: The TIFF tag SampleFormat of floating-point pixels.
_FLOATING = 3
#: Bytes that are searched for the end of a PLY file's header.
_PLY_HEADER = 8192


def _natural(path: Path) -> list[tuple[int, str]]:
    return natural(path.name)


def _is_station(path: Path) -> bool:
    try:
        return path.suffix == ".toml" and b"[polarized]" in read_regular(path)
    except OSError:
        return False


def listing(root: Root, name: str) -> dict[str, Any]:
    """A folder for the page: its folders, images and station files, in natural order."""
    folder = root.directory(name)
    entries = sorted((path for path in folder.iterdir() if not path.name.startswith(".")), key=_natural)
    inside = [path for path in entries if root.holds(path)]
    mask = station_import.mask_of(folder)
    # os.path returns False for entries without permission, where pathlib raises.
    folders = [path for path in inside if os.path.isdir(path)]
    files = [path for path in inside if os.path.isfile(path)]
    return {
        "path": root.name(folder),
        "name": folder.name,
        "opened": root.folder.name,
        "home": (folder if folder == root.folder else folder.parent).name,
        "parent": None if folder == root.folder else root.name(folder.parent),
        "folders": [
            {
                "path": root.name(path),
                "name": path.name,
                "is_work": is_result(path),
                "images": _count(path),
            }
            for path in folders
        ],
        "images": [
            {"path": root.name(path), "name": path.name, "taken": exif.taken(path), "raw": is_raw(path)}
            for path in files
            if is_image(path)
        ],
        "mask": root.name(mask) if mask is not None and mask in files else None,
        "stations": [root.name(path) for path in files if _is_station(path)],
        "hidden": [as_text(path.name) for path in entries if not is_utf8(path.name)],
    }


def _count(folder: Path) -> int:
    try:
        return sum(is_image(path) for path in folder.iterdir())
    except OSError:
        return 0


def angles(root: Root, folder: str, source: str, names: Sequence[str], first: float, step: float) -> list[dict[str, Any]]:  # fmt: skip
    """Image and angle [deg] of each of `names`, by `source`: "names" (or the folder's table or sidecars, as `malus import`
    reads them), or "taken": from `first` in steps of `step`, in the order in which the camera took the images.

    Raises InputError if the source does not give the angles.
    """
    images = [root.file(name) for name in names]
    if source == "taken":
        moments = [exif.taken(path) for path in images]
        missing = [path.name for path, moment in zip(images, moments, strict=True) if moment is None]
        if missing:
            raise InputError(f"{', '.join(missing)}: do not say when they were taken, expected EXIF dates")
        order = sorted(range(len(images)), key=lambda index: (str(moments[index]), _natural(images[index])))
        return [{"image": root.name(images[index]), "angle": first + step * place} for place, index in enumerate(order)]
    directory = root.directory(folder)
    mask = station_import.mask_of(directory)
    if set(images) == set(station_import.images_of(directory, mask)):
        shots = station_import.shots_of(directory, mask, None, None, None, _INSTEAD)
    else:
        found = _core.angles_of_names(images, directory.name, f"expected {_INSTEAD}")
        shots = [station_import.Shot(path, angle) for path, angle in zip(images, found, strict=True)]
    return [{"image": root.name(shot.image), "angle": shot.angle_deg, "exposure": shot.exposure_s} for shot in shots]


def below(root: Root) -> tuple[list[tuple[Path, list[str]]], bool]:
    """The opened folder and all folders below it, each with its files, without folders inside results; and whether these are all, since
    at most _SEARCHED folders and files are searched.
    """
    found: list[tuple[Path, list[str]]] = []
    seen = 0
    for place, folders, files in os.walk(root.folder):
        here = Path(place)
        # The tiles of an image for the web (IIIF, info.json) are no images of the object.
        inner = "info.json" in files or ("manifest.json" in files and is_result(here))
        deeper = len(here.relative_to(root.folder).parts) < _SEARCH_DEPTH and not inner
        folders[:] = sorted(f for f in folders if not f.startswith(".")) if deeper else []
        seen += 1 + len(files)
        if seen > _SEARCHED:
            return found, False
        if root.holds(here):
            found.append((here, files))
    return found, True


def candidates(root: Root) -> dict[str, Any]:
    """Files that a station file may name, and existing stations: `priors` as {kind, path}, where the kinds are the keys of [prior];
    `models` of COLMAP, folders of `images`, and `stations`, as paths; `note` says if not all folders were searched, else it is None.
    """
    priors: list[dict[str, str]] = []
    models, images, stations = [], [], []
    searched, complete = below(root)
    for here, files in searched:
        if "manifest.json" in files and is_result(here):  # Results are no inputs.
            continue
        names = set(files)
        if names & {"cameras.txt", "cameras.bin"} and names & {"images.txt", "images.bin"}:
            models.append(root.name(here))
        inside = [here / f for f in sorted(files, key=natural) if root.holds(here / f)]
        priors += [{"kind": kind, "path": root.name(path)} for path in inside if (kind := _kind_of_prior(path))]
        stations += [root.name(path) for path in inside if _is_station(path)]
        if any(is_image(path) for path in inside):
            images.append(root.name(here))
    note = (
        f"The folder {root.folder.name} holds more than {_SEARCHED} files: not all stations, models and surfaces below it are listed. "
        "Start Studio in a folder inside."
    )
    return {
        "priors": priors,
        "models": models,
        "images": images,
        "stations": stations,
        "note": None if complete else note,
    }


def _kind_of_prior(path: Path) -> str | None:
    """The key of [prior] for a file: cloud, mesh, depth; None if the file is no surface."""
    kind = path.suffix.lower()
    if kind in (".tif", ".tiff"):
        tags = exif.tags_of(path)
        is_floating = exif.number_of(tags.get(Base.SampleFormat)) == _FLOATING
        return "depth" if is_floating and tags.get(Base.SamplesPerPixel, 1) == 1 else None
    if kind == ".ply":
        try:
            with open_regular(path) as file:
                header = file.read(_PLY_HEADER).partition(b"end_header")[0]
        except OSError:
            return None
        return "mesh" if re.search(rb"element face [1-9]", header) else "cloud"
    return "cloud" if kind == ".xyz" or is_scan(path) else None


def images_of_model(path: Path) -> list[str]:
    """Names of the images of a COLMAP model."""
    return sorted(_core.ColmapModel.read(str(path)).images())


def polarized_images(root: Root, station: Path, values: Mapping[str, Any]) -> list[str]:
    """The existing images that a station file names, one by one or as a folder, even if the file has other errors."""
    polarized = values.get("polarized")
    said = polarized.get("images") if isinstance(polarized, Mapping) else None
    if isinstance(said, str):
        place = station.parent / said
        paths = sorted((path for path in place.iterdir() if is_image(path)), key=_natural) if place.is_dir() else []
    else:
        paths = [
            station.parent / name
            for name in (said if isinstance(said, list) else [])
            if isinstance(name, str) and (station.parent / name).is_file()
        ]
    return [root.name(path) for path in paths if root.holds(path)]


def photos_of(root: Root, station: Path, values: Mapping[str, Any]) -> list[dict[str, str]]:
    """The photos in which a station's known distances and control points are marked, each as `path` and as the `image` that marks
    name: the photos of [photos], else those of its COLMAP model, from the folder that has most of the model's photos.
    """
    photos = values.get("photos", {})
    folder = photos.get("folder")
    if isinstance(folder, str):
        masks = photos.get("masks")
        place = resolved(station.parent / masks) if isinstance(masks, str) else None
        files = photo_files(root.directory(str(station.parent / folder)), photos.get("exclude", []), place)
        return [{"path": root.name(path), "image": name} for name, path in files.items() if root.holds(path)]
    camera = values.get("camera", {})
    if "colmap_model" not in camera:
        return []
    # The model's image of the station is left out: the polarized images need not have its content.
    names = set(images_of_model(root.directory(str(station.parent / camera["colmap_model"])))) - {camera.get("image")}
    found = {here: sorted(name for name in names if (root.path(here) / name).is_file()) for here in candidates(root)["images"]}  # fmt: skip
    best = max(found, key=lambda here: len(found[here]), default=None)
    named = [] if best is None else sorted(found[best], key=natural)
    return [{"path": root.name(root.path(str(best)) / name), "image": name} for name in named]
