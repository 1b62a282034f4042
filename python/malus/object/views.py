"""Finished stations as views of one object: their surfaces in the world. The library (cpp/malus/object) computes on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus._extra import extra
from malus.camera import Camera
from malus.object.arrays import on_disk
from malus.threads import ALL_CORES
from malus.workspace import Workspace

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]

#: The maps of a View.
_MAPS = ("depth", "normals", "sigma", "cosine", "usable", "object", "color")


def scipy(module: str) -> ModuleType:
    """A module of scipy; ExternalError if the package is not installed."""
    return extra(f"scipy.{module}", "scipy", "the surface of an object", "object")


def unit(vectors: Floats) -> Floats:
    """Vectors (…×3) divided by their lengths; zero stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30))


@dataclass(frozen=True)
class View:
    """A station's surface. Maps are H×W (×3), station unit, world frame. `usable` marks where the surface is trusted; `object` marks
    where the object may be: the reconstructed pixels and a rim about them.

    sigma: one standard deviation along the normal. cosine: of the angle between normal and viewing ray. Maps are in single
    precision, as the station's own rasters are: many stations of many megapixels are read together. shared_px: errors of depth are
    alike up to this distance, in pixels. most_sigma: no usable pixel has a larger sigma. unsure: share of the surface that is not usable
    for this reason.
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
    shared_px: float = 1.0
    most_sigma: float = math.inf
    unsure: float = 0.0

    @cached_property
    def core(self) -> _core.ObjectView:
        """The same view for the library, without a copy of maps in single precision. InputError if maps differ in size."""
        height, width = self.depth.shape
        camera = Camera("PINHOLE", width, height, [*self.focal, *self.center], self.rotation, self.translation)
        masks = (np.asarray(mask, bool).view(np.uint8) for mask in (self.usable, self.object))
        return _core.ObjectView(
            self.name, self.gsd, self.shared_px, camera, self.depth, self.normals, self.sigma, self.cosine, *masks
        )

    @property
    def eye(self) -> Floats:
        """Projection center in the world."""
        return self.core.eye

    def resolves_more(self, other: View) -> bool:
        """Whether this view has detail that another lacks: its pixels are clearly smaller, and its surface is as certain."""
        return self.core.resolves_more(other.core)

    def finer(self, cosine: Floats, other: View, other_cosine: Floats) -> Bools:
        """Which places this view shows in more detail than another does, by the cosines (N) of the angles under which they see them.

        The flatter the angle at which a pixel sees a surface, the more of the surface it covers; so a near view at a flat angle may be the
        coarser one.
        """
        return self.core.finer(cosine, other.core, other_cosine)

    def points_at(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> Floats:
        """World points (…×3) of the surface in these pixels. InputError if one of them is outside of the image."""
        return self.core.points_at(rows.ravel(), columns.ravel()).reshape(*rows.shape, 3)

    def sights(self, points: Floats, normals: Floats) -> tuple[NDArray[np.int32], NDArray[np.int32], Floats]:
        """Row, column and cosine of the angle under which this view sees places of a surface (N×3, with normals) that it has measured
        (`sees`); the first pixel and 0 for all others.
        """
        return self.core.sights(points, normals)


def sees(view: View, points: Floats, normals: Floats) -> Bools:
    """Which places of a surface (N×3, with normals) the view has measured: its own surface is at most four standard deviations away."""
    return view.sights(points, normals)[2] > 0


def may_see(views: Sequence[View], points: Floats) -> list[int]:
    """Numbers of the views whose field of view reaches into the box about these points (N×3): no other view sees any of them."""
    if not len(points):
        return []
    low, high = points.min(0), points.max(0)
    return [k for k, view in enumerate(views) if view.core.may_see(low, high)]


def stored(view: View, folder: Path, names: Sequence[str] = _MAPS) -> View:
    """The view with its maps, or those that are named, in files of a new folder."""
    maps: dict[str, Any] = {name: on_disk(getattr(view, name), folder / name) for name in names}
    return replace(view, **maps)


def load_view(name: str, folder: Path, most_sigma_gsd: float | None = None, threads: int = ALL_CORES) -> View:
    """The surface of a station's finished workspace. Pixels whose sigma is above `most_sigma_gsd` GSD are not usable; None: above four
    GSD and above four standard deviations of a point of the station's prior, which does not become surer with smaller pixels.
    """
    workspace = Workspace(folder)
    surface, prior = workspace.surface(), workspace.manifest["steps"]["prior"]["notes"]
    camera, (rotation, translation) = workspace.camera, workspace.pose
    gsd = _core.median_gsd(surface)
    most = _core.most_sigma_gsd(gsd, prior["noise"]) if most_sigma_gsd is None else most_sigma_gsd
    maps = _core.view_maps(surface, most, threads)
    sigma_gsd = maps["sigma"] / (surface.depth / camera.fx)
    known = np.isfinite(sigma_gsd)
    return View(
        name=name,
        gsd=gsd,
        focal=(camera.fx, camera.fy),
        center=(camera.cx, camera.cy),
        rotation=rotation,
        translation=translation,
        depth=surface.depth,
        normals=maps["normals"],
        sigma=maps["sigma"],
        cosine=maps["cosine"],
        usable=maps["usable"].view(bool),
        object=maps["object"].view(bool),
        color=workspace.color().reshape(*surface.depth.shape, -1),
        shared_px=_core.shared_px(prior["smoothing_px"]),
        most_sigma=most * gsd,
        unsure=float((sigma_gsd[known] >= most).mean()) if known.any() else 0.0,
    )
