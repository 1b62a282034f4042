"""Stations: one camera position, images through a polarizer, and what is known about the object."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Required, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus import _core
from malus._arrays import (
    as_colors,
    as_image,
    as_images,
    as_labels,
    as_mask,
    as_metal,
    as_numbers,
    as_rows,
    as_triangles,
    require_shares,
)
from malus._files import require_utf8
from malus._plain import plain
from malus.camera import Camera
from malus.capture import BayerPattern


class PolarizedValues(TypedDict, total=False):
    """[polarized] of a station file without the names of the images: how the images are to be read (docs/station-file.md)."""

    angle_direction: Literal["ccw", "cw"]
    angle_zero_deg: float
    mosaic: Sequence[Sequence[float]]
    mosaic_colors: BayerPattern
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
    metal: str | Sequence[float]


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


class ShapeValues(TypedDict, total=False):
    """One of the shapes that [prior] can have."""

    plane: PlaneValues
    sphere: SphereValues
    cylinder: CylinderValues


class PriorValues(ShapeValues, total=False):
    """[prior]: one file (cloud, mesh, depth) or one shape (plane, sphere, cylinder), and its standard deviation, required for a shape."""

    cloud: str
    mesh: str
    depth: str
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
    _photos_of: str | None = None
    _curves: list[tuple[int, int]] | None = None
    _labels_sha256: str | None = None

    def __init__(
        self,
        images: Sequence[ArrayLike] | NDArray[Any],
        angles_deg: Sequence[float] | NDArray[Any] | Literal["auto"] | None,
        camera: Camera | None,
        *,
        prior_points: ArrayLike | None = None,
        prior_normals: ArrayLike | None = None,
        prior_colors: ArrayLike | None = None,
        prior_mesh: tuple[ArrayLike, ArrayLike] | None = None,
        prior_depth: ArrayLike | None = None,
        prior_sigma: float | None = None,
        mask: ArrayLike | None = None,
        name: str = "station",
        unit: str = "mm",
        refractive_index: float | None = 1.5,
        reflection: str | ArrayLike = "auto",
        metal: str | complex | Sequence[float] = "auto",
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
        without prior_normals (N×3, out of the object) and prior_colors (N×3, 0 to 255, to compare with the images), prior_mesh
        (vertices N×3, world frame, and triangles M×3 of their indices), prior_depth (H×W z-depth of the undistorted view, NaN =
        none), `prior`, a file or a shape, or `photos`, which give the camera's pose, too. The polarization maps and the height
        from them need neither prior nor camera (None); everything else does. prior_sigma: standard deviation of points, mesh or
        depth, in `unit`. mask: H×W, non-zero = object. refractive_index: None = "auto". reflection: a word, a file, or labels
        H×W (1 = diffuse, 2 = specular, 0 = decide) as taken. metal: "auto", "none", its name or refractive index, n + k i or (n, k).

        The remaining tables of a station file are given with the keys of the file: `polarized` (response, levels, exposures,
        channel, mosaic …), `optics` (light …), `patches`, `profiles`, `photos`, `scale`, `control` (points that check the
        camera's pose, which `Camera.resected` makes from others, or that give it with `photos`) and `object` (catalog entries).
        Relative file names in them start at the current folder. Wrong shapes, masked values and what both an argument and a table
        state raise ValueError; wrong values malus.InputError, whose message names tables and keys as for a file.
        """
        noise = {"frames_averaged": frames_averaged, "full_well_e": full_well_e, "read_noise_e": read_noise_e}
        _require_said_once("polarized", polarized, angles_deg=angles_deg, **noise)
        _require_said_once("optics", optics, refractive_index=refractive_index, reflection=reflection, metal=metal)
        _require_said_once("prior", prior, sigma=prior_sigma)
        stack, whole_numbers = _stack(images, camera, polarized)
        shape = stack[0].shape[:2]
        cloud = (prior_points, prior_normals, prior_colors)
        arrays = _prior_arrays(cloud, prior_mesh, prior_depth, shape, (prior, photos))
        labels = None if isinstance(reflection, str | os.PathLike) else as_labels(reflection, "reflection", shape)
        self._labels_sha256 = None if labels is None else hashlib.sha256(labels.tobytes()).hexdigest()
        tables = {
            "station": {"name": name, "unit": unit},
            "polarized": {"angles_deg": _angles(angles_deg, len(stack)), **noise, **(polarized or {})},
            "optics": _optics(refractive_index, reflection if labels is None else "auto", metal) | dict(optics or {}),
            "object": object,
            "prior": prior if prior_sigma is None else {**(prior or {}), "sigma": prior_sigma},
            "photos": None if photos is None else _with_absolute_folders(photos),
            "patch": patches, "profile": profiles, "scale": scale, "control": control,
        }  # fmt: skip
        self._core = _core.Station.from_arrays(
            images=stack,
            whole_numbers=whole_numbers,
            camera=None if camera is None else camera.values(),
            tables=json.dumps(plain(tables, "station: ")),
            **arrays,
            mask=None if mask is None else as_mask(mask, shape),
            labels=labels,
        )
        if (polarized or {}).get("white_level") is None:
            require_shares(stack, "images", "their polarized.white_level")

    @classmethod
    def load(cls, path: str | Path, *, photos_of: str | Path | None = None) -> Station:
        """Read a station file; `malus.InputError` names file, field, value and what was expected.

        photos_of: a file, such as that of an object, whose [photos] are used if the station file has neither [photos] nor [prior].
        """
        require_utf8(path)
        station = cls.__new__(cls)
        station._core = _core.Station.load(str(path), None if photos_of is None else str(photos_of))
        station._file = os.path.abspath(path)
        station._photos_of = None if photos_of is None else os.path.abspath(photos_of)
        return station

    def with_curves_of(self, pixels: Sequence[tuple[int, int]]) -> Station:
        """A copy of the station that shows intensity against polarizer angle (Fig. 1c of the paper) at these pixels (x, y) of its images.

        At most eight pixels; they replace `curve_pixels` of the station file. Raises `malus.InputError` for more pixels, or for
        pixels outside of the images.
        """
        station = Station.__new__(Station)
        station._file, station._photos_of = self._file, self._photos_of
        station._labels_sha256 = self._labels_sha256
        station._curves = [(int(x), int(y)) for x, y in pixels]
        station._core = self._core.with_curves_of(station._curves)
        return station

    def __copy__(self) -> Station:
        return self  # it never changes

    def __reduce__(self) -> tuple[Any, ...]:
        if self._file is None:
            raise TypeError(
                f"station {self.name}: is made of arrays, expected one of a file, which another process can read again; make it there"
            )
        return _loaded, (self._file, self._curves, self._photos_of)

    @property
    def name(self) -> str:
        """The station's name."""
        return str(self.describe()["name"])

    @property
    def unit(self) -> str:
        """Unit of all lengths."""
        return str(self.describe()["unit"])

    def describe(self) -> dict[str, Any]:
        """All values of the station, as plain data. `path`: its file; for a station made in code, words that name it in messages.
        `labels_sha256`: checksum of labels that are an array, else None.
        """
        description: dict[str, Any] = json.loads(self._core.describe())
        named = {"path": f"station {description['name']}", "labels_sha256": self._labels_sha256}
        return {**named, **description}

    def __repr__(self) -> str:
        description = self.describe()
        return f"Station({description['name']!r}, {description['image_count']} images, unit={description['unit']!r})"


