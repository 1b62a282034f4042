"""From photos and the station's image to the station's pose and the depth in its view: the main path.

photos → their cameras (photo_cameras) → the station among them (station_pose) → more accurate image points in all
images (window_matching) → metric scale (scale) or frame (control) → surface sweep in the station's view
(malus.stereo) → depth with sigma → second sweep near the surface fused with this depth. All files are kept below one
folder, and finished stages are not repeated (journal).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core, stereo
from malus._robust import robust_spread
from malus.camera import Camera
from malus.errors import DataError, InputError
from malus.options import Options
from malus.photogrammetry import diagnosis
from malus.photogrammetry.bench import Bench
from malus.photogrammetry.control import adjust_datum, move_model, require_control_points
from malus.photogrammetry.diagnosis import Log
from malus.photogrammetry.journal import Journal, digest
from malus.photogrammetry.marks import require_marks_in_photos
from malus.photogrammetry.model import SparseModel
from malus.photogrammetry.photo_cameras import PhotoCameras, enough_photos_of, solve_photos
from malus.photogrammetry.photos import Photo, describe_photo
from malus.photogrammetry.program import Colmap
from malus.photogrammetry.scale import adjust_scale
from malus.photogrammetry.station_pose import (
    STATION_IMAGE,
    PlacedStations,
    StationView,
    lens_of_raster,
    place_stations,
    station_image,
)
from malus.photogrammetry.window_matching import match_windows

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class StationCameras:
    """Cameras in the world of the result: the control points' frame, or COLMAP's scaled to the station's unit."""

    station: Camera
    """Lens (that of the undistorted raster if a lens was given, else the calibrated one) and pose."""
    photos: list[tuple[Photo, Camera]]
    model: SparseModel
    figures: dict[str, Any]
    """For quality.json: `photogrammetry`, `scale`, and `control` if there are control points."""
    times: dict[str, Any]
    """`seconds`, `cpu_seconds` and `peak_mb` of all stages together, and of each stage (`stages`)."""
    warnings: list[str] = field(default_factory=list)
    """Warnings from the joint search for the cameras of several stations, for this station's report."""
    silhouettes: list[tuple[str, Path, Camera]] = field(default_factory=list)
    """Outlines of the object beside those of `photos`: image name, mask, and camera of the image that the mask belongs to."""


@dataclass(frozen=True)
class Outline:
    """A station's mask, which shows all of the object that is in view."""

    mask: NDArray[np.uint8]
    """H×W of the undistorted image, non-zero = object."""
    file: Path
    """The mask of the images as taken."""


def camera_of(description: Mapping[str, Any]) -> Camera:
    """The camera of a description by `Station.describe`."""
    return Camera(
        description["model"], description["width"], description["height"], description["params"],
        description.get("rotation", np.eye(3)), description.get("translation", np.zeros(3)),
    )  # fmt: skip


def find_cameras(
    station: Mapping[str, Any],
    unpolarized: NDArray[np.float32],
    folder: Path,
    *,
    options: Options,
    threads: int,
    progress: Report,
    log: Log,
) -> StationCameras:
    """Cameras of a station's photos and of the station itself.

    station: as `Station.describe` returns it. unpolarized: H×W intensity of the station's view, linear, undistorted if its
    lens is known. folder: where COLMAP's files, logs and marks of finished stages are kept.

    Raises InputError for wrong files, DataError with advice on what to photograph if the photos do not suffice, and
    ExternalError if COLMAP is missing or fails.
    """
    bench = _bench(folder, options, threads, progress, log)
    photos, solved = _solved(bench, station)
    lens = lens_of_raster(camera_of(station["camera"])) if "camera" in station else None
    shared = None if lens is not None else _photo_of_same_camera(station, photos, solved.model, unpolarized.shape, log)
    view = StationView(unpolarized, lens, shared)
    placed, model, figures = _placed_and_scaled(bench, photos, solved, {STATION_IMAGE: view}, station)
    figures["photogrammetry"]["station"] = {
        **_station_figures(placed, STATION_IMAGE),
        "lens": "given" if lens is not None else "of the photos" if shared is not None else "self-calibrated",
    }
    return StationCameras(
        station=model.images[STATION_IMAGE].camera,
        photos=[(photo, model.images[photo.name].camera) for photo in photos if photo.name in model.images],
        model=model,
        figures=figures,
        times=_times(bench.journal),
    )


