"""The steps "photos" and "sweep" of a run: camera pose and prior from photos, before the library goes on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from malus import _core, photogrammetry
from malus._files import sha256_of
from malus.camera import Camera
from malus.options import Options


@dataclass(frozen=True)
class PhotoSteps:
    """What these steps need of a run.

    station, description: with readable images, and what it states. folder: for their files. run: the library's steps up to the one
    named, into the run's workspace. report: of step, fraction and message. log: of level and message.
    """

    station: _core.Station
    description: dict[str, Any]
    options: Options
    folder: Path
    threads: int
    run: Callable[[_core.Station, str], dict[str, Any]]
    report: Callable[[str, float, str], None]
    log: Callable[[str, str], None]
    _warnings: list[str] = field(default_factory=list, init=False)

    def station_with_prior(self, known: photogrammetry.StationCameras | None) -> _core.Station:
        """The station with camera and prior from its photos; `known`: its cameras, if they are known already.

        The polarization step runs first; its unpolarized image is oriented among the photos. A sweep then finds depth in the
        station's view. With the option sweep.again a second sweep starts from the surface fused with the first one.
        """
        images = self._images()
        with photogrammetry.exclusive(self.folder):
            cameras = known or self._found_cameras(images)
            for warning in cameras.warnings:
                self._log("photos", "warning", warning)
            lens = cameras.station
            if "camera" in self.description:
                stated = Camera.from_description(self.description["camera"])
                lens = replace(stated, rotation=lens.rotation, translation=lens.translation)
            else:  # Now that the lens is known, the images can be undistorted.
                images = self.run(self._placed(lens), "polarization")
            swept = self._swept(cameras, lens, images)
        figures = {**cameras.figures, "sweep": swept.figures}
        times = {"photos": cameras.times, "sweep": swept.times}
        masks: dict[Path, str] = {} if swept.hull is None else swept.hull.masks
        return self.station.with_photogrammetry(
            lens.values(), swept.rasters(), json.dumps(figures), json.dumps(times), self._warnings, masks
        )

    def _images(self) -> dict[str, Any]:
        """The maps of the polarization step.

        Without a lens they stay in memory: the workspace gets those of the undistorted images, once the lens is known.
        """
        if "camera" in self.description:
            return self.run(self.station, "polarization")
        return _core.reconstruct(
            self.station, self.options.to_json(), self.threads, until="polarization", progress=self.report
        )

    def _placed(self, lens: Camera, prior: Any = None) -> _core.Station:
        return self.station.with_photogrammetry(lens.values(), prior, "{}", "{}", [], {})

    def _found_cameras(self, images: dict[str, Any]) -> photogrammetry.StationCameras:
        return photogrammetry.find_cameras(
            self.description,
            images["scene"],
            self.folder,
            options=self.options,
            threads=self.threads,
            progress=partial(self.report, "photos"),
            log=partial(self._log, "photos"),
        )

    def _swept(
        self, cameras: photogrammetry.StationCameras, lens: Camera, images: dict[str, Any]
    ) -> photogrammetry.Swept:
        def fuse(first: photogrammetry.Swept) -> photogrammetry.FusedOnce:
            """In memory: the workspace holds the fusion with the last sweep, which repeats the warnings of this one."""
            outcome = _core.reconstruct(
                self._placed(lens, first.rasters()), self.options.to_json(), self.threads, until="fuse", known=images["results"],
                progress=lambda step, fraction, _: self.report("sweep", fraction, f"fusing for a better sweep: {step}"),
            )  # fmt: skip
            return photogrammetry.FusedOnce(outcome["depth"], outcome["prior_depth"], outcome["prior_sigma"])

        return photogrammetry.sweep_station(
            cameras,
            images["scene"],
            np.where(images["valid"] != 0, np.uint8(255), np.uint8(0)),
            self.folder,
            fuse=fuse,
            fused_of=inputs_of_fusion(self.description, images, self.options),
            options=self.options,
            threads=self.threads,
            progress=partial(self.report, "sweep"),
            log=partial(self._log, "sweep"),
        )

    def _log(self, step: str, level: str, message: str) -> None:
        if level == "warning":
            self._warnings.append(f"{step}: {message}")
        self.log(level, message)


def inputs_of_fusion(description: dict[str, Any], images: dict[str, Any], options: Options) -> dict[str, Any]:
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
