"""Reading a finished workspace: its rasters, its camera, its record."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus._core import FusedSurface
from malus._files import read_regular, require_utf8, sha256_of
from malus.camera import Camera
from malus.errors import InputError, MalusError
from malus.options import Options

Raster = NDArray[np.float32]
#: The names of the steps in manifest.json, in the order in which they run.
STEPS: tuple[str, ...] = tuple(_core.step_names())


def is_result(folder: Path) -> bool:
    """Whether a folder holds the results of a run, even if damaged. Files manifest.json also exist in IIIF, web pages and archives."""
    try:
        said = json.loads(read_regular(folder / "manifest.json"))
    except OSError:
        return False
    except (ValueError, RecursionError):
        return True
    return isinstance(said, dict) and ("steps" in said or "format" in said)


class WorkspaceGiver(Protocol):
    """A result in memory, which can be written to a workspace. (The module of results imports this one.)"""

    @property
    def name(self) -> str:
        """The station's name."""

    @property
    def workspace(self) -> Path | None:
        """The workspace folder that holds the result; None if it is only in memory."""

    def in_workspace(self) -> AbstractContextManager[Path]:
        """The workspace folder; for a result in memory, a temporary one that exists until the context ends."""


@contextmanager
def folder_of(work: str | Path | WorkspaceGiver, output: str | Path | None, what_output: str) -> Iterator[Path]:
    """The workspace folder of a result. Without an `output` (`what_output`: what it names, for the message), InputError for a result in
    memory: its folder is temporary, and with it all that is written there.
    """
    if isinstance(work, str | PathLike):
        yield Path(work)
        return
    if output is None and work.workspace is None:
        raise InputError(f"output is missing: {work.name} is in memory, expected the path of {what_output}")
    with work.in_workspace() as folder:
        yield folder


