"""Distances between the surface and a reference scan by M3C2 (Lague, Brodu and Leroux 2013), through py4dgeo.

M3C2 averages both clouds in a cylinder along the local normal, so that noise and density of the clouds hardly matter. For every
point it also gives the smallest distance that could be detected, by the scatter of both clouds; errors of their alignment are not in
it. It complements the point-to-surface comparison in quality.json.
"""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus._extra import extra
from malus._files import sha256_of, write_text
from malus._robust import distance_figures
from malus.columns import number
from malus.errors import DataError, InputError
from malus.workspace import Workspace

#: Approximate largest number of core points: larger stations get one core point for every n × n pixels.
CORE_POINTS = 200000
#: Number of points that a cylinder should hold, and the ratio of the radius for normals to the cylinder's radius.
_POINTS_IN_CYLINDER = 25
NORMAL_FACTOR = 3.0
_BINS = 50
#: Surface and scan are not compared where they are farther apart than this.
_FARTHEST_GSD = 50.0


def py4dgeo() -> ModuleType:
    """The package; ExternalError if it is not installed."""
    library = extra("py4dgeo", "py4dgeo", "M3C2", "m3c2")
    # On import py4dgeo sets up logging to standard output and to py4dgeo.log in the current folder: remove both.
    logger = logging.getLogger("py4dgeo")
    for handler in list(logger.handlers):
        logger.removeHandler(handler)
        handler.close()
    logger.setLevel(logging.WARNING)
    return library


