"""Cameras of the photos alone: features, matches, mapping, a last adjustment with the principal point."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from malus import _core
from malus.camera import Camera
from malus.errors import DataError, ExternalError, InputError
from malus.photogrammetry import database, diagnosis
from malus.photogrammetry.bench import Bench
from malus.photogrammetry.diagnosis import Log, listed
from malus.photogrammetry.features import find_features
from malus.photogrammetry.journal import UNFINISHED
from malus.photogrammetry.model import SparseModel, reader_options
from malus.photogrammetry.photos import (
    Photo,
    other_images,
    photos_of,
    require_different,
    stray_masks,
    write_proxy,
)
from malus.photogrammetry.program import SearchStoppedError

#: Lens model that is calibrated from the photos.
SELF_CALIBRATED = "OPENCV"
#: Focal lengths, in longer image sides, that are assumed in turn if none is known: a usual lens, a portrait lens, a long
#: macro lens. The adjustment refines an assumption that is roughly right.
FOCAL_ASSUMPTIONS = (1.2, 2.4, 5.0)
MIN_PHOTOS = 3
_ENOUGH_SHARE = 0.8
#: Least matches that place a photo, by COLMAP's default. If photos share fewer, the least matches of a pair suffice.
_PLACING_MATCHES = 30
#: Message of COLMAP's mapper if photos match but no pair of them fixes the geometry. This is not a failure of the program.
_NO_MODEL = "failed to create sparse model"
_PHOTOS_A_SEARCH_LIMIT = 20
_UNTURNED = "save it with its pixels as the camera wrote them, whatever its EXIF orientation"
#: Least number of photos of a lens for an adjustment to separate the principal point from the poses.
MIN_PHOTOS_PRINCIPAL_POINT = 6


@dataclass(frozen=True)
class CameraGroup:
    """Photos of one camera."""

    photos: list[Photo]
    known: Camera | None
    """Calibrated lens, which is held fixed; None if it is unknown."""

    @property
    def focal_px(self) -> float | None:
        """Focal length in pixels from the EXIF data; None if unknown."""
        return self.photos[0].focal_px

    @property
    def title(self) -> str:
        """Camera, lens, their serial numbers and focal length from the EXIF data, for messages."""
        first = self.photos[0]
        focal = f"{first.focal_mm:g} mm" if first.focal_mm else f"{first.focal_px:.0f} px" if first.focal_px else ""
        return ", ".join(filter(None, (first.maker, first.serial, focal)))

    def reader(self) -> dict[str, object]:
        """Options of COLMAP's image reader."""
        if self.known is not None:
            return reader_options(self.known)
        if self.focal_px is not None:
            first = self.photos[0]
            params = f"{self.focal_px!r},{self.focal_px!r},{first.width / 2},{first.height / 2},0,0,0,0"
            return {"camera_model": SELF_CALIBRATED, "camera_params": params}
        return {"camera_model": SELF_CALIBRATED}


def group_by_camera(photos: Sequence[Photo], known: Camera | None) -> list[CameraGroup]:
    """Groups of photos that share a camera: one group if the camera is known, else groups by size and EXIF data."""
    if known is not None:
        for photo in photos:
            if (photo.width, photo.height) != (known.width, known.height):
                advice = "exclude the photo or leave the camera out"
                if (photo.height, photo.width) == (known.width, known.height):
                    advice = f"it was turned when it was saved: {_UNTURNED}, or exclude it"
                raise InputError(
                    f"{photo.path} has {photo.width} x {photo.height} pixels, but [photos].camera is for "
                    f"{known.width} x {known.height}; {advice}"
                )
        return [CameraGroup(list(photos), known)]
    groups: dict[tuple[object, ...], list[Photo]] = {}
    for photo in photos:
        groups.setdefault(photo.camera_key, []).append(photo)
    return [CameraGroup(members, None) for members in groups.values()]


def doubts_of_lenses(photos: Sequence[Photo], known: Camera | None) -> list[str]:
    """Warnings about photos of several lenses: of others than the calibrated one, or of one that too few photos share."""
    groups = group_by_camera(photos, None)
    if known is not None:
        stated = [group for group in groups if group.photos[0].maker or group.photos[0].focal_mm or group.focal_px]
        kinds = [f"{group.title} ({listed([photo.name for photo in group.photos])})" for group in stated]
        if len(kinds) < 2:
            return []
        return [
            f"[photos].camera is one lens at one zoom, but by their EXIF data the photos are of {len(kinds)}: {'; '.join(kinds)}. "
            "With a lens that is not theirs, photos bend the surface: exclude them, or leave the camera out"
        ]
    few = [photo.name for group in groups if len(group.photos) < MIN_PHOTOS for photo in group.photos]
    if len(groups) < 2 or not few:
        return []
    sizes = {(photo.width, photo.height) for photo in photos}
    turned = any(width != height and (height, width) in sizes for width, height in sizes)
    return [
        f"[photos]: by size and EXIF data the photos are of {len(groups)} cameras, lenses or zooms; {listed(few)} share theirs with too "
        f"few others to calibrate it well, expected {MIN_PHOTOS} photos or more of each"
        + (f"; photos that were turned when they were saved count as others: {_UNTURNED}" if turned else "")
    ]