class Workspace:
    """The folder that `malus run` or `malus-station` wrote; each file is read only when it is needed.

    Only files that the manifest lists are read. Files of another run, and files that were changed after their step wrote
    them, raise an InputError.
    """

    def __init__(self, folder: str | Path) -> None:
        require_utf8(folder)
        self.folder = Path(folder)
        self._checked: set[str] = set()

    @cached_property
    def quality(self) -> dict[str, Any]:
        """Every figure, quality.json."""
        return self._json("quality.json")

    @cached_property
    def manifest(self) -> dict[str, Any]:
        """Inputs, options, versions and steps, manifest.json."""
        self.require()
        manifest: dict[str, Any] = json.loads(_core.read_manifest(str(self.folder)))
        return manifest

    def require(self) -> None:
        """Raise InputError if the folder is no workspace."""
        if not (self.folder / "manifest.json").exists():
            wrong = "is no workspace" if self.folder.exists() else "there is no such folder"
            raise InputError(
                f"{self.folder}: {wrong}, expected one that `malus run STATION.toml -o FOLDER` has written"
            )

    @cached_property
    def outputs(self) -> dict[str, dict[str, Any]]:
        """Size and SHA-256 of every file that a step wrote, by its path relative to the folder."""
        return {path: output for step in self.manifest["steps"].values() for path, output in step["outputs"].items()}

    @cached_property
    def m3c2(self) -> dict[str, Any] | None:
        """Figures of `malus assess --m3c2`, m3c2.json; None if it was not run."""
        return self._json("m3c2.json") if self.has("m3c2.json") else None

    @cached_property
    def findings(self) -> list[dict[str, Any]]:
        """What the checks of the inputs concluded, evidence/findings.json."""
        findings: list[dict[str, Any]] = json.loads(self.path("evidence/findings.json").read_text(encoding="utf-8"))
        return findings

    def path(self, name: str) -> Path:
        """Path of a file of the workspace; InputError if no finished step wrote it, or if it was changed since."""
        path = self.folder / name
        if not self.has(name):
            raise InputError(f"{path}: no step that is done has made it; run `malus run` first")
        if name not in self._checked:
            if sha256_of(path) != self.outputs[name]["sha256"]:
                raise InputError(f"{path}: is not as its step left it; run `malus run` again")
            self._checked.add(name)
        return path

    @property
    def read(self) -> set[str]:
        """Names of the files that were read so far."""
        return set(self._checked)

    def require_unchanged(self) -> None:
        """InputError if another run has meanwhile changed a file that was read: the data read could be of two surfaces."""
        now = Workspace(self.folder).outputs
        for name in self._checked:
            if now.get(name) != self.outputs[name]:
                raise InputError(f"{self.folder / name}: was changed by another run meanwhile; run again")

    def has(self, name: str) -> bool:
        """Whether a finished step wrote this file."""
        return name in self.outputs

    def _json(self, name: str) -> dict[str, Any]:
        content: dict[str, Any] = json.loads(self.path(name).read_text(encoding="utf-8"))
        return content

    @contextmanager
    def recording(self, step: str, watch: _core.StepWatch | None = None) -> Iterator[list[str]]:
        """Record a step that Python runs. Files of an earlier run of the step are removed; the caller names its new files in the
        list, which are recorded at the end. On failure the new files are removed. It is a failure (InputError), too, if another
        run has meanwhile changed the results from which they were made. watch: measures the step from an earlier time on.
        """
        watch = watch or _core.StepWatch()
        _core.forget_step(str(self.folder), step)
        made_from = {
            name: record["key"]
            for name, record in self.manifest["steps"].items()
            if name != step and step not in record["after"]
        }
        files: list[str] = []
        try:
            yield files
            steps = json.loads(_core.read_manifest(str(self.folder)))["steps"]
            if {name: record["key"] for name, record in steps.items()} != made_from:
                raise InputError(f"{self.folder}: was changed by another run meanwhile; run again")
            _core.record_step(str(self.folder), step, files, watch.stop())
        except BaseException:
            # Another program may have recorded the step meanwhile, with files of these names: its record must not stay without them.
            with suppress(MalusError):
                _core.forget_step(str(self.folder), step)
            for name in files:
                (self.folder / name).unlink(missing_ok=True)
            raise

    def raster(self, name: str) -> Raster:
        """Float TIFF or PNG of the workspace, H×W or H×W×3, float32."""
        raster: Raster = _core.read_raster(str(self.path(name)))
        return raster

    def rays(self) -> NDArray[np.float64]:
        """Viewing rays of all pixels, H×W×3, camera frame, z = 1."""
        camera = self.camera
        v, u = np.indices((camera.height, camera.width))
        return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], -1)

    def points(self, depth: Raster | None = None) -> NDArray[np.float64]:
        """World points of all pixels, H×W×3, NaN where there is no depth; of the fused surface, or of a given depth map in its view."""
        rotation, translation = self.pose
        in_camera = self.rays()
        in_camera *= (self.raster("fused/depth.tif") if depth is None else depth)[..., None]
        points: NDArray[np.float64] = (in_camera - translation) @ rotation
        return points

    def color(self) -> Raster:
        """Linear image of the object without polarization, H×W×3 if it was taken in color, else H×W."""
        return self.raster(
            "polarization/color.tif" if self.has("polarization/color.tif") else "polarization/unpolarized.tif"
        )

    def mirrored_share(self) -> Raster | None:
        """Share of the unpolarized intensity that was mirrored at the surface, H×W in [0, 1]; NaN where it is not known.

        None for a surface without a reflection model (`--fusion grid`), and for bare metal, where the share is unknown everywhere.
        """
        if not self.has("fused/mirrored.tif"):
            return None
        mirrored = self.raster("fused/mirrored.tif")
        if not np.isfinite(mirrored).any():
            return None
        with np.errstate(invalid="ignore", divide="ignore"):
            share = mirrored / self.raster("polarization/unpolarized.tif")
        return np.asarray(np.clip(share, 0, 1), dtype=np.float32)

    @cached_property
    def _fused_notes(self) -> dict[str, Any]:
        if "fuse" not in self.manifest["steps"]:
            raise InputError(f"{self.folder}: has no fused surface; run `malus run` first")
        notes: dict[str, Any] = self.manifest["steps"]["fuse"]["notes"]
        return notes

    @property
    def fused_key(self) -> str | None:
        """What the fused surface was made from and how, as a checksum; None if there is none."""
        key: str | None = self.manifest["steps"].get("fuse", {}).get("key")
        return key

    @cached_property
    def camera(self) -> Camera:
        """Camera of all rasters, memory pixel convention, and its pose."""
        camera, pose = self._fused_notes["camera"], self._fused_notes["pose"]
        params = [float(camera[key]) for key in ("fx", "fy", "cx", "cy")]
        return Camera(
            "PINHOLE",
            camera["width"],
            camera["height"],
            params,
            np.array(pose["rotation"]),
            np.array(pose["translation"]),
        )

    @property
    def pose(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation (3×3) and translation (3) that take world points into the camera frame."""
        return self.camera.pose()

    def surface(self) -> FusedSurface:
        """The fused surface."""
        depth, normals, sigma = (self.raster(f"fused/{name}.tif") for name in ("depth", "normals", "sigma"))
        return FusedSurface(depth, normals, sigma, self.camera)

    def options(self) -> Options:
        """The options of the run that made the workspace."""
        return Options(**self.manifest["options"])
