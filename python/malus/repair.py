"""Repairs of a surface for an export: uncertain parts are removed, holes are closed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from malus._core import FusedSurface
from malus._extra import extra
from malus.columns import number
from malus.errors import DataError
from malus.surface import normals_from_depth

#: Color of filled pixels, which were not measured, sRGB.
FILLED_COLOR = (255, 0, 255)


def trimmed(surface: FusedSurface, largest_sigma: float) -> FusedSurface:
    """The surface without pixels whose stated standard deviation of depth exceeds `largest_sigma` (its unit).

    DataError if nothing is left.
    """
    kept = np.isfinite(surface.depth) & (surface.sigma <= largest_sigma)
    if not kept.any():
        raise DataError(
            f"--trim: every pixel's standard deviation exceeds {number(largest_sigma, 4)}, expected a larger limit; "
            f"the smallest is {number(float(np.nanmin(surface.sigma)), 4)}"
        )
    depth, sigma = (np.where(kept, values, np.nan).astype(np.float32) for values in (surface.depth, surface.sigma))
    normals = np.where(kept[..., None], surface.normals, np.nan).astype(np.float32)
    return FusedSurface(depth, normals, sigma, surface.camera)


def filled(surface: FusedSurface) -> tuple[FusedSurface, NDArray[np.bool_]]:
    """The surface with its holes closed, and a mask of the filled pixels, H×W.

    A hole is a part without depth that the surface surrounds. It is filled with the membrane through its border (Laplace's equation in
    inverse depth), which continues a plane exactly. Filled pixels get no standard deviation, because nothing was measured there.
    """
    ndimage, sparse, linalg = (
        extra(name, "scipy", "--fill") for name in ("scipy.ndimage", "scipy.sparse", "scipy.sparse.linalg")
    )
    missing = ~np.isfinite(surface.depth)
    parts, _ = ndimage.label(missing)
    border = np.unique(np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]]))
    holes = missing & ~np.isin(parts, border)
    if not holes.any():
        return surface, holes
    number = np.full(holes.shape, -1)
    rows, columns = np.nonzero(holes)
    number[holes] = np.arange(len(rows))
    known = np.zeros(len(rows))
    entries: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
    # A hole does not touch the image's border: every pixel has four neighbors.
    for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        neighbor = number[rows + down, columns + right]
        inside = neighbor >= 0
        entries.append((np.flatnonzero(inside), neighbor[inside]))
        known[~inside] += 1 / surface.depth[(rows + down)[~inside], (columns + right)[~inside]].astype(float)
    first, second = (np.concatenate(part) for part in zip(*entries, strict=True))
    matrix = sparse.diags([4.0] * len(rows)) - sparse.coo_matrix(
        (np.ones(len(first)), (first, second)), shape=(len(rows), len(rows))
    )
    depth = surface.depth.copy()
    depth[holes] = 1 / linalg.spsolve(matrix.tocsc(), known)
    normals = surface.normals.copy()
    normals[holes] = normals_from_depth(depth, surface.camera)[holes]
    return FusedSurface(depth, normals, surface.sigma, surface.camera), holes
