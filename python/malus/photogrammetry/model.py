"""A sparse model as COLMAP writes it: cameras of the photos and triangulated points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.camera import Camera
from malus.photogrammetry.database import unquoted


@dataclass(frozen=True)
class RegisteredImage:
    """An image whose position is known."""

    camera: Camera
    """Lens and pose; pixels in the memory convention."""
    camera_group: tuple[object, ...]
    """Equal for images that share one lens."""
    observations: int
    """Features that see a triangulated point."""


@dataclass(frozen=True)
class SparseModel:
    """Registered images by name, and points in the model's frame."""

    images: dict[str, RegisteredImage]
    points: NDArray[np.float64]
    """N×3."""
    errors_px: NDArray[np.float64]
    """N; mean reprojection error."""
    track_lengths: NDArray[np.int64]
    """N; images that see the point."""

    @staticmethod
    def read(folder: Path) -> SparseModel:
        """Read a COLMAP model, binary or text. Raises InputError for a damaged one."""
        model = _core.ColmapModel.read(str(folder))
        images = {}
        for quoted_name, (values, _, observations) in model.images().items():
            lens, width, height, params, _, _ = values
            group = (lens, width, height, *params)
            images[unquoted(quoted_name)] = RegisteredImage(Camera(*values), group, observations)
        points, errors, lengths = model.points()
        return SparseModel(images, points, errors, lengths)

    @property
    def cameras(self) -> dict[str, Camera]:
        """Cameras of the images, by the images' names."""
        return {name: image.camera for name, image in self.images.items()}

    @property
    def mean_error_px(self) -> float:
        """Mean reprojection error of the observations."""
        total = float(self.track_lengths.sum())
        return float((self.errors_px * self.track_lengths).sum() / total) if total else float("nan")

    def relief(self) -> float:
        """Relief of the points: their spread across the plane that fits them best over their spread along this plane."""
        if len(self.points) < 4:
            return 0.0
        centered = self.points - np.median(self.points, axis=0)
        near = np.linalg.norm(centered, axis=1)
        centered = centered[near <= np.percentile(near, 90)]
        spread = np.linalg.svd(centered - centered.mean(axis=0), compute_uv=False)
        return float(spread[2] / spread[0])


def reader_options(camera: Camera) -> dict[str, object]:
    """Options of COLMAP's image reader for images of a known lens."""
    params = ",".join(repr(float(p)) for p in colmap_params(camera))
    return {"camera_model": camera.model, "camera_params": params}


def colmap_params(camera: Camera) -> NDArray[np.float64]:
    """A camera's parameters in COLMAP's pixel convention (the first pixel's center at 0.5, 0.5)."""
    params = np.array(camera.params, dtype=np.float64)
    first = 1 if camera.model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL") else 2
    params[first : first + 2] += 0.5
    return params
