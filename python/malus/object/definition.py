"""Object files: the stations of one object, and the settings for its surface."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from malus import _core, photogrammetry
from malus._files import resolved
from malus._toml import read_toml
from malus.campaign import Campaign, options_of, read_tables, require_kind, stations_of, value_of
from malus.errors import InputError, MalusError, error_of
from malus.object.cloud_file import read_cloud, without_normals
from malus.object.one_frame import doubts_of_frames
from malus.object.reference import Reference
from malus.object.texture import require_packages
from malus.options import Options
from malus.photogrammetry.diagnosis import listed
from malus.photogrammetry.photos import photos_of
from malus.photogrammetry.program import Colmap
from malus.planning import check
from malus.threads import ALL_CORES

_KEYS = {
    "": ("object", "photos", "scale", "control", "options"),
    "object": (
        "name",
        "unit",
        "stations",
        "report",
        "closed",
        "max_sigma_gsd",
        "faces",
        "texture_format",
        "reference",
        "register",
        "turntable",
    ),
}
#: Triangles of the textured mesh.
_FACES = 20000.0
_LEAST_FACES, _MOST_FACES = 100, 10**9
#: Formats of the textures in object/levels/. "jpeg": JPEG colors and PNG normals, which every reader of glTF opens.
_TEXTURE_FORMATS = ("webp", "jpeg")
#: Expected seconds for the object's surface per megapixel of its stations: 87 for six of 1 megapixel, 366 for six of 4 (decision 116).
_SURFACE_SECONDS_PER_MPX = 15.0
#: Any of these keys of [camera] gives a pose.
_POSE_KEYS = ("colmap_model", "qvec", "omega_phi_kappa_deg")
#: Relative difference of two scales of one cloud up to which they are measurements of the same distance: that of scale bars.
_SAME_SCALE = 1e-3


#: What `Station.describe` says of the stations, by their files.
Stations = Mapping[Path, Mapping[str, Any]]


@dataclass(frozen=True)
class Object:
    """Stations about one object, in one frame and unit.

    closed: the mesh has no holes; areas that no station sees are guessed and marked. Otherwise these areas stay open, and so do areas
    whose standard deviation exceeds max_sigma_gsd GSD (None: four GSD, or four times that of a point of the stations' priors if this is
    more). faces: most triangles, about, of the textured mesh (object/mesh.glb).
    texture_format: of the textures in object/levels/, "webp" or "jpeg" (JPEG colors and PNG normals). reference: a scan to compare the
    mesh with; register: the scan is in another frame and is first registered to the mesh. turntable: the object turned while its
    surroundings stood still. Then only features inside the masks of photos and stations count, and these masks show all of the object.
    """

    campaign: Campaign
    unit: str
    closed: bool = False
    max_sigma_gsd: float | None = None
    faces: int = int(_FACES)
    reference: Path | None = None
    register: bool = True
    shared: Mapping[str, Any] | None = None
    """`photos`, `scale` and `control` that all stations share, as in `Station.describe`; None if the stations are already in one frame."""
    texture_format: str = _TEXTURE_FORMATS[0]
    turntable: bool = False
    folder: Path = Path()
    """That of the object's file, to which its page and quality.json name files."""

    @property
    def name(self) -> str:
        """The object's name."""
        return self.campaign.name

    @staticmethod
    def load(path: str | Path) -> Object:
        """Read an object file; InputError names file, field, value and what was expected.

        [object] has `stations`, a list of station files or globs relative to the file, and optionally `name`, `unit` (the same for
        all stations), `report`, `closed`, `max_sigma_gsd`, `faces`, `texture_format`, `reference`, `register` and `turntable`.
        [options] takes the same settings as `--options`. All stations must be in one frame. Either their poses are from one COLMAP model
        or in the same coordinates; or the object file has [photos] and [[scale]] or [[control]], as in a station file, and all stations
        are found among these photos.
        """
        file = Path(path)
        content = read_tables(file, _KEYS)
        table = content.get("object")
        if not isinstance(table, dict):
            raise InputError(f"{file}: there is no table [object]")

        def value(key: str, default: Any) -> Any:
            return value_of(file, "object", table, key, default)

        limit = value("max_sigma_gsd", 4.0) if "max_sigma_gsd" in table else None
        faces = value("faces", _FACES)
        if limit is not None and not limit > 0:
            raise InputError(f"{file}: object.max_sigma_gsd = {limit:g}, expected more than 0")
        if not _LEAST_FACES <= faces <= _MOST_FACES:
            raise InputError(f"{file}: object.faces = {faces:g}, expected {_LEAST_FACES} to {_MOST_FACES}")
        textures = value("texture_format", _TEXTURE_FORMATS[0])
        if textures not in _TEXTURE_FORMATS:
            raise InputError(f"{file}: object.texture_format = {textures!r}, expected 'webp' or 'jpeg'")
        name = value("name", file.stem)
        if not name:
            raise InputError(f"{file}: object.name = '', expected a text, or no name for that of the file")
        files = stations_of(file, "object", table)
        own = _own_photos(file) if "photos" in content else None
        campaign = Campaign(
            name, files, options_of(file, content), value("report", True),
            None if own is None else Path(os.path.abspath(file)),
        )  # fmt: skip
        stations = _described(campaign)
        unit = _common_unit(file, stations, value("unit", ""))
        shared = _shared(file, content, stations) if own is None else _own(file, own, stations)
        _require_one_frame(stations, from_photos=shared is not None)
        turntable = value("turntable", False)
        if turntable:
            _require_masks(file, stations, shared)
        reference = _reference(file, value("reference", ""), given="reference" in table)
        if reference is None and "register" in table:
            raise InputError(f"{file}: object.register needs object.reference, the scan that is to be registered")
        return Object(
            campaign,
            unit,
            value("closed", False),
            limit,
            int(faces),
            reference,
            value("register", True),
            shared,
            textures,
            turntable,
            resolved(file.parent),
        )

    def read_reference(self) -> Reference | None:
        """The scan to compare with, if there is one; InputError if it cannot be read."""
        return None if self.reference is None else Reference.read(self.reference, self.unit)

    def unmasked(self) -> list[str]:
        """Warnings about photos and stations of a turntable that have no mask; none for other objects."""
        if not self.turntable or self.shared is None:
            return []
        masked = {
            "photos": {photo.name: photo.mask is not None for photo in photos_of(self.shared["photos"])},
            "stations": self._masked_stations(),
        }
        warnings = []
        for what, known in masked.items():
            if without := [name for name, has_mask in known.items() if not has_mask]:
                warnings.append(
                    f"turntable: {len(without)} of {len(known)} {what} have no mask ({listed(without)}): what stands still behind "
                    "the object can pull them to a wrong place; give them masks, or leave them out"
                )
        return warnings

    def require_ready(self) -> None:
        """Raise what would otherwise end a run after hours of work: ExternalError for a package or program that is missing, and InputError
        for a reference that cannot be read.
        """
        require_packages()
        if self.closed or self.shared is not None:
            Colmap(1, self.campaign.options.photos.backend)
        self.read_reference()

    def check(self, options: Options | None = None, *, threads: int = ALL_CORES) -> list[dict[str, Any]]:
        """The result of `malus.check` for each station, with `station`, its name in folders and tables; the first one includes the
        processing of the shared photos.

        Raises the errors that a run would raise before it starts. If stations cannot be run, the error lists all of them, with reasons.
        """
        self.require_ready()
        settings = options or self.campaign.options
        plans: list[dict[str, Any]] = []
        failed: dict[str, MalusError] = {}
        clouds: set[str] = set()
        described: dict[str, Mapping[str, Any]] = {}
        for task in self.campaign.tasks(Path(), threads):
            try:
                station = task.load()
                plan = check(station, settings, cameras_known=self.shared is not None, threads=threads)
                plans.append({"station": task.identifier, **plan})
                described[task.identifier] = station.describe()
                cloud = described[task.identifier].get("prior_cloud")
                if cloud is not None and cloud not in clouds:
                    clouds.add(cloud)
                    if read_cloud(Path(cloud), self.unit) is None:
                        plan["warnings"].append(without_normals(cloud, self.folder))
            except MalusError as error:
                failed[task.identifier] = error
        if failed:
            raise _together(failed, len(self.campaign.stations))
        if self.shared is None:
            doubts = doubts_of_frames(described, self.folder)
            for plan in plans:
                plan["warnings"] += doubts[plan["station"]]
        else:
            description = {**self.campaign.station(self.campaign.stations[0]).describe(), **self.shared}
            photos = photogrammetry.plan(
                description, 1e-6 * plans[0]["width"] * plans[0]["height"], options=settings, threads=threads,
                silhouettes=self._outlines_of_others(),
            )  # fmt: skip
            does = plans[0]["does"]
            sweep = next(k for k, line in enumerate(does) if line.startswith("sweep: "))
            does[sweep:sweep] = photos.photos
            plans[0]["warnings"] += [*photos.warnings, *self.unmasked()]
            plans[0]["seconds"] += photos.finding.seconds
            plans[0]["memory_mb"] = max(plans[0]["memory_mb"], photos.finding.memory_mb)
        return plans

    def _outlines_of_others(self) -> int:
        """How many outlines of other stations every station has at least as silhouettes."""
        return max(0, sum(self._masked_stations().values()) - 1) if self.turntable else 0

    def _masked_stations(self) -> dict[str, bool]:
        """Whether each station has a mask, by its name in folders and tables."""
        return {task.identifier: _has_mask(task.load().describe()) for task in self.campaign.tasks(Path(), ALL_CORES)}

    def planned_surface(self, plans: Sequence[Mapping[str, Any]]) -> tuple[str, float]:
        """What a run makes of the finished stations, and its expected seconds. plans: of the stations, from `check`."""
        does = f"surface: one {'closed' if self.closed else 'open'} mesh, and a textured one of at most about {self.faces} triangles"
        if self.reference is not None:
            does += f", compared with {self.reference.name}"
        return does, _SURFACE_SECONDS_PER_MPX * 1e-6 * sum(plan["width"] * plan["height"] for plan in plans)


