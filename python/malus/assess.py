"""Quality figures of a surface: plane fits on flat patches, sections, distances to a reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from malus import _core
from malus._arrays import as_rows, as_triangles
from malus._core import FusedSurface
from malus.camera import Camera, as_view
from malus.options import Options
from malus.threads import ALL_CORES


def _as_gsd(gsd: float) -> float:
    """The GSD; ValueError unless it is a positive length: otherwise all figures would be infinite or have the wrong sign."""
    if not (gsd > 0 and np.isfinite(gsd)):
        raise ValueError(f"gsd = {gsd}, expected a positive length: the size of a pixel on the object")
    return float(gsd)


def fit_patch(depth: ArrayLike, camera: Camera, box: Sequence[int], gsd: float) -> dict[str, float] | None:
    """Plane through a flat patch of a depth map (Table 2): count, rmse (unit of depth), rmse_gsd, mad_gsd, max_abs_gsd.

    box: x0, y0, x1, y1 in pixels, corners inclusive. gsd: size of a pixel on the object, unit of depth. None if ten or fewer pixels
    have a depth. ValueError for a depth map that is not of the camera's size.
    """
    if len(box) != 4:
        raise ValueError(f"box has {len(box)} numbers, expected 4: x0, y0, x1, y1")
    if not np.isfinite(box).all():
        raise ValueError(f"box = {list(box)}, expected finite numbers")
    x0, y0, x1, y1 = (int(value) for value in box)
    return _core.fit_patch(as_view(depth, "depth", camera), camera, x0, y0, x1, y1, _as_gsd(gsd))


def profile(
    depth: ArrayLike,
    camera: Camera,
    start: Sequence[float],
    end: Sequence[float],
    gsd: float,
    *,
    prior: ArrayLike | None = None,
    options: Options | None = None,
) -> dict[str, Any]:
    """Section through a depth map along a line of the image, pixels (u, v) to (u, v) (Fig. 12 and 13).

    Returns `position` along the chord, the heights of the `surface` and the `prior` above the chord (unit of depth, NaN = none;
    `prior` is empty without one), `roughness_gsd`, `difference_rms_gsd` to the prior, and `status`. ValueError for maps that are not of
    the camera's size.
    """
    if len(start) != 2 or len(end) != 2:
        raise ValueError(f"start and end have {len(start)} and {len(end)} numbers, expected 2: u, v")
    return _core.section(
        (float(start[0]), float(start[1])),
        (float(end[0]), float(end[1])),
        as_view(depth, "depth", camera),
        None if prior is None else as_view(prior, "prior", camera),
        camera,
        _as_gsd(gsd),
        (options or Options()).to_json(),
    )


def compare(
    surface: FusedSurface,
    vertices: ArrayLike,
    gsd: float,
    *,
    triangles: ArrayLike | None = None,
    options: Options | None = None,
    threads: int = ALL_CORES,
) -> dict[str, Any]:
    """Signed distances of a surface to a reference in the world frame: a cloud (N×3), or a mesh with its triangles (M×3).

    Returns `distance` (H×W, unit of the surface, positive = in front of the reference, NaN = not compared), `rmse_gsd`, `mad_gsd`,
    `median_gsd`, `compared_fraction`, `status`, and `reference_from_surface` (scale, rotation by rows, translation). The option
    `assess.alignment` says how the surface is moved onto the reference first.
    """
    points = as_rows(vertices, "vertices")
    faces = None if triangles is None else as_triangles(triangles, "triangles", len(points))
    return _core.compare_with_reference(surface, points, faces, _as_gsd(gsd), (options or Options()).to_json(), threads)
