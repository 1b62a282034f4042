"""Reading a finished workspace: its rasters, its camera, its record."""

from __future__ import annotations

import json
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus._core import FusedSurface, Pinhole
from malus.errors import InputError
from malus.options import Options

Raster = NDArray[np.float32]


def _read_json(path: Path, missing: str) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text())
    except FileNotFoundError:
        raise InputError(f"{path}: {missing}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: is not a JSON object")
    return content


class Workspace:
    """The folder that `malus run` or `malus-station` left behind; nothing is read before it is asked for."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    @cached_property
    def quality(self) -> dict[str, Any]:
        """Every figure, quality.json."""
        return _read_json(self.folder / "quality.json", "there is none; run `malus assess` or `malus run` first")

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """Inputs, options, versions and steps, manifest.json."""
        return _read_json(self.folder / "manifest.json", "there is none; this is not a workspace of malus")

    @cached_property
    def m3c2(self) -> dict[str, Any] | None:
        """Figures of `malus assess --m3c2`, m3c2.json; None if it was not run."""
        return _read_json(self.folder / "m3c2.json", "") if self.has("m3c2.json") else None

    def path(self, name: str) -> Path:
        """Path of a file of the workspace; InputError if it is not there."""
        path = self.folder / name
        if not path.is_file():
            raise InputError(f"{path}: there is none; run `malus run` to make it")
        return path

    def has(self, name: str) -> bool:
        """Whether the workspace has this file."""
        return (self.folder / name).is_file()

    def raster(self, name: str) -> Raster:
        """Float TIFF or PNG of the workspace, H×W or H×W×3, float32."""
        raster: Raster = _core.read_raster(str(self.path(name)))
        return raster

    def color(self) -> Raster:
        """Linear image of the object without polarization, H×W×3 if it was taken in colour, else H×W."""
        return self.raster(
            "polarization/color.tif" if self.has("polarization/color.tif") else "polarization/unpolarized.tif"
        )

    @cached_property
    def _fused_notes(self) -> dict[str, Any]:
        steps = self.manifest.get("steps", {})
        for step in ("refine", "fuse"):
            if steps.get(step, {}).get("status") == "done":
                notes: dict[str, Any] = steps[step]["notes"]
                return notes
        raise InputError(f"{self.folder}: has no fused surface; run `malus run` first")

    @cached_property
    def camera(self) -> Pinhole:
        """Camera of all rasters, memory pixel convention."""
        camera = self._fused_notes["camera"]
        return Pinhole(*(camera[key] for key in ("width", "height", "fx", "fy", "cx", "cy")))

    @cached_property
    def pose(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation (3×3) and translation (3) that take world points into the camera frame."""
        pose = self._fused_notes["pose"]
        return np.array(pose["rotation"], float), np.array(pose["translation"], float)

    def surface(self) -> FusedSurface:
        """The fused surface."""
        depth, normals, sigma = (self.raster(f"fused/{name}.tif") for name in ("depth", "normals", "sigma"))
        rotation, translation = self.pose
        return FusedSurface(depth, normals, sigma, self.camera, rotation, translation)

    def options(self) -> Options:
        """The options of the run that made it."""
        return Options(**self.manifest["options"])
