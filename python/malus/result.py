"""What a reconstruction returns."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus._files import require_utf8
from malus.camera import Camera
from malus.errors import InputError
from malus.lengths import shown
from malus.workspace import Workspace

#: Long side of the pictures in a notebook, in pixels.
_PICTURE_PX = 480


@dataclass(frozen=True)
class Confidence:
    """How far the surface may be trusted, from evidence: level "high", "partial" or "low", and why it is not high."""

    level: str
    reasons: list[str]


@dataclass(frozen=True, repr=False, eq=False)
class Result:
    """What a reconstruction returns; rasters have the size of the undistorted polarized image and are read-only.

    depth: H×W float32, z in the station camera, station unit, NaN = none. normals: H×W×3 float32, unit, camera frame (x
    right, y down, z forward), towards the camera. sigma: H×W float32, one standard deviation of depth. prior_depth, prior_sigma:
    the same of the coarse surface. polarization_height: H×W, from polarization alone, in pixels on the object (GSD), positive
    towards the camera. unpolarized: H×W, linear, 1 = white level; degree, phase_rad (0 to π, counter-clockwise from image +x), and
    zenith_rad (angle between normal and viewing ray by the degree alone): H×W. camera: the camera of all rasters, with its pose;
    None for a station without a camera, and as long as the pose among the photos is not known. status: how the fusion ended, on
    success "converged" for a solver and "done" for the grid transfer. confidence: how far the surface may be trusted. warnings:
    those of all steps, "<step>: <sentence>". quality: every figure of the report (as quality.json). Fields of steps that were not
    run are None.
    """

    name: str
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
    camera: Camera | None
    status: str | None
    confidence: Confidence | None
    warnings: list[str]
    quality: dict[str, Any] | None
    workspace: Path | None
    _save: Callable[[Path], None] | None = field(default=None)
    _fused_key: str | None = field(default=None)

    @property
    def pose(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Rotation (3×3) and translation (3) that take world points into the camera frame."""
        return None if self.camera is None else self.camera.pose()

    def save(self, workspace: str | Path) -> None:
        """Write everything into a workspace folder, as `malus.reconstruct` does with `workspace`; a workspace in that folder is replaced.

        Steps that were not run yet are run now. Raises InputError for a result that was unpickled, such as one from another process.
        """
        require_utf8(workspace)
        if self._save is None:
            raise InputError(f"{self.name}: the result comes from another process, expected one of malus.reconstruct")
        self._save(Path(workspace))

    @contextmanager
    def in_workspace(self) -> Iterator[Path]:
        """The workspace of the run; for a result in memory, a temporary workspace that exists until the context ends.

        Raises InputError if another run has meanwhile written another surface there.
        """
        if self.workspace is not None:
            if self._fused_key not in (None, Workspace(self.workspace).fused_key):
                raise InputError(
                    f"{self.workspace}: a later run has replaced the surface of this result by another one; expected the result "
                    "of that run, or a workspace for each result"
                )
            yield self.workspace
            return
        with tempfile.TemporaryDirectory(prefix="malus-") as folder:
            self.save(folder)
            yield Path(folder)

    def show(self) -> Path:
        """Write the report and show it in the web browser; returns the page's path."""
        from malus.report import open_page, write_report

        if self.workspace is not None:
            return open_page(write_report(self))
        return open_page(write_report(self, Path(tempfile.mkdtemp(prefix="malus-")) / "report.html"))

    def pictures(self) -> dict[str, NDArray[np.uint8]]:
        """Relief shadings of prior and fused surface, of each only if it exists: title → gray and alpha, at most 480 px wide or high."""
        from malus.raster import reduced, step_for
        from malus.relief import flattened, gray, hillshade

        pictures = {}
        for title, depth in (("prior", self.prior_depth), ("fused", self.depth)):
            if depth is None or self.camera is None or not np.isfinite(depth).any():
                continue
            step = step_for(depth.shape, _PICTURE_PX)
            small = reduced(depth, step)
            pixel = step * float(np.nanmedian(depth)) / self.camera.fx
            pictures[title] = gray(hillshade(flattened(small), pixel))
        return pictures

    def _summary(self) -> str:
        parts = []
        if self.quality is not None:
            parts.append(f"{self.quality['method']} fusion")
        if self.status not in (None, "converged", "done"):
            parts.append("still changing when its computation ended")
        if self.confidence is not None:
            parts.append(f"{self.confidence.level} confidence")
        if self.camera is not None:
            parts.append(f"{self.camera.width} × {self.camera.height} px")
        if self.quality is not None:
            parts.append(f"GSD {shown(self.quality['gsd'], self.quality['unit'], 4)}")
        count = len(self.warnings)
        parts.append("1 warning" if count == 1 else f"{count} warnings")
        return ", ".join(parts)

    def __repr__(self) -> str:
        return f"Result({self.name!r}: {self._summary()})"

    def _repr_html_(self) -> str:
        from malus.pictures import data_url

        pictures = "".join(
            f'<figure style="display:inline-block;margin:4px"><img alt="Relief shading of the {title} surface" '
            f'src="{data_url(picture, "PNG")}">'
            f"<figcaption>{title}</figcaption></figure>"
            for title, picture in self.pictures().items()
        )
        cautions = [*(self.confidence.reasons if self.confidence else []), *self.warnings]
        listed = "".join(f"<li>{escape(line)}</li>" for line in cautions)
        return f"<p><b>{escape(self.name)}</b>: {escape(self._summary())}</p>{pictures}" + (
            f"<ul>{listed}</ul>" if listed else ""
        )

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_save": None}
