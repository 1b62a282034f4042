"""Inputs of a station that the library cannot read itself."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from malus import _core, encoding, exif, raw, scans
from malus.station import Station


def readable(
    station: Station, core: _core.Station, folder: Path, progress: Callable[[float, str], None] = lambda _, __: None
) -> _core.Station:
    """`core`, made from the station, with the inputs that the library cannot read itself: RAW files are developed into `folder`, and clouds in scanner
    formats are read here. InputError if the images were taken with different camera settings. progress: of fraction and message.
    """
    description = station.describe()
    if "prior_cloud" in description and scans.is_scan(Path(description["prior_cloud"])):
        core = core.with_cloud(*scans.read_scan(Path(description["prior_cloud"]), description["unit"]))
    images = [Path(path) for path in description["images"]]
    tags = [raw.settings_of(path) for path in images]
    exif.require_alike(images, tags, exposures_differ=description["exposure_s"] is not None)
    doubts = encoding.doubts(images, description["response"])
    doubts += exif.exposure_doubts(images, tags, description["exposure_s"])
    doubts += encoding.mosaic_doubts(images, description["mosaic"] is not None)
    mask = description.get("mask")
    core = core.with_file_doubts(doubts, exif.mask_notes(images, None if mask is None else Path(mask)))
    if not images or not raw.is_raw(images[0]):
        return core
    developed = raw.develop(images, description["channel"], folder, progress)
    return core.with_developed([str(path) for path in developed.images], developed.full_well_e, developed.read_noise_e)


def needs_photos(station: Station, until: str | None = None) -> bool:
    """Whether a run up to the step `until` must first find camera pose and prior from photos."""
    return station.describe()["prior"] == "photos" and until not in ("polarization", "polarizer", "zenith")


@contextmanager
def folder_for(workspace: str | Path | None, name: str) -> Iterator[Path]:
    """Folder for the files that Python writes: `name` in the workspace, or a temporary folder until the context ends."""
    if workspace is not None:
        yield Path(workspace) / name
        return
    with tempfile.TemporaryDirectory(prefix="malus-") as folder:
        yield Path(folder)