@dataclass(frozen=True)
class PhotoCameras:
    """The photos' model, where its files are, and how it was found."""

    folder: Path
    """Folder of the adjusted model."""
    database: Path
    model: SparseModel
    calibrated: bool
    sparing: bool
    """Whether matches are few: they were searched for again, and fewer of them suffice to place an image."""
    hashes: dict[str, str]
    """Photo name → SHA-256 of the file that was read."""


def enough_photos_of(said: Mapping[str, Any], log: Log) -> list[Photo]:
    """The photos of a [photos] table as `Station.describe` returns it, with a warning if the folder has images of other formats.

    Raises InputError for files that cannot be used, DataError for too few photos.
    """
    photos = photos_of(said)
    others = other_images(said, photos)
    if len(photos) < MIN_PHOTOS:
        raise DataError(diagnosis.too_few_photos(len(photos), MIN_PHOTOS, others))
    require_different(photos)
    if others:
        log("warning", f"[photos]: {others} cannot be read as photos, expected PNG, TIFF or JPEG")
    if stray := stray_masks(said):
        log(
            "warning",
            f"[photos] masks: {listed(stray)}: {'is' if len(stray) == 1 else 'are'} the mask of no photo, expected a name such as "
            f"{photos[0].name}.png for {photos[0].name}",
        )
    return photos


def solve_photos(bench: Bench, photos: Sequence[Photo], known: Camera | None) -> PhotoCameras:
    """Find the cameras of the photos. `known`: their calibrated lens, in one of COLMAP's models.

    Raises DataError with advice on what to photograph if the cameras cannot be found; ExternalError if COLMAP fails.
    """
    groups = group_by_camera(photos, known)
    stage = bench.journal.stage
    hashes = bench.journal.watch({photo.name: photo.path for photo in photos})
    # Each copy by its name, not the whole folder: the stations' images are in it, too.
    copies = [f"images/{database.quoted(photo.name)}" for photo in photos]
    stage("copies", {"photos": hashes, "colmap": bench.colmap.title}, copies, lambda: _copy(bench, photos))
    options = bench.options.photos
    features = stage(
        "features",
        {
            "groups": [[group.reader(), [photo.name for photo in group.photos]] for group in groups],
            "max_features": options.max_features,
            "max_side_px": options.max_side_px,
            **_masks(bench, photos),
        },
        ["features.db"],
        lambda: _find_features(bench, groups),
    )
    diagnosis.check_features(features["counts"], bench.log, inside_masks=bench.inside_masks)
    names = [photo.name for photo in photos]
    pairs, mapping = _connect(bench, groups, names, sparing=False)
    sparing = False
    if not _is_enough(mapping, names, pairs):
        more_pairs, again = _connect(bench, groups, names, sparing=True)
        sparing = _largest(again) > _largest(mapping)
    if sparing:
        pairs, mapping = more_pairs, again
        bench.log(
            "warning",
            f"the photos share few features: {options.min_inliers} matches place a photo here instead of {_PLACING_MATCHES}, "
            "so their positions are less certain; more photos in between, or texture around the object, help",
        )
    diagnosis.check_mapping(mapping, names, pairs, bench.log, ran_out=mapping[UNFINISHED])
    stage(
        "adjustment",
        {"max_error_px": options.max_error_px},
        ["adjusted"],
        lambda: _adjust(bench, mapping["best"], known is not None),
    )
    model = SparseModel.read(bench.folder / "adjusted")
    return PhotoCameras(
        folder=bench.folder / "adjusted",
        database=bench.folder / f"{_prefix(sparing)}mapping.db",
        model=model,
        calibrated=known is not None,
        sparing=sparing,
        hashes=hashes,
    )


def _prefix(sparing: bool) -> str:
    """Prefix of the files and stages of the second attempt."""
    return "sparing_" if sparing else ""


