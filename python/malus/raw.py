"""RAW files of cameras → linear images, before the C++ library reads them (extra `raw`: rawpy)."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus._extra import extra
from malus._files import replacing
from malus.errors import InputError
from malus.exif import tags_of

#: What C++ takes for RAW by its name (io/image_file.h, is_raw_name).
SUFFIXES = frozenset(
    (".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dng", ".iiq", ".nef", ".nrw", ".orf", ".pef", ".raf", ".rw2", ".sr2")
    + (".srw",)
)
_PLANES = {"red": 0, "green": 1, "blue": 2}
#: Changes when development does, so that nothing old is taken from a workspace.
_RECIPE = "linear 1"
_DNG_NOISE_PROFILE = 51041


@dataclass(frozen=True)
class Developed:
    """Linear images, floating point, 0 = black and 1 = white level, and the noise that the files state."""

    images: list[Path]
    full_well_e: float | None
    read_noise_e: float | None


def is_raw(path: Path) -> bool:
    """Whether the name is that of a camera's RAW file."""
    return path.suffix.lower() in SUFFIXES


def develop(
    images: Sequence[Path], channel: str, folder: Path, progress: Callable[[float, str], None] = lambda _, __: None
) -> Developed:
    """Develop RAW files into `folder`, one floating-point TIFF each; what is there already is kept.

    Black and white level come from the files; no brightening, no white balance, no rotation, the camera's own colors;
    the Bayer pattern is interpolated linearly, so that all images of a station are treated alike. `channel` "red",
    "green" or "blue" keeps one plane, anything else all. LibRaw cuts off what noise puts below the black level.
    """
    library = extra("rawpy", "rawpy", "developing RAW files", "raw")
    developed = []
    for index, path in enumerate(images):
        progress(index / len(images), f"developing {path.name}")
        try:
            content = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
        plane = _PLANES.get(channel)
        recipe = f"{_RECIPE} {library.__version__} {plane}".encode()
        target = folder / f"{path.stem}_{hashlib.sha256(content + recipe).hexdigest()[:16]}.tif"
        if not target.exists():
            pixels = _linear(library, path)
            if plane is not None and pixels.ndim == 3:
                pixels = pixels[..., plane]
            with replacing(target) as temporary:
                _core.write_float_tiff(str(temporary), np.ascontiguousarray(pixels))
        developed.append(target)
    full_well_e, read_noise_e = _noise(images[0])
    return Developed(developed, full_well_e, read_noise_e)


def _linear(library: object, path: Path) -> NDArray[np.float32]:
    """H×W or H×W×3, 1 = white level."""
    try:
        with library.imread(str(path)) as raw:  # type: ignore[attr-defined]
            pixels = raw.postprocess(
                demosaic_algorithm=library.DemosaicAlgorithm.LINEAR,  # type: ignore[attr-defined]
                output_color=library.ColorSpace.raw,  # type: ignore[attr-defined]
                output_bps=16,
                gamma=(1, 1),
                no_auto_bright=True,
                adjust_maximum_thr=0,
                use_camera_wb=False,
                use_auto_wb=False,
                user_wb=[1, 1, 1, 1],
                user_flip=0,
            )
    except library.LibRawError as error:  # type: ignore[attr-defined]
        raise InputError(
            f"{path}: not a RAW file that LibRaw can read ({error}), expected one, or PNG or TIFF"
        ) from None
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[..., 0]
    return np.asarray(pixels, dtype=np.float32) / np.float32(65535)


def _noise(path: Path) -> tuple[float | None, float | None]:
    """Electrons at white and of read noise by a DNG's NoiseProfile: variance = S · signal + O, signal in [0, 1]."""
    profile = tags_of(path).get(_DNG_NOISE_PROFILE)
    if not isinstance(profile, tuple) or len(profile) < 2:
        return None, None
    # Pairs (S, O), one a color plane; green is the middle one of three.
    pair = 2 * (len(profile) // 4)
    slope, offset = float(profile[pair]), float(profile[pair + 1])
    if not (math.isfinite(slope) and slope > 0 and math.isfinite(offset) and offset >= 0):
        return None, None
    return 1 / slope, math.sqrt(offset) / slope
