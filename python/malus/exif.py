"""The camera settings that image files state, and whether they are equal for all images of a station."""

from __future__ import annotations

import math
import threading
import warnings
from collections.abc import Mapping, Sequence
from io import BufferedReader
from pathlib import Path
from typing import Any

from PIL.ExifTags import IFD, Base
from PIL.Image import Image
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from malus import _core
from malus._files import open_regular
from malus.errors import InputError

#: What viewers do with an image by its orientation; 1 = nothing. From 5 on, width and height are exchanged.
_TURNED = {
    2: "mirrored",
    3: "turned by 180°",
    4: "turned by 180° and mirrored",
    5: "turned by 90° and mirrored",
    6: "turned by 90°",
    7: "turned by 90° and mirrored",
    8: "turned by 90°",
}
#: Tags that must not change within a station, their names and units.
_ALIKE: dict[int, tuple[str, str]] = {
    Base.ExposureTime: ("exposure time", " s"),
    Base.ISOSpeedRatings: ("ISO sensitivity", ""),
    Base.FNumber: ("aperture f/", ""),
    Base.FocalLength: ("focal length", " mm"),
    Base.SubjectDistance: ("focus distance", " m"),
    Base.WhiteBalance: ("white balance", ""),
}
#: Relative difference up to which two values count as equal, because cameras round them.
_SAME = 1e-3
#: Ratio up to which exposure times are those of the station file: cameras write 1/60 s for 1/64 s. A third of a stop is more.
_ROUNDED = 1.2
_FILTERS = threading.Lock()


def tags_of(path: Path) -> dict[int, Any]:
    """TIFF and EXIF tags of a JPEG, PNG, TIFF or TIFF-like RAW file (CR2, NEF, ARW, DNG, PEF); empty if it has none, or if they
    are damaged.
    """
    try:
        # Filters of warnings are those of the whole process: two threads would restore each other's.
        with _FILTERS, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _read_tags(path)
    except Exception:  # Pillow raises nearly any exception type for damaged tags; damaged tags must not end a run.
        return {}


def _read_tags(path: Path) -> dict[int, Any]:
    with open_regular(path) as file:
        header = file.read(8)
        if header[:4] in (b"II*\0", b"MM\0*"):
            directory = ImageFileDirectory_v2(header)
            file.seek(directory.next)
            directory.load(file)
            tags = dict(directory)
            if isinstance(offset := tags.get(IFD.Exif), int):
                detail = ImageFileDirectory_v2(header)
                file.seek(offset)
                detail.load(file)
                tags |= dict(detail)
            return tags
        file.seek(0)
        # Not with Image.open, which tries every format that it knows and refuses large images.
        kind = JpegImageFile if header.startswith(b"\xff\xd8") else PngImageFile
        with kind(file) as image:
            if kind is PngImageFile and "exif" not in image.info and (found := _png_exif(file)) is not None:
                image.info["exif"] = found
            # Not the function of PngImageFile, which decodes all pixels if no tags lie before them.
            exif = Image.getexif(image)
            return dict(exif) | dict(exif.get_ifd(IFD.Exif))


def _png_exif(file: BufferedReader) -> bytes | None:
    """The EXIF data of a PNG file, which may also lie behind the pixels, where ExifTool writes them."""
    file.seek(8)
    while len(start := file.read(8)) == 8:
        length, chunk = int.from_bytes(start[:4], "big"), start[4:]
        if chunk == b"eXIf":
            return b"Exif\0\0" + file.read(length)
        if chunk == b"IEND":
            break
        file.seek(length + 4, 1)
    return None


def taken(path: Path) -> str | None:
    """When an image was taken, in the camera's form ("2026:05:04 10:11:12.57"), which sorts by time; None if the file does not say."""
    tags = tags_of(path)
    moment = tags.get(Base.DateTimeOriginal)
    if not isinstance(moment, str) or not moment.strip():
        return None
    fraction = str(tags.get(Base.SubsecTimeOriginal, "")).strip()
    return f"{moment.strip()}.{fraction}" if fraction else moment.strip()


