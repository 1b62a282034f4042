"""From the cameras to the depth in the station's view.

Surface sweep in the station's view (malus.stereo) → depth with sigma → second sweep near the surface fused with this depth; where the
sweep finds nothing, the visual hull of the photos' masks. Finished sweeps are not repeated (journal).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core, stereo
from malus._robust import robust_spread
from malus.camera import Camera
from malus.errors import DataError, InputError
from malus.options import Options
from malus.photogrammetry.diagnosis import Log, listed, silent
from malus.photogrammetry.front_end import Report, StationCameras
from malus.photogrammetry.journal import Journal, digest
from malus.photogrammetry.station_pose import lens_of_raster, placed_at
from malus.threads import ALL_CORES


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


#: A photo in the messages of malus.stereo.sweep, with its index among those that the sweep got.
_VIEW = re.compile(r"(?<=^surface sweep: )views\[(\d+)\]")
#: Hulls that are tried, each of which can take seconds, to find wrong masks: enough for two of 64 that contradict each other.
MOST_HULLS = 24
#: File of a mask, and the values of its image's camera.
_Silhouette = tuple[str, Any]


def _without_which(names: Sequence[str], most: int, is_right: Callable[[Sequence[str]], bool]) -> list[str]:
    """A few names, at most `most`, without which the others are right; none if none are found.

    Each step leaves out a part, about half, of the names that the step before left out, so that a single wrong name is found. Of several
    wrong names it finds a part that holds all of them, together with right ones.
    """
    found: list[str] = []
    while most > 0 and len(found) != 1:
        suspects = found or names
        count = max(2, math.ceil(len(suspects) / most))
        # First every second name is left out: neighbors often show the same side, and without a whole side no hull is closed. Two wrong
        # names that this separates may fall into one part if the names are taken in twos or fours.
        parts = (
            [name for at, name in enumerate(suspects) if at // together % count == number]
            for together in (1, 2, 4)
            for number in range(count)
        )
        part = next((part for part in parts if part != found and 0 < len(part) <= most and is_right(part)), None)
        if part is None:
            break
        found = part
    return found


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
            try:
                rasters = self._hull_of(silhouettes)
            except DataError as error:
                raise DataError(f"{error} ({self._blamed(silhouettes)})") from error
            self._write(_HULL, rasters)
            return {
                "masks": len(silhouettes),
                "mask_files": {name: hashes[f"mask of {name}"] for name, _, _ in masked},
            }

        figures = self.journal.stage("hull", inputs, _HULL, found)
        depth, sigma = self._read(_HULL)
        return Hull(depth, sigma, figures, {mask: hashes[f"mask of {name}"] for name, mask, _ in masked})

    def _hull_of(self, silhouettes: list[_Silhouette]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        return _core.visual_hull(
            self.view.values(), self.mask, silhouettes, self.threads,
            lambda _, fraction, __: self.progress(fraction, "visual hull"),
        )  # fmt: skip

    def _blamed(self, silhouettes: list[_Silhouette]) -> str:
        """Says for the error which masks keep the others from having a hull, or all masks if leaving out some does not help. Two that
        contradict each other are both named.
        """
        hulls = iter(range(MOST_HULLS))

        def others_have_one(left_out: Sequence[str]) -> bool:
            if next(hulls, None) is None:
                return False
            try:
                self._hull_of([one for one in silhouettes if one[0] not in left_out])
            except DataError:
                return False
            return True

        masks = [mask for mask, _ in silhouettes]
        most = len(masks) - _core.least_silhouettes
        blamed = _without_which(masks, most, others_have_one)
        if not blamed:
            return f"masks: {listed(masks)}"
        if len(blamed) == 1:
            # Of two outlines that do not meet, leaving out either one helps, though both may be wrong.
            instead = _without_which([mask for mask in masks if mask not in blamed], most, others_have_one)
            if len(instead) == 1:
                return (
                    f"{blamed[0]} and {instead[0]} contradict each other: there is a visual hull without the one, and without the "
                    "other; look at both"
                )
        return f"without {listed(blamed)} there is a visual hull"

    def _write(self, outputs: Sequence[str], rasters: Sequence[NDArray[np.float32]]) -> None:
        for name, values in zip(outputs, rasters, strict=True):
            _core.write_float_tiff(str(self.journal.folder / name), values)

    def _read(self, outputs: Sequence[str]) -> list[NDArray[np.float32]]:
        return [_core.read_raster(str(self.journal.folder / name)) for name in outputs]

    def _run(
        self, outputs: Sequence[str], surface: tuple[NDArray[np.float32], NDArray[np.float32]] | None
    ) -> dict[str, Any]:
        try:
            found = stereo.sweep(
                np.nan_to_num(self.unpolarized),
                self.view,
                [(photo.path, camera) for photo, camera in self.cameras.photos],
                self.cameras.model.points,
                self.mask,
                self.options,
                self.threads,
                lambda _, fraction, message: self.progress(fraction, message),
                lambda level, message: self.journal.log(level, self._named(message)),
                surface,
            )
        except InputError as error:
            raise InputError(self._named(str(error))) from error
        self._write(outputs, (found.depth, found.sigma, found.confidence))
        return {
            "views": found.views_used,
            "points": found.points_used,
            "completeness": found.completeness,
            "highlights": found.highlights,
            "score": found.median_score,
            "sigma_gsd": found.median_sigma_gsd,
        }

    def _named(self, message: str) -> str:
        """A message of the sweep with the name of the photo's file, which is what people know."""
        return _VIEW.sub(lambda view: f"photo {self.cameras.photos[int(view[1])][0].name}", message)

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
        return self._behind_hull(Swept(depth, sigma, None, figures, self.journal.total_times(), hull))

    def _behind_hull(self, swept: Swept) -> Swept:
        """A sweep without the depths in front of its hull, which are outside of an outline: photos agreed on mirror images there."""
        hull = swept.hull
        if hull is None:
            return swept
        mirrored = swept.depth < hull.depth - HULL_SIGMAS * np.hypot(swept.sigma, hull.sigma)
        depth, sigma = (np.where(mirrored, np.float32(np.nan), values) for values in (swept.depth, swept.sigma))
        figures = {**swept.figures, **hull.figures, "completeness": self._completeness(depth)}
        return replace(swept, depth=depth, sigma=sigma, figures=figures)

    def _completeness(self, depth: NDArray[np.float32]) -> float:
        """Share of the object that has a depth."""
        return float(np.isfinite(depth)[self.mask != 0].mean())

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
            return {**first.figures, "completeness": self._completeness(some.depth)}

        if not np.isfinite(first.depth).any():
            return first
        if first.figures["completeness"] < AGAIN_COMPLETENESS:
            figures = self.journal.stage("sweep_kept", fused_of, _KEPT, kept)
            depth, sigma, shape = self._read(_KEPT)
        else:
            figures = self.journal.stage("sweep_again", fused_of, _AGAIN, swept)
            depth, sigma, _, shape = self._read(_AGAIN)
        figures = {**figures, "first": first.figures}
        return self._behind_hull(Swept(depth, sigma, shape, figures, self.journal.total_times(), first.hull))


def sweep_station(
    cameras: StationCameras,
    unpolarized: NDArray[np.float32],
    mask: NDArray[np.uint8],
    folder: Path,
    *,
    options: Options | None = None,
    threads: int = ALL_CORES,
    progress: Report = silent,
    log: Log = silent,
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
    options = options or Options()
    view = placed_at(lens_of_raster(cameras.station), cameras.station)
    journal = Journal(folder, log)
    sweep = _Sweep(cameras, view, unpolarized, mask, options, threads, progress, journal)
    settings = json.loads(options.to_json())["sweep"]
    again = settings.pop("again")
    swept = sweep.first(settings)
    if fuse is not None and again:
        swept = sweep.again(swept, fuse, fused_of or {})
    progress(1.0, "")
    return swept
