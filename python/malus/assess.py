"""Figures that can be defended: plane fits on flat patches."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from malus import _core
from malus._arrays import as_image
from malus.camera import Camera


def fit_patch(depth: ArrayLike, camera: Camera, box: Sequence[int], gsd: float) -> dict[str, float] | None:
    """Plane through a flat patch of a depth map (Table 2): count, rmse (unit of depth), rmse_gsd, mad_gsd, max_abs_gsd.

    box: x0, y0, x1, y1 in pixels, corners inclusive. None if ten or fewer pixels have a depth.
    """
    if len(box) != 4:
        raise ValueError(f"box has {len(box)} numbers, expected 4: x0, y0, x1, y1")
    x0, y0, x1, y1 = (int(value) for value in box)
    return _core.fit_patch(as_image(depth, "depth"), camera, x0, y0, x1, y1, gsd)
