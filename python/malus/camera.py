"""Camera of a station: lens model and pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import as_image, as_numbers, as_rows


@dataclass
class Camera:
    """Camera with its lens model and pose.

    `model` is one of SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV, BROWN; `params` in COLMAP's
    order, but with the principal point in the memory pixel convention (center of the top-left pixel at (0, 0): COLMAP's
    value minus 0.5). `rotation` (3×3) and `translation` (3) take world points into the camera frame (x right, y down, z
    forward): x_in_cam = rotation @ x_in_world + translation. By default the camera frame is the world frame.

    Functions on arrays take the camera of the undistorted images: a PINHOLE camera, such as `undistorted()` returns.
    """

    model: str
    width: int
    height: int
    params: Sequence[float] | NDArray[Any]
    rotation: ArrayLike = field(default_factory=lambda: np.eye(3))
    translation: ArrayLike = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> Camera:
        """The camera that `description` states, or one within `Station.describe`, which may have no pose."""
        return cls(**description)

    def description(self) -> dict[str, Any]:
        """All fields as plain data, checked, under the names that `Station.describe` has."""
        model, width, height, params, rotation, translation = self.values()
        return {
            "model": model, "width": width, "height": height, "params": params,
            "rotation": rotation.tolist(), "translation": translation.tolist(),
        }  # fmt: skip

    def __eq__(self, other: object) -> bool:
        """Whether lens and pose have the same numbers; the method that a dataclass generates cannot compare arrays."""
        if not isinstance(other, Camera):
            return NotImplemented
        return (self.model, self.width, self.height) == (other.model, other.width, other.height) and (
            np.array_equal(self.params, other.params)
            and np.array_equal(self.rotation, other.rotation)
            and np.array_equal(self.translation, other.translation)
        )

    def pose(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Copies of rotation (3×3) and translation (3) as float64, checked; changing the copies does not move the camera."""
        rotation = np.array(as_numbers(self.rotation, "rotation"), dtype=np.float64)
        translation = np.array(as_numbers(self.translation, "translation"), dtype=np.float64)
        if rotation.shape != (3, 3):
            raise ValueError(f"rotation has shape {rotation.shape}, expected (3, 3)")
        if translation.shape != (3,):
            raise ValueError(f"translation has shape {translation.shape}, expected (3,)")
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise ValueError("rotation is not a rotation matrix (orthonormal, determinant +1)")
        return rotation, translation

    def undistorted(self) -> Camera:
        """Camera of the images without distortion: PINHOLE, with the same size, focal length, principal point and pose."""
        return _core.undistorted(self.values())

    @property
    def fx(self) -> float:
        """Focal length along x of the undistorted images, in pixels."""
        return self.undistorted().params[0]

    @property
    def fy(self) -> float:
        """Focal length along y of the undistorted images, in pixels."""
        return self.undistorted().params[1]

    @property
    def cx(self) -> float:
        """Principal point of the undistorted images, x in pixels."""
        return self.undistorted().params[2]

    @property
    def cy(self) -> float:
        """Principal point of the undistorted images, y in pixels."""
        return self.undistorted().params[3]

    def resected(self, points: ArrayLike, pixels: ArrayLike) -> tuple[Camera, dict[str, Any]]:
        """The same lens, with the pose resected from points of known coordinates and their pixels.

        points: N×3, N ≥ 4, not on one line; pixels: N×2 (column, row) in the image as taken (distorted), memory pixel convention.
        The pose of this camera is not used. Returns the camera in the points' frame, and figures: `rms_px`, `center_sigma`
        (standard deviation of the projection center along its most uncertain direction, unit of the points), `residuals_px` (N×2,
        given pixel minus projected point) and `doubtful`, the index of a point without which the others fit far better, or None.

        Raises ValueError for wrong shapes, malus.InputError for numbers that are not finite and for points that do not
        determine a pose, or do not fit. Method: SQPnP (Terzakis and Lourakis 2020) and, near a plane, IPPE (Collins and
        Bartoli 2014), then least squares.
        """
        known = as_rows(points, "points")
        marks = np.asarray(as_numbers(pixels, "pixels"), dtype=np.float64)
        if marks.shape != (len(known), 2):
            raise ValueError(f"pixels has shape {marks.shape}, expected ({len(known)}, 2) as points")
        found = _core.resect([str(index) for index in range(len(known))], known.T, marks.T, self.values())
        doubtful = found.pop("doubtful")
        camera = Camera(*found.pop("camera"))
        return camera, {**found, "doubtful": None if doubtful is None else int(doubtful)}

    def values(self) -> tuple[str, int, int, list[float], NDArray[np.float64], NDArray[np.float64]]:
        """All fields as plain values, checked, in the form that the C++ library takes."""
        rotation, translation = self.pose()
        return self.model, self.width, self.height, [float(p) for p in self.params], rotation, translation


def as_view(values: ArrayLike, name: str, camera: Camera) -> NDArray[np.float32]:
    """The values as a float32 array H×W of the camera's size; ValueError for another shape."""
    raster = as_image(values, name)
    if raster.shape != (camera.height, camera.width):
        raise ValueError(f"{name} has shape {raster.shape}, expected {(camera.height, camera.width)} as its camera")
    return raster


def require_view(camera: Camera | None, shape: tuple[int, ...], of: str) -> None:
    """ValueError unless the camera's images have the size `shape` of the raster or state `of`: its rays would be those of other pixels."""
    if camera is not None and (camera.height, camera.width) != shape:
        raise ValueError(f"camera has shape {(camera.height, camera.width)}, expected {shape} as {of}")
