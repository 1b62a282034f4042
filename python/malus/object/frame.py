"""Stations found among an object's photos, in one frame."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from malus._files import new_folder, sha256_of
from malus.camera import Camera
from malus.errors import DataError, MalusError
from malus.object.definition import Object
from malus.photogrammetry import Outline, exclusive, find_object_cameras
from malus.photogrammetry.photos import photos_of, require_different, require_usable_masks
from malus.photogrammetry.shared_frame import save_cameras, save_failure
from malus.reconstruction import unpolarized_scene


@dataclass(frozen=True)
class Frame:
    """Stations found among an object's photos. cameras: folder with a file for each station. figures: for quality.json, on the photos,
    on each station and on the scale.
    """

    cameras: Path
    figures: dict[str, Any]
    warnings: list[str]


def key_of_photos(shared: Mapping[str, Any]) -> str:
    """Hash of an object's photos and their masks, and of what is said of them. Raises InputError for photos that cannot be read."""
    said = [shared["photos"]["camera"], shared["scale"], shared["control"]]
    files = [
        [photo.name, sha256_of(photo.path), None if photo.mask is None else sha256_of(photo.mask)]
        for photo in photos_of(shared["photos"])
    ]
    return hashlib.sha256(json.dumps([said, files]).encode()).hexdigest()


def find_frame(thing: Object, output: Path, threads: int, say: Callable[[str, float, str], None]) -> Frame:
    """Find all stations among the object's photos, and write each station's cameras for its own run.

    For a station that fails or cannot be placed, the error is written instead, and the station's own run ends with this error. Stages
    whose inputs did not change are not repeated. An error that ends the search has the warnings before it as notes.
    """
    assert thing.shared is not None
    # Now, as the stations' polarization takes minutes.
    photos = photos_of(thing.shared["photos"])
    require_different(photos)
    require_usable_masks(photos)
    folder, options = output / "photogrammetry", thing.campaign.options
    kept = folder / "stations"
    warnings = thing.unmasked()
    tasks = thing.campaign.tasks(output, threads, kept)
    with exclusive(folder, wait=True):
        kept.mkdir(exist_ok=True)
        views = {}
        outlines = {}
        for count, task in enumerate(tasks):
            say("photos", 0.3 * count / len(tasks), f"polarization of {task.identifier}")
            station, begun = task.load(), folder / "polarization" / task.identifier
            try:
                scene, mask = unpolarized_scene(station, options, begun, threads)
                said = station.describe()
                views[task.identifier] = (Camera.from_description(said["camera"]), scene)
                if said["mask"] is not None:
                    outlines[task.identifier] = Outline(mask, Path(said["mask"]))
                _begin(task.workspace, begun)
            except MalusError as error:
                save_failure(Path(task.cameras), error)
        if not views:
            return Frame(kept, {}, warnings)
        try:
            found = find_object_cameras(
                thing.shared, views, folder, outlines=outlines if thing.turntable else None, options=options, threads=threads,
                log=lambda level, text: warnings.append(text) if level == "warning" else None,
                progress=lambda share, message: say("photos", 0.3 + 0.7 * share, message),
            )  # fmt: skip
        except MalusError as error:
            with_warnings(error, warnings)
            raise
        for task in tasks:
            if task.identifier in found:
                cameras = replace(found[task.identifier], warnings=list(warnings))
                save_cameras(Path(task.cameras), cameras, folder / "model")
            elif task.identifier in views:
                save_failure(
                    Path(task.cameras),
                    DataError(
                        f"{task.identifier} could not be placed among the photos of the object; take a few photos near its direction, "
                        "and check that [camera] is the polarized images' own calibration"
                    ),
                )
    if not found:
        return Frame(kept, {}, warnings)
    figures = {name: cameras.figures["photogrammetry"]["station"] for name, cameras in found.items()}
    whole = next(iter(found.values())).figures
    return Frame(
        kept,
        {
            **whole["photogrammetry"],
            "station": figures,
            **{name: whole[name] for name in ("scale", "control") if name in whole},
        },
        warnings,
    )


def with_warnings(error: MalusError, warnings: Sequence[str]) -> MalusError:
    """The error with the warnings before it as notes: they often say why, and no report will show them."""
    for warning in warnings:
        error.add_note(f"warning before it: {warning}")
    return error


def _begin(workspace: Path, begun: Path) -> None:
    """Start a station's workspace with the polarization step that was computed for finding the station."""
    if not workspace.exists():
        with new_folder(workspace) as new:
            shutil.copytree(begun, new, ignore=shutil.ignore_patterns(".lock"), dirs_exist_ok=True)
