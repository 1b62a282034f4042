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


@dataclass(frozen=True)
class Registration:
    """How one image lies to the first: pixel of the first → pixel of this one is the 2×3 map `image_from_base`."""

    status: str
    message: str
    image_from_base: NDArray[np.float64]
    displacement_px: float
    rms_px: float


def demosaic(mosaic: ArrayLike, *, threads: int = 1) -> list[NDArray[np.float32]]:
    """Split a 2×2 polarizer mosaic (H×W, even sides) into four H×W images: cell top left, top right, bottom left, bottom right.

    Every image is interpolated to the mosaic's pixels, so that all four show the same point at the same pixel.
    """
    return _core.demosaic(as_image(mosaic, "mosaic"), threads)


def register(
    images: Sequence[ArrayLike] | NDArray[Any],
    *,
    full_well_e: float = 20000.0,
    read_noise_e: float = 8.0,
    frames_averaged: int = 1,
    options: Options | None = None,
    threads: int = 1,
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
