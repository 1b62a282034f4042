"""A station's cloud with its normals, which are needed where no station sees the object."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from malus import _core, scans
from malus._files import with_relative_paths
from malus.object.views import Floats


def without_normals(cloud: str, folder: Path) -> str:
    """The warning about a cloud without normals. folder: that of the object's file, to which the page names files."""
    return (
        f"cloud {with_relative_paths(cloud, folder)} has no normals: where no station sees the object, its points give no surface; "
        "export it with normals"
    )


def read_cloud(path: Path, unit: str) -> tuple[Floats, Floats] | None:
    """Points of a station's cloud, a file or a workspace of COLMAP's dense stereo, that have normals, and these unit normals; None if there
    are none.
    """
    points, normals = scans.read_scan(path, unit)[:2] if scans.is_scan(path) else _core.read_oriented_points(str(path))
    if normals is None:
        return None
    # A normal that is not known is zero. Such a point confirms no other, and would make outliers of the good ones beside it.
    known = normals.any(1)
    return (points[known], normals[known].astype(np.float64)) if known.any() else None
