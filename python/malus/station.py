"""Stations: one camera position, images through a polarizer, and what is known about the object."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Required, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import as_image, as_images, as_mask, as_numbers, as_rows, require_shares
from malus._files import require_utf8
from malus.camera import Camera
from malus.errors import InputError


class PolarizedValues(TypedDict, total=False):
    """[polarized] of a station file without the names of the images: how the images are to be read (docs/station-file.md)."""

    angle_direction: Literal["ccw", "cw"]
    angle_zero_deg: float
    mosaic: Sequence[Sequence[float]]
    mosaic_colors: Literal["RGGB", "BGGR", "GRBG", "GBRG"]
    exposure_s: Sequence[float]
    channel: Literal["luminance", "red", "green", "blue", "mean"]
    channel_weights: Sequence[float]
    response: str
    white_level: float
    black_level: float
    frames_averaged: int
    full_well_e: float | None
    read_noise_e: float | None
    curve_pixels: Sequence[Sequence[int]]


class OpticsValues(TypedDict, total=False):
    """[optics]; `reflection` may also be the path of a label image."""

    refractive_index: float | Literal["auto"]
    reflection: str
    light: Sequence[float]


class PlaneValues(TypedDict):
    """[prior].plane, world frame."""

    point: Sequence[float]
    normal: Sequence[float]


class SphereValues(TypedDict):
    """[prior].sphere, world frame, in the station's unit."""

    center: Sequence[float]
    radius: float


class CylinderValues(TypedDict):
    """[prior].cylinder, world frame, in the station's unit: circular and of infinite length; `point` is on its axis."""

    point: Sequence[float]
    axis: Sequence[float]
    radius: float


class PriorValues(TypedDict, total=False):
    """[prior]: one file (cloud, mesh, depth) or one shape (plane, sphere, cylinder), and its standard deviation, required for a shape."""

    cloud: str
    mesh: str
    depth: str
    plane: PlaneValues
    sphere: SphereValues
    cylinder: CylinderValues
    sigma: float


class PatchValues(TypedDict, total=False):
    """[[patch]]: x0, y0, x1, y1 in the image, inclusive."""

    name: str
    box: Required[Sequence[int]]


#: [[profile]]: its two ends, each a pixel [x, y].
ProfileValues = TypedDict("ProfileValues", {"name": str, "from": Sequence[float], "to": Sequence[float]}, total=False)


class MarkValues(TypedDict):
    """A mark in a photo, in pixels; the center of the first one is at (0, 0)."""

    image: str
    x: float
    y: float


class PhotosValues(TypedDict, total=False):
    """[photos]: the folder of the photos that give camera and prior; `camera` has the keys of a lens in a station file."""

    folder: Required[str | Path]
    exclude: Sequence[str]
    masks: str | Path
    camera: Mapping[str, Any]


class ScaleValues(TypedDict, total=False):
    """[[scale]]: a known distance between two points of the prior's frame (a_xyz, b_xyz); with photos between two places that are
    marked in them (a, b), or two coded targets.
    """

    distance: Required[float]
    a_xyz: Sequence[float]
    b_xyz: Sequence[float]
    a: Sequence[MarkValues]
    b: Sequence[MarkValues]
    targets: Sequence[int]
    targets_dictionary: str
    check: bool


class ControlValues(TypedDict, total=False):
    """[[control]]: a point of known coordinates, marked in photos, in the polarized images (`pixel`), or in both."""

    name: str
    xyz: Required[Sequence[float]]
    pixel: Sequence[float]
    marks: Sequence[MarkValues]
    check: bool