def find_object_cameras(
    shared: Mapping[str, Any],
    stations: Mapping[str, tuple[Camera, NDArray[np.float32]]],
    folder: Path,
    *,
    outlines: Mapping[str, Outline] | None = None,
    options: Options,
    threads: int,
    progress: Report,
    log: Log,
) -> dict[str, StationCameras]:
    """Cameras of an object's photos and of its stations in one model, by the stations' names.

    shared: `path`, `photos`, `scale` and `control` as in `Station.describe`. stations: lens and H×W unpolarized intensity, undistorted.
    Stations that cannot be placed are left out. For each station, the images of the other stations count as photos. outlines: of an
    object that turned before a fixed camera, by the names of the stations that have a mask. Features then count only inside the masks of
    photos and stations, and the stations' outlines are silhouettes as those of the photos are. Raises the errors of `find_cameras`.
    """
    bench = _bench(folder, options, threads, progress, log, inside_masks=outlines is not None)
    outlines = outlines or {}
    photos, solved = _solved(bench, shared)
    images = {name: station_image(number) for number, name in enumerate(stations)}
    views = {
        images[name]: StationView(
            unpolarized, lens_of_raster(lens), mask=outlines[name].mask if name in outlines else None
        )
        for name, (lens, unpolarized) in stations.items()
    }
    placed, model, figures = _placed_and_scaled(bench, photos, solved, views, shared)
    pictures = list(photos)
    for image, view in views.items():
        height, width = view.unpolarized.shape
        pictures.append(Photo(image, bench.images / image, width, height))
    silhouettes = {
        name: (images[name], outline.file, _placed_at(stations[name][0], model.images[images[name]].camera))
        for name, outline in outlines.items()
        if placed.has(images[name])
    }
    found = {}
    for name, image in images.items():
        if placed.has(image):
            own = {**figures["photogrammetry"], "station": {**_station_figures(placed, image), "lens": "given"}}
            found[name] = StationCameras(
                station=model.images[image].camera,
                photos=[
                    (picture, model.images[picture.name].camera)
                    for picture in pictures
                    if picture.name in model.images
                    and picture.name != image
                    and (picture.name not in views or placed.has(picture.name))
                ],
                model=model,
                figures={**figures, "photogrammetry": own},
                times=_times(bench.journal),
                silhouettes=[silhouette for other, silhouette in silhouettes.items() if other != name],
            )
    return found


def _placed_at(lens: Camera, camera: Camera) -> Camera:
    """A lens with the pose of another camera."""
    return replace(lens, rotation=camera.rotation, translation=camera.translation)


def _bench(
    folder: Path, options: Options, threads: int, progress: Report, log: Log, *, inside_masks: bool = False
) -> Bench:
    folder.mkdir(parents=True, exist_ok=True)
    colmap = Colmap(threads, options.photos.backend)
    journal = Journal(folder, log, colmap)
    return Bench(colmap, folder, journal, options, progress, journal.log, inside_masks)


def _solved(bench: Bench, said: Mapping[str, Any]) -> tuple[list[Photo], PhotoCameras]:
    """The photos that [photos] names, and their cameras. said: `path`, `photos`, `scale` and `control`."""
    photos = enough_photos_of(said["photos"], bench.log)
    require_marks_in_photos(said, photos)
    require_control_points(said, [photo.name for photo in photos])
    solved = solve_photos(bench, photos, known_lens(said["photos"]["camera"], bench.log))
    relief = solved.model.relief()
    if not solved.calibrated and relief < diagnosis.FLAT_RELIEF:
        raise DataError(diagnosis.unknown_focal_on_flat_scene(relief))
    return photos, solved


