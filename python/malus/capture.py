"""From a camera's files to linear, undistorted images that are registered to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import as_image, as_numbers, as_shares, require_noise
from malus.camera import Camera
from malus.options import Options
from malus.threads import ALL_CORES

#: Color filters of a color camera's 2×2 cells, by rows.
BayerPattern: TypeAlias = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
BAYER_PATTERNS: tuple[str, ...] = get_args(BayerPattern)


@dataclass(frozen=True)
class Registration:
    """Where one image lies relative to the first: the 2×3 map `image_from_base` takes a pixel of the first image to its pixel here."""

    status: str
    message: str
    image_from_base: NDArray[np.float64]
    displacement_px: float
    rms_px: float


def demosaic(mosaic: ArrayLike, *, colors: str | None = None, threads: int = ALL_CORES) -> list[NDArray[np.float32]]:
    """Split a 2×2 polarizer mosaic (H×W, linear) into four images: cell top left, top right, bottom left, bottom right.

    Every image has the mosaic's size, so that all four show the same point at the same pixel: H×W, or H×W×3 for a
    color camera, whose `colors` is the Bayer pattern of the cells by rows, "RGGB"; all color channels are assumed to have the same
    polarization. Height and width must be multiples of 2, in color of 4.
    """
    image = as_image(mosaic, "mosaic")
    if colors is None:
        return _core.demosaic(image, threads)
    channels, ratios = _core.demosaic_color(image, colors, threads)
    factors = np.stack(ratios, axis=-1)
    return [channel[..., None] * factors for channel in channels]


def linearize(
    image: ArrayLike, *, response: str = "linear", black_level: float = 0.0, white_level: float = 1.0
) -> NDArray[np.float32]:
    """Linear intensities, in [0, 1] of the white level, from digital numbers (H×W, or H×W×3, channel by channel).

    response: "linear", "srgb", "gamma:X", or the path of a lookup table (docs/station-file.md).
    """
    pixels = np.ascontiguousarray(as_numbers(image, "image"), dtype=np.float32)
    if pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] != 3) or pixels.size == 0:
        raise ValueError(f"image has shape {pixels.shape}, expected (H, W) or (H, W, 3)")
    return _core.linearize(pixels, response, float(black_level), float(white_level))


def undistort(image: ArrayLike, camera: Camera, *, threads: int = ALL_CORES) -> NDArray[np.float32]:
    """The image (H×W) as a camera of the same focal length without distortion sees it; NaN where the image has no data."""
    return _core.undistort(as_image(image, "image"), camera.values(), threads)


def register(
    images: Sequence[ArrayLike] | NDArray[Any],
    *,
    full_well_e: float = 20000.0,
    read_noise_e: float = 8.0,
    frames_averaged: int = 1,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> list[Registration]:
    """Register images to the first by affine maps, jointly; one `Registration` per image.

    images: K arrays H×W, linear, in [0, 1] of the white level, or all uint16 with white at 65535.
    """
    require_noise(full_well_e, read_noise_e, frames_averaged)
    found = _core.register_images(
        as_shares(images, "images"),
        (options or Options()).to_json(),
        frames_averaged,
        full_well_e,
        read_noise_e,
        threads,
    )
    return [Registration(**entry) for entry in found]
