"""The photos of a station: the list of files, the camera data in the files, and the photos' copies for COLMAP."""

from __future__ import annotations

import fnmatch
import math
import os
import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags

from malus import _core, raw
from malus._files import natural, open_regular, reading, require_utf8, sha256_of
from malus._patterns import MOST_NAMES
from malus.errors import InputError, MalusError
from malus.exif import number_of, positive, tags_of
from malus.workspace import is_result

#: Diagonal of the 36 × 24 mm frame to which 35-mm-equivalent focal lengths refer.
_FULL_FRAME_DIAGONAL_MM = 43.27
#: Relative difference up to which a focal length agrees with its 35-mm equivalent, which is rounded and need not be by the diagonal.
_ROUNDED_FILM = 0.15
#: Suffixes of images of cameras and phones that cannot be read as photos, in small letters.
_OTHER_SUFFIXES = raw.SUFFIXES | {".heic", ".heif", ".webp", ".avif"}
#: Most masks whose faults a message describes.
_PROBLEMS_TOLD = 6
_MM_PER_RESOLUTION_UNIT: dict[float, float] = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}


@dataclass(frozen=True)
class Photo:
    """A photo's file, its size, and the camera data in its EXIF."""

    name: str
    """Path relative to the photos' folder, with forward slashes."""
    path: Path
    width: int
    height: int
    maker: str = ""
    """Camera and lens from the EXIF data; empty if unknown."""
    focal_px: float | None = None
    """Focal length in pixels from the EXIF data; None if unknown."""
    mask: Path | None = None
    """Image of the photo's size, non-zero = object; None if there is none."""
    focal_mm: float | None = None
    """Focal length in millimeters from the EXIF data, which may not tell the size of a pixel; None if unknown."""

    serial: str = ""
    """Serial numbers of camera and lens from the EXIF data; empty if unknown."""

    @property
    def camera_key(self) -> tuple[int, int, str, str, float | None, float | None]:
        """Key that is the same for photos of one camera, lens and focal length."""
        if self.focal_px is not None:
            return self.width, self.height, self.maker, self.serial, round(self.focal_px, 1), None
        return self.width, self.height, self.maker, self.serial, None, self.focal_mm

    def may_share_lens(self, other: Photo) -> bool:
        """Whether two files do not say that they are of different cameras, lenses or focal lengths. Programs that develop photos may leave
        serial numbers out.
        """
        if not (self.serial and other.serial):
            return replace(self, serial="").camera_key == replace(other, serial="").camera_key
        return self.camera_key == other.camera_key


def _words_of(said: Mapping[int, Any], *tags: int) -> str:
    """The texts of some tags; empty if the file has none of them."""
    return " ".join(str(said[tag]).strip("\x00 ") for tag in tags if said.get(tag))


def _focal_lengths(said: Mapping[int, Any], width: int, height: int) -> tuple[float | None, float | None]:
    """The focal length in pixels and in millimeters (None if unknown), from a file's EXIF data."""
    tags = ExifTags.Base
    focal_mm = positive(said.get(tags.FocalLength))
    resolution = positive(said.get(tags.FocalPlaneXResolution))
    unit = _MM_PER_RESOLUTION_UNIT.get(number_of(said.get(tags.FocalPlaneResolutionUnit)) or 2, 25.4)
    written = positive(said.get(tags.ExifImageWidth))
    equivalent = positive(said.get(tags.FocalLengthIn35mmFilm))
    by_film = equivalent / _FULL_FRAME_DIAGONAL_MM * math.hypot(width, height) if equivalent else None
    if focal_mm and resolution:
        # The resolution refers to the image as the camera wrote it.
        scale = max(width, height) / max(written or width, positive(said.get(tags.ExifImageHeight)) or height)
        by_pixels = focal_mm * resolution / unit * scale
        # Programs that develop or resize photos and write their new size may keep the resolution of the old one.
        if by_film is None or abs(by_pixels - by_film) < _ROUNDED_FILM * by_film:
            return by_pixels, focal_mm
    return by_film, focal_mm