class Station:
    """A station, from a file (`Station.load`) or from arrays. One from a file can be pickled, for a process that sees the same files:
    there the file is read again.
    """

    _file: str | None = None
    _curves: list[tuple[int, int]] | None = None

    def __init__(
        self,
        images: Sequence[ArrayLike] | NDArray[Any],
        angles_deg: Sequence[float] | Literal["auto"] | None,
        camera: Camera,
        *,
        prior_points: ArrayLike | None = None,
        prior_normals: ArrayLike | None = None,
        prior_depth: ArrayLike | None = None,
        prior_sigma: float | None = None,
        mask: ArrayLike | None = None,
        name: str = "station",
        unit: str = "mm",
        refractive_index: float | None = 1.5,
        reflection: str = "auto",
        frames_averaged: int = 1,
        full_well_e: float | None = None,
        read_noise_e: float | None = None,
        polarized: PolarizedValues | None = None,
        optics: OpticsValues | None = None,
        prior: PriorValues | None = None,
        patches: Sequence[PatchValues] = (),
        profiles: Sequence[ProfileValues] = (),
        photos: PhotosValues | None = None,
        scale: Sequence[ScaleValues] = (),
        control: Sequence[ControlValues] = (),
        object: Mapping[str, str] | None = None,
    ) -> None:
        """Build a station in code.

        images: K arrays H×W or, in color, H×W×3, by default linear intensities in [0, 1] of the white level; digital numbers
        of any type need polarized={"white_level": …}, and those of an integer type count as rounded, as those of a file.
        angles_deg: K polarizer angles, counter-clockwise from image +x as displayed; "auto" if they are not known; None with
        a mosaic, which states the angles itself. Give at most one prior: prior_points (N×3, world frame, in `unit`) with or
        without prior_normals (N×3, towards the camera), prior_depth (H×W z-depth of the undistorted view, NaN = none), `prior`, a
        file or a shape, or `photos`, which give the camera's pose, too. Polarization maps, and the height from them, need no prior.
        prior_sigma: standard deviation of the points or the depth, in `unit`. mask: H×W, non-zero = object. refractive_index: None = "auto".

        The remaining tables of a station file are given with the keys of the file: `polarized` (response, levels, exposures,
        channel, mosaic …), `optics` (light …), `patches`, `profiles`, `photos`, `scale`, `control`, `object` (catalog entries).
        Relative file names in them start at the current folder. Wrong shapes and masked values raise ValueError; wrong values
        malus.InputError, whose message names tables and keys as for a file.
        """
        stack = as_images(images, "images", color=True)
        shape = stack[0].shape[:2]
        if shape != (camera.height, camera.width):
            raise ValueError(f"images are {shape[1]} x {shape[0]} pixels, camera is {camera.width} x {camera.height}")
        if sum(given is not None for given in (prior_points, prior_depth, prior, photos)) > 1:
            raise ValueError("prior_points, prior_depth, prior, photos: more than one is given, expected one of them")
        points, normals = _oriented_points(prior_points, prior_normals)
        noise = {"frames_averaged": frames_averaged, "full_well_e": full_well_e, "read_noise_e": read_noise_e}
        tables = {
            "station": {"name": name, "unit": unit},
            "polarized": {"angles_deg": _angles(angles_deg, len(stack)), **noise, **(polarized or {})},
            "optics": {
                "refractive_index": "auto" if refractive_index is None else refractive_index,
                "reflection": reflection,
                **(optics or {}),
            },
            "object": object,
            "prior": prior if prior_sigma is None else {**(prior or {}), "sigma": prior_sigma},
            "photos": None if photos is None else _with_absolute_folders(photos),
            "patch": patches,
            "profile": profiles,
            "scale": scale,
            "control": control,
        }
        has_white = (polarized or {}).get("white_level") is not None
        self._core = _core.Station.from_arrays(
            images=stack,
            whole_numbers=has_white and all(np.asarray(image).dtype.kind in "iu" for image in images),
            camera=camera.values(),
            tables=json.dumps(_plain(tables, "station: ")),
            prior_points=points,
            prior_normals=normals,
            prior_depth=_depth(prior_depth, shape),
            mask=as_mask(mask, shape),
        )
        if not has_white:
            require_shares(stack, "images", "their polarized.white_level")

    @classmethod
    def load(cls, path: str | Path) -> Station:
        """Read a station file; `malus.InputError` names file, field, value and what was expected."""
        require_utf8(path)
        station = cls.__new__(cls)
        station._core = _core.Station.load(str(path))
        station._file = os.path.abspath(path)
        return station

    def with_curves_of(self, pixels: Sequence[tuple[int, int]]) -> Station:
        """A copy of the station that shows intensity against polarizer angle (Fig. 1c of the paper) at these pixels (x, y) of its images.

        At most eight pixels; they replace `curve_pixels` of the station file. Raises `malus.InputError` for more pixels, or for
        pixels outside of the images.
        """
        station = Station.__new__(Station)
        station._file, station._curves = self._file, [(int(x), int(y)) for x, y in pixels]
        station._core = self._core.with_curves_of(station._curves)
        return station

    def __copy__(self) -> Station:
        return self  # it never changes

    def __reduce__(self) -> tuple[Any, ...]:
        if self._file is None:
            raise TypeError(
                f"station {self.name}: is made of arrays, expected one of a file, which another process can read again; make it there"
            )
        return _loaded, (self._file, self._curves)

    @property
    def name(self) -> str:
        """The station's name."""
        return str(self.describe()["name"])

    @property
    def unit(self) -> str:
        """Unit of all lengths."""
        return str(self.describe()["unit"])

    def describe(self) -> dict[str, Any]:
        """All values of the station, as plain data."""
        description: dict[str, Any] = json.loads(self._core.describe())
        return description

    def __repr__(self) -> str:
        description = self.describe()
        return f"Station({description['name']!r}, {description['image_count']} images, unit={description['unit']!r})"


def _loaded(file: str, curves: list[tuple[int, int]] | None) -> Station:
    """A pickled station, read again."""
    station = Station.load(file)
    return station if curves is None else station.with_curves_of(curves)


def _angles(angles_deg: Sequence[float] | str | None, count: int) -> Any:
    """The angles as a station file states them; ValueError unless there is one for each image."""
    if angles_deg is None or isinstance(angles_deg, str):
        return angles_deg
    angles = as_numbers(angles_deg, "angles_deg")
    if angles.shape != (count,):
        raise ValueError(f"angles_deg has shape {angles.shape}, expected ({count},): one angle per image")
    return angles


def _depth(values: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[np.float32] | None:
    depth = None if values is None else as_image(values, "prior_depth")
    if depth is not None and depth.shape != shape:
        raise ValueError(f"prior_depth has shape {depth.shape}, expected {shape}")
    return depth


def _with_absolute_folders(photos: PhotosValues) -> dict[str, Any]:
    """The table with absolute paths: COLMAP is started in another folder."""
    values: dict[str, Any] = dict(photos)
    return values | {key: os.path.abspath(values[key]) for key in ("folder", "masks") if key in values}


def _oriented_points(
    points: ArrayLike | None, normals: ArrayLike | None
) -> tuple[NDArray[np.float64] | None, NDArray[np.float32] | None]:
    if points is None:
        if normals is not None:
            raise ValueError("prior_normals are given without prior_points")
        return None, None
    checked = as_rows(points, "prior_points")
    return checked, None if normals is None else as_rows(normals, "prior_normals", len(checked), np.float32)


def _plain(value: Any, where: str) -> Any:
    """Convert arrays, NumPy numbers and paths to values that JSON has; InputError for numbers that are not finite."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        inner = f"{where}[{{}}]" if where.endswith(": ") else f"{where}.{{}}"
        return {key: _plain(item, inner.format(key)) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item, f"{where}[{k}]") for k, item in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{where} = {value}, expected a finite number")
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
