"""The main path from Python: a station in, a metric surface out."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core, encoding, exif, photogrammetry, raw, scans
from malus._files import require_utf8, sha256_of
from malus.camera import Camera
from malus.errors import DataError
from malus.options import Options
from malus.overlay import write_overlay
from malus.photogrammetry.memory import limit_mb
from malus.photogrammetry.plan import Plan
from malus.result import Confidence, Result
from malus.station import Station
from malus.threads import ALL_CORES
from malus.workspace import Workspace


@dataclass(frozen=True)
class Progress:
    """One progress event: `fraction` (0 … 1) of `step` is done."""

    step: str
    fraction: float
    message: str


def reconstruct(
    station: Station,
    options: Options | None = None,
    *,
    workspace: str | Path | None = None,
    replace: bool = False,
    until: str | None = None,
    reference: str | Path | None = None,
    keep_maps: bool = True,
    threads: int = ALL_CORES,
    cameras: photogrammetry.StationCameras | None = None,
    progress: Callable[[Progress], None] | None = None,
    log: Callable[[str, str], None] | None = None,
) -> Result:
    """Run the pipeline on a station.

    With a workspace folder every step is written there, and steps already done with the same inputs and options are not
    repeated; without one everything stays in memory. The folder holds the surface of the last run only. A workspace belongs to one station: the workspace of another station is
    refused unless `replace` is true. `until` names the last step to run; the steps that it needs run first (see
    malus.workspace.STEPS). `reference` is a PLY cloud or mesh in the world frame to compare the surface with. keep_maps=False
    frees maps that no later step needs. This saves memory; the result then has only the maps of the last step, and the other maps
    are in the workspace. `progress` and `log` are called from this thread. Ctrl-C, or an exception that one of them raises,
    stops within a second; files of finished steps stay.

    A station with [photos] and no [prior] gets its pose and its prior from the photos (malus.photogrammetry, needs the
    program COLMAP or the package pycolmap); progress then has the steps "photos" and "sweep" too. `cameras`: cameras of
    the photos and of the station, if they are known already (malus.photogrammetry.find_object_cameras). With them the
    station needs neither [photos] nor a pose; it still needs its lens.

    Raises malus.InputError, DataError, ExternalError or ResourceError.
    """
    settings = copy(options or Options())  # Result.save needs those of this run, whatever the caller sets afterwards

    def report(step: str, fraction: float, message: str) -> None:
        if progress is not None:
            progress(Progress(step, fraction, message))

    def run(core: _core.Station, last: str | None, *, keep: bool = True) -> dict[str, Any]:
        return _core.reconstruct(
            core,
            settings.to_json(),
            threads,
            workspace=None if workspace is None else str(workspace),
            replace=replace,
            until=last,
            reference=None if reference is None else str(reference),
            keep_maps=keep,
            progress=None if progress is None else report,
            log=log,
        )

    def save(folder: Path) -> None:
        """Write steps whose results are in memory, without repeating them."""
        _core.claim_workspace(str(folder), station._core, True)
        _core.reconstruct(
            _readable(station, core, folder / "raw", lambda _, __: None), settings.to_json(), threads, workspace=str(folder),
            replace=True, reference=None if reference is None else str(reference), keep_maps=False, known=results,
        )  # fmt: skip

    for path in (workspace, reference):
        if path is not None:
            require_utf8(path)
    if workspace is not None:
        _core.claim_workspace(str(workspace), station._core, replace)
    with _folder(workspace, "raw") as developed:
        core = _readable(
            station, station._core, developed, lambda fraction, message: report("polarization", fraction, message)
        )
        if cameras is not None or _needs_photos(station, until):
            with _folder(workspace, "prior/colmap") as folder:
                log = log or (lambda _, __: None)
                core = _with_photos(station.describe(), core, settings, folder, run, threads, report, log, cameras)
        outcome = run(core, until, keep=keep_maps)
    if workspace is not None and log is not None:
        for told in _core.overtaken_exports(str(workspace)):
            log("warning", told)
    results = outcome.pop("results")
    return _result(outcome, station.name, workspace, save)


def _result(outcome: dict[str, Any], name: str, workspace: str | Path | None, save: Callable[[Path], None]) -> Result:
    for intermediate in ("scene", "valid"):
        del outcome[intermediate]
    quality, confidence = outcome.pop("quality"), outcome.pop("confidence")
    return Result(
        **outcome,
        name=name,
        confidence=None if confidence is None else Confidence(*confidence),
        quality=None if quality is None else json.loads(quality),
        workspace=None if workspace is None else Path(workspace),
        _save=save,
        _fused_key=None if workspace is None else Workspace(workspace).fused_key,
    )


def unpolarized_scene(
    station: Station, options: Options, workspace: Path, threads: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Unpolarized intensity of a station's whole image, object and background (H×W, linear, undistorted), and where the object is by
    the mask (H×W, non-zero = object; everywhere without a mask).

    The polarization step is written to `workspace`, which must not be the workspace of a run. The station's lens must be known.
    Raises the errors of `reconstruct`.
    """
    _core.claim_workspace(str(workspace), station._core, True)
    core = _readable(station, station._core, workspace / "raw", lambda _, __: None)
    outcome = _core.reconstruct(
        core, options.to_json(), threads, workspace=str(workspace), replace=True, until="polarization"
    )
    return np.asarray(outcome["scene"], np.float32), np.asarray(outcome["valid"], np.uint8)