def describe_photo(path: Path, name: str) -> Photo:
    """Size and EXIF data of one file, which may be a camera's RAW file. Raises InputError if the file is not a readable image."""
    width, height = raw.image_size(path)
    said, tags = tags_of(path), ExifTags.Base
    maker = _words_of(said, tags.Make, tags.Model, tags.LensModel)
    serial = _words_of(said, tags.BodySerialNumber, tags.LensSerialNumber)
    focal_px, focal_mm = _focal_lengths(said, width, height)
    return Photo(name, path, width, height, maker, focal_px, focal_mm=focal_mm, serial=serial)


def files_below(folder: Path) -> Iterator[Path]:
    """The files below a folder that may be photos or masks: none that is hidden, and none of the results of a run, an object, a
    campaign or `malus check`.

    Raises InputError for a folder with more files and folders than a station can have.
    """
    count = 0
    for place, folders, files in os.walk(folder):
        count += len(folders) + len(files)
        if count > MOST_NAMES:
            raise InputError(
                f'[photos] folder = "{folder}" has more than {MOST_NAMES} files and folders, expected the photos of one station'
            )
        here = Path(place)
        folders[:] = sorted(name for name in folders if not name.startswith(".") and not _has_results(here / name))
        yield from (here / name for name in files if not name.startswith(".") and not name.endswith("-check.png"))


def _has_results(folder: Path) -> bool:
    """Whether a folder's pictures are results, which would change with each run if they were taken for photos."""
    return is_result(folder) or any((folder / name).exists() for name in ("campaign.json", "features.db"))


def photo_files(folder: Path, exclude: Sequence[str], masks: Path | None = None) -> dict[str, Path]:
    """The photos of `files_below` a folder (PNG, TIFF, JPEG) by their paths below it, which station files call them by, in natural
    order; without those whose name or path matches a pattern of `exclude`, and without files of a folder of masks in it.

    Raises InputError for a pattern that matches none of the files, for names that are not in UTF-8, and for a folder with
    more files and folders than a station can have.
    """
    names = dict(_images_below(folder, masks, raw.IMAGE_SUFFIXES))
    if masks == folder:
        found = {mask for name in names for mask in _mask_names(name) if mask != name}
        names = {name: path for name, path in names.items() if name not in found}
    for pattern in exclude:
        if not any(_matches(name, pattern) for name in names):
            raise InputError(f'[photos] exclude = ["{pattern}"]: no photo in {folder} has that name')
    kept = sorted((n for n in names if not any(_matches(n, pattern) for pattern in exclude)), key=natural)
    for name in kept:
        require_utf8(names[name])
    return {name: names[name] for name in kept}


def _images_below(folder: Path, masks: Path | None, suffixes: frozenset[str]) -> Iterator[tuple[str, Path]]:
    """The `files_below` a folder that have one of these suffixes, and their paths below it; without those of a folder of masks in it."""
    # A folder of masks may also hold the photos' folder, or be it: programs write the masks beside the photos.
    inside = None if masks is None or masks == folder or not masks.is_relative_to(folder) else masks
    for path in files_below(folder):
        is_mask = inside is not None and inside in path.parents
        if not is_mask and path.suffix.lower() in suffixes and path.is_file():
            yield path.relative_to(folder).as_posix(), path


def other_images(said: Mapping[str, Any], photos: Sequence[Photo]) -> str:
    """How many images below the folder of a [photos] table are of other formats, and of which; empty without any.

    One beside a photo of the same name is no loss: cameras write RAW and JPEG files together.
    """
    masks = None if said["masks"] is None else Path(said["masks"])
    read = {photo.path.with_suffix("") for photo in photos}
    kinds = Counter(
        path.suffix.lower()
        for name, path in _images_below(Path(said["folder"]), masks, _OTHER_SUFFIXES)
        if path.with_suffix("") not in read and not any(_matches(name, pattern) for pattern in said["exclude"])
    )
    count = kinds.total()
    return f"{count} file{'s' * (count != 1)} ({', '.join(sorted(kinds))})" if count else ""