def _loaded(file: str, curves: list[tuple[int, int]] | None, photos_of: str | None) -> Station:
    """A pickled station, read again."""
    station = Station.load(file, photos_of=photos_of)
    return station if curves is None else station.with_curves_of(curves)


def _require_said_once(name: str, table: Mapping[str, Any] | None, **arguments: Any) -> None:
    """ValueError if one of the arguments, by its key in this table, is not the default and the table has the key, too."""
    for key, value in arguments.items():
        default = (Station.__init__.__kwdefaults__ or {}).get(key)
        if key in (table or {}) and not (np.ndim(value) == 0 and value == default):
            raise ValueError(f"{name}: has {key}, which an argument states, too, expected one of them")


def _stack(
    images: Sequence[ArrayLike] | NDArray[Any], camera: Camera | None, polarized: PolarizedValues | None
) -> tuple[list[NDArray[Any]], bool]:
    """The images, float32, and whether they are whole numbers, rounded as those of a file. ValueError if their size is not the camera's."""
    stack = as_images(images, "images", color=True)
    height, width = stack[0].shape[:2]
    if camera is not None and (height, width) != (camera.height, camera.width):
        raise ValueError(f"images are {width} x {height} pixels, camera is {camera.width} x {camera.height}")
    has_white = (polarized or {}).get("white_level") is not None
    return stack, has_white and all(np.asarray(image).dtype.kind in "iu" for image in images)