def _placed_and_scaled(
    bench: Bench,
    photos: list[Photo],
    solved: PhotoCameras,
    views: Mapping[str, StationView],
    said: Mapping[str, Any],
) -> tuple[PlacedStations, SparseModel, dict[str, Any]]:
    """Place the stations among the photos, measure by windows, and scale the model to the station unit or, with control
    points, move it into their frame. said: `scale` and `control`, and the `path` of their file. Returns the placed
    stations, the model and its figures.
    """
    placed, windows = match_windows(bench, photos, solved, views, place_stations(bench, solved, views))
    registered = {name: camera for name, camera in placed.model.cameras.items() if name not in views}
    scale, datum = None, None
    try:
        if said["control"]:
            bench.report("scale", 0.0, "frame from control points")
            datum = adjust_datum(said["control"], registered, bench.options.photos.mark_sigma_px, bench.log)
        else:
            bench.report("scale", 0.0, "scale from known distances")
            scale = adjust_scale(said["scale"], photos, registered, bench.options, bench.log)
    except (InputError, DataError) as error:
        raise type(error)(f"{said['path']}: {error}") from error
    bench.journal.require_unchanged()
    factor = 1.0 if scale is None else float(scale["scale"])
    unmoved = {"scale": factor, "rotation": np.eye(3), "translation": np.zeros(3)}
    move_model(placed.folder, bench.folder / "model", datum or unmoved)
    model = SparseModel.read(bench.folder / "model")
    figures = {
        "photogrammetry": {
            "program": bench.colmap.title,
            "photos": len(photos),
            "registered": len(registered),
            "unregistered": solved.unregistered,
            "self_calibrated": not solved.calibrated,
            "reprojection_px": model.mean_error_px,
            "points": len(model.points),
            "relief": solved.model.relief(),
            "windows": windows,
            "files": solved.hashes,
        },
        "scale": scale,
    }
    if datum is not None:
        figures["control"] = {"datum": {**datum, "rotation": datum["rotation"].tolist()}}
    bench.progress(1.0, f"{len(registered)} of {len(photos)} photos")
    return placed, model, figures


def _station_figures(placed: PlacedStations, image: str) -> dict[str, Any]:
    matches = placed.matches[image]
    return {
        "matches": sum(matches.values()),
        "photos_matched": len(matches),
        "points_seen": placed.model.images[image].observations,
    }


def _times(journal: Journal) -> dict[str, Any]:
    stages = journal.times.values()
    return {
        **{name: round(sum(stage[name] for stage in stages), 2) for name in ("seconds", "cpu_seconds")},
        "peak_mb": max((stage["peak_mb"] for stage in stages), default=0.0),
        "stages": journal.times,
    }


def known_lens(said: Mapping[str, Any] | None, log: Log) -> Camera | None:
    """The photos' calibrated lens in one of COLMAP's models."""
    if said is None:
        return None
    values, rms_px = _core.as_colmap_camera(camera_of(said).values())
    if rms_px > 0.05:
        log(
            "warning",
            f"COLMAP has no lens model like that of [photos].camera; the nearest one differs by {rms_px:.2f} px",
        )
    return Camera(*values)


def _photo_of_same_camera(
    station: Mapping[str, Any], photos: list[Photo], model: SparseModel, shape: tuple[int, ...], log: Log
) -> str | None:
    """Name of a registered photo with the camera, lens and focal length of the station, by the data in the files; None if there is none."""
    first = describe_photo(Path(station["images"][0]), "station") if station["images"] else None
    if first is not None and (first.height, first.width) == shape:
        for photo in photos:
            if photo.name in model.images and photo.camera_key == first.camera_key:
                log(
                    "warning",
                    f"the station's lens is not given ([camera] is missing); that of the photos is used, since {photo.name} "
                    "is of the same size and says nothing else. If focus or zoom differ, the surface is wrong: calibrate",
                )
                return photo.name
    log(
        "warning",
        "the station's lens is not given ([camera] is missing) and is no photo's: it is calibrated from this one image, "
        "which determines its focal length and distance badly; give [camera] model, width, height and params",
    )
    return None


