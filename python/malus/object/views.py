"""Finished stations as views of one object: their surfaces in the world, and the projection of world points into the views."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus._extra import extra
from malus.object.arrays import on_disk
from malus.workspace import Workspace

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]

#: Rims are not used: places where the cosine of the angle between normal and viewing ray is smaller.
LEAST_COSINE = 0.17
#: Pixels, and standard deviations, that differ by less than this factor count as equally large.
ALIKE = 1.25
#: Up to this many pixels from a step in depth or from the contour, pixels mix foreground and background.
_RIM_PX = 2
#: A depth difference of more than this many GSD between neighboring pixels, widened by the slope, is a step.
_STEP_GSD = 6.0


def scipy(module: str) -> ModuleType:
    """A module of scipy; ExternalError if the package is not installed."""
    return extra(f"scipy.{module}", "scipy", "the surface of an object", "object")


def unit(vectors: Floats) -> Floats:
    """Vectors (…×3) divided by their lengths; zero stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30))


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

    def off(self, points: Floats) -> Floats:
        """Signed distance of the surface from the points that were looked up (N×3), along the surface's normal."""
        return np.asarray((self.normals * (self.points - points)).sum(-1))


@dataclass(frozen=True)
class View:
    """A station's surface. Maps are H×W (×3), station unit, world frame. `usable` marks where the surface is trusted; `object` marks
    where the object may be: the reconstructed pixels and a rim about them.

    sigma: one standard deviation along the normal. cosine: of the angle between normal and viewing ray. Maps are in single
    precision, as the station's own rasters are: many stations of many megapixels are read together.
    """

    name: str
    gsd: float
    focal: tuple[float, float]
    center: tuple[float, float]
    rotation: Floats
    translation: Floats
    depth: Singles
    normals: Singles
    sigma: Singles
    cosine: Singles
    usable: Bools
    object: Bools
    color: Singles

    @property
    def eye(self) -> Floats:
        """Projection center in the world."""
        return np.asarray(-self.rotation.T @ self.translation)

    @cached_property
    def usual_sigma(self) -> float:
        """Median standard deviation where the surface is usable; the GSD if it is so nowhere."""
        return float(np.median(self.sigma[self.usable])) if self.usable.any() else self.gsd

    def resolves_more(self, other: View) -> bool:
        """Whether this view's pixels are clearly smaller than another's and its surface is as sure: it has detail that the other has not."""
        return other.gsd > ALIKE * self.gsd and self.usual_sigma <= ALIKE * other.usual_sigma

    def finer(self, cosine: Floats, other: View, other_cosine: Floats) -> Bools:
        """Which places this view shows in more detail than another does, by the cosines (N) of the angles under which they see them.

        A pixel covers the more of a surface the flatter it sees it, so that a near view at a flat angle may be the coarser one.
        """
        if not self.resolves_more(other):
            return np.zeros(len(cosine), bool)
        return np.asarray(other.gsd * cosine > ALIKE * self.gsd * other_cosine)

    def points_at(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> Floats:
        """World points (…×3) of the surface in these pixels."""
        z = self.depth[rows, columns].astype(np.float64)
        x, y = (columns - self.center[0]) / self.focal[0] * z, (rows - self.center[1]) / self.focal[1] * z
        return np.asarray((np.stack([x, y, z], -1) - self.translation) @ self.rotation)

    def may_see(self, points: Floats) -> bool:
        """Whether the box about world points (N×3) reaches into the camera's field of view. Quick; if False, no point is in the image."""
        if not len(points):
            return False
        height, width = self.depth.shape
        low, high = points.min(0), points.max(0)
        corners = np.array(list(itertools.product(*zip(low, high, strict=True)))) @ self.rotation.T + self.translation
        x, y, z = corners.T
        u, v = self.focal[0] * x + self.center[0] * z, self.focal[1] * y + self.center[1] * z
        # The box is outside if all its corners lie beyond one of the planes that bound the field of view.
        beside = (z <= 0, u < -z, v < -z, u > width * z, v > height * z)
        return not any(side.all() for side in beside)

    def project(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Pixel coordinates u, v and depth z of world points (N×3)."""
        x, y, z = (points @ self.rotation.T + self.translation).T
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.focal[0] * x / z + self.center[0], self.focal[1] * y / z + self.center[1], z

    def _pixels(self, points: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats, Bools]:
        """Row, column and depth z of world points (N×3), and which of them fall into the image; the first pixel for all others."""
        height, width = self.depth.shape
        u, v, z = self.project(points)
        inside = np.asarray((z > 0) & (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5))
        column, row = (np.where(inside, np.rint(x), 0).astype(np.int64) for x in (u, v))
        return row, column, z, inside

    def meet(self, points: Floats) -> Meeting:
        """The surface in the pixels that world points (N×3) fall into."""
        row, column, z, inside = self._pixels(points)
        there = inside & self.usable[row, column]
        return Meeting(
            column, row, z, self.points_at(row, column), self.normals[row, column].astype(np.float64),
            self.sigma[row, column].astype(np.float64), np.where(there, self.cosine[row, column].astype(np.float64), 0.0),
        )  # fmt: skip

    def facing(self, points: Floats, normals: Floats) -> Floats:
        """Cosine of the angle under which this view would see places with these normals (N×3); negative from behind."""
        to_eye = self.eye - points
        return np.asarray((normals * to_eye).sum(1) / np.linalg.norm(to_eye, axis=1))

    def placed(self, points: Floats) -> tuple[Bools, Bools]:
        """Which world points (N×3) fall into the image, and which of them fall on the object."""
        row, column, _, inside = self._pixels(points)
        return inside, np.asarray(inside & self.object[row, column])

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
    if not view.may_see(points):
        return np.zeros(len(points), bool)
    at = view.meet(points)
    facing = view.facing(points, normals) > LEAST_COSINE
    return np.asarray((at.weight > 0) & facing & (np.abs(at.off(points)) < 4 * np.hypot(at.sigma, view.gsd)))


def stored(view: View, folder: Path) -> View:
    """The view with its maps in files of a new folder."""
    names = ("depth", "normals", "sigma", "cosine", "usable", "object", "color")
    maps: dict[str, Any] = {name: on_disk(getattr(view, name), folder / name) for name in names}
    return replace(view, **maps)


def load_view(name: str, folder: Path, most_sigma_gsd: float) -> View:
    """The surface of a station's finished workspace. Pixels whose sigma is above `most_sigma_gsd` GSD are not usable."""
    workspace = Workspace(folder)
    surface = workspace.surface()
    camera, (rotation, translation) = workspace.camera, workspace.pose
    depth = surface.depth.astype(np.float64)
    rays = workspace.rays()
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
        depth=surface.depth,
        normals=(normals @ rotation).astype(np.float32),
        sigma=sigma.astype(np.float32),
        cosine=cosine.astype(np.float32),
        usable=usable,
        object=_grown(known),
        color=workspace.color().reshape(*depth.shape, -1),
    )


def _rims(depth: Floats, gsd: Floats, cosine: Floats, known: Bools) -> Bools:
    """Pixels near the contour or a step in depth."""
    edge = ~known
    slope = np.sqrt(np.clip(1 / np.maximum(cosine, LEAST_COSINE) ** 2 - 1, 0, None))
    most = _STEP_GSD * gsd * (1 + slope)
    down = np.abs(np.diff(depth, axis=0)) > np.maximum(most[:-1], most[1:])
    across = np.abs(np.diff(depth, axis=1)) > np.maximum(most[:, :-1], most[:, 1:])
    edge[:-1] |= down
    edge[1:] |= down
    edge[:, :-1] |= across
    edge[:, 1:] |= across
    return _grown(edge)


def _grown(region: Bools) -> Bools:
    """A region and the pixels within _RIM_PX of it."""
    return np.asarray(scipy("ndimage").binary_dilation(region, iterations=_RIM_PX))