def list_photos(folder: Path, exclude: Sequence[str], masks: Path | None = None) -> list[Photo]:
    """The photos of `photo_files`, with sizes and EXIF data. Raises InputError, also for files that are not readable images."""
    return [describe_photo(path, name) for name, path in photo_files(folder, exclude, masks).items()]


def photos_of(said: Mapping[str, Any]) -> list[Photo]:
    """The photos of a [photos] table as `Station.describe` returns it, with their masks."""
    masks = None if said["masks"] is None else Path(said["masks"])
    photos = list_photos(Path(said["folder"]), said["exclude"], masks)
    return photos if masks is None else with_masks(photos, masks)


def stray_masks(said: Mapping[str, Any]) -> list[str]:
    """Images in the folder of masks of a [photos] table that are the mask of no photo, not even of an excluded one; none if the
    photos are in that folder, too.
    """
    if said["masks"] is None or Path(said["folder"]).is_relative_to(said["masks"]):
        return []
    folder = Path(said["masks"])
    known = {mask for name in photo_files(Path(said["folder"]), [], folder) for mask in _mask_names(name)}
    return sorted(
        (name for name, _ in _images_below(folder, None, raw.IMAGE_SUFFIXES) if name not in known), key=natural
    )


def _sample(path: Path) -> tuple[int, bytes]:
    """Length and some bytes of a file."""
    with reading(path), open_regular(path) as file:
        length = file.seek(0, os.SEEK_END)
        file.seek(length // 2)
        return length, file.read(65536)


def require_different(photos: Sequence[Photo]) -> None:
    """InputError if a photograph is among the photos twice: as a copy, or saved in two formats under one name.

    The sweep takes it for two observations that confirm each other. COLMAP would find both at one place.
    """
    first_of: dict[Path | str, Photo] = {}
    twice = []
    samples = [_sample(photo.path) for photo in photos]
    for photo, sample in zip(photos, samples, strict=True):
        same: list[Path | str] = [photo.path.with_suffix("")]
        if samples.count(sample) > 1:  # For most photos the sample suffices, and the whole file need not be read.
            same.append(sha256_of(photo.path))
        first = next((first_of[key] for key in same if key in first_of), photo)
        if first is not photo:
            twice.append(f"{first.name} and {photo.name}")
        for key in same:
            first_of.setdefault(key, first)
    if twice:
        raise InputError(
            f"[photos]: {_told(twice)} are the same photograph{'s' * (len(twice) > 1)}, expected each once: the copies would confirm "
            'what one of them shows; remove them, or name them in exclude = ["…"]'
        )


def _mask_names(photo: str) -> list[str]:
    """Names of a photo's mask in the folder of masks, as COLMAP, by the stem alone, Metashape and RealityCapture write them.

    Also with accents as macOS writes them, apart from their letters: files of both kinds meet where folders are copied.
    """
    forms = dict.fromkeys([photo, *(unicodedata.normalize(form, photo) for form in ("NFC", "NFD"))])
    stems = [(name, name[: -len(Path(name).suffix)]) for name in forms]
    return [
        mask for name, stem in stems for mask in (f"{name}.png", f"{stem}.png", f"{stem}_mask.png", f"{name}.mask.png")
    ]


def _mask_of(photo: Photo, folder: Path) -> Path | None:
    paths = (folder / name for name in _mask_names(photo.name))
    return next((path for path in paths if path.is_file() and path != photo.path), None)


def _wrong_size_of_mask(photo: Photo) -> str:
    """What is wrong with the size of a photo's mask, empty if nothing is."""
    if photo.mask is None:
        return ""
    width, height = _core.image_size(str(photo.mask))
    if (width, height) == (photo.width, photo.height):
        return ""
    turned = (height, width) == (photo.width, photo.height)
    return f"{photo.mask}: is {width} x {height} pixels, expected {photo.width} x {photo.height} as {photo.name}" + (
        "; EXIF orientation is ignored: turn the mask as the photo's pixels are stored" if turned else ""
    )


def _told(problems: Sequence[str]) -> str:
    """Problems for a message, at most _PROBLEMS_TOLD of them and the number of the others."""
    more = len(problems) - _PROBLEMS_TOLD
    return "; ".join(problems[:_PROBLEMS_TOLD]) + (f"; and {more} more" if more > 0 else "")


def with_masks(photos: Sequence[Photo], folder: Path) -> list[Photo]:
    """The photos with the masks that they have in a folder.

    A mask is named like its photo, a photo in a subfolder has its mask in the same subfolder: "a.jpg.png", "a.png",
    "a_mask.png" or "a.jpg.mask.png" for "a.jpg". Raises InputError if no photo has one, and for masks of another size, naming all.
    """
    found = [replace(photo, mask=_mask_of(photo, folder)) for photo in photos]
    if wrong := [problem for photo in found if (problem := _wrong_size_of_mask(photo))]:
        raise InputError(_told(wrong))
    if photos and all(photo.mask is None for photo in found):
        name = photos[0].name
        raise InputError(
            f'[photos] masks = "{folder}" has no mask of any photo, expected for example {name}.png for {name}'
        )
    return found


def require_usable_masks(photos: Sequence[Photo]) -> None:
    """InputError that names all masks that are black everywhere, or photographs."""
    problems = []
    for mask in (photo.mask for photo in photos if photo.mask is not None):
        state = mask.stat()
        if problem := _problem_of_mask(str(mask), state.st_mtime_ns, state.st_size):
            problems.append(problem)
    if problems:
        raise InputError(f"[photos] masks: {_told(problems)}")


@lru_cache(maxsize=4096)
def _problem_of_mask(path: str, modified_ns: int, length: int) -> str:
    """Why an image cannot be a mask, empty if it can. Studio asks after every change, and a large mask takes half a second to read:
    it is read again only if the file has changed.
    """
    try:
        _core.read_mask(path)
    except InputError as error:
        return str(error)
    return ""


def _matches(name: str, pattern: str) -> bool:
    # A keyboard writes é as one sign, macOS in names of files as two.
    name, pattern = (unicodedata.normalize("NFC", text) for text in (name, pattern))
    # A file's own name is no pattern, even with brackets: "IMG_7 [edited].jpg".
    return any(said == pattern or fnmatch.fnmatchcase(said, pattern) for said in (name, name.rsplit("/", 1)[-1]))


def read_gray(path: Path) -> NDArray[np.float32]:
    """Intensity of a photo as encoded in its file (not linearized), in [0, 1] of full scale, H×W: the mean of the channels."""
    return _core.read_intensity(str(path))


def to_bytes(intensity: NDArray[np.float32], *, gamma: float) -> NDArray[np.uint8]:
    """An 8-bit image in which features can be found: intensities from the 0.1 to the 99.9 percentile, to the power of
    1 / gamma (gamma 1 for images that are gamma-encoded already). NaN becomes black.
    """
    finite = intensity[np.isfinite(intensity)]
    low, high = np.percentile(finite, [0.1, 99.9]) if finite.size else np.zeros(2)
    if not high > low:
        return np.zeros(intensity.shape, np.uint8)
    stretched = np.clip((np.nan_to_num(intensity, nan=low) - low) / (high - low), 0, 1) ** (1 / gamma)
    copy: NDArray[np.uint8] = np.rint(255 * stretched).astype(np.uint8)
    return copy


def write_proxy(photo: Photo, target: Path) -> None:
    """Write a photo's 8-bit copy, as PNG whatever the name of `target`. Raises InputError for a damaged file or a path that
    cannot be used, ResourceError on a full disk.
    """
    pixels, full_scale = _core.read_image_dn(str(photo.path))
    gray = pixels if pixels.ndim == 2 else pixels.mean(axis=2, dtype=np.float32)
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        _core.write_png(str(target), to_bytes(gray, gamma=1.0 if full_scale == 255 else 2.2))
    except MalusError as error:
        raise type(error)(f"{photo.path}: no copy could be written for COLMAP ({error})") from None