def _largest(mapping: Mapping[str, Any]) -> int:
    """Number of photos in the best model."""
    return len(mapping["models"].get(mapping["best"], []))


def _is_enough(mapping: Mapping[str, Any], names: list[str], pairs: dict[tuple[str, str], int]) -> bool:
    """Whether one model has most photos of the largest group that matches link."""
    return bool(_largest(mapping) >= _ENOUGH_SHARE * len(database.connected_groups(names, pairs)[0]))


def _connect(
    bench: Bench, groups: Sequence[CameraGroup], names: Sequence[str], *, sparing: bool
) -> tuple[dict[tuple[str, str], int], dict[str, Any]]:
    """Verified pairs of photos with their matches, and the models that COLMAP's mapper makes of them.

    sparing: for photos that share few features. Matches are searched for again along epipolar lines, and fewer matches place a photo.
    """
    options, prefix = bench.options.photos, _prefix(sparing)
    guided = sparing or options.guided_matching
    matches = bench.journal.stage(
        f"{prefix}matches",
        {
            "guided": guided,
            "min_inliers": options.min_inliers,
            "exhaustive": len(names) <= options.exhaustive_limit,
        },
        [f"{prefix}matches.db"],
        lambda: _match(bench, names, prefix, guided),
    )
    pairs = {(first, second): count for first, second, count in matches["pairs"]}
    if not sparing:  # The first attempt checked this.
        diagnosis.check_connections(names, pairs)
    mapping = bench.journal.stage(
        f"{prefix}mapping",
        {"min_inliers": options.min_inliers, "search_limit_s": options.search_limit_s},
        [f"{prefix}sparse", f"{prefix}mapping.db"],
        lambda: _map(bench, groups, pairs, sparing=sparing),
    )
    return pairs, mapping


def _copy(bench: Bench, photos: Sequence[Photo]) -> dict[str, Any]:
    pool = ThreadPoolExecutor(bench.colmap.threads)
    try:
        written = pool.map(lambda photo: write_proxy(photo, bench.images / database.quoted(photo.name)), photos)
        for count, _ in enumerate(written, 1):
            bench.report("copies", count / len(photos), f"copy of photo {count}/{len(photos)}")
    finally:  # After a damaged photo or Ctrl-C the others are not waited for.
        pool.shutdown(cancel_futures=True)
    return {}


def _masks(bench: Bench, photos: Sequence[Photo]) -> dict[str, Any]:
    """Hashes of the masks, if features depend on them."""
    masks = {f"mask of {photo.name}": photo.mask for photo in photos if photo.mask is not None}
    return {"masks": bench.journal.watch(masks)} if bench.inside_masks else {}


def _find_features(bench: Bench, groups: Sequence[CameraGroup]) -> dict[str, Any]:
    target = bench.folder / "features.db"
    for group in groups:
        find_features(bench, "features", target, [photo.name for photo in group.photos], group.reader())
        for photo in group.photos:
            is_masked = bench.inside_masks and photo.mask is not None
            mask = _core.read_mask(str(photo.mask)) if is_masked else None
            database.keep_features(target, photo.name, bench.options.photos.max_features, mask)
    counts = database.feature_counts(target)
    return {"counts": {photo.name: counts.get(photo.name, 0) for group in groups for photo in group.photos}}


def _match(bench: Bench, names: Sequence[str], prefix: str, guided: bool) -> dict[str, Any]:
    target = bench.folder / f"{prefix}matches.db"
    database.copy(bench.folder / "features.db", target)
    bench.match("matches", target, pairs_to_match(names, bench.options.photos.exhaustive_limit), guided=guided)
    return {"pairs": [[*pair, count] for pair, count in sorted(database.verified_pairs(target).items())]}


def pairs_to_match(names: Sequence[str], exhaustive_limit: int) -> list[tuple[str, str]]:
    """All pairs of up to `exhaustive_limit` photos; of more photos, pairs at most ten apart in their order, in which the first photos follow
    the last ones, as around an object, and pairs 16, 32, 64, … apart.
    """
    count = len(names)
    if count <= exhaustive_limit:
        distances = set(range(1, count))
    else:
        near = range(1, min(11, count))
        # Those `count - d` apart are `d` apart around the ring.
        distances = {*near, *(count - d for d in near), *(2**power for power in range(4, count.bit_length()))}
    return [(names[i], names[i + d]) for d in sorted(distances) for i in range(count - d)]


