"""Stations: one camera position, images through a polarizer, and what is known about the object."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import as_images, as_mask
from malus._files import require_utf8
from malus.camera import Camera


class Station:
    """A station, from a file (`Station.load`) or from arrays."""

    def __init__(
        self,
        images: Sequence[ArrayLike] | NDArray[Any],
        angles_deg: Sequence[float],
        camera: Camera,
        *,
        prior_points: ArrayLike | None = None,
        prior_depth: ArrayLike | None = None,
        mask: ArrayLike | None = None,
        name: str = "station",
        unit: str = "mm",
        refractive_index: float | None = 1.5,
        reflection: str = "auto",
        frames_averaged: int = 1,
        full_well_e: float | None = None,
        read_noise_e: float | None = None,
    ) -> None:
        """Build a station in code.

        images: K arrays H×W, linear intensities in [0, 1] of the white level; angles_deg: K polarizer angles,
        counter-clockwise from image +x as displayed. Exactly one of prior_points (N×3, world frame, in `unit`) and
        prior_depth (H×W z-depth of the undistorted view, NaN = none) is needed for more than the polarization maps.
        mask: H×W, non-zero = object. refractive_index None means "auto". Wrong shapes raise ValueError.
        """
        stack = as_images(images, "images")
        angles = np.asarray(angles_deg, dtype=np.float64)
        if angles.shape != (len(stack),):
            raise ValueError(f"angles_deg has shape {angles.shape}, expected ({len(stack)},): one angle an image")
        if (stack[0].shape[1], stack[0].shape[0]) != (camera.width, camera.height):
            raise ValueError(
                f"images are {stack[0].shape[1]} x {stack[0].shape[0]} pixels, camera is {camera.width} x {camera.height}"
            )
        if prior_points is not None and prior_depth is not None:
            raise ValueError("prior_points and prior_depth are both given, expected one of them")
        points = None
        if prior_points is not None:
            points = np.ascontiguousarray(prior_points, dtype=np.float64)
            if points.ndim != 2 or points.shape[1] != 3:
                raise ValueError(f"prior_points has shape {points.shape}, expected (N, 3)")
        depth = None
        if prior_depth is not None:
            depth = np.ascontiguousarray(prior_depth, dtype=np.float32)
            if depth.shape != stack[0].shape:
                raise ValueError(f"prior_depth has shape {depth.shape}, expected {stack[0].shape}")
        self._core = _core.Station.from_arrays(
            images=stack,
            angles_deg=angles.tolist(),
            camera=camera.values(),
            prior_points=points,
            prior_depth=depth,
            mask=None if mask is None else as_mask(mask, stack[0].shape),
            name=name,
            unit=unit,
            refractive_index=refractive_index,
            reflection=reflection,
            frames_averaged=frames_averaged,
            full_well_e=full_well_e,
            read_noise_e=read_noise_e,
        )

    @classmethod
    def load(cls, path: str | Path) -> Station:
        """Read a station file; `malus.InputError` names file, field, value and what was expected."""
        require_utf8(path)
        station = cls.__new__(cls)
        station._core = _core.Station.load(str(path))
        return station

    @property
    def name(self) -> str:
        """The station's name."""
        return str(self.describe()["name"])

    @property
    def unit(self) -> str:
        """Unit of all lengths."""
        return str(self.describe()["unit"])

    def describe(self) -> dict[str, Any]:
        """Everything the station says, as plain data."""
        description: dict[str, Any] = json.loads(self._core.describe())
        return description

    def __repr__(self) -> str:
        description = self.describe()
        return f"Station({description['name']!r}, {description['image_count']} images, unit={description['unit']!r})"
