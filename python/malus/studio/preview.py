"""Previews intensity, degree and phase of a few polarized images within seconds, before there is a station file."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import evidence, polarization
from malus.capture import linearize
from malus.encoding import exponent_of
from malus.errors import InputError
from malus.pictures import data_url
from malus.raster import reduced, step_for
from malus.studio.pictures import colored, linear_or_encoded

#: Long side of the previews.
SIDE_PX = 640


def decoded(pixels: NDArray[np.float32], response: str) -> NDArray[np.float32]:
    """Linear intensity of encoded pixels in [0, 1]. response: as in the station file, linear, srgb or gamma:G."""
    if response == "linear":
        return pixels
    if exponent_of(response) is None:
        raise InputError(f"response = {response!r}, expected linear, srgb or gamma:2.2 for a preview")
    return linearize(pixels, response=response)


def small_images(
    paths: Sequence[Path], response: str, exposure_s: Sequence[float] | None = None
) -> list[NDArray[np.float32]]:
    """The images, linear, reduced, and scaled to equal exposure and below 1, so that no pixel counts as saturated.

    Pixels that are saturated in the files are flat in all images.
    """
    stack = [_small(path, response) for path in paths]
    if len({image.shape for image in stack}) > 1:
        raise InputError("the images are not of one size, expected one camera and one setting")
    if exposure_s:
        stack = [image / np.float32(seconds) for image, seconds in zip(stack, exposure_s, strict=True)]
    white = max(float(image.max()) for image in stack)
    return [image / np.float32(1.02 * max(white, 1e-12)) for image in stack]


def _small(path: Path, response: str) -> NDArray[np.float32]:
    pixels, _ = linear_or_encoded(path, half_size=True)
    gray = pixels if pixels.ndim == 2 else pixels.mean(-1)
    return decoded(reduced(gray, step_for(gray.shape, SIDE_PX)), response)


def angles_from_x(angles_deg: Sequence[float], direction: str, zero_deg: float) -> list[float]:
    """Angles of the filter's scale, in radians counter-clockwise from image +x; direction and zero as in the station file."""
    sign = -1.0 if direction == "cw" else 1.0
    return [float(np.radians(sign * (angle - zero_deg))) for angle in angles_deg]


def as_picture(values: NDArray[Any], colors: str, low: float, high: float) -> str:
    """Data URL of a picture in the colors of a matplotlib color map; gray where there is no value."""
    picture = colored(values, colors, low, high)[..., :3]
    picture[~np.isfinite(values)] = 128
    return data_url(picture, "WEBP", quality=88)


def preview(
    paths: Sequence[Path],
    angles_deg: Sequence[float],
    *,
    direction: str,
    zero_deg: float,
    response: str,
    exposure_s: Sequence[float] | None = None,
) -> dict[str, Any]:
    """Pictures of intensity, degree and phase as data URLs, their ranges, and the findings of checks that need the images alone.

    Angles are those of the filter's scale; `direction`, `zero_deg` and `exposure_s` as in the station file. Raises InputError or
    DataError (fewer than three angles).
    """
    start = time.monotonic()
    images = small_images(paths, response, exposure_s)
    angles_rad = angles_from_x(angles_deg, direction, zero_deg)
    state = polarization.decompose(images, angles_rad)
    degree = np.asarray(state.degree)
    light = np.maximum(state.unpolarized, 0)
    low, high = (float(p) for p in np.nanpercentile(light, [0.5, 99.5]))
    top = float(np.nanpercentile(degree, 99))
    findings = [evidence.check_order(images, angles_rad)]
    if len(images) > 3:
        findings.append(evidence.check_response(images, angles_rad))  # type: ignore[arg-type]
    return {
        "intensity": as_picture(light ** (1 / 2.2), "gray", low ** (1 / 2.2), high ** (1 / 2.2)),
        "degree": as_picture(degree, "viridis", 0, top),
        "phase": as_picture(np.degrees(np.asarray(state.phase_rad)), "twilight", 0, 180),
        "degree_top": top,
        "degree_median": float(np.nanmedian(degree)),
        "findings": [
            {"severity": f.severity, "message": f.message, "suggestion": f.suggestion} for f in findings
        ],
        "seconds": time.monotonic() - start,
    }  # fmt: skip
