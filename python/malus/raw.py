"""RAW files of cameras → linear images, before the C++ library reads them (extra `raw`: rawpy)."""

from __future__ import annotations

import glob
import hashlib
import io
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL.ExifTags import Base

from malus import _core
from malus._extra import extra
from malus._files import reading, replacing, sha256_of
from malus.errors import InputError
from malus.exif import tags_of

#: Suffixes of cameras' RAW files, and of other images, in small letters.
SUFFIXES = frozenset(_core.raw_suffixes)
IMAGE_SUFFIXES = frozenset(_core.image_suffixes)
_SETTINGS: dict[int, str] = {
    Base.ExposureTime: "shutter_speed",
    Base.ISOSpeedRatings: "iso_speed",
    Base.FNumber: "aperture",
    Base.FocalLength: "focal_length",
}
_PLANES = {"red": 0, "green": 1, "blue": 2}
#: To be changed whenever development changes, so that images developed in the old way are not reused from a workspace.
_RECIPE = "linear 2"
#: Deflate, the strongest compression of RAW files, makes 1032 bytes from one at most.
_MOST_PIXELS_A_BYTE = 1032
#: Share of the white level from which a sample is clipped, as by default for a pixel (capture.saturation).
_CLIPPED = 0.995


@dataclass(frozen=True)
class Developed:
    """Linear images, floating point, 0 = black and 1 = white level, and the noise that the files state."""

    images: list[Path]
    full_well_e: float | None
    read_noise_e: float | None


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image; of a RAW file's, once it is developed."""
    if not is_raw(path):
        return _core.image_size(str(path))
    with _opened(path) as raw:
        return int(raw.sizes.iwidth), int(raw.sizes.iheight)


@contextmanager
def _opened(path: Path, content: bytes | None = None) -> Iterator[Any]:
    """A RAW file of which LibRaw has read the header. InputError if it fails, here or within, or if the file is too small for
    the pixels that its header states: LibRaw would take memory for all of them.
    """
    library = extra("rawpy", "rawpy", "reading RAW files", "raw")
    try:
        with library.RawPy() as raw:
            if content is None:
                raw.open_file(str(path))
            else:
                raw.open_buffer(io.BytesIO(content))
            size = path.stat().st_size if content is None else len(content)
            width, height = int(raw.sizes.raw_width), int(raw.sizes.raw_height)
            if width * height > _MOST_PIXELS_A_BYTE * size:
                raise InputError(f"{path}: states {width} x {height} pixels, more than its {size} bytes can hold")
            yield raw
    except library.LibRawError as error:
        raise InputError(
            f"{path}: not a RAW file that LibRaw can read ({error}), expected one, or PNG or TIFF"
        ) from None


def is_raw(path: Path) -> bool:
    """Whether the file's suffix is that of a camera's RAW file."""
    return path.suffix.lower() in SUFFIXES


def is_image(path: Path) -> bool:
    """Whether the file's suffix is that of an image that can be read, RAW or other."""
    return is_raw(path) or path.suffix.lower() in IMAGE_SUFFIXES


def settings_of(path: Path) -> dict[int, Any]:
    """TIFF and EXIF tags of an image; of a RAW file that is not built like TIFF (CR3, RAF, ORF, RW2) those of the camera settings that
    LibRaw finds.
    """
    tags = tags_of(path)
    if tags or not is_raw(path):
        return tags
    with _opened(path) as raw:
        found = getattr(raw, "other", None)  # older versions of rawpy have none
    return {
        tag: float(value)
        for tag, name in _SETTINGS.items()
        if (value := getattr(found, name, None)) is not None and value > 0
    }


