"""Finished stations as views of one object: their surfaces in the world, and the projection of world points into the views."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus.workspace import Workspace

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Rims are not used: places where the cosine of the angle between normal and viewing ray is smaller.
LEAST_COSINE = 0.17
#: Up to this many pixels from a step in depth or from the contour, pixels mix foreground and background.
_RIM_PX = 2
#: A depth difference of more than this many GSD between neighboring pixels, widened by the slope, is a step.
_STEP_GSD = 6.0


@dataclass(frozen=True)
class Meeting:
    """Where points fall in a view, N each: pixel, depth of the point, and the view's surface in this pixel.

    depth: of the points (z). points, normals: of the surface in the same pixel (N×3, world). sigma: standard deviation of this
    surface along its normal. weight: cosine of the angle under which the surface is seen, 0 where there is no usable surface.
    """

    u: NDArray[np.int64]
    v: NDArray[np.int64]
    depth: Floats
    points: Floats
    normals: Floats
    sigma: Floats
    weight: Floats


@dataclass(frozen=True)
class View:
    """A station's surface. Maps are H×W (×3), station unit, world frame. `usable` marks where the surface is trusted; `object` marks
    where the object may be: the reconstructed pixels and a rim about them.

    sigma: one standard deviation along the normal. cosine: of the angle between normal and viewing ray.
    """

    name: str
    gsd: float
    focal: tuple[float, float]
    center: tuple[float, float]
    rotation: Floats
    translation: Floats
    depth: Floats
    points: Floats
    normals: Floats
    sigma: Floats
    cosine: Floats
    usable: Bools
    object: Bools
    color: Floats

    @property
    def eye(self) -> Floats:
        """Projection center in the world."""
        return np.asarray(-self.rotation.T @ self.translation)

    def project(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Pixel coordinates u, v and depth z of world points (N×3)."""
        x, y, z = (points @ self.rotation.T + self.translation).T
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.focal[0] * x / z + self.center[0], self.focal[1] * y / z + self.center[1], z

    def meet(self, points: Floats) -> Meeting:
        """The surface in the pixels that world points (N×3) fall into."""
        height, width = self.depth.shape
        u, v, z = self.project(points)
        inside = (z > 0) & (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
        column, row = (np.where(inside, np.rint(x), 0).astype(np.int64) for x in (u, v))
        there = inside & self.usable[row, column]
        return Meeting(
            column, row, z, self.points[row, column], self.normals[row, column], self.sigma[row, column],
            np.where(there, self.cosine[row, column], 0.0),
        )  # fmt: skip

    def facing(self, points: Floats, normals: Floats) -> Floats:
        """Cosine of the angle under which this view would see places with these normals (N×3); negative from behind."""
        to_eye = self.eye - points
        return np.asarray((normals * to_eye).sum(1) / np.linalg.norm(to_eye, axis=1))

    def placed(self, points: Floats) -> tuple[Bools, Bools]:
        """Which world points (N×3) fall into the image, and which of them fall on the object."""
        height, width = self.depth.shape
        u, v, z = self.project(points)
        inside = (z > 0) & (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
        column, row = (np.where(inside, np.rint(x), 0).astype(np.int64) for x in (u, v))
        return np.asarray(inside), np.asarray(inside & self.object[row, column])

    def in_front(self, points: Floats, margin: float) -> Bools:
        """Which world points (N×3) lie in front of this view's surface by more than `margin` standard deviations.

        The camera saw the surface through these points, so nothing is there. False where the surface is not usable.
        """
        at = self.meet(points)
        gap = self.depth[at.v, at.u] - at.depth
        allowed = margin * np.hypot(at.sigma, self.gsd) / np.maximum(at.weight, LEAST_COSINE)
        return np.asarray((at.weight > 0) & (gap > allowed))


def sees(view: View, points: Floats, normals: Floats) -> Bools:
    """Which places of a surface (N×3, with normals) the view has measured."""
    at = view.meet(points)
    off = np.abs((at.normals * (at.points - points)).sum(1))
    facing = view.facing(points, normals) > LEAST_COSINE
    return np.asarray((at.weight > 0) & facing & (off < 4 * np.hypot(at.sigma, view.gsd)))


def load_view(name: str, folder: Path, most_sigma_gsd: float) -> View:
    """The surface of a station's finished workspace. Pixels whose sigma exceeds `most_sigma_gsd` GSD are not usable."""
    workspace = Workspace(folder)
    surface = workspace.surface()
    camera, (rotation, translation) = workspace.camera, workspace.pose
    depth = surface.depth.astype(np.float64)
    rows, columns = np.indices(depth.shape, dtype=np.float64)
    rays = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(depth)], -1)
    in_camera = rays * depth[..., None]
    length = np.linalg.norm(rays, axis=-1)
    normals = surface.normals.astype(np.float64)
    cosine = -(normals * rays).sum(-1) / length
    # An error of depth moves the point along its ray; sigma is needed along the normal.
    sigma = surface.sigma * length * np.clip(cosine, LEAST_COSINE, 1)
    gsd = depth / camera.fx
    known = np.isfinite(depth) & np.isfinite(sigma) & np.isfinite(normals).all(-1)
    with np.errstate(invalid="ignore"):
        usable = known & ~_rims(depth, gsd, cosine, known) & (cosine > LEAST_COSINE) & (sigma < most_sigma_gsd * gsd)
    return View(
        name=name,
        gsd=float(np.median(gsd[known])),
        focal=(camera.fx, camera.fy),
        center=(camera.cx, camera.cy),
        rotation=rotation,
        translation=translation,
        depth=depth,
        points=(in_camera - translation) @ rotation,
        normals=normals @ rotation,
        sigma=sigma,
        cosine=cosine,
        usable=usable,
        object=_grown(known),
        color=workspace.color().astype(np.float64).reshape(*depth.shape, -1),
    )


def _rims(depth: Floats, gsd: Floats, cosine: Floats, known: Bools) -> Bools:
    """Pixels near the contour or a step in depth."""
    edge = ~known
    slope = np.sqrt(np.clip(1 / np.maximum(cosine, LEAST_COSINE) ** 2 - 1, 0, None))
    for axis in (0, 1):
        step = np.abs(np.diff(depth, axis=axis)) > _most(_STEP_GSD * gsd * (1 + slope), axis)
        edge |= np.concatenate([step, np.zeros_like(step.take([0], axis))], axis)
        edge |= np.concatenate([np.zeros_like(step.take([0], axis)), step], axis)
    return _grown(edge)


def _grown(region: Bools) -> Bools:
    """A region and the pixels within _RIM_PX of it."""
    for _ in range(_RIM_PX):
        grown = region.copy()
        grown[1:] |= region[:-1]
        grown[:-1] |= region[1:]
        grown[:, 1:] |= region[:, :-1]
        grown[:, :-1] |= region[:, 1:]
        region = grown
    return region


def _most(values: Floats, axis: int) -> Floats:
    """The larger of each two neighbors along an axis."""
    first, second = np.split(np.arange(values.shape[axis]), [1])
    return np.asarray(np.maximum(values.take(np.concatenate([first, second[:-1]]), axis), values.take(second, axis)))
