"""The main path from Python: a station in, a metric surface out."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus.options import Options
from malus.station import Station

#: The steps in their order, as they stand in manifest.json.
STEPS: tuple[str, ...] = tuple(_core.step_names())


@dataclass(frozen=True)
class Progress:
    """One progress event: `fraction` (0 … 1) of `step` is done."""

    step: str
    fraction: float
    message: str


@dataclass(frozen=True)
class Result:
    """What a reconstruction returns; rasters have the size of the undistorted polarized image.

    depth: H×W float32, z in the station camera, station unit, NaN = none. normals: H×W×3 float32, unit, camera frame (x
    right, y down, z forward), towards the camera. sigma: H×W float32, one standard deviation of depth. prior_depth: the
    coarse surface. quality: every figure of the report (as quality.json). A step that was not run leaves None.
    """

    depth: NDArray[np.float32] | None
    normals: NDArray[np.float32] | None
    sigma: NDArray[np.float32] | None
    prior_depth: NDArray[np.float32] | None
    prior_sigma: NDArray[np.float32] | None
    polarization_height: NDArray[np.float32] | None
    unpolarized: NDArray[np.float32] | None
    degree: NDArray[np.float32] | None
    phase_rad: NDArray[np.float32] | None
    zenith_rad: NDArray[np.float32] | None
    quality: dict[str, Any] | None
    workspace: Path | None


def reconstruct(
    station: Station,
    options: Options | None = None,
    *,
    workspace: str | Path | None = None,
    until: str | None = None,
    reference: str | Path | None = None,
    threads: int = 1,
    progress: Callable[[Progress], None] | None = None,
    log: Callable[[str, str], None] | None = None,
) -> Result:
    """Run the pipeline on a station.

    With a workspace folder every step is written there, and steps already done with the same inputs and options are not
    repeated; without one everything stays in memory. `until` names the last step to run (see STEPS). `reference` is a PLY
    cloud or mesh in the world frame to compare the surface with. `progress` and `log` are called from this thread. Ctrl-C stops within a second; what a finished step wrote stays.

    Raises malus.InputError, DataError or ResourceError.
    """
    outcome = _core.reconstruct(
        station._core,
        (options or Options()).to_json(),
        None if workspace is None else str(workspace),
        until,
        None if reference is None else str(reference),
        threads,
        None if progress is None else lambda step, fraction, message: progress(Progress(step, fraction, message)),
        log,
    )
    quality = outcome.pop("quality")
    return Result(
        **outcome,
        quality=None if quality is None else json.loads(quality),
        workspace=None if workspace is None else Path(workspace),
    )


def check(station: Station, options: Options | None = None, *, threads: int = 1) -> dict[str, Any]:
    """Read everything a station names and say what a run would do, its expected time and memory, and what is wrong."""
    plan: dict[str, Any] = json.loads(_core.check(station._core, (options or Options()).to_json(), threads))
    return plan
