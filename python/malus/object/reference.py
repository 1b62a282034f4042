"""Comparison of an object's mesh with a reference scan: registration, distances and completeness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core, registration, scans
from malus._robust import distance_figures
from malus.errors import DataError
from malus.object.meshing import ObjectMesh, face_normals, sums_at_vertices
from malus.object.texture import NearestVertices
from malus.object.views import Floats, View, scipy
from malus.options import Options
from malus.registration import some_of

#: For the registration: stations that are tried, those that see most first; points of the surface and of the reference.
_MOST_STATIONS, _SURFACE_POINTS, _REFERENCE_POINTS = 6, 20_000, 100_000
#: Surfaces farther apart than this (GSD) are not compared.
_FARTHEST_GSD = 50.0
_FAR_AWAY = f"no part of the mesh is within {_FARTHEST_GSD:g} GSD of it; expected the same object and unit"
#: An alignment that ends without convergence after fewer steps found no points near the mesh.
_MOST_STEPS = 60
#: Completeness: part of the reference counts as reconstructed if the mesh lies within this many GSD of it.
_COMPLETE_GSD = (1, 2, 4)
#: Most points of the reference for completeness; most vertices that are compared at once, and most of a mesh that is searched as a whole.
_MOST_LOOKED_FOR, _MOST_AT_ONCE = 1_000_000, 4_000_000


@dataclass(frozen=True)
class Reference:
    """A mesh, or a cloud without triangles. points: N×3. triangles: M×3 indices of points, or None."""

    points: Floats
    triangles: NDArray[np.uint32] | None

    @staticmethod
    def read(path: Path, unit: str) -> Reference:
        """PLY, XYZ, LAS or E57. Raises InputError for a file that cannot be read."""
        if scans.is_scan(path):
            return Reference(scans.read_scan(path, unit).points, None)
        return Reference(*_core.read_cloud_or_mesh(str(path)))

    def moved(self, rotation: Floats, translation: Floats) -> Reference:
        """The reference at rotation · x + translation."""
        return replace(self, points=np.ascontiguousarray(self.points @ rotation.T + translation))

    def areas(self) -> Floats:
        """Area of the surface that each point represents (N), up to a factor."""
        if self.triangles is None:
            return np.ones(len(self.points))
        areas = np.linalg.norm(face_normals(self.points, self.triangles), axis=1)
        return sums_at_vertices(self.triangles, areas, len(self.points))


@dataclass(frozen=True)
class Comparison:
    """reference: in the object's frame. distances: of the mesh's vertices (N), positive outside the reference, NaN where it is not near.
    figures: for quality.json.
    """

    reference: Reference
    distances: NDArray[np.float32]
    figures: dict[str, Any]


def place(reference: Reference, views: Sequence[View]) -> registration.Placement:
    """Pose of a reference that is in another frame, from the first station whose surface determines it.

    Raises DataError if no station's surface does.
    """
    scan = reference.points[some_of(len(reference.points), _REFERENCE_POINTS)]
    failures: list[DataError] = []
    for view in sorted(views, key=lambda view: -int(view.usable.sum()))[:_MOST_STATIONS]:
        rows, columns = np.nonzero(view.usable)
        some = some_of(len(rows), _SURFACE_POINTS)
        points = view.points_at(rows[some], columns[some])
        try:
            return registration.place_reference(points, view.eye - points.mean(0), scan)
        except DataError as error:
            failures.append(error)
    raise failures[0]


def aligned(reference: Reference, mesh: ObjectMesh, gsd: float, threads: int) -> tuple[Reference, bool]:
    """The reference moved onto the mesh by the ICP of `malus assess`, and whether the ICP converged. With a cloud, whose tangent planes
    change from point to point, it may keep moving a little. DataError if no part of the reference is near.
    """
    measured = np.flatnonzero(mesh.measured & mesh.even())
    points = np.ascontiguousarray(mesh.vertices[measured[some_of(len(measured), _SURFACE_POINTS)]])
    found = _core.align_with_reference(
        points, reference.points, reference.triangles, gsd, _options(_FARTHEST_GSD), threads
    )
    if not found["converged"] and found["iterations"] < _MOST_STEPS:
        raise DataError(_FAR_AWAY)
    motion = found["reference_from_surface"]
    rotation = np.array(motion["rotation"]).reshape(3, 3)
    return reference.moved(rotation.T, -rotation.T @ np.array(motion["translation"])), found["converged"]


def compare(reference: Reference, mesh: ObjectMesh, gsd: float, threads: int) -> Comparison:
    """Distances of a mesh from a reference in the same frame, and the completeness of the mesh.

    Guessed parts that close the mesh get distances, but do not count in the figures, in which all of the surface counts alike.
    """
    distances = np.concatenate(
        [
            _core.distances_from_reference(
                np.ascontiguousarray(mesh.vertices[start : start + _MOST_AT_ONCE]),
                np.ascontiguousarray(mesh.normals[start : start + _MOST_AT_ONCE]),
                reference.points, reference.triangles, gsd, _options(_FARTHEST_GSD), threads, False,
            )
            for start in range(0, len(mesh.vertices), _MOST_AT_ONCE)
        ]
    )  # fmt: skip
    counted = distances[mesh.measured & mesh.even()] / gsd
    compared = counted[np.isfinite(counted)]
    if not len(compared):
        raise DataError(_FAR_AWAY)
    figures = {
        "compared_fraction": len(compared) / len(counted),
        "within_1_gsd": float((np.abs(compared) < 1).mean()),
        "absolute_median_gsd": float(np.median(np.abs(compared))),
        "distance_gsd": distance_figures(compared),
        "completeness": _completeness(reference, mesh, gsd, threads),
    }
    return Comparison(reference, distances, figures)


def _completeness(reference: Reference, mesh: ObjectMesh, gsd: float, threads: int) -> dict[str, float]:
    """Shares of the reference's surface within each limit of _COMPLETE_GSD of the mesh."""
    some = some_of(len(reference.points), _MOST_LOOKED_FOR)
    points, areas = reference.points[some], reference.areas()[some]
    if len(mesh.vertices) < 2 * _MOST_AT_ONCE:
        # What lies so many GSD beyond the mesh's border counts, too.
        away: NDArray[np.floating] = _core.distances_from_reference(
            points, points, mesh.vertices, np.ascontiguousarray(mesh.triangles, np.uint32), gsd, _options(_COMPLETE_GSD[-1]), threads, True
        )  # fmt: skip
    else:
        away = _by_vertices(points, mesh, gsd, threads)
    with np.errstate(invalid="ignore"):
        return {f"{limit}_gsd": float(areas[np.abs(away) < limit * gsd].sum() / areas.sum()) for limit in _COMPLETE_GSD}