@dataclass(frozen=True)
class Swept:
    """Depth of the station's undistorted view (H×W), from the photos."""

    depth: NDArray[np.float32]
    sigma: NDArray[np.float32]
    """Standard deviation of the depth."""
    shape: NDArray[np.float32] | None
    """Surface around which the sweep searched; None = without a known surface."""
    figures: dict[str, Any]
    times: dict[str, Any]
    """`seconds`, `cpu_seconds` and `peak_mb` of all stages together, and of each stage (`stages`)."""
    hull: Hull | None = None
    """Visual hull, for the pixels without a depth; None = none or too few of the photos have a mask."""

    def rasters(self) -> dict[str, NDArray[np.float32]]:
        """Rasters of the C++ library's SweptDepth by name."""
        found = {"depth": self.depth, "sigma": self.sigma}
        if self.shape is not None:
            found["shape"] = self.shape
        if self.hull is not None:
            found |= {"hull": self.hull.depth, "hull_sigma": self.hull.sigma}
        return found


@dataclass(frozen=True)
class Hull:
    """Front of the photos' visual hull in the station's view, H×W; NaN = none."""

    depth: NDArray[np.float32]
    sigma: NDArray[np.float32]
    """One standard deviation of depth."""
    figures: dict[str, Any]
    """`masks`: how many; `mask_files`: their SHA-256, by the images' names."""
    masks: dict[Path, str]
    """The masks' files and their SHA-256."""


@dataclass(frozen=True)
class FusedOnce:
    """A surface fused with a first sweep's prior, and that prior (H×W)."""

    depth: NDArray[np.float32]
    prior_depth: NDArray[np.float32]
    prior_sigma: NDArray[np.float32]


#: Least share of the object on which photos must agree for a second sweep, near the fused surface. Below it, the photos
#: show mostly mirror images, which a narrow search would find again at any depth.
AGAIN_COMPLETENESS = 0.3
#: Where the fused surface is farther from its prior than this many standard deviations, polarization gave a wrong slope.
TRUSTED_SIGMAS = 2.0
#: Depths farther from the fused surface than this many robust standard deviations of all gaps are mirror images. Their own
#: sigma does not reveal them: both halves of the photos agree on them.
LARGEST_GAP = 4.0


def _held(fused: FusedOnce) -> NDArray[np.float32]:
    """The fused surface, limited to TRUSTED_SIGMAS about its prior."""
    reach = TRUSTED_SIGMAS * fused.prior_sigma
    shape = np.clip(fused.depth, fused.prior_depth - reach, fused.prior_depth + reach)
    return np.where(np.isfinite(shape), shape, fused.prior_depth)


def _contradicted(swept: Swept, fused: FusedOnce) -> NDArray[np.bool_]:
    """Pixels whose depth contradicts the surface that was fused from the sweep and polarization, up to a scale.

    Polarization determines the shape: depths of mirror images deviate from it, while the other depths lie on one surface.
    """
    gap = np.log(swept.depth / fused.depth)
    gap -= np.nanmedian(gap)
    far: NDArray[np.bool_] = np.abs(gap) > LARGEST_GAP * robust_spread(gap)
    return far


#: Depths nearer than the hull by more than this many of both standard deviations are those of mirror images.
HULL_SIGMAS = 3.0

#: Files below the folder: the visual hull.
_HULL = ["hull_depth.tif", "hull_sigma.tif"]
#: Files below the folder: the first sweep; its depths that were kept; the sweep near the fused surface, and that surface.
_FIRST = ["sweep_depth.tif", "sweep_sigma.tif", "sweep_confidence.tif"]
_SHAPE = "sweep_again_shape.tif"
_KEPT = ["sweep_kept_depth.tif", "sweep_kept_sigma.tif", _SHAPE]
_AGAIN = ["sweep_again_depth.tif", "sweep_again_sigma.tif", "sweep_again_confidence.tif", _SHAPE]