def _needs_photos(station: Station, until: str | None) -> bool:
    """Whether a run up to the step `until` must first find camera pose and prior from photos."""
    return station.describe()["prior"] == "photos" and until not in ("polarization", "polarizer", "zenith")


def _readable(
    station: Station, core: _core.Station, folder: Path, progress: Callable[[float, str], None]
) -> _core.Station:
    """The station with the inputs that the C++ library cannot read itself: RAW files are developed into `folder`, and clouds in
    scanner formats are read here. InputError if the images were taken with different camera settings.
    """
    description = station.describe()
    if "prior_cloud" in description and scans.is_scan(Path(description["prior_cloud"])):
        core = core.with_cloud(*scans.read_scan(Path(description["prior_cloud"]), description["unit"]))
    images = [Path(path) for path in description["images"]]
    tags = [raw.settings_of(path) for path in images]
    exif.require_alike(images, tags, exposures_differ=description["exposure_s"] is not None)
    doubts = encoding.doubts(images, description["response"])
    doubts += exif.exposure_doubts(images, tags, description["exposure_s"])
    doubts += encoding.mosaic_doubts(images, description["mosaic"] is not None)
    mask = description.get("mask")
    core = core.with_file_doubts(doubts, exif.mask_notes(images, None if mask is None else Path(mask)))
    if not images or not raw.is_raw(images[0]):
        return core
    developed = raw.develop(images, description["channel"], folder, progress)
    return core.with_developed([str(path) for path in developed.images], developed.full_well_e, developed.read_noise_e)


@contextmanager
def _folder(workspace: str | Path | None, name: str) -> Iterator[Path]:
    """Folder for the files that Python writes: `name` in the workspace, or a temporary folder until the context ends."""
    if workspace is not None:
        yield Path(workspace) / name
        return
    with tempfile.TemporaryDirectory(prefix="malus-") as folder:
        yield Path(folder)


