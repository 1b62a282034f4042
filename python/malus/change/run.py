"""`malus compare BEFORE AFTER -o DIR`: the whole comparison of two dates, and its files."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core
from malus._extra import extra
from malus._files import new_folder, resolved, sha256_of
from malus.change.page import write_page
from malus.change.regions import Region, find_regions, pixel_areas
from malus.change.registration import Registration, register
from malus.change.significance import Distances, measure
from malus.columns import csv_text, plain
from malus.errors import InputError
from malus.exports.exporter import Exporter
from malus.lengths import shown
from malus.surface import Dem, write_dem
from malus.threads import ALL_CORES
from malus.units import METERS
from malus.workspace import Workspace

#: If a smaller share of the surface is unchanged, the registration may be wrong.
_LEAST_STABLE = 0.5
#: With `same_frame`: surfaces whose median distance exceeds this many registration errors are probably not in one frame.
_MOST_OFFSET = 3.0
#: Relative difference of lengths between the dates above which a wrong scale is likelier than a change.
_MOST_SIZE = 0.002


@dataclass(frozen=True)
class Change:
    """The result of `compare`. distance, limit: H×W float32, the earlier station's view and unit, NaN = not compared; distance is positive
    where the later surface lies in front. regions: changed parts, largest first. figures: the content of change.json.
    """

    distance: NDArray[np.float32]
    limit: NDArray[np.float32]
    regions: list[Region]
    figures: dict[str, Any]
    folder: Path


def compare(
    before: str | Path,
    after: str | Path,
    output: str | Path,
    *,
    same_frame: bool = False,
    threads: int = ALL_CORES,
    progress: Callable[[float, str], None] = lambda fraction, message: None,
) -> Change:
    """Compare two workspaces of one object, taken at two dates; writes a folder and returns its content.

    The later surface is registered to the earlier one by the parts that did not change. `same_frame`: both surfaces are in one frame
    already, for instance by control points, and nothing is moved. output: a new folder, or that of an earlier comparison, which is
    replaced. It gets index.html, change.json, regions.csv, distance.tif and limit.tif (float, the earlier station's view and unit),
    distance_dem.tif (GeoTIFF on the grid of the earlier elevation model) and figures/.

    Raises malus.InputError if the units differ or `output` holds other files, malus.DataError if the surfaces cannot be registered,
    malus.ExternalError unless the extra `compare` is installed.
    """
    for module, package in (("py4dgeo", "py4dgeo"), ("cv2", "opencv-contrib-python-headless"), ("scipy", "scipy")):
        extra(module, package, "malus compare", "compare")
    folder = _own_folder(Path(output), Path(before), Path(after))
    progress(0.0, "reading")
    first, second = (Exporter(Workspace(work), threads) for work in (before, after))
    if first.unit != second.unit:
        raise InputError(
            f"{after}: lengths are in {second.unit}, those of {before} in {first.unit}, expected one unit; "
            "set [station] unit and run it again"
        )
    progress(0.1, "aligning the two surfaces")
    registration = register(first, second, same_frame=same_frame, threads=threads)
    progress(0.4, "measuring distances")
    distances = measure(first, second, registration, threads)
    regions = find_regions(first, distances)
    figures = _figures(first, second, registration, distances, regions)
    progress(0.8, "writing")
    with new_folder(folder, replace=True) as new:
        _write_files(new, first, distances, regions, figures)
        write_page(new, first, distances, regions, figures)
        for exporter in (first, second):
            exporter.workspace.require_unchanged()
    progress(1.0, str(folder / "index.html"))
    return Change(distances.distance, distances.limit, regions, figures, folder)


def _own_folder(folder: Path, *works: Path) -> Path:
    """The folder, if it may be replaced: it is new, empty or of an earlier comparison, and contains neither workspace; else InputError."""
    for work in works:
        if resolved(folder) in (resolved(work), *resolved(work).parents):
            raise InputError(f"{folder}: holds the workspace {work}, expected a folder of its own for the comparison")
    if folder.exists() and not (folder / "change.json").is_file() and any(folder.iterdir() if folder.is_dir() else "x"):
        raise InputError(f"{folder}: is there already, expected a new folder or one of an earlier comparison")
    return folder


def _figures(
    before: Exporter, after: Exporter, registration: Registration, distances: Distances, regions: list[Region]
) -> dict[str, Any]:
    um = METERS[before.unit] * 1e6
    compared = np.isfinite(distances.distance)
    values, limits = distances.distance[compared] * um, distances.limit[compared] * um
    areas = pixel_areas(before)
    whole, changed = (float(np.nansum(areas[chosen])) for chosen in (compared, distances.significant))
    return {
        "unit": before.unit,
        "before": _identity(before),
        "after": _identity(after),
        "registration": {
            "by": registration.by,
            "matches": registration.matches,
            "size_after_over_before": registration.size,
            "error_um": registration.error * um,
            "offset_um": registration.offset * um,
            "stable_fraction": registration.stable_fraction,
            "rotation": registration.motion.rotation.tolist(),
            "translation": registration.motion.translation.tolist(),
        },
        "compared_fraction": float(compared.sum() / np.isfinite(before.surface.depth).sum()),
        "cylinder_radius_um": distances.radius * um,
        "distance_um": {
            **{f"p{p:02d}": float(np.percentile(values, p)) for p in (1, 5, 50, 95, 99)},
            "mean": float(values.mean()),
            "rms": float(np.sqrt((values**2).mean())),
        },
        "limit_um": {f"p{p:02d}": float(np.percentile(limits, p)) for p in (5, 50, 95)},
        "significant_fraction": changed / whole,
        "regions": [asdict(region) for region in regions],
        "warnings": _warnings(before, after, registration),
        "versions": before.workspace.manifest["versions"],
    }


def _identity(exporter: Exporter) -> dict[str, Any]:
    quality = exporter.workspace.quality
    return {
        "workspace": str(resolved(exporter.workspace.folder)),
        "manifest_sha256": sha256_of(exporter.workspace.folder / "manifest.json"),
        "name": exporter.name,
        "recorded_on": quality.get("object", {}).get("recorded_on") or None,
        "gsd_um": float(quality["gsd"]) * METERS[exporter.unit] * 1e6,
        "confidence": quality["confidence"],
    }


def _warnings(before: Exporter, after: Exporter, registration: Registration) -> list[str]:
    warnings = []
    for which, exporter in (("earlier", before), ("later", after)):
        confidence = exporter.workspace.quality["confidence"]
        if confidence["level"] == "low":
            warnings.append(f"the {which} surface has low confidence: {'; '.join(confidence['reasons'])}")
    if registration.stable_fraction < _LEAST_STABLE:
        warnings.append(
            f"only {100 * registration.stable_fraction:.0f} % of the surface did not change: it may have been aligned at "
            "the wrong place, or one of the surfaces is bent"
        )
    if registration.by == "none" and abs(registration.offset) > _MOST_OFFSET * registration.error:
        um = METERS[before.unit] * 1e6
        warnings.append(
            f"half of the later surface lies more than {shown(abs(registration.offset) * um, 'um')} "
            f"{'in front of' if registration.offset > 0 else 'behind'} the earlier one: either everything moved, or the "
            "two frames are not the same"
        )
    if registration.by == "frames":
        warnings.append(
            "the pictures have too little in common to find the place; the surfaces were aligned from the "
            "frames of their stations alone"
        )
    if registration.size is not None and abs(registration.size - 1) > _MOST_SIZE:
        warnings.append(
            f"lengths on the later surface differ by {100 * (registration.size - 1):+.2f} % from those on the earlier one: "
            "check the scale bars of both"
        )
    return warnings


def _write_files(
    folder: Path, before: Exporter, distances: Distances, regions: list[Region], figures: dict[str, Any]
) -> None:
    _core.write_float_tiff(str(folder / "distance.tif"), distances.distance)
    _core.write_float_tiff(str(folder / "limit.tif"), distances.limit)
    dem = before.dem()
    write_dem(folder / "distance_dem.tif", _on_grid(before, dem, distances), unit=before.unit, name="change")
    table = csv_text(list(Region.__dataclass_fields__), map(astuple, regions))
    (folder / "regions.csv").write_text(table, encoding="utf-8")
    (folder / "change.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


def _on_grid(before: Exporter, dem: Dem, distances: Distances) -> Dem:
    """The distances as an elevation model: on its grid, in place of the elevations."""
    height, width = distances.distance.shape
    known = np.isfinite(dem.elevation)
    pixels = np.rint(before.pixels(dem.points()[known])).astype(int)
    u, v = np.clip(pixels[:, 0], 0, width - 1), np.clip(pixels[:, 1], 0, height - 1)
    values = np.full(dem.elevation.shape, np.nan, np.float32)
    values[known] = distances.distance[v, u]
    return Dem(values, dem.pixel, dem.origin, dem.right, dem.up, dem.normal)


def change_summary(figures: dict[str, Any]) -> list[str]:
    """The summary for the terminal, as lines."""
    registration, regions = figures["registration"], figures["regions"]
    count = len(regions)
    found = f"{count} changed part{'' if count == 1 else 's'}" if count else "no change"
    lines = [
        f"{figures['before']['name']} and {figures['after']['name']}: {found}; "
        f"half of the surface would show one beyond {shown(figures['limit_um']['p50'], 'um')}"
    ]
    for region in regions[:5]:
        lines.append(
            f"  {region['number']}: {'added' if region['mean_um'] > 0 else 'lost'} "
            f"{shown(abs(region['mean_um']), 'um')} on average, {shown(abs(region['extreme_um']), 'um')} at most, on "
            f"{plain(region['area_mm2'])} mm², {plain(abs(region['volume_mm3']))} mm³"
        )
    if count > 5:
        lines.append(f"  and {count - 5} more, regions.csv")
    moved = {"features": "by features and ICP", "frames": "by ICP from their frames", "none": "not moved"}
    lines.append(
        f"  aligned {moved[registration['by']]}: {shown(registration['error_um'], 'um')} apart where "
        f"nothing changed ({100 * registration['stable_fraction']:.0f} % of the surface)"
    )
    return lines + [f"  warning: {warning}" for warning in figures["warnings"]]
