"""The main path from Python: a station in, a metric surface out."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus._files import require_utf8
from malus.inputs import folder_for, needs_photos, readable
from malus.options import Options
from malus.photo_steps import PhotoSteps
from malus.photogrammetry import StationCameras
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
    cameras: StationCameras | None = None,
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
            readable(station, core, folder / "raw"), settings.to_json(), threads, workspace=str(folder),
            replace=True, reference=None if reference is None else str(reference), keep_maps=False, known=results,
        )  # fmt: skip

    for path in (workspace, reference):
        if path is not None:
            require_utf8(path)
    if workspace is not None:
        _core.claim_workspace(str(workspace), station._core, replace)
    with folder_for(workspace, "raw") as developed:
        core = readable(station, station._core, developed, partial(report, "polarization"))
        if cameras is not None or needs_photos(station, until):
            with folder_for(workspace, "prior/colmap") as folder:
                note = log or (lambda _, __: None)
                steps = PhotoSteps(core, station.describe(), settings, folder, threads, run, report, note)
                core = steps.station_with_prior(cameras)
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
    core = readable(station, station._core, workspace / "raw")
    outcome = _core.reconstruct(
        core, options.to_json(), threads, workspace=str(workspace), replace=True, until="polarization"
    )
    return np.asarray(outcome["scene"], np.float32), np.asarray(outcome["valid"], np.uint8)