@dataclass(frozen=True)
class _Sweep:
    """A station's sweeps, each a stage of the journal."""

    cameras: StationCameras
    view: Camera
    unpolarized: NDArray[np.float32]
    mask: NDArray[np.uint8]
    options: Options
    threads: int
    progress: Report
    journal: Journal

    def hull(self) -> Hull | None:
        """The visual hull of all outlines, or None without masks, and, with a warning, with too few of them."""
        masked = [(photo.name, photo.mask, camera) for photo, camera in self.cameras.photos if photo.mask is not None]
        masked += self.cameras.silhouettes
        if not masked:
            return None
        if len(masked) < _core.least_silhouettes:
            # No error: the photos may agree on a surface, and on a turntable masks are there for its sake, not for a hull.
            self.journal.log(
                "warning",
                f"{len(masked)} of the images that are placed have a mask: a visual hull is made of at least "
                f"{_core.least_silhouettes}, so there is none where photos do not agree",
            )
            return None
        hashes = self.journal.watch({f"mask of {name}": mask for name, mask, _ in masked})
        silhouettes = [(str(mask), camera.values()) for _, mask, camera in masked]
        inputs = {
            "view": repr(self.view.values()),
            "masks": [[name, hashes[f"mask of {name}"]] for name, _, _ in masked],
            "cameras": repr([camera for _, camera in silhouettes]),
            "object": digest(self.mask),
        }

        def found() -> dict[str, Any]:
            rasters = _core.visual_hull(
                self.view.values(), self.mask, silhouettes, self.threads,
                lambda _, fraction, __: self.progress(fraction, "visual hull"),
            )  # fmt: skip
            self._write(_HULL, rasters)
            return {
                "masks": len(silhouettes),
                "mask_files": {name: hashes[f"mask of {name}"] for name, _, _ in masked},
            }

        figures = self.journal.stage("hull", inputs, _HULL, found)
        depth, sigma = self._read(_HULL)
        return Hull(depth, sigma, figures, {mask: hashes[f"mask of {name}"] for name, mask, _ in masked})

    def _write(self, outputs: Sequence[str], rasters: Sequence[NDArray[np.float32]]) -> None:
        for name, values in zip(outputs, rasters, strict=True):
            _core.write_float_tiff(str(self.journal.folder / name), values)

    def _read(self, outputs: Sequence[str]) -> list[NDArray[np.float32]]:
        return [_core.read_raster(str(self.journal.folder / name)) for name in outputs]

    def _run(
        self, outputs: Sequence[str], surface: tuple[NDArray[np.float32], NDArray[np.float32]] | None
    ) -> dict[str, Any]:
        found = stereo.sweep(
            np.nan_to_num(self.unpolarized),
            self.view,
            [(photo.path, camera) for photo, camera in self.cameras.photos],
            self.cameras.model.points,
            self.mask,
            self.options,
            self.threads,
            lambda _, fraction, message: self.progress(fraction, message),
            self.journal.log,
            surface,
        )
        self._write(outputs, (found.depth, found.sigma, found.confidence))
        return {
            "views": found.views_used,
            "points": found.points_used,
            "completeness": found.completeness,
            "highlights": found.highlights,
            "score": found.median_score,
            "sigma_gsd": found.median_sigma_gsd,
        }

    def first(self, settings: Mapping[str, Any]) -> Swept:
        """The first sweep, near the triangulated points."""
        hashes = self.journal.watch({photo.name: photo.path for photo, _ in self.cameras.photos})
        inputs = {
            "view": repr(self.view.values()),
            "photos": [
                (photo.name, hashes[photo.name], repr(camera.values())) for photo, camera in self.cameras.photos
            ],
            "image": digest(self.unpolarized, self.mask),
            "points": digest(self.cameras.model.points),
            "options": settings,
        }
        hull = self.hull()
        figures = self.journal.stage(
            "sweep", inputs, _FIRST, lambda: self._run(_FIRST, None) if hull is None else self._run_or_none(hull)
        )
        depth, sigma, _ = self._read(_FIRST)
        if hull is not None:
            figures = {**figures, **hull.figures}
            mirrored = depth < hull.depth - HULL_SIGMAS * np.hypot(sigma, hull.sigma)
            depth, sigma = (np.where(mirrored, np.float32(np.nan), values) for values in (depth, sigma))
        return Swept(depth, sigma, None, figures, _times(self.journal), hull)

    def _run_or_none(self, hull: Hull) -> dict[str, Any]:
        """The first sweep, without any depth if the photos do not agree: the hull takes its place then."""
        try:
            return self._run(_FIRST, None)
        except DataError as error:
            self.journal.log("warning", f"{error}; the visual hull of the photos' masks takes its place")
            nothing = np.full(hull.depth.shape, np.nan, np.float32)
            self._write(_FIRST, (nothing, nothing, np.zeros_like(nothing)))
            return {
                "views": 0, "points": 0, "completeness": 0.0, "highlights": 0.0, "score": None, "sigma_gsd": None,
            }  # fmt: skip

    def again(self, first: Swept, fuse: Callable[[Swept], FusedOnce], fused_of: Mapping[str, Any]) -> Swept:
        """A second sweep, near the surface fused with the first; if the first found little, its depths that this surface supports."""

        def swept() -> dict[str, Any]:
            fused = fuse(first)
            shape = _held(fused)
            self._write([_SHAPE], [shape])
            return self._run(_AGAIN[:3], (shape, fused.prior_sigma))

        def kept() -> dict[str, Any]:
            mirrored = _contradicted(first, fuse(first))
            some = replace(
                first,
                depth=np.where(mirrored, np.float32(np.nan), first.depth),
                sigma=np.where(mirrored, np.float32(np.nan), first.sigma),
            )
            self._write(_KEPT, (some.depth, some.sigma, _held(fuse(some))))
            return {**first.figures, "completeness": float(np.isfinite(some.depth)[self.mask != 0].mean())}

        if not np.isfinite(first.depth).any():
            return first
        if first.figures["completeness"] < AGAIN_COMPLETENESS:
            figures = self.journal.stage("sweep_kept", fused_of, _KEPT, kept)
            depth, sigma, shape = self._read(_KEPT)
        else:
            figures = self.journal.stage("sweep_again", fused_of, _AGAIN, swept)
            depth, sigma, _, shape = self._read(_AGAIN)
        return Swept(depth, sigma, shape, {**figures, "first": first.figures}, _times(self.journal), first.hull)