def _described(campaign: Campaign) -> dict[Path, Mapping[str, Any]]:
    """What `Station.describe` says of the stations, by their files. The error lists all stations whose files cannot be read."""
    stations: dict[Path, Mapping[str, Any]] = {}
    failed: dict[str, MalusError] = {}
    for task, path in zip(campaign.tasks(Path(), 1), campaign.stations, strict=True):
        try:
            require_kind(path, "station")
            # Reported here, because the station itself would report a missing pose, which a [prior] needs.
            if campaign.photos_of is not None and "prior" in read_toml(path, "station file"):
                raise InputError(
                    f"{path}: has a [prior], but {campaign.photos_of} has [photos], which give all stations their pose and coarse "
                    "surface; expected the lens in [camera], and no [prior]"
                )
            stations[path] = task.load().describe()
        except MalusError as error:
            failed[task.identifier] = error
    if failed:
        raise _together(failed, len(campaign.stations))
    return stations


def _together(failed: Mapping[str, MalusError], count: int) -> MalusError:
    """One error for all stations (by name) that cannot be run, with the exit code of the first; one that all have in common stays as it is."""
    first = next(iter(failed.values()))
    if len(failed) == count and len({str(error) for error in failed.values()}) == 1:
        return first
    lines = [f"{len(failed)} of {count} stations cannot be run"]
    return error_of(first.exit_code)("\n".join([*lines, *(f"  {name}: {error}" for name, error in failed.items())]))


