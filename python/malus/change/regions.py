"""Connected parts of a surface that changed: where, how large, how deep, how much was lost or added."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from malus._extra import extra
from malus.change.significance import Distances
from malus.exports.exporter import Exporter
from malus.units import METERS


@dataclass(frozen=True)
class Region:
    """One changed part. u, v: its center in the earlier image, pixels; x, y, z: its center in the earlier world frame, station unit.

    mean_um, extreme_um: mean and largest distance, positive = material in front of the earlier surface. volume_mm3: of the material that was added
    (positive) or lost (negative).
    """

    number: int
    u: float
    v: float
    x: float
    y: float
    z: float
    area_mm2: float
    mean_um: float
    extreme_um: float
    volume_mm3: float


def find_regions(before: Exporter, distances: Distances) -> list[Region]:
    """Connected significant pixels of one sign that are unlikely to be chance, largest volume first.

    Among many independent places, some exceed a limit of 95 % by chance. A part is reported only if chance would produce such a
    part anywhere on the surface in at most one of twenty comparisons. One independent place is the section of a cylinder over which
    M3C2 averages; the mean of a part of n sections scatters by 1/√n.
    """
    ndimage = extra("scipy.ndimage", "scipy", "malus compare", "compare")
    normal = extra("scipy.stats", "scipy", "malus compare", "compare").norm
    meter = METERS[before.unit]
    area = pixel_areas(before) * (meter * 1e3) ** 2
    section = np.pi * (distances.radius * meter * 1e3) ** 2
    places = max(np.nansum(area[np.isfinite(distances.limit)]) / section, 1.0)
    by_chance = normal.isf(0.025 / places) / normal.isf(0.025)
    um = distances.distance * meter * 1e6
    points = before.workspace.points()
    found: list[Region] = []
    for sign in (1, -1):
        labels, count = ndimage.label(distances.significant & (sign * um > 0), structure=np.ones((3, 3)))
        for k, box in enumerate(ndimage.find_objects(labels, count), start=1):
            inside = labels[box] == k
            areas = area[box][inside]
            values, limits = um[box][inside], distances.limit[box][inside] * meter * 1e6
            sections = areas.sum() / section
            if sections < 1 or np.average(np.abs(values) / limits, weights=areas) * np.sqrt(sections) < by_chance:
                continue
            rows, columns = np.nonzero(inside)
            u, v = columns.mean() + box[1].start, rows.mean() + box[0].start
            x, y, z = points[box][inside].mean(0).tolist()
            found.append(
                Region(
                    0, float(u), float(v), x, y, z, float(areas.sum()), float(np.average(values, weights=areas)),
                    float(sign * (sign * values).max()), float((values * areas).sum() / 1000),
                )
            )  # fmt: skip
    found.sort(key=lambda region: -abs(region.volume_mm3))
    return [replace(region, number=k) for k, region in enumerate(found, start=1)]


def pixel_areas(exporter: Exporter) -> NDArray[np.float64]:
    """Area of the surface in each pixel, H×W, station unit squared; NaN where there is none."""
    camera, surface = exporter.workspace.camera, exporter.surface
    # A pixel's ray has z = 1: across the axis the pixel covers depth² / (fx fy), and on the surface this area over the cosine.
    facing = np.maximum(-(exporter.workspace.rays() * surface.normals).sum(-1), 0.1)
    return np.asarray(surface.depth.astype(float) ** 2 / (camera.fx * camera.fy) / facing, dtype=np.float64)