def _angles(angles_deg: Sequence[float] | NDArray[Any] | str | None, count: int) -> Any:
    """The angles as a station file states them; ValueError unless there is one for each image."""
    if angles_deg is None or isinstance(angles_deg, str):
        return angles_deg
    angles = as_numbers(angles_deg, "angles_deg")
    if angles.shape != (count,):
        raise ValueError(f"angles_deg has shape {angles.shape}, expected ({count},): one angle per image")
    return angles


def _optics(refractive_index: float | None, reflection: Any, metal: str | complex | Sequence[float]) -> dict[str, Any]:
    """[optics] by the arguments."""
    index = "auto" if refractive_index is None else refractive_index
    named = as_metal(metal) if isinstance(metal, complex) else metal
    return {"refractive_index": index, "reflection": reflection, "metal": named}


def _with_absolute_folders(photos: PhotosValues) -> dict[str, Any]:
    """The table with absolute paths: COLMAP is started in another folder."""
    values: dict[str, Any] = dict(photos)
    return values | {key: os.path.abspath(values[key]) for key in ("folder", "masks") if key in values}


def _prior_arrays(
    cloud: tuple[ArrayLike | None, ArrayLike | None, ArrayLike | None],
    mesh: tuple[ArrayLike, ArrayLike] | None,
    depth: ArrayLike | None,
    shape: tuple[int, ...],
    others: tuple[object, object],
) -> dict[str, Any]:
    """The arrays of a prior, checked, under the names by which the C++ library takes them; a mesh's vertices are points.

    cloud: points, normals and colors. others: the tables that give a prior, too. ValueError if more than one way is given.
    """
    points, normals, colors = cloud
    if sum(given is not None for given in (points, mesh, depth, *others)) > 1:
        raise ValueError(
            "prior_points, prior_mesh, prior_depth, prior, photos: more than one is given, expected one of them"
        )
    arrays: dict[str, Any] = dict.fromkeys(
        ("prior_points", "prior_normals", "prior_colors", "prior_triangles", "prior_depth")
    )
    for name, given in (("prior_normals", normals), ("prior_colors", colors)):
        if given is not None and points is None:
            raise ValueError(f"{name} are given without prior_points")
    if points is not None:
        arrays["prior_points"] = as_rows(points, "prior_points")
        count = len(arrays["prior_points"])
        if normals is not None:
            arrays["prior_normals"] = as_rows(normals, "prior_normals", count, np.float32)
        if colors is not None:
            arrays["prior_colors"] = as_colors(colors, "prior_colors", count)
    if mesh is not None:
        if len(mesh) != 2:
            raise ValueError(f"prior_mesh has {len(mesh)} parts, expected vertices (N, 3) and triangles (M, 3)")
        arrays["prior_points"] = as_rows(mesh[0], "prior_mesh[0]")
        arrays["prior_triangles"] = as_triangles(mesh[1], "prior_mesh[1]", len(arrays["prior_points"]))
    if depth is not None:
        arrays["prior_depth"] = as_image(depth, "prior_depth")
        if arrays["prior_depth"].shape != shape:
            raise ValueError(f"prior_depth has shape {arrays['prior_depth'].shape}, expected {shape}")
    return arrays