def _with_photos(
    description: dict[str, Any],
    station: _core.Station,
    options: Options,
    folder: Path,
    run: Callable[[_core.Station, str | None], dict[str, Any]],
    threads: int,
    report: Callable[[str, float, str], None],
    log: Callable[[str, str], None],
    known: photogrammetry.StationCameras | None,
) -> _core.Station:
    """The station with camera and prior from its photos. The polarization step runs first; its unpolarized image is oriented
    among the photos. A sweep then finds depth in the station's view. With the option sweep.again a second sweep starts from the
    surface fused with the first one.
    """
    warnings: list[str] = []

    def log_of(step: str) -> Callable[[str, str], None]:
        def note(level: str, message: str) -> None:
            if level == "warning":
                warnings.append(f"{step}: {message}")
            log(level, message)

        return note

    def fuse(first: photogrammetry.Swept) -> photogrammetry.FusedOnce:
        """Fuse in memory: the workspace holds the steps of the fusion with the last sweep, which repeat the warnings of this one."""
        core = station.with_photogrammetry(lens.values(), first.rasters(), "{}", "{}", [], {})
        outcome = _core.reconstruct(
            core, options.to_json(), threads, until="fuse", known=images["results"],
            progress=lambda step, fraction, _: report("sweep", fraction, f"fusing for a better sweep: {step}"),
        )  # fmt: skip
        return photogrammetry.FusedOnce(outcome["depth"], outcome["prior_depth"], outcome["prior_sigma"])

    if "camera" in description:
        images = run(station, "polarization")
    else:  # Also in memory: the workspace gets the polarization step of the undistorted images, once the lens is known.
        images = _core.reconstruct(station, options.to_json(), threads, until="polarization", progress=report)
    with photogrammetry.exclusive(folder):
        cameras = known or photogrammetry.find_cameras(
            description,
            images["scene"],
            folder,
            options=options,
            threads=threads,
            progress=lambda fraction, message: report("photos", fraction, message),
            log=log_of("photos"),
        )
        for warning in cameras.warnings:
            log_of("photos")("warning", warning)
        lens = cameras.station
        if "camera" in description:
            lens = replace(
                Camera.from_description(description["camera"]), rotation=lens.rotation, translation=lens.translation
            )
        else:
            # Now that the lens is known, the images can be undistorted.
            placed = station.with_photogrammetry(lens.values(), None, "{}", "{}", [], {})
            images = run(placed, "polarization")
        swept = photogrammetry.sweep_station(
            cameras,
            images["scene"],
            np.where(images["valid"] != 0, np.uint8(255), np.uint8(0)),
            folder,
            fuse=fuse,
            fused_of=_fused_of(description, images, options),
            options=options,
            threads=threads,
            progress=lambda fraction, message: report("sweep", fraction, message),
            log=log_of("sweep"),
        )
    figures = {**cameras.figures, "sweep": swept.figures}
    times = {"photos": cameras.times, "sweep": swept.times}
    masks: dict[Path, str] = {} if swept.hull is None else swept.hull.masks
    return station.with_photogrammetry(
        lens.values(), swept.rasters(), json.dumps(figures), json.dumps(times), warnings, masks
    )


def _fused_of(description: dict[str, Any], images: dict[str, Any], options: Options) -> dict[str, Any]:
    """The inputs that determine the surface fused with a sweep, besides the sweep itself."""
    label = description.get("label_image")
    settings = json.loads(options.to_json())
    return {
        "images": [
            hashlib.sha256(images[name].tobytes()).hexdigest() for name in ("unpolarized", "degree", "phase_rad")
        ],
        "noise": [description[name] for name in ("frames_averaged", "full_well_e", "read_noise_e")],
        "optics": [description[name] for name in ("refractive_index", "reflection", "light", "metal")],
        "labels": description["labels_sha256"] if label is None else sha256_of(Path(label)),
        "options": {name: value for name, value in settings.items() if name not in ("assess", "surface")},
    }


#: Steps that this package runs before the library makes the prior. The library's table has their places.
_STEPS_OF_PHOTOS = ("photos", "sweep")
#: Expected seconds for the report: fixed part, and per megapixel.
_REPORT_SECONDS = (4.0, 3.0)
#: Expected seconds for the paper's plates and tables: 25 plates took 11 on an example. Plates have the same print size for any image.
PLATES_SECONDS = 11.0


def expected_times(
    station: Station,
    options: Options | None = None,
    *,
    until: str | None = None,
    cameras_known: bool = False,
    threads: int = ALL_CORES,
) -> list[tuple[str, float]]:
    """The steps of a run in order, including the report at the end, and the seconds that each is expected to take.

    cameras_known: as in `check`. Only the images' size and the mask are read; raises the errors that a run raises for these.
    """
    settings = options or Options()
    description = station.describe()
    first = Path(description["images"][0]) if description["images"] else None
    size = raw.image_size(first) if first is not None and raw.is_raw(first) else None
    if first is not None:
        width, height = size or _core.image_size(str(first))
    else:
        camera = description.get("camera", {"width": 0, "height": 0})
        width, height = camera["width"], camera["height"]
    of_photos: dict[str, float] = {}
    if _needs_photos(station, until):
        planned = _planned(description, settings, threads, width, height, known=cameras_known)
        # The second sweep needs a surface fused with the first one: the steps from polarization to fusion run once in between.
        fusing = _core.expected_times(station._core, settings.to_json(), "fuse", size, threads)[1:]
        between = sum(seconds for _, seconds in fusing)
        of_photos["sweep"] = planned.sweeping.seconds + (between if settings.sweep.again else 0.0)
        if not cameras_known:
            of_photos["photos"] = planned.finding.seconds
    times = [
        (step, of_photos.get(step, seconds))
        for step, seconds in _core.expected_times(station._core, settings.to_json(), until, size, threads)
        if step in of_photos or step not in _STEPS_OF_PHOTOS
    ]
    if until is None:
        fixed, per_megapixel = _REPORT_SECONDS
        times.append(("report", fixed + per_megapixel * width * height / 1e6))
    return times


