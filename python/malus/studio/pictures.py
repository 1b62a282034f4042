"""Images as a browser can show them, RAW and 16-bit files too."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from malus import _core, raw
from malus.errors import InputError
from malus.figures import encode, reduced, step_for

#: Of the full scale or brighter: what is shown white.
_WHITE_PERCENTILE = 99.5
THUMBNAIL_SIDE_PX = 320


def linear_or_encoded(path: Path, *, half_size: bool = False) -> tuple[NDArray[np.float32], bool]:
    """Pixels H×W or H×W×3 in [0, 1] of full scale, and whether the file is to be taken as linear (more than 8 bits).

    half_size: RAW files with half the pixels a side, which is much faster.
    """
    if raw.is_raw(path):
        return raw.linear_image(path, half_size=half_size), True
    pixels, full_scale = _core.read_image_dn(str(path))
    return np.asarray(pixels, dtype=np.float32) / np.float32(full_scale), full_scale > 255


def displayed(path: Path, side_px: int | None = None) -> NDArray[np.uint8]:
    """An image for the eye, H×W×3 in 8 bits; with `side_px` averaged until no side is longer."""
    pixels, linear = linear_or_encoded(path, half_size=side_px is not None)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if side_px is not None:
        step = step_for(pixels.shape, side_px)
        pixels = np.stack([reduced(pixels[..., c], step) for c in range(pixels.shape[2])], -1)
    if linear:
        white = max(float(np.percentile(pixels[:: 1 + pixels.shape[0] // 500, :: 1 + pixels.shape[1] // 500], _WHITE_PERCENTILE)), 1e-6)  # fmt: skip
        pixels = np.clip(pixels / white, 0, 1) ** np.float32(1 / 2.2)
    bytes_of = np.rint(255 * np.clip(pixels, 0, 1)).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(bytes_of, (*bytes_of.shape[:2], 3)))


def _cached(make: Callable[[Path], bytes], size: int) -> Callable[[Path], bytes]:
    """Keeps what was made of a file until the file changes."""

    @lru_cache(maxsize=size)
    def made(path: Path, _changed_ns: int) -> bytes:
        return make(path)

    def current(path: Path) -> bytes:
        try:
            changed = path.stat().st_mtime_ns
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
        return made(path, changed)

    return current


def _thumbnail(path: Path) -> bytes:
    if path.suffix.lower() in (".jpg", ".jpeg"):
        try:
            with Image.open(path) as image:  # which decodes an eighth of the pixels only
                image.draft("RGB", (THUMBNAIL_SIDE_PX, THUMBNAIL_SIDE_PX))
                image.thumbnail((THUMBNAIL_SIDE_PX, THUMBNAIL_SIDE_PX))
                buffer = io.BytesIO()
                image.convert("RGB").save(buffer, "JPEG", quality=85)
                return buffer.getvalue()
        except (OSError, UnidentifiedImageError) as error:
            raise InputError(f"{path}: cannot be read as an image ({error})") from None
    return encode(displayed(path, THUMBNAIL_SIDE_PX), "JPEG", quality=85)


#: JPEG of an image, small and whole.
thumbnail = _cached(_thumbnail, 400)
picture = _cached(lambda path: encode(displayed(path), "JPEG", quality=90), 12)


def size_of(path: Path) -> tuple[int, int]:
    """Width and height of an image in pixels."""
    return raw.image_size(path) if raw.is_raw(path) else _core.image_size(str(path))
