"""Checks the direction and zero of the filter's scale: compares the measured phase with the phase expected from the coarse surface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import malus
from malus import evidence, polarization
from malus._extra import extra
from malus.camera import Camera
from malus.errors import DataError, InputError
from malus.overlay import nearest_points
from malus.planning import prior_upon_image
from malus.studio.preview import angles_from_x, as_picture, small_images

#: Radius over which points of a cloud are averaged, in cells of about one point each: single points give no slopes.
_SMOOTH_CELLS = 3.0
#: Least share of the cells around a pixel that must have a point.
_LEAST_POINTS = 0.3


def compared(station: malus.Station, threads: int) -> dict[str, Any]:
    """Pictures of both phases as data URLs, and the finding of the check that a run makes before it fuses.

    Raises InputError for a station whose angles are not given, or whose camera takes them all at once; DataError without a
    coarse surface in the image.
    """
    said = station.describe()
    angles = said["angles_deg"]
    if said["mosaic"] or not isinstance(angles, list) or len(angles) != len(said["images"]):
        raise InputError("this is for one image an angle, with all angles given; the run checks others")
    image, mask, points = prior_upon_image(station, threads=threads)
    if said.get("camera") is None or not len(points):
        raise DataError("the coarse surface covers no pixel of the polarized image, or there is none yet")
    paths = [Path(path) for path in said["images"]]
    images = small_images(paths, said["response"], said["exposure_s"])
    state = polarization.decompose(images, angles_from_x(angles, said["angle_direction"], said["angle_zero_deg"]))
    step = image.shape[1] / images[0].shape[1]
    lens = Camera.from_description(said["camera"])
    normals = _normals(points, image.shape, images[0].shape, (step / lens.fx, step / lens.fy))
    normals[_resampled((mask != 0).astype(np.float64), images[0].shape, step) < 1] = np.nan
    found = evidence.check_phase(state, normals, threads=threads)
    # The expected phase is that of diffuse reflection; for specular reflection it differs by 90°.
    azimuth = np.degrees(np.arctan2(-normals[..., 1], normals[..., 0])) % 180
    return {
        "measured": as_picture(np.degrees(np.asarray(state.phase_rad)), "twilight", 0, 180),
        "expected": as_picture(azimuth, "twilight", 0, 180),
        "severity": found.severity,
        "message": found.message,
        "suggestion": found.suggestion,
    }


def _normals(
    points: NDArray[np.float32], whole: tuple[int, ...], small: tuple[int, ...], pixel: tuple[float, float]
) -> NDArray[np.float32]:
    """Normals of the coarse surface at each pixel of a small image, towards the camera; NaN where there are too few points.

    points: N×3, u, v [px of the whole image] and distance; pixel: width and height of a small pixel at distance one.
    """
    ndimage = extra("scipy.ndimage", "scipy", "comparing the phase", "studio")
    distance, cell = nearest_points(points, whole)
    there = np.isfinite(distance)
    share = ndimage.gaussian_filter(there.astype(np.float64), _SMOOTH_CELLS)
    mean = ndimage.gaussian_filter(np.where(there, distance, 0).astype(np.float64), _SMOOTH_CELLS) / np.maximum(
        share, 1e-9
    )
    step = whole[1] / small[1] / cell
    depth = _resampled(mean, small, step)
    down, right = np.gradient(depth)
    wide, high = np.array(pixel) * float(np.median(points[:, 2]))
    normals = np.dstack([right / wide, down / high, -np.ones(small)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    normals[ndimage.minimum_filter(_resampled(share, small, step), 5) < _LEAST_POINTS] = np.nan
    return normals.astype(np.float32)


def _resampled(values: NDArray[np.float64], shape: tuple[int, ...], step: float) -> NDArray[np.float64]:
    """Values at the centers of the pixels of a small image; `step`: side of such a pixel, in pixels of `values`."""
    ndimage = extra("scipy.ndimage", "scipy", "comparing the phase", "studio")
    rows, columns = ((np.arange(side) + 0.5) * step - 0.5 for side in shape)
    found: NDArray[np.float64] = ndimage.map_coordinates(
        values, np.meshgrid(rows, columns, indexing="ij"), order=1, mode="nearest"
    )
    return found
