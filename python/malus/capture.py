"""From what a camera delivers to images that lie on each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import as_image, as_images
from malus.options import Options
from malus.threads import ALL_CORES


@dataclass(frozen=True)
class Registration:
    """How one image lies to the first: pixel of the first → pixel of this one is the 2×3 map `image_from_base`."""

    status: str
    message: str
    image_from_base: NDArray[np.float64]
    displacement_px: float
    rms_px: float


def demosaic(mosaic: ArrayLike, *, colors: str | None = None, threads: int = ALL_CORES) -> list[NDArray[np.float32]]:
    """Split a 2×2 polarizer mosaic (H×W, linear) into four images: cell top left, top right, bottom left, bottom right.

    Every image has the mosaic's pixels, so that all four show the same point at the same pixel: H×W, or H×W×3 for a
    color camera, whose `colors` is the Bayer pattern of the cells by rows, "RGGB"; all colors are taken to be polarized alike.
    Sides are multiples of 2, in color of 4.
    """
    image = as_image(mosaic, "mosaic")
    if colors is None:
        return _core.demosaic(image, threads)
    if colors not in ("RGGB", "BGGR", "GRBG", "GBRG"):
        raise ValueError(f'colors = {colors!r}, expected "RGGB", "BGGR", "GRBG" or "GBRG"')
    channels, ratios = _core.demosaic_color(image, colors, threads)
    factors = np.stack(ratios, axis=-1)
    return [channel[..., None] * factors for channel in channels]


def register(
    images: Sequence[ArrayLike] | NDArray[Any],
    *,
    full_well_e: float = 20000.0,
    read_noise_e: float = 8.0,
    frames_averaged: int = 1,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> list[Registration]:
    """Register linear images (K arrays H×W) to the first by affine maps, all together; one `Registration` an image."""
    found = _core.register_images(
        as_images(images, "images"),
        (options or Options()).to_json(),
        frames_averaged,
        full_well_e,
        read_noise_e,
        threads,
    )
    return [Registration(**entry) for entry in found]