def _planned(
    description: dict[str, Any], settings: Options, threads: int, width: int, height: int, *, known: bool
) -> Plan:
    """The plan of a station's photos. known: its cameras are found together with those of other stations, from the distances and points
    of all of them; those that its own file names need not suffice.
    """
    said = {**description, "scale": [], "control": []} if known else description
    return photogrammetry.plan(said, 1e-6 * width * height, options=settings, threads=threads, read_masks=not known)


def prior_upon_image(
    station: Station, *, threads: int = ALL_CORES
) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float32]]:
    """The first polarized image as taken (H×W, linear), its mask (H×W, non-zero = object), and the prior's points projected into
    it: N×3, u, v [px] and distance [station's unit]; N = 0 without a camera or a prior.
    """
    with _folder(None, "raw") as folder:
        return _core.check_picture(_readable(station, station._core, folder, lambda _, __: None), threads)


def _add_memory(plan: dict[str, Any], photos_mb: float) -> None:
    """Add the memory of the photos' stages to the plan, and a warning if the run exceeds the memory that it may have."""
    steps_mb, allowed_mb = plan["memory_mb"], limit_mb()
    plan["memory_mb"] = max(steps_mb, photos_mb)
    if plan["memory_mb"] < allowed_mb:
        return
    advice = (
        "mask what is not the object, or halve the images" if steps_mb >= allowed_mb else "take fewer or halved photos"
    )
    plan["warnings"].append(
        f"the run is expected to take {plan['memory_mb'] / 1000:.2g} GB of memory, of which it may have "
        f"{allowed_mb / 1000:.2g} GB here: take fewer threads, {advice}"
    )


def check(
    station: Station,
    options: Options | None = None,
    *,
    overlay: str | Path | None = None,
    cameras_known: bool = False,
    threads: int = ALL_CORES,
) -> dict[str, Any]:
    """Read everything a station names and say what a run would do, its expected time and memory, and what is wrong.

    cameras_known: the run will be given `cameras` (see `reconstruct`), as for the stations of an object.
    overlay: a PNG file to write, with the prior's points and the mask's outline on the first polarized image. It is also
    written when a DataError is raised because prior and images do not fit.
    """
    settings = options or Options()
    with _folder(None, "raw") as folder:
        core = _readable(station, station._core, folder, lambda _, __: None)
        picture = None if overlay is None else _core.check_picture(core, threads)
        try:
            plan: dict[str, Any] = json.loads(_core.check(core, settings.to_json(), threads))
        except DataError as error:  # for example, the cloud lies beside the object: the picture shows that best
            if overlay is not None and picture is not None:
                write_overlay(Path(overlay), picture, station, [str(error)])
            raise
    photos_mb = 0.0
    if _needs_photos(station, None):
        planned = _planned(station.describe(), settings, threads, plan["width"], plan["height"], known=cameras_known)
        lines = {"photos": [] if cameras_known else planned.photos, "sweep": [planned.sweep]}
        plan["does"] = [line for does in plan["does"] for line in lines.get(does.split(":")[0], [does])]
        plan["warnings"] += [] if cameras_known else planned.warnings
        stages = [planned.sweeping] if cameras_known else [planned.finding, planned.sweeping]
        photos_mb = max(stage.memory_mb for stage in stages)
    _add_memory(plan, photos_mb)
    times = expected_times(station, settings, cameras_known=cameras_known, threads=threads)
    plan["seconds"] = sum(seconds for _, seconds in times)
    if overlay is not None and picture is not None:
        said = [line.split(": ", 1)[1] for line in plan["does"] if line.startswith(("prior: ", "evidence: "))]
        write_overlay(Path(overlay), picture, station, [*said, *plan["warnings"]])
    return plan
