"""What a run would do: its steps, time and memory, and what is wrong with its inputs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core, photogrammetry, raw
from malus.errors import DataError
from malus.inputs import folder_for, needs_photos, readable
from malus.options import Options
from malus.overlay import write_overlay
from malus.photogrammetry.memory import limit_mb
from malus.photogrammetry.plan import Plan
from malus.station import Station
from malus.threads import ALL_CORES

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
    if needs_photos(station, until):
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
    """The plan of a station's photos. known: its cameras are found together with those of other stations, from the distances and points of
    all stations, so that those in its own file need not suffice.
    """
    said = {**description, "scale": [], "control": []} if known else description
    return photogrammetry.plan(said, 1e-6 * width * height, options=settings, threads=threads, read_masks=not known)


def prior_upon_image(
    station: Station, *, threads: int = ALL_CORES
) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float32]]:
    """The first polarized image as taken (H×W, linear), its mask (H×W, non-zero = object), and the prior's points projected into
    it: N×3, u, v [px] and distance [station's unit]; N = 0 without a camera or a prior.
    """
    with folder_for(None, "raw") as folder:
        return _core.check_picture(readable(station, station._core, folder), threads)


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
    with folder_for(None, "raw") as folder:
        core = readable(station, station._core, folder)
        picture = None if overlay is None else _core.check_picture(core, threads)
        try:
            plan: dict[str, Any] = json.loads(_core.check(core, settings.to_json(), threads))
        except DataError as error:  # for example, the cloud lies beside the object: the picture shows that best
            if overlay is not None and picture is not None:
                write_overlay(Path(overlay), picture, station, [str(error)])
            raise
    photos_mb = 0.0
    if needs_photos(station):
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