def develop(
    images: Sequence[Path], channel: str, folder: Path, progress: Callable[[float, str], None] = lambda _, __: None
) -> Developed:
    """Develop RAW files into `folder`, one floating-point TIFF each; images developed earlier are reused if they are unchanged, and
    removed if they are of other files or were developed otherwise.

    Black and white level come from the files. There is no brightening, no white balance and no rotation; colors are the camera's
    own. The Bayer pattern is interpolated linearly, so that all images of a station are treated alike; what is interpolated from
    a clipped sample is at the white level, so that it counts as saturated. `channel` "red", "green" or "blue" keeps one plane,
    anything else keeps all. LibRaw clips values that noise puts below the black level.
    """
    library = extra("rawpy", "rawpy", "developing RAW files", "raw")
    developed = []
    for index, path in enumerate(images):
        progress(index / len(images), f"developing {path.name}")
        with reading(path):
            content = path.read_bytes()
        plane = _PLANES.get(channel)
        recipe = f"{_RECIPE} {library.__version__} {plane}".encode()
        name = f"{name_of(path, content)}{hashlib.sha256(recipe).hexdigest()[:8]}"
        kept = next(
            (file for file in folder.glob(f"{glob.escape(name)}_*.tif") if file == _named_by_content(file, name)), None
        )
        if kept is None:
            pixels = linear_image(path, content)
            if plane is not None and pixels.ndim == 3:
                pixels = pixels[..., plane]
            unnamed = folder / f"{name}.tif"
            with replacing(unnamed) as temporary:
                _core.write_float_tiff(str(temporary), np.ascontiguousarray(pixels))
            kept = unnamed.replace(_named_by_content(unnamed, name))
        developed.append(kept)
    for left in set(folder.glob("*.tif")).difference(developed):  # of other files, another channel or another version
        left.unlink(missing_ok=True)
    full_well_e, read_noise_e = _noise(images[0])
    return Developed(developed, full_well_e, read_noise_e)


def name_of(path: Path, content: bytes) -> str:
    """Start of a developed image's name: it identifies the RAW file and the content that the file had."""
    return f"{path.stem}_{hashlib.sha256(content).hexdigest()[:16]}_"


def _named_by_content(file: Path, name: str) -> Path:
    """Path of a developed image whose name contains the hash of its content, so that a later change of the file is detected."""
    return file.with_name(f"{name}_{sha256_of(file)[:16]}.tif")


def linear_image(path: Path, content: bytes | None = None, *, half_size: bool = False) -> NDArray[np.float32]:
    """A RAW file's pixels, H×W or H×W×3, 1 = white level. content: the bytes of the file, if they are read already. half_size: one
    pixel per cell of four, which is faster.
    """
    library = extra("rawpy", "rawpy", "reading RAW files", "raw")
    with _opened(path, content) as raw:
        raw.unpack()
        pixels = raw.postprocess(
            half_size=half_size,
            demosaic_algorithm=library.DemosaicAlgorithm.LINEAR,
            output_color=library.ColorSpace.raw,
            output_bps=16,
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0,
            use_camera_wb=False,
            use_auto_wb=False,
            user_wb=[1, 1, 1, 1],
            user_flip=0,
        )
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[..., 0]
    linear = np.asarray(pixels, dtype=np.float32) / np.float32(65535)
    if linear.ndim == 3 and not half_size:
        _clip_rims(linear)
    return linear


def _clip_rims(pixels: NDArray[np.float32]) -> None:
    """Put the pixels beside a clipped sample at the white level, color by color. These rims of highlights are interpolated from the
    sample, so they are too dark as well, but do not look clipped.
    """
    clipped = np.pad(pixels >= _CLIPPED, ((1, 1), (1, 1), (0, 0)))
    rows = clipped[:-2] | clipped[1:-1] | clipped[2:]
    pixels[rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]] = 1


def _noise(path: Path) -> tuple[float | None, float | None]:
    """Electrons at white and electrons of read noise from a DNG's NoiseProfile: variance = S · signal + O, signal in [0, 1]."""
    profile = tags_of(path).get(Base.NoiseProfile)
    if not isinstance(profile, tuple) or len(profile) < 2:
        return None, None
    # Pairs (S, O), one per color plane; green is the middle one of three.
    pair = 2 * (len(profile) // 4)
    slope, offset = float(profile[pair]), float(profile[pair + 1])
    if not (math.isfinite(slope) and slope > 0 and math.isfinite(offset) and offset >= 0):
        return None, None
    return 1 / slope, math.sqrt(offset) / slope