def _aligned(
    points: NDArray[np.float64], direction: NDArray[np.float64], comparison: dict[str, Any] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and a direction moved into the reference's frame by the alignment of `malus assess`; unchanged if there is no comparison."""
    if not comparison:
        return points, direction
    motion = comparison["reference_from_surface"]
    rotation = np.array(motion["rotation"]).reshape(3, 3)
    moved: NDArray[np.float64] = motion["scale"] * points @ rotation.T + np.array(motion["translation"])
    return moved, rotation @ direction


def _moved_back(points: NDArray[np.float64], comparison: dict[str, Any] | None) -> NDArray[np.float64]:
    """Points of the reference's frame in that of the surface."""
    if not comparison:
        return points
    motion = comparison["reference_from_surface"]
    turned = (points - np.array(motion["translation"])) @ np.array(motion["rotation"]).reshape(3, 3)
    back: NDArray[np.float64] = turned / motion["scale"]
    return back


def distances(
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    core: NDArray[np.float64],
    normals_of: NDArray[np.float64],
    *,
    radius: float,
    largest: float,
    towards: NDArray[np.float64],
    registration: float = 0.0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Signed distances from one cloud to another at core points (all N×3, one frame), and the smallest detectable distances (95 %).

    radius: of the cylinders, which extend by `largest` in both directions along the normals of the cloud `normals_of`. The normals
    are oriented `towards` a direction; distances in it are positive. registration: one standard deviation of the registration of
    the clouds to each other. NaN = not compared.
    """
    library = py4dgeo()
    library.set_memory_policy(library.MemoryPolicy.COREPOINTS)
    # Parts of the library compute in single precision: pass coordinates relative to the middle.
    middle = core.mean(0)
    algorithm = library.M3C2(
        epochs=(library.Epoch(before - middle), library.Epoch(after - middle)),
        corepoints=core - middle,
        cyl_radius=radius,
        max_distance=largest,
        normal_radii=[NORMAL_FACTOR * radius],
        cloud_for_normals=library.Epoch(normals_of - middle),
        orientation_vector=towards,
        registration_error=registration,
    )
    found, uncertainty = algorithm.run()
    return np.asarray(found, float), np.asarray(uncertainty["lodetection"], float)


def cylinder_radius(spacing: float) -> float:
    """Radius of a cylinder that holds about 25 points of a surface with this distance between points."""
    return float(np.sqrt(_POINTS_IN_CYLINDER / np.pi)) * spacing


def thinning(pixels: int) -> int:
    """The n for which one core point per n × n pixels gives at most about CORE_POINTS core points."""
    return int(max(1, np.ceil(np.sqrt(pixels / CORE_POINTS))))


def spread_out(values: NDArray[np.float64], step: int, known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """A map of the known pixels from the values of the core points, which are those of every step-th row and column: each pixel has
    the value of the nearest one, so that the map is not shifted. NaN at all other pixels.
    """
    core = np.full(known[::step, ::step].shape, np.nan, np.float32)
    core[known[::step, ::step]] = values
    rows, columns = (
        np.minimum((np.arange(known.shape[k]) + (step - 1) // 2) // step, core.shape[k] - 1) for k in (0, 1)
    )
    return np.where(known, core[np.ix_(rows, columns)], np.float32(np.nan))


def _spacing_px(workspace: Workspace, scan: NDArray[np.float64]) -> float:
    """Distance between the points of a scan on the surface, in pixels of the station. Parts of the surface where the scan has no points do
    not count, nor do points behind the surface, such as those of an object's other side.
    """
    depth, camera, (rotation, translation) = workspace.raster("fused/depth.tif"), workspace.camera, workspace.pose
    x, y, z = (_moved_back(scan, workspace.quality["reference"]) @ rotation.T + translation).T
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    inside = (z > 0) & (u > -0.5) & (v > -0.5) & (u < camera.width - 0.5) & (v < camera.height - 0.5)
    columns, rows = (np.rint(at[inside]).astype(int) for at in (u, v))
    on_surface = np.abs(z[inside] - depth[rows, columns]) < _FARTHEST_GSD * float(workspace.quality["gsd"])
    columns, rows = columns[on_surface], rows[on_surface]
    if len(rows) == 0:
        return 1.0
    known = np.isfinite(depth)
    spacing = float(np.sqrt(known.sum() / len(rows)))
    for _ in range(5):
        # The area of the cells with points; cells of 16 points are seldom empty by chance.
        side = int(np.ceil(4 * spacing))
        counts = known.astype(np.int64)
        for axis in (0, 1):
            counts = np.add.reduceat(counts, np.arange(0, counts.shape[axis], side), axis)
        occupied = np.zeros(counts.shape, bool)
        occupied[rows // side, columns // side] = True
        spacing = float(np.sqrt(counts[occupied].sum() / len(rows)))
    return spacing


def _summary(found: NDArray[np.float64], detectable: NDArray[np.float64], gsd: float) -> dict[str, Any]:
    known = np.isfinite(found)
    # A cylinder with too few points has no scatter, and so no limit: whether its distance is significant cannot be said.
    limited = known & np.isfinite(detectable)
    values = found[known] / gsd
    spread = float(np.percentile(np.abs(values), 99)) or 1.0
    counts, edges = np.histogram(values, _BINS, (-spread, spread))
    limit = detectable[limited] / gsd
    significant = np.abs(found[limited]) > detectable[limited]
    return {
        "compared_fraction": float(known.mean()),
        "distance_gsd": {"count": int(known.sum()), **distance_figures(values)},
        "detection_limit_median_gsd": float(np.median(limit)) if limit.size else None,
        "significant_fraction": float(significant.mean()) if limit.size else None,
        "histogram_gsd": {
            "low": -spread,
            "bin_width": float(edges[1] - edges[0]),
            "counts": counts.tolist(),
            "below": int((values < -spread).sum()),
            "above": int((values > spread).sum()),
        },
    }


def _require_as_assessed(workspace: Workspace, reference: Path) -> None:
    """InputError for a reference that was changed since `malus assess` compared it: the alignment that it found is of the earlier one."""
    known = workspace.manifest["steps"]["assess"]["inputs"]
    # The manifest names files relative to the station file, if both paths are absolute.
    station = workspace.manifest["station"].get("file")
    names = [str(reference), *([os.path.relpath(reference, Path(station).parent)] if station else [])]
    if any(name in known and known[name] != sha256_of(reference) for name in names):
        raise InputError(f"{reference}: was changed since `malus assess` compared the surface with it; run that again")


def compare(work: str | Path, reference: str | Path, *, radius: float | None = None) -> dict[str, Any]:
    """Compare the fused surface of a workspace with a scan; writes WORK/m3c2.json and WORK/fused/m3c2_distance.tif.

    `reference`: PLY or XYZ, world frame; only the vertices of a mesh are used. The alignment found by `malus assess` is applied.
    `radius`: of the cylinders, in the station's unit; by default a cylinder holds about 25 points of the sparser cloud. The map (H×W,
    station unit, NaN = not compared) is positive where the surface lies in front of the reference. Returns the content of m3c2.json.

    Raises malus.InputError, also for a reference that was changed since `malus assess` read it, DataError if no part of the reference is near the surface, ExternalError without py4dgeo.
    """
    py4dgeo()  # fail before anything is read if the package is missing
    if radius is not None and not radius > 0:
        raise InputError(f"radius {radius}, expected a positive length")
    watch, workspace = _core.StepWatch(), Workspace(work)
    gsd = float(workspace.quality["gsd"])
    scan = _core.read_points(str(reference))
    _require_as_assessed(workspace, Path(reference))
    grid, towards = _aligned(workspace.points(), -workspace.pose[0][2], workspace.quality["reference"])
    known: NDArray[np.bool_] = np.asarray(np.isfinite(grid).all(-1))
    step = thinning(int(known.sum()))
    core = known[::step, ::step]
    surface, core_points = grid[known], grid[::step, ::step][core]
    low, high = surface.min(0) - _FARTHEST_GSD * gsd, surface.max(0) + _FARTHEST_GSD * gsd
    near = scan[((scan >= low) & (scan <= high)).all(1)]
    if len(near) < 10:
        raise DataError(
            f"{reference}: {len(near)} points lie near the surface, expected more; is it in the same frame and unit?"
        )
    chosen = radius or cylinder_radius(gsd * max(1.0, _spacing_px(workspace, near)))
    found, detectable = distances(
        near,
        surface,
        core_points,
        surface,
        radius=chosen,
        largest=_FARTHEST_GSD * gsd,
        towards=towards,
    )
    if not np.isfinite(found).any():
        raise DataError(
            f"{reference}: no point of the surface has {number(chosen, 4)} around it in the reference, expected a larger radius"
        )
    figures = {
        "reference": str(reference),
        "reference_points": len(near),
        "cylinder_radius": chosen,
        "normal_radius": NORMAL_FACTOR * chosen,
        "pixels_per_core_point": step * step,
        **_summary(found, detectable, gsd),
    }
    with workspace.recording("m3c2", watch) as files:
        files += ["fused/m3c2_distance.tif", "m3c2.json"]
        _core.write_float_tiff(str(workspace.folder / files[0]), spread_out(found, step, known))
        write_text(workspace.folder / files[1], json.dumps(figures, indent=2) + "\n")
    return figures