def sweep_station(
    cameras: StationCameras,
    unpolarized: NDArray[np.float32],
    mask: NDArray[np.uint8],
    folder: Path,
    *,
    options: Options,
    threads: int,
    progress: Report,
    log: Log,
    fuse: Callable[[Swept], FusedOnce] | None = None,
    fused_of: Mapping[str, Any] | None = None,
) -> Swept:
    """Sweep near the triangulated points and, if that finds enough, again near the surface fused with the first sweep.

    The fused surface has slopes and detail that photos do not show. Windows that lie on this surface can be larger, and
    can match weaker texture. If the first sweep finds little, there is no second one: depths that contradict the fused
    surface are dropped, and the other depths are fused anew. `fuse` is called if this is not done yet, None = one sweep;
    `fused_of` is everything besides the sweep that the fused surface depends on. Results are kept below `folder` and read
    back while their inputs are unchanged. Where the sweep finds nothing, the visual hull of the photos' masks, if they
    have any, is the depth.
    """
    view = _placed_at(lens_of_raster(cameras.station), cameras.station)
    journal = Journal(folder, log)
    sweep = _Sweep(cameras, view, unpolarized, mask, options, threads, progress, journal)
    settings = json.loads(options.to_json())["sweep"]
    again = settings.pop("again")
    swept = sweep.first(settings)
    if fuse is not None and again:
        swept = sweep.again(swept, fuse, fused_of or {})
    progress(1.0, "")
    return swept
