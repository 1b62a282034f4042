"""Relief of depth maps, and its shading."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from malus.workspace import Raster

#: Sine of the angle beyond grazing light at which relief shading becomes black.
_BEYOND_GRAZING = 0.342


def flattened(depth: Raster) -> Raster:
    """Relief of a depth map, towards the camera: minus the depth, without the plane that fits it."""
    relief = -depth.astype(float)
    known = np.isfinite(relief)
    v, u = np.nonzero(known)
    design = np.stack([u, v, np.ones(len(u))], -1)
    stride = max(1, len(u) // 20000)
    coefficients = np.linalg.lstsq(design[::stride], relief[known][::stride], rcond=None)[0]
    relief[known] -= design @ coefficients
    return relief.astype(np.float32)


def _slope(relief: Raster, axis: int) -> Raster:
    """Mean of the differences to both neighbors along an axis; at borders the difference to the only neighbor, without neighbors 0."""
    steps = np.diff(relief, axis=axis)
    empty = np.full_like(np.take(relief, [0], axis=axis), np.nan)
    before, after = np.concatenate([empty, steps], axis), np.concatenate([steps, empty], axis)
    slope = np.where(np.isnan(before), after, np.where(np.isnan(after), before, (before + after) / 2))
    return np.nan_to_num(slope)


def hillshade(relief: Raster, pixel: float, azimuth_deg: float = 315, altitude_deg: float = 45) -> Raster:
    """Relief shading, 0 … 1, NaN where there is no relief; not stretched, so that two pictures can be compared.

    It is linear in the cosine of the angle between normal and light, and reaches black 20° beyond the grazing angle, so that round
    objects show form on their side away from the light. The light comes from `azimuth_deg` (clockwise from up) and `altitude_deg`;
    `pixel`: size of a pixel in the relief's unit.
    """
    azimuth, altitude = np.radians(azimuth_deg), np.radians(altitude_deg)
    right, up = _slope(relief, 1) / pixel, -_slope(relief, 0) / pixel
    towards = np.sin(altitude) - np.cos(altitude) * (np.sin(azimuth) * right + np.cos(azimuth) * up)
    cosine = towards / np.sqrt(1 + right**2 + up**2)
    shade = np.clip((cosine + _BEYOND_GRAZING) / (1 + _BEYOND_GRAZING), 0, 1)
    return np.where(np.isfinite(relief), shade, np.nan).astype(np.float32)


def gray(shade: Raster) -> NDArray[np.uint8]:
    """Shading 0 … 1 as gray with alpha, transparent where it is NaN."""
    known = np.isfinite(shade)
    level = np.rint(255 * np.clip(np.where(known, shade, 0), 0, 1)).astype(np.uint8)
    return np.stack([level, np.where(known, 255, 0).astype(np.uint8)], -1)
