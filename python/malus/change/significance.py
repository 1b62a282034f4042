"""Signed distances between two registered surfaces by M3C2, and the smallest detectable change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from malus import m3c2
from malus.change.registration import Registration
from malus.errors import DataError
from malus.exports.exporter import Exporter
from malus.prior import project_mesh
from malus.raster import reduced, sample_known

Floats = NDArray[np.float32]
#: Standard deviations that a change must exceed (95 %).
_CONFIDENCE = 1.96


@dataclass(frozen=True)
class Distances:
    """Maps in the earlier station's view, H×W, its unit, NaN = not compared.

    distance: along the earlier surface's normal, positive where the later surface lies in front of it. limit: the smallest detectable
    change (95 %). depth_after: the later surface's depth in the earlier view. radius: of the cylinders, station unit.
    """

    distance: Floats
    limit: Floats
    depth_after: Floats
    radius: float

    @property
    def significant(self) -> NDArray[np.bool_]:
        """Where the distance exceeds its limit."""
        return np.asarray(np.abs(self.distance) > self.limit)


def measure(before: Exporter, after: Exporter, registration: Registration, threads: int) -> Distances:
    """Distances at the pixels of the earlier surface; DataError if nothing could be compared.

    The limit is the larger of two values. The first is the detection limit of M3C2, from the scatter of both surfaces in its cylinders
    and from the registration error (Lague, Brodu and Leroux 2013, Eq 1). The second is 1.96 standard deviations of the difference,
    from the standard deviations that both surfaces state.
    """
    grid = before.workspace.points()
    known = np.asarray(np.isfinite(grid).all(-1))
    step = m3c2.thinning(int(known.sum()))
    core = known[::step, ::step]
    mesh = after.mesh()
    points = registration.motion.apply(mesh.vertices)
    gsd = max(float(exporter.workspace.quality["gsd"]) for exporter in (before, after))
    radius = m3c2.cylinder_radius(gsd)
    depth_after = _seen_from(before, after, points, mesh.triangles, registration, threads)
    towards = -before.rotation[2]
    distance, detectable = m3c2.distances(
        grid[known],
        points,
        grid[::step, ::step][core],
        grid[known],
        radius=radius,
        largest=_largest(before.surface.depth, depth_after, gsd),
        towards=towards,
        registration=registration.error,
    )
    if not np.isfinite(distance).any():
        raise DataError(f"{after.workspace.folder}: no part of its surface lies near that of {before.workspace.folder}")
    stated = _CONFIDENCE * _stated_sigma(before, after, registration, grid[::step, ::step][core])
    # A cylinder with too few points has no scatter and no M3C2 limit: add the registration error to the stated one instead.
    # Just beyond the later surface's rim no deviation is stated: there M3C2's limit is the only one.
    told = np.where(np.isfinite(detectable), np.fmax(detectable, stated), stated + _CONFIDENCE * registration.error)
    # Without a limit nothing could be said of a distance.
    distance = np.where(np.isfinite(told), distance, np.nan)
    limit = np.where(np.isfinite(distance), told, np.nan)
    if not np.isfinite(distance).any():
        raise DataError(
            f"{after.workspace.folder}: neither its surface nor that of {before.workspace.folder} has a standard deviation where they meet"
        )
    distances, limits = (m3c2.spread_out(values, step, known) for values in (distance, limit))
    return Distances(distances, limits, depth_after, radius)


def _seen_from(
    before: Exporter,
    after: Exporter,
    points: NDArray[np.float64],
    triangles: NDArray[np.uint32],
    registration: Registration,
    threads: int,
) -> Floats:
    """Depth of the later surface (its mesh in the earlier frame) in the earlier view, NaN where the later station did not see it."""
    seen = np.isfinite(before.surface.depth)
    prior = project_mesh(points, triangles, before.workspace.camera, mask=seen, threads=threads)
    # `project_mesh` fills holes: remove pixels whose point the later station did not see.
    depth = prior.depth.copy()
    depth[~_seen_by(after, registration, before.workspace.points(depth))] = np.nan
    return depth


def _later_pixels(after: Exporter, registration: Registration, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels of the later image at which points of the earlier frame (…×3) are seen."""
    return after.pixels((points - registration.motion.translation) @ registration.motion.rotation)


def _seen_by(after: Exporter, registration: Registration, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    pixels = _later_pixels(after, registration, points)
    height, width = after.surface.depth.shape
    with np.errstate(invalid="ignore"):
        inside = (pixels >= -0.5).all(-1) & (pixels[..., 0] < width - 0.5) & (pixels[..., 1] < height - 0.5)
    at = np.rint(np.where(inside[..., None], pixels, 0)).astype(int)
    return np.asarray(inside & np.isfinite(after.surface.depth[at[..., 1], at[..., 0]]))


def _largest(depth: Floats, depth_after: Floats, gsd: float) -> float:
    """Half length of the cylinders: 10 GSD plus twice the movement that all but a thousandth of the pixels stay below."""
    moved = np.abs(depth_after - depth)
    moved = moved[np.isfinite(moved)]
    return 10 * gsd + (2 * float(np.percentile(moved, 99.9)) if moved.size else 0.0)


def _stated_sigma(
    before: Exporter, after: Exporter, registration: Registration, points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """One standard deviation of the difference of both surfaces at points of the earlier frame (N×3), from the stated standard deviations."""
    pairs = ((before, before.pixels(points)), (after, _later_pixels(after, registration, points)))
    variances = [sample_known(exporter.surface.sigma, at) ** 2 for exporter, at in pairs]
    return np.asarray(np.sqrt(sum(variances)))


def reduced_maps(distances: Distances, step: int) -> tuple[Floats, Floats]:
    """Distance, and distance only where it is significant, reduced to the size of the pictures."""
    return reduced(distances.distance, step), reduced(
        np.where(distances.significant, distances.distance, np.nan).astype(np.float32), step
    )
