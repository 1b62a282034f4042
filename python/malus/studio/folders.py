"""What lies in a folder: images with the moment they were taken, station files, results, and the angles of its images."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from malus import _core, exif, station_import
from malus.errors import InputError
from malus.raw import is_raw
from malus.scans import is_scan
from malus.studio.access import Root

_IMAGES = frozenset({".png", ".tif", ".tiff", ".jpg", ".jpeg"})
#: Folders and files that are looked through for clouds and models, at most.
_SEARCHED = 5000
_SEARCH_DEPTH = 4


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in _IMAGES or is_raw(path)


def _natural(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part.lower()) for part in re.split(r"(\d+)", path.name)]


def _is_station(path: Path) -> bool:
    try:
        return path.suffix == ".toml" and "[polarized]" in path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False


def listing(root: Root, name: str) -> dict[str, Any]:
    """A folder for the page: its folders, images, station files and tables, in natural order."""
    folder = root.directory(name)
    entries = sorted((path for path in folder.iterdir() if not path.name.startswith(".")), key=_natural)
    inside = [path for path in entries if path.resolve().is_relative_to(root.folder)]
    folders = [path for path in inside if path.is_dir()]
    files = [path for path in inside if path.is_file()]
    return {
        "path": root.name(folder),
        "name": folder.name,
        "home": (folder if folder == root.folder else folder.parent).name,
        "parent": None if folder == root.folder else root.name(folder.parent),
        "folders": [
            {
                "path": root.name(path),
                "name": path.name,
                "is_work": (path / "manifest.json").is_file(),
                "images": _count(path),
            }
            for path in folders
        ],
        "images": [
            {"path": root.name(path), "name": path.name, "taken": exif.taken(path)} for path in files if _is_image(path)
        ],
        "stations": [root.name(path) for path in files if _is_station(path)],
        "tables": [root.name(path) for path in files if path.suffix.lower() == ".csv"],
    }


def _count(folder: Path) -> int:
    try:
        return sum(_is_image(path) for path in folder.iterdir())
    except OSError:
        return 0


def angles(root: Root, folder: str, source: str, names: Sequence[str], first: float, step: float) -> list[dict[str, Any]]:  # fmt: skip
    """Image and angle [deg] of each of `names`, by `source`: "names" (or the folder's table or sidecars, as `malus import`
    reads them), "table:PATH", or "taken": from `first` in steps, in the order in which the camera took them.

    Raises InputError if the source does not say them.
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
    if source.startswith("table:"):
        shots = station_import.shots_of(directory, None, root.file(source.removeprefix("table:")), None, None)
    elif set(images) == set(station_import.images_of(directory, station_import.mask_of(directory))):
        shots = station_import.shots_of(directory, station_import.mask_of(directory), None, None, None)
    else:
        found = _core.angles_of_names(images, str(directory), "expected them typed into the table")
        shots = [station_import.Shot(path, angle) for path, angle in zip(images, found, strict=True)]
    return [{"image": root.name(shot.image), "angle": shot.angle_deg, "exposure": shot.exposure_s} for shot in shots]


def candidates(root: Root) -> dict[str, list[str]]:
    """Files and folders that the station file may name: clouds, models of COLMAP, folders of images, masks."""
    clouds, models, images = [], [], []
    seen = 0
    for place, folders, files in os.walk(root.folder):
        here = Path(place)
        depth = len(here.relative_to(root.folder).parts)
        # What a run has left is no input.
        folders[:] = sorted(f for f in folders if not f.startswith(".")) if depth < _SEARCH_DEPTH and "manifest.json" not in files else []  # fmt: skip
        if "manifest.json" in files:
            continue
        seen += len(files)
        if seen > _SEARCHED:
            break
        names = set(files)
        if names & {"cameras.txt", "cameras.bin"} and names & {"images.txt", "images.bin"}:
            models.append(root.name(here))
        clouds += [root.name(here / f) for f in sorted(files) if Path(f).suffix.lower() in (".ply", ".xyz") or is_scan(Path(f))]  # fmt: skip
        if any(_is_image(Path(f)) for f in files):
            images.append(root.name(here))
    return {"clouds": clouds, "models": models, "images": images}


def images_of_model(path: Path) -> list[str]:
    """Names of the images of a COLMAP model."""
    return sorted(_core.ColmapModel.read(str(path)).images())