def _by_vertices(points: Floats, mesh: ObjectMesh, gsd: float, threads: int) -> Floats:
    """Distance of points (N) from a mesh that is too large to be searched as a whole: from the piece of plane within half a GSD about the
    nearest vertex. Infinite beyond the last limit of _COMPLETE_GSD. Of guessed parts, whose vertices lie far apart, most are not found.
    """
    thinner = len(mesh.vertices) // _MOST_AT_ONCE
    reach = (_COMPLETE_GSD[-1] + 2 * thinner**0.5) * gsd
    tree = scipy("spatial").cKDTree(mesh.vertices[::thinner])
    near = np.flatnonzero(np.isfinite(tree.query(points, distance_upper_bound=reach, workers=threads)[0]))
    away = np.full(len(points), np.inf)
    if len(near):
        nearest = NearestVertices(mesh)(points[near])
        apart, normals = points[near] - mesh.vertices[nearest], mesh.normals[nearest]
        across = (apart * normals).sum(1)
        along = np.linalg.norm(apart - across[:, None] * normals, axis=1)
        away[near] = np.hypot(across, np.maximum(along - gsd / 2, 0))
    return away


def _options(farthest_gsd: float) -> str:
    options = Options()
    options.assess.alignment = "rigid"
    options.assess.max_distance_gsd = farthest_gsd
    return options.to_json()