def _reference(file: Path, name: str, *, given: bool) -> Path | None:
    if not given:
        return None
    path = resolved(file.parent / name)
    if not path.is_file():
        raise InputError(f"{file}: object.reference = {name!r}, expected a file: PLY, XYZ, LAS or E57")
    return path


def _common_unit(file: Path, stations: Stations, expected: str) -> str:
    """The unit of the stations; InputError if they do not all have the same one."""
    for path, station in stations.items():
        expected = expected or station["unit"]
        if station["unit"] != expected:
            raise InputError(f"{path}: station.unit = {station['unit']!r}, expected {expected!r} as the rest of {file}")
    return expected


def _has_mask(station: Mapping[str, Any]) -> bool:
    return station["mask"] is not None


def _require_masks(file: Path, stations: Stations, shared: Mapping[str, Any] | None) -> None:
    """InputError unless a turntable's stations are found among photos, and photos and stations have masks: without masks the
    surroundings, which do not turn, place all images as if nothing had turned.
    """
    if shared is None:
        raise InputError(
            f"{file}: object.turntable = true needs [photos], among which the stations are found; stations with given poses are in "
            "the object's frame already, expected them without it"
        )
    if shared["photos"]["masks"] is None:
        raise InputError(
            f"{file}: object.turntable = true needs masks of the photos: what stands still behind the object would place them as if "
            "nothing had turned; expected [photos] masks, a folder with a mask for every photo"
        )
    if not any(map(_has_mask, stations.values())):
        raise InputError(
            f"{file}: object.turntable = true needs masks of the stations: what stands still behind the object would place them as if "
            "nothing had turned; expected [polarized] mask in every station file"
        )


