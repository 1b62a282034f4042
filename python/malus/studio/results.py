"""Finished results: the main figures of each, the difference of two, and profiles picked on the surface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from malus import assess
from malus._files import shortened
from malus.errors import DataError, InputError, MalusError
from malus.pictures import data_url, encode
from malus.raster import reduced, step_for
from malus.relief import gray, hillshade
from malus.studio.access import Root
from malus.studio.folders import below
from malus.studio.pictures import colored
from malus.workspace import Workspace, is_result

#: Long side of the pictures of results.
_SIDE_PX = 1400
#: Largest relative difference of two cameras that is put down to rounding.
_SAME_CAMERA = 1e-6


def works(root: Root) -> list[str]:
    """Folders below the root that hold the results of a run."""
    return [name for name in _folders_with(root, "manifest.json") if is_result(root.path(name))]


def comparisons(root: Root) -> list[str]:
    """Folders below the root that hold the comparison of two dates."""
    return _folders_with(root, "change.json")


def folder_of_comparison(root: Root, before: Path, after: Path) -> Path:
    """Folder for the comparison of two results; always the same one for the same results."""
    names = [root.name(work).replace("/", "_") for work in (before, after)]
    return root.path(shortened("_".join(["change", *names])))


def _folders_with(root: Root, file: str) -> list[str]:
    # A link may lead out of the opened folder.
    return sorted(root.name(here) for here, files in below(root)[0] if file in files and root.holds(here / file))


def station_of(root: Root, folder: Path) -> str | None:
    """The station file whose result the folder holds, by its name on the page; None if the file is not in the opened folder."""
    owner = Workspace(folder).manifest.get("station") or {}
    # Station file and results may have been moved or copied together.
    for path in (folder / str(owner.get("file_from_here")), Path(str(owner.get("file")))):
        if path.is_file() and root.holds(path):
            return root.name(path)
    return None


def summary(root: Root, folder: Path) -> dict[str, Any]:
    """The figures of a result for the list of results; `problem` if the result is not finished, or not of this version of Malus."""
    try:
        return _figures(root, Workspace(folder))
    except MalusError as error:
        return {"problem": str(error)}
    except (KeyError, ValueError, TypeError, AttributeError, OSError) as error:  # it must not hide the other results
        return {"problem": f"its figures cannot be shown ({type(error).__name__}: {error}); run the station again"}


def _figures(root: Root, workspace: Workspace) -> dict[str, Any]:
    quality = workspace.quality
    keys = ("name", "unit", "gsd", "width", "height", "confidence", "warnings")
    return {
        **{key: quality[key] for key in keys},
        "station": station_of(root, workspace.folder),
        "coverage": quality["coverage"]["fraction"],
        "sigma_gsd": quality["sigma"]["median_gsd"] if quality["sigma"] else None,
        "report": workspace.has("report/index.html"),
    }


def relief(folder: Path) -> bytes:
    """PNG of a result's relief shading, for profiles and comparisons; reduced if the rasters are large, else pixel for pixel."""
    workspace = Workspace(folder)
    depth = workspace.raster("fused/depth.tif")
    step = step_for(depth.shape, _SIDE_PX)
    return encode(gray(hillshade(-reduced(depth, step), float(workspace.quality["gsd"]) * step)), "PNG")


def _is_same_place(a: Workspace, b: Workspace) -> bool:
    """Whether two cameras of one lens stand at one place and look in one direction. Places are compared relative to the distance of
    the object: coordinates may be those of a national grid, a millionth of which is meters.
    """
    (turn_a, shift_a), (turn_b, shift_b) = a.pose, b.pose
    apart = float(np.linalg.norm(turn_a.T @ shift_a - turn_b.T @ shift_b))
    distance = float(a.quality["gsd"]) * a.camera.fx
    return np.allclose(turn_a, turn_b, rtol=0, atol=_SAME_CAMERA) and apart <= _SAME_CAMERA * distance


def difference(first: Path, second: Path) -> dict[str, Any]:
    """How much nearer the second surface is than the first, as a picture and figures in the station's unit.

    Both must have been made from the same place: two runs, or two dates from one fixed camera. InputError otherwise.
    """
    a, b = Workspace(first), Workspace(second)
    same_camera = all(
        np.isclose(getattr(a.camera, key), getattr(b.camera, key), rtol=_SAME_CAMERA)
        for key in ("width", "height", "fx", "fy", "cx", "cy")
    )
    if not (same_camera and _is_same_place(a, b)) or a.quality["unit"] != b.quality["unit"]:
        raise InputError(
            f"{first.name} and {second.name} were not taken from the same place with the same camera and unit, so that they cannot "
            "be compared pixel by pixel; two dates of one object are compared below"
        )
    nearer = a.raster("fused/depth.tif") - b.raster("fused/depth.tif")
    known = nearer[np.isfinite(nearer)]
    if not known.size:
        raise DataError(f"{first.name} and {second.name} have no pixel in common")
    limit = max(float(np.percentile(np.abs(known), 98)), 1e-9)
    small = reduced(nearer, step_for(nearer.shape, _SIDE_PX))
    return {
        "picture": data_url(colored(small, "RdBu", -limit, limit), "PNG"),
        "limit": limit,
        "mean": float(known.mean()),
        "rms": float(np.sqrt(np.mean(np.square(known, dtype=float)))),
        "median": float(np.median(known)),
        "unit": str(a.quality["unit"]),
    }


def profile(folder: Path, start: tuple[float, float], end: tuple[float, float]) -> dict[str, Any]:
    """A section through prior and fused surface between two pixels, computed as the report's profiles are: distance along its chord
    and height above it, in the unit.

    Heights point towards the camera; None where there is no surface.
    """
    workspace = Workspace(folder)
    depths = {name: workspace.raster(f"{name}/depth.tif") for name in ("prior", "fused")}
    height, width = depths["fused"].shape
    if not all(0 <= u <= width - 1 and 0 <= v <= height - 1 for u, v in (start, end)):
        raise InputError(f"the profile from {start} to {end} leaves the picture of {width} x {height} pixels")
    if np.hypot(end[0] - start[0], end[1] - start[1]) < 2:
        raise InputError("the profile is shorter than 2 pixels, expected two places apart")
    gsd = float(workspace.quality["gsd"])
    section = assess.profile(depths["fused"], workspace.camera, start, end, gsd, prior=depths["prior"])
    if section["status"] != "done":
        raise DataError("the profile meets no surface")
    return {
        "unit": str(workspace.quality["unit"]),
        "along": [float(x) for x in section["position"]],
        **{
            name: [float(x) if np.isfinite(x) else None for x in section[key]]
            for name, key in (("prior", "prior"), ("fused", "surface"))
        },
    }
