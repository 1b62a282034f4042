"""Tells what the front end would do with a station, without doing it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from malus import _core
from malus.exif import mask_notes
from malus.options import Options
from malus.photogrammetry import diagnosis
from malus.photogrammetry.control import require_control_points
from malus.photogrammetry.cost import Expected, Work, photos_cost, sweep_cost
from malus.photogrammetry.front_end import known_lens
from malus.photogrammetry.marks import marks_in_files, require_marks_in_photos
from malus.photogrammetry.photo_cameras import doubts_of_lenses, enough_photos_of, group_by_camera, pairs_to_match
from malus.photogrammetry.photos import require_usable_masks
from malus.photogrammetry.program import Colmap
from malus.photogrammetry.scale import require_scale
from malus.threads import ALL_CORES


@dataclass(frozen=True)
class Plan:
    """What would be done: lines about the photos and their scale, the line about a station's sweep, warnings, and the expected cost of
    finding the cameras and of the sweeps of one station.
    """

    photos: list[str]
    sweep: str
    warnings: list[str]
    finding: Expected
    sweeping: Expected


def _scale_line(station: Mapping[str, Any]) -> str:
    marked = [point for point in station["control"] if len(point["marks"]) > 1]
    used = marked if station["control"] else station["scale"]
    held_out = sum(entry["check"] for entry in used)
    count = len(used) - held_out
    besides = (
        f"; {held_out} more {'check' if held_out > 1 else 'checks'} {'it' if count == 1 else 'them'}"
        if held_out
        else ""
    )
    if station["control"]:
        return f"scale: frame and size from {count} control points that are marked in the photos{besides}"
    distances = f"{count} known distance{'s' * (count != 1)}"
    return f"scale: {distances}{besides}" if station["scale"] else "scale: none, arbitrary unit"


def plan(
    station: Mapping[str, Any],
    station_mpx: float,
    *,
    options: Options | None = None,
    threads: int = ALL_CORES,
    silhouettes: int = 0,
    read_masks: bool = True,
) -> Plan:
    """What would be done for a station, as `Station.describe` returns it, with an image of `station_mpx` megapixels.

    silhouettes: outlines of the object beside those that masks of photos give, as of other stations on a turntable.
    read_masks: whether to read the masks of photos for what is wrong with them, which can take half a second for each.

    Raises the errors that a run would raise before it starts: InputError for unreadable or wrong photos, DataError for too few,
    ExternalError when COLMAP is missing.
    """
    options = options or Options()
    said = station["photos"]
    warnings: list[str] = []
    photos = enough_photos_of(said, lambda _, message: warnings.append(message))
    masks = sum(photo.mask is not None for photo in photos)
    if 0 < masks and masks + silhouettes < _core.least_silhouettes:
        warnings.append(
            f"[photos] masks: {masks} of {len(photos)} photos have a mask; a visual hull is made of at least "
            f"{_core.least_silhouettes}, from many sides"
        )
    turned = [photo.name for photo in photos if mask_notes([photo.path], photo.mask)]
    if turned:
        warnings.append(
            f"[photos] masks: viewers turn {diagnosis.listed(turned)} by EXIF data, but not the masks; all are taken as their pixels are "
            "stored: were the masks drawn on the turned pictures?"
        )
    station = marks_in_files(station, photos)
    require_marks_in_photos(station, photos)
    names = [photo.name for photo in photos]
    require_control_points(station, names)
    require_scale(station, names)
    if read_masks:
        require_usable_masks(photos)
    program = Colmap(threads, options.photos.backend)
    known = known_lens(said.get("camera"), lambda _, message: warnings.append(message))
    groups = group_by_camera(photos, known)
    warnings += doubts_of_lenses(photos, known)
    pairs = pairs_to_match(names, options.photos.exhaustive_limit)
    lens = "calibrated lens" if known is not None else f"{len(groups)} self-calibrated lens{'es' * (len(groups) > 1)}"
    does = [
        f"photos: {len(photos)} with {lens}, {f'{masks} masks, ' if masks else ''}{len(pairs)} pairs to match, {program.title}",
        _scale_line(station),
    ]
    if known is None and any(group.focal_px is None for group in groups):
        warnings.append(
            "[photos]: neither `camera` nor an EXIF focal length states their lens: if the scene is flat or the lens is long, the "
            "photos cannot be placed; give the calibrated lens as camera = { model, width, height, params }"
        )
    if not station["scale"] and not station["control"]:
        warnings.append(diagnosis.NO_SIZE)
    if "camera" not in station:
        warnings.append(
            "[camera] is missing: the station's lens is taken from the photos if it is theirs, else calibrated from one image, which "
            "determines its distance badly; give model, width, height and params"
        )
    work = Work([(photo.width, photo.height) for photo in photos], len(pairs), station_mpx, options, threads)
    again = ", then again about the surface fused with it" if options.sweep.again else ""
    sweep = f"sweep: depth of the station's view from the photos{again}"
    return Plan(does, sweep, warnings, photos_cost(work), sweep_cost(work))
