"""Converts images, also RAW and 16-bit files, for display in a browser."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile

from malus import _core, raw
from malus._files import reading
from malus.camera import Camera
from malus.capture import undistort
from malus.errors import InputError
from malus.pictures import encode
from malus.raster import reduced, step_for
from malus.threads import ALL_CORES

#: Percentile of the pixels that is shown white.
_WHITE_PERCENTILE = 99.5
THUMBNAIL_SIDE_PX = 320
#: Side of the tiles in which large images are sent.
TILE_PX = 512

Made = TypeVar("Made")
#: A lens: model, width, height and parameters, as malus.Camera takes them.
Lens = tuple[str, int, int, tuple[float, ...]]


def linear_or_encoded(path: Path, *, half_size: bool = False) -> tuple[NDArray[np.float32], bool]:
    """Pixels H×W or H×W×3 in [0, 1] of full scale, and whether they are linear (RAW, or assumed for more than 8 bits and for
    floating point, whose full scale is taken as 1).

    half_size: read RAW files with half the pixels per side, which is much faster.
    """
    if raw.is_raw(path):
        return raw.linear_image(path, half_size=half_size), True
    pixels, full_scale = _core.read_image_dn(str(path))
    return np.asarray(pixels, dtype=np.float32) / np.float32(full_scale), full_scale != 255


def distorting(camera: Mapping[str, Any] | None) -> Lens | None:
    """The lens of a station's camera, as `Station.describe` gives it; None for one without distortion, or that is not known."""
    if camera is None or camera["model"] in ("PINHOLE", "SIMPLE_PINHOLE"):
        return None
    return camera["model"], camera["width"], camera["height"], tuple(camera["params"])


def displayed(path: Path, side_px: int | None = None) -> NDArray[np.uint8]:
    """An image for display, H×W×3 in 8 bits; with `side_px`, reduced by averaging until no side is longer."""
    toned = _toned(path, side_px)
    return np.ascontiguousarray(np.broadcast_to(toned, (*toned.shape[:2], 3)))


def _toned(path: Path, side_px: int | None = None) -> NDArray[np.uint8]:
    """Like displayed(), but with as many channels as the file has."""
    pixels, linear = linear_or_encoded(path, half_size=side_px is not None)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if side_px is not None:
        step = step_for(pixels.shape, side_px)
        pixels = np.stack([reduced(pixels[..., c], step) for c in range(pixels.shape[2])], -1)
    pixels = np.nan_to_num(pixels, copy=False)
    if linear:
        white = max(float(np.percentile(pixels[:: 1 + pixels.shape[0] // 500, :: 1 + pixels.shape[1] // 500], _WHITE_PERCENTILE)), 1e-6)  # fmt: skip
        pixels = np.clip(pixels / white, 0, 1) ** np.float32(1 / 2.2)
    return np.rint(255 * np.clip(pixels, 0, 1)).astype(np.uint8)


def colored(values: NDArray[Any], colors: str, low: float, high: float) -> NDArray[np.uint8]:
    """A picture H×W×4 in the colors of a matplotlib color map, transparent where there is no value."""
    scaled = np.clip((np.nan_to_num(values, nan=low) - low) / max(high - low, 1e-9), 0, 1)
    picture: NDArray[np.uint8] = np.rint(255 * mpl.colormaps[colors](scaled)).astype(np.uint8)
    picture[..., 3] = np.where(np.isfinite(values), 255, 0)
    return picture


def _undistorted(pixels: NDArray[np.uint8], lens: Lens) -> NDArray[np.uint8]:
    """Pixels H×W×C as a camera without the lens's distortion sees them, which is that of all results; black where there are none."""
    camera = Camera(*lens)
    channels = [undistort(pixels[..., c], camera, threads=ALL_CORES) for c in range(pixels.shape[2])]
    return np.stack([np.rint(np.clip(np.nan_to_num(one), 0, 255)).astype(np.uint8) for one in channels], -1)


def cached(make: Callable[..., Made], size: int) -> Callable[..., Made]:
    """Caches the result of `make` for a file, and for what else `make` takes, until the file changes."""
    # Two requests for tiles at the same time must not read the image twice.
    lock = threading.Lock()

    @lru_cache(maxsize=size)
    def made(path: Path, _changed_ns: int, *more: Hashable) -> Made:
        return make(path, *more)

    def current(path: Path, *more: Hashable) -> Made:
        with reading(path):
            changed = path.stat().st_mtime_ns
        with lock:
            return made(path, changed, *more)

    return current


def _thumbnail(path: Path) -> bytes:
    if path.suffix.lower() in (".jpg", ".jpeg"):
        try:
            # Not Image.open, which refuses images of more than 179 megapixels. draft() decodes only an eighth of the pixels.
            with JpegImageFile(path) as image:
                image.draft("RGB", (THUMBNAIL_SIDE_PX, THUMBNAIL_SIDE_PX))
                image.thumbnail((THUMBNAIL_SIDE_PX, THUMBNAIL_SIDE_PX))
                return encode(np.asarray(image.convert("RGB")), "JPEG", quality=85)
        except SyntaxError:  # Pillow raises this for a file that is no JPEG, whatever its name says.
            pass
        except OSError as error:
            raise InputError(f"{path}: cannot be read as an image ({error})") from None
    return encode(displayed(path, THUMBNAIL_SIDE_PX), "JPEG", quality=85)


def _pyramid(path: Path, lens: Lens | None) -> list[Image.Image]:
    """The image, without the distortion of a lens if one is given, then each level with half the sides (rounded up) of the one
    before, until a level fits into one tile.
    """
    pixels = _toned(path)
    if lens is not None:
        pixels = _undistorted(pixels, lens)
    levels = [Image.fromarray(pixels[..., 0] if pixels.shape[2] == 1 else np.ascontiguousarray(pixels[..., :3]))]
    while max(levels[-1].size) > TILE_PX:
        levels.append(levels[-1].reduce(2))
    return levels


#: JPEG of an image, small.
thumbnail = cached(_thumbnail, 400)
#: Few at a time, since images are large: the station's images are shown in turn, and one other.
_pyramid_of = cached(_pyramid, 3)


def tile(path: Path, halvings: int, column: int, row: int, lens: Lens | None = None) -> bytes:
    """JPEG of one tile of an image whose sides were halved `halvings` times; lens: its distortion is removed first."""
    levels = _pyramid_of(path, lens)
    if not 0 <= halvings < len(levels):
        raise InputError(f"{path}: has {len(levels)} levels, expected one of them")
    level = levels[halvings]
    left, top = column * TILE_PX, row * TILE_PX
    if not (0 <= left < level.width and 0 <= top < level.height):
        raise InputError(f"{path}: has no tile {column}, {row}")
    part = level.crop((left, top, min(left + TILE_PX, level.width), min(top + TILE_PX, level.height)))
    return encode(np.asarray(part), "JPEG", quality=88)