def _require_one_frame(stations: Stations, *, from_photos: bool) -> None:
    """InputError unless every station has a [camera]; or, if photos give pose and prior, has a lens without pose and prior. Stations
    whose own file says nothing about the others' frame are errors, too.
    """
    for path, station in stations.items():
        camera = station.get("camera")
        if not from_photos and camera is None:
            raise InputError(
                f"{path}: [camera] is missing; the stations of an object must stand in one frame, expected colmap_model and image, "
                "or a pose, or [photos] in which all of them are found"
            )
        if from_photos and (camera is None or "rotation" in camera):
            raise InputError(
                f"{path}: [camera] {'is missing' if camera is None else 'has a pose, but [photos] give it in another frame'}; "
                "expected the lens of the polarized images alone: model, width, height and params"
            )
        if from_photos and station["prior"] != "photos":
            raise InputError(
                f"{path}: has a [prior], or no [photos]; expected [photos] alone, as in the other stations of the object"
            )
        if not from_photos and station["prior"] == "none":
            raise InputError(
                f"{path}: has neither [prior] nor [photos], and so no surface; expected [prior] in the frame of the other stations of the "
                "object, or [photos] in which all of them are found"
            )
        marked = any(point["marks"] for point in station["control"])
        if not from_photos and station["prior"] == "photos" and not marked:
            raise InputError(
                f"{path}: has no [prior], so that its frame is that of its own photos; expected pose and [prior] in the frame of the "
                "other stations of the object, or [[control]] points with marks in the photos"
            )
    _require_poses(stations)
    _require_one_scale(stations)


def _require_poses(stations: Stations) -> None:
    """InputError if more than one station takes its camera's frame for the world's, as it may with a depth map or a shape as prior."""
    without = [
        path
        for path, station in stations.items()
        if station["prior"] not in ("cloud", "mesh", "photos")
        and not station["control"]
        and not any(key in read_toml(path, "station file").get("camera", {}) for key in _POSE_KEYS)
    ]
    if len(without) > 1:
        raise InputError(
            f"{without[1]}: [camera] has no pose, like that of {without[0]}, so that each stands in a frame of its own; expected qvec "
            "and tvec, or omega_phi_kappa_deg and center, in one frame for all stations of the object"
        )


def _require_one_scale(stations: Stations) -> None:
    """InputError if known distances scale a cloud or a mesh that several stations share differently: their frames differ then."""
    known: dict[str, tuple[Path, float]] = {}
    for path, station in stations.items():
        source = station.get("prior_cloud") or station.get("prior_mesh")
        if source is None:
            continue
        first, scale = known.setdefault(source, (path, station["prior_scale"]))
        if abs(station["prior_scale"] / scale - 1) > _SAME_SCALE:
            raise InputError(
                f"{path}: its [[scale]] make {source} {station['prior_scale']:.6g} times as large, those of {first} "
                f"{scale:.6g} times; expected the same [[scale]] in all stations of the object"
            )


