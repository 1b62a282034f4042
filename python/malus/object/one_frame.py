"""Whether stations with poses of their own stand in one frame, as far as their files tell before a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core, scans
from malus._files import resolved, with_relative_paths
from malus._toml import read_toml
from malus.camera import Camera
from malus.columns import number
from malus.errors import InputError
from malus.object.views import Floats
from malus.photogrammetry.diagnosis import listed
from malus.registration import some_of

#: What `Station.describe` says of the stations, by their names.
Described = Mapping[str, Mapping[str, Any]]

#: Photos of the same names are the same photos if most of them turn alike from one model to the other, within this angle (radians). Two
#: models are compared if they share at least so many photos; more than the largest number are not needed.
_ALIKE_RAD, _LEAST_PHOTOS, _MOST_PHOTOS = 0.03, 3, 300
#: Two models have one frame if the photos are turned by less than this angle (radians), and moved by less than this share of their distance
#: from the object. An adjustment that is repeated with other photos moves them less; models made separately are off by any amount.
_SAME_FRAME = 0.01
#: Points of a prior that are looked for in the views of other stations, and points that are projected at once.
_MOST_POINTS, _AT_ONCE = 1_000_000, 50_000
#: A view is taken to be wider by this share on each side, for lenses with distortion.
_MARGIN = 0.25


def doubts_of_frames(stations: Described, folder: Path) -> dict[str, list[str]]:
    """Warnings, by the name of the station they are about, on stations that seem to stand in different frames.

    stations: with a pose and a prior each. folder: that of the object's file, to which warnings name files. Raises InputError for priors
    that cannot be read.
    """
    doubts: dict[str, list[str]] = {name: [] for name in stations}
    groups = _Groups(stations)
    named: dict[tuple[Path, float], str] = {}
    for name, station in stations.items():
        if (model := _model_of(station)) is not None:
            groups.link(named.setdefault((model, station["prior_scale"]), name), name)
    models: dict[str, _Model] = {}
    for key, name in named.items() if len(named) > 1 else ():
        with suppress(InputError):  # damaged points, which stations do not read
            models[name] = _Model.read(*key)
    for earlier, later in combinations(models, 2):
        if doubts[later] or groups.are_linked(earlier, later):
            continue
        moved = _moved(models[earlier], models[later])
        if moved is not None and moved.is_noise:
            groups.link(earlier, later)
        elif moved is not None:
            said = (
                f"{models[later].folder} and {models[earlier].folder}, the model of {earlier}, are in different frames: of {moved.photos} "
                f"photos of the same names {moved.photo} is turned by {moved.degrees:.3g}° and moved by {number(moved.distance)} "
                f"{stations[later]['unit']} from one to the other; expected poses and priors from one model of all photos"
            )
            doubts[later].append(with_relative_paths(said, folder))
    if any(doubts.values()):
        return doubts
    _link_by_priors(groups, stations)
    first, *others = sorted(groups.members(), key=len, reverse=True)
    for names in others:
        doubts[names[0]].append(
            f"{listed(names)} and {listed(first)} have nothing in common: no prior of the ones has a point in the views of the others; if "
            "they show the same places, they stand in different frames or units: expected poses and priors from one model of all photos"
        )
    return doubts


class _Groups:
    """Stations that are known to be in one frame."""

    def __init__(self, names: Iterable[str]) -> None:
        self._of = {name: number for number, name in enumerate(names)}

    def link(self, name: str, other: str) -> None:
        joined = self._of[other]
        self._of = {member: self._of[name] if number == joined else number for member, number in self._of.items()}

    def are_linked(self, name: str, other: str) -> bool:
        return self._of[name] == self._of[other]

    def members(self) -> list[list[str]]:
        return [[name for name in self._of if self._of[name] == number] for number in dict.fromkeys(self._of.values())]


@dataclass(frozen=True)
class _Model:
    """Photos of a COLMAP model in a station's frame. numbers: by the photos' names. rotations: N×3×3, from the world. centers: N×3.
    distance: usual one from the object.
    """

    folder: Path
    numbers: dict[str, int]
    rotations: Floats
    centers: Floats
    distance: float

    @staticmethod
    def read(folder: Path, scale: float) -> _Model:
        """The model in a folder, made `scale` times as large."""
        model = _core.ColmapModel.read(str(folder))
        images, points = model.images(), model.points()[0]
        rotations = np.array([values[4] for values, _, _ in images.values()]).reshape(-1, 3, 3)
        translations = np.array([values[5] for values, _, _ in images.values()]).reshape(-1, 3)
        centers = -np.einsum("nji,nj->ni", rotations, translations)
        middle = np.median(points if len(points) else centers, axis=0)
        distance = float(np.median(np.linalg.norm(centers - middle, axis=1)))
        return _Model(folder, {name: k for k, name in enumerate(images)}, rotations, scale * centers, scale * distance)


def _model_of(station: Mapping[str, Any]) -> Path | None:
    """The folder of the COLMAP model that gives a station its frame; None without one."""
    file = Path(station["path"])
    folder = read_toml(file, "station file").get("camera", {}).get("colmap_model")
    if folder is not None:
        return resolved(file.parent / folder)
    cloud = station.get("prior_cloud")
    return resolved(Path(cloud) / "sparse") if cloud is not None and Path(cloud).is_dir() else None


@dataclass(frozen=True)
class _Moved:
    """How the photos that two models share are moved from the first to the second one: their number; the photo that is moved by the median
    distance, its turn and its distance; and whether the two models can be in the same frame.
    """

    photos: int
    photo: str
    degrees: float
    distance: float
    is_noise: bool


def _moved(first: _Model, second: _Model) -> _Moved | None:
    """None if the models have too few photos in common, or others of the same names."""
    common = sorted(first.numbers.keys() & second.numbers.keys())
    if len(common) < _LEAST_PHOTOS:
        return None
    names = [common[k] for k in some_of(len(common), _MOST_PHOTOS)]
    before, after = [first.numbers[name] for name in names], [second.numbers[name] for name in names]
    turns = np.einsum("nji,njk->nik", second.rotations[after], first.rotations[before]).reshape(-1, 9)

    def angles(traces: Floats) -> Floats:
        return np.asarray(np.arccos(np.clip((traces - 1) / 2, -1, 1)))

    if np.median(angles(turns @ turns.T), axis=1).min() > _ALIKE_RAD:
        return None
    turned = angles(turns @ np.eye(3).ravel())
    moved = np.linalg.norm(second.centers[after] - first.centers[before], axis=1)
    nearer = min(first.distance, second.distance)
    middle = np.argsort(moved)[len(moved) // 2]
    return _Moved(
        len(common), names[middle], float(np.degrees(turned[middle])), float(moved[middle]),
        bool(np.median(turned) < _SAME_FRAME and np.median(moved) <= _SAME_FRAME * nearer),
    )  # fmt: skip


def _link_by_priors(groups: _Groups, stations: Described) -> None:
    """Link stations of which one has a point of its prior in the view of the other one, or which share the prior. Where points are not
    known before the run, all are taken to be linked.
    """
    points = {name: _points_of(station) for name, station in stations.items()}
    sources: dict[tuple[str, float], str] = {}
    for name, station in stations.items():
        source = station.get("prior_cloud") or station.get("prior_mesh") or name
        groups.link(sources.setdefault((source, station["prior_scale"]), name), name)
        if points[name] is None:
            for other in stations:
                groups.link(name, other)
    for name, read in points.items():
        apart = [other for other in stations if not groups.are_linked(name, other)]
        if apart and read is not None:
            seen = read()
            for other in apart:
                if not groups.are_linked(name, other) and _in_view(seen, stations[other]["camera"]):
                    groups.link(name, other)


def _points_of(station: Mapping[str, Any]) -> Callable[[], Floats] | None:
    """Reads points (N×3) of a station's prior in the object's frame; None for shapes, which may have no end, and for photos."""
    scale, prior = station["prior_scale"], station["prior"]
    if prior == "cloud":
        return lambda: scale * _some(_cloud(Path(station["prior_cloud"]), station["unit"]))
    if prior == "mesh":
        return lambda: scale * _on_mesh(*_core.read_cloud_or_mesh(station["prior_mesh"]))
    if prior == "depth":
        return lambda: _of_depth(scale * _core.read_raster(station["prior_depth"]), station["camera"])
    return None


def _cloud(path: Path, unit: str) -> Floats:
    return scans.read_scan(path, unit).points if scans.is_scan(path) else _core.read_oriented_points(str(path))[0]


def _some(points: Floats) -> Floats:
    return points[some_of(len(points), _MOST_POINTS)]


def _on_mesh(vertices: Floats, triangles: NDArray[np.uint32] | None) -> Floats:
    """Points all over a mesh, as its triangles may be larger than a view."""
    if triangles is None:
        return _some(vertices)
    corners = vertices[triangles[some_of(len(triangles), _MOST_POINTS)]]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not areas.sum() > 0:
        return _some(vertices)
    random = np.random.default_rng(0)
    chosen = corners[random.choice(len(corners), _MOST_POINTS // 4, p=areas / areas.sum())]
    return np.asarray(np.einsum("nk,nkj->nj", random.dirichlet(np.ones(3), len(chosen)), chosen))


def _of_depth(depth: NDArray[np.float32], camera: Mapping[str, Any]) -> Floats:
    """The points of a depth map of the undistorted image."""
    lens = Camera.from_description(camera).undistorted()
    step = max(1, math.isqrt(depth.size // _MOST_POINTS))
    some = depth[::step, ::step]
    rows, columns = np.nonzero((some > 0) & np.isfinite(some))
    z = some[rows, columns].astype(np.float64)
    in_camera = np.stack([(step * columns - lens.cx) / lens.fx * z, (step * rows - lens.cy) / lens.fy * z, z], 1)
    rotation, translation = lens.pose()
    return np.asarray((in_camera - translation) @ rotation)


def _in_view(points: Floats, camera: Mapping[str, Any]) -> bool:
    """Whether some of the points lie in a camera's view, at whatever distance."""
    lens = Camera.from_description(camera).undistorted()
    rotation, translation = lens.pose()
    size, focal = np.array([lens.width, lens.height]), np.array([lens.fx, lens.fy])
    off = np.array([lens.cx, lens.cy]) - (size - 1) / 2
    for start in range(0, len(points), _AT_ONCE):
        at = points[start : start + _AT_ONCE] @ rotation.T + translation
        at = at[at[:, 2] > 0]
        if (np.abs(focal * at[:, :2] + off * at[:, 2:]) < (0.5 + _MARGIN) * size * at[:, 2:]).all(1).any():
            return True
    return False