def require_alike(images: Sequence[Path], tags: Sequence[Mapping[int, Any]], *, exposures_differ: bool) -> None:
    """InputError that names files and values if a camera setting changed between the images.

    `tags`: of each image. Files that do not state a setting are taken to agree. `exposures_differ`: exposure times are stated in the
    station file and may differ.
    """
    for tag, (name, unit) in _ALIKE.items():
        if tag == Base.ExposureTime and exposures_differ:
            continue
        first: tuple[Path, float] | None = None
        for path, values in zip(images, tags, strict=True):
            value = number_of(values.get(tag))
            if value is None:
                continue
            if first is None:
                first = (path, value)
            elif abs(value - first[1]) > _SAME * max(abs(value), abs(first[1])):
                raise InputError(
                    f"{path}: {name} {_shown(tag, value)}{unit}, but {first[0].name} has {_shown(tag, first[1])}{unit}; "
                    "expected the same for all polarized images of a station"
                    + (" (or several exposures at every angle, with exposure_s)" if tag == Base.ExposureTime else "")
                )


def exposure_doubts(
    images: Sequence[Path], tags: Sequence[Mapping[int, Any]], exposure_s: Sequence[float] | None
) -> list[tuple[str, str, str]]:
    """Check, message and suggestion if the files' exposure times have other ratios than those of the station file; else an empty list.

    `tags`: of each image. exposure_s: seconds, one per image, or None. Files that do not state an exposure time are taken to agree.
    """
    first: tuple[Path, float, float] | None = None
    for path, of_file, stated in zip(images, tags, exposure_s or (), strict=False):
        seconds = number_of(of_file.get(Base.ExposureTime))
        if seconds is None or seconds <= 0:
            continue
        first = first or (path, seconds, stated)
        of_files, of_station = seconds / first[1], stated / first[2]
        if max(of_files, of_station) > _ROUNDED * min(of_files, of_station):
            message = (
                f"{path.name} was exposed {of_files:.3g} times as long as {first[0].name} according to the files, but "
                f"{of_station:.3g} times according to exposure_s"
            )
            return [("exposures", message, "is exposure_s in the order of the images?")]
    return []


def mask_notes(images: Sequence[Path], mask: Path | None) -> list[tuple[str, str, str]]:
    """Check, message and suggestion if viewers turn the images but not their mask, which has the same size either way; else an empty
    list. A mask that was drawn on the turned picture would lie on the wrong pixels, as all are taken as they are stored.
    """
    if not images or mask is None:
        return []
    of_image, of_mask = (tags_of(path).get(Base.Orientation, 1) for path in (images[0], mask))
    if of_image == of_mask or of_image not in _TURNED:
        return []
    # Drawn on a picture turned by 90° the mask would have another size, unless it is square.
    if of_image >= 5 and len(set(_core.image_size(str(mask)))) > 1:
        return []
    message = (
        f"viewers show {images[0].name} {_TURNED[of_image]} by its EXIF data, but not {mask.name}; both are taken as their pixels "
        "are stored"
    )
    return [("mask", message, "was the mask drawn on the turned picture? `malus check --overlay` shows where it lies")]


def number_of(value: object) -> float | None:
    """A tag's value, or the first of its values, as a finite number; None if it is not a finite number."""
    if isinstance(value, tuple) and value:
        value = value[0]
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def positive(value: object) -> float | None:
    """As `number_of`; None also for a number that is not positive."""
    number = number_of(value)
    return number if number is not None and number > 0 else None


def _shown(tag: int, value: float) -> str:
    if tag == Base.ExposureTime and 0 < value < 0.4:
        return f"1/{1 / value:.6g}"
    if tag == Base.WhiteBalance:
        return "manual" if value else "automatic"
    return f"{value:.6g}"