def _map(
    bench: Bench, groups: Sequence[CameraGroup], pairs: dict[tuple[str, str], int], *, sparing: bool
) -> dict[str, Any]:
    """Run the mapper with the known lens, or with one assumed focal length after the other until most photos fit."""
    names = [photo.name for group in groups for photo in group.photos]
    reachable = len(database.connected_groups(names, pairs)[0])
    unknown = [group for group in groups if group.known is None and group.focal_px is None]
    tried: list[dict[str, Any]] = []
    ran_out = False
    for factor in FOCAL_ASSUMPTIONS if unknown else (None,):
        source = bench.folder / f"{_prefix(sparing)}mapping.db"
        database.copy(bench.folder / f"{_prefix(sparing)}matches.db", source)
        for group in unknown:
            first = group.photos[0]
            focal = float(factor or 1) * max(first.width, first.height)
            params = np.array([focal, focal, first.width / 2, first.height / 2, 0, 0, 0, 0])
            database.set_camera(source, database.camera_of(source, first.name), params)
        models, stopped = _run_mapper(bench, source, len(tried), groups, len(names), sparing)
        best = max(models, key=lambda name: len(models[name]), default=None)
        tried.append({"focal": factor, "models": models, "best": best})
        ran_out |= stopped and best is None
        if best is not None and len(models[best]) >= _ENOUGH_SHARE * reachable:
            ran_out = False
            break
    chosen = max(tried, key=lambda attempt: len(attempt["models"].get(attempt["best"], [])))
    chosen[UNFINISHED] = ran_out
    chosen["calibrated"] = all(group.known is not None for group in groups)
    chosen["assumed"] = len(tried) if unknown else 0
    return chosen


def placing(bench: Bench, sparing: bool) -> dict[str, object]:
    """The mapper's options for the least number of matches that place an image."""
    return {"Mapper.abs_pose_min_num_inliers": bench.options.photos.min_inliers} if sparing else {}


def _run_mapper(
    bench: Bench, source: Path, attempt: int, groups: Sequence[CameraGroup], count: int, sparing: bool
) -> tuple[dict[str, list[str]], bool]:
    """Models by folder (below the bench's folder), each with the names of its photos, and whether the time for a search ran out."""
    target = bench.folder / f"{_prefix(sparing)}sparse" / f"attempt_{attempt}"
    target.mkdir(parents=True)
    fixed = all(group.known is not None for group in groups)
    arguments: dict[str, object] = {
        "database_path": source,
        "image_path": bench.images,
        "output_path": target,
        "Mapper.num_threads": bench.colmap.threads,
        "Mapper.min_num_matches": bench.options.photos.min_inliers,
        "Mapper.min_model_size": MIN_PHOTOS,
        **placing(bench, sparing),
    }
    if fixed:
        arguments |= {
            "Mapper.ba_refine_focal_length": 0,
            "Mapper.ba_refine_extra_params": 0,
            "Mapper.init_min_tri_angle": 8,
        }
    limit_s = bench.options.photos.search_limit_s * max(1.0, count / _PHOTOS_A_SEARCH_LIMIT)
    registered, search_start = 0, time.monotonic()

    def read(line: str) -> None:
        nonlocal registered, search_start
        if "Finding good initial image pair" in line:
            if registered >= MIN_PHOTOS:  # A model is complete: the search for another one has the whole time again.
                search_start = time.monotonic()
            registered = 0
        match = re.search(r"Registering image #\d+ \((\d+)\)", line)
        if match:
            registered = int(match[1])
            bench.report("mapping", registered / count, f"position of photo {registered}/{count}")

    def keep_going() -> bool:
        return registered >= MIN_PHOTOS or time.monotonic() - search_start < limit_s

    stopped = False
    try:
        bench.colmap.run("mapper", arguments, bench.log_file("mapping"), on_line=read, keep_going=keep_going)
    except SearchStoppedError:
        stopped = True  # The models that it has found so far count.
    except ExternalError as error:
        if _NO_MODEL not in str(error):
            raise
    models = {}
    for folder in sorted(target.iterdir()):
        if (folder / "images.bin").exists():
            models[folder.relative_to(bench.folder).as_posix()] = sorted(SparseModel.read(folder).images)
    return models, stopped


def _adjust(bench: Bench, best: str, fixed: bool) -> dict[str, Any]:
    bench.report("adjustment", 0, "adjustment of all photos")
    source, target = bench.folder / best, bench.folder / "adjusted"
    # COLMAP frees the principal points of all lenses or of none.
    of_lens = Counter(image.camera_group for image in SparseModel.read(source).images.values())
    enough = min(of_lens.values()) >= MIN_PHOTOS_PRINCIPAL_POINT
    bench.adjust("adjustment", source, target, lens=not fixed, principal_point=not fixed and enough)
    return {}