def _shared(file: Path, content: Mapping[str, Any], stations: Stations) -> dict[str, Any] | None:
    """Photos, known distances and control points by which all stations are found, from the stations' files; None without photos."""
    if names := [name for name in ("scale", "control") if name in content]:
        raise InputError(f"{file}: [[{names[0]}]] needs [photos], in which its points are marked")
    # Next to given surfaces, photos are those of one station, which its control points bring into the frame of the others.
    photographed = [path for path, station in stations.items() if station["prior"] == "photos"]
    if not photographed or any(station["prior"] not in ("photos", "none") for station in stations.values()):
        return None
    first, *others = photographed
    photos = stations[first]["photos"]
    for path in others:
        if stations[path]["photos"] != photos:
            raise InputError(
                f"{path}: [photos] are not those of {first}; the stations of an object are found in the same photos"
            )
    _require_one_size(stations)
    files = ", ".join(str(path) for path in stations)
    marks = {"scale": _distances_of_all(stations), "control": _points_of_all(stations)}
    return {"path": files, "photos": photos, **marks}


def _require_one_size(stations: Stations) -> None:
    """InputError if one station states distances and another one control points: the points alone would count."""
    scaled, pointed = (next((path for path in stations if stations[path][key]), None) for key in ("scale", "control"))
    if scaled is not None and pointed is not None:
        raise InputError(
            f"{scaled}: [[scale]] cannot be given together with the [[control]] points of {pointed}: they give the size of the object, "
            "and those with check = true show how good it is"
        )


def _own_photos(file: Path) -> dict[str, Any]:
    """The object file's photos, distances and points."""
    own: dict[str, Any] = json.loads(_core.photos_tables(str(file)))
    for point in own["control"]:
        if point["pixel"] is not None:
            raise InputError(
                f"{file}: [[control]] {point['name']}: pixel is a place in one station's image; expected it in that station's "
                "file, and here marks in the photos"
            )
    return own


def _own(file: Path, own: dict[str, Any], stations: Stations) -> dict[str, Any]:
    """The object file's photos, distances and points. InputError if a station file has other ones, which would be ignored."""
    for path, station in stations.items():
        if station.get("photos", own["photos"]) != own["photos"]:
            raise InputError(
                f"{path}: [photos] are not those of {file}, which count for all stations; expected the same folder, "
                "exclude, masks and camera"
            )
        marked = [f"[[control]] {point['name']} with marks" for point in station["control"] if point["marks"]]
        if given := ["[[scale]]"] * bool(station["scale"]) + marked:
            raise InputError(f"{path}: {given[0]} does not count, since {file} has [photos]; expected it in that file")
        if station["control"] and not own["control"]:
            raise InputError(
                f"{path}: [[control]] {station['control'][0]['name']}: the object is not in the frame of this point, expected [[control]] "
                f"points with marks in the photos in {file}"
            )
    return own


def _distances_of_all(stations: Stations) -> list[Any]:
    """Known distances of all stations, without duplicates; InputError if one is held out in one file and used in another."""
    found: dict[str, tuple[Path, Any]] = {}
    for path, station in stations.items():
        for entry in station["scale"]:
            first, known = found.setdefault(json.dumps({**entry, "check": None}), (path, entry))
            if entry["check"] != known["check"]:
                raise InputError(
                    f"{path}: [[scale]] distance = {entry['distance']:g}: check is not what {first} says of the same distance; "
                    "expected the same"
                )
    return [entry for _, entry in found.values()]


def _points_of_all(stations: Stations) -> list[Any]:
    """Control points of all stations, without duplicates. A point has one position and one set of marks, as the stations share the
    photos; its pixel differs between the stations' images.
    """
    found: dict[str, tuple[Path, dict[str, Any]]] = {}
    for path, station in stations.items():
        for entry in station["control"]:
            point = {**entry, "pixel": None}
            first, known = found.setdefault(point["name"], (path, point))
            if not known["marks"] or not point["marks"]:  # One station marks the point in its polarized image alone.
                known["marks"] = point["marks"] = known["marks"] or point["marks"]
            if different := [key for key in point if point[key] != known[key]]:
                raise InputError(
                    f"{path}: [[control]] {point['name']}: {different[0]} is not what {first} says of the point of this name; "
                    "expected the same, or another name"
                )
    return [point for _, point in found.values()]
