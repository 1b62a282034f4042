"""The page of an object: a mesh to turn and light, which station sees which part, how well stations agree, and the figures."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngImageFile

from malus import _core
from malus._files import write_bytes, write_text
from malus.lengths import scale_bar, shown, sides
from malus.object.agreement import Agreement
from malus.object.arrays import chunks
from malus.object.glb import encoded, glb
from malus.object.meshing import ObjectMesh
from malus.object.reference import Comparison
from malus.object.texture import NearestVertices, TexturedMesh
from malus.object.views import View, sees
from malus.pages import base64_text, template
from malus.pictures import encode
from malus.units import METERS
from malus.viewer import pack

#: Longest sides of the texture and of a station's map in the page (pixels).
_TEXTURE_SIDE, _MAP_SIDE = 2048, 1200
#: Distances of this many standard deviations or more, and so contradictions, have the last color of the map.
_MOST_RATIO = 4.0
#: Gray value of pixels without data, and the margin that is left around the pixels with data, as a share of their extent.
_NOTHING, _ROOM = 128, 0.05
#: A number in a sentence; digits in the name of a file, as in IMG_0012.JPG, do not count.
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?!\.?\w)")
#: Distances from the reference of this many GSD or more have the first or last color.
_MOST_DISTANCE_GSD = 2.0
#: A pixel's place is in the mesh if a vertex lies within this many GSD of the object, or of the station if its pixels are larger.
_FARTHEST_VERTEX_GSD = 4.0


def colors_of(shares: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Colors (…×3) of numbers 0 … 1, from blue over white to red; gray for NaN."""
    known = np.isfinite(shares)
    value = np.clip(np.where(known, shares, 0), 0, 1)[..., None]
    low, middle, high = (np.array(color) for color in ((33.0, 102, 172), (247, 247, 247), (178, 24, 43)))
    color = np.where(value < 0.5, low + (middle - low) * 2 * value, middle + (high - middle) * (2 * value - 1))
    return np.asarray(np.where(known[..., None], np.rint(color), _NOTHING), dtype=np.uint8)


def write_maps(folder: Path, agreements: Sequence[Agreement]) -> list[Path]:
    """A PNG for each station: RMS of the other stations' distances over their standard deviation, blue 0 to red 4, which are
    contradictions, too.
    """
    return [_write_map(folder, one.view, one.ratio / _MOST_RATIO) for one in agreements]


def write_distances(
    folder: Path, distances: NDArray[np.float32], mesh: ObjectMesh, views: Sequence[View], gsd: float
) -> list[Path]:
    """A PNG for each station: distance of the mesh (N vertices) from its reference where the station sees the mesh, blue outside, red
    inside.
    """
    find = NearestVertices(mesh)
    paths = []
    for view in views:
        shown = np.full(view.depth.shape, np.nan, np.float32)
        farthest = _FARTHEST_VERTEX_GSD * max(gsd, view.gsd)
        pixels = np.nonzero(view.usable)
        for some in chunks(len(pixels[0])):
            rows, columns = (places[some] for places in pixels)
            points = view.points_at(rows, columns)
            nearest = find(points)
            near = np.linalg.norm(mesh.vertices[nearest] - points, axis=1) < farthest
            shown[rows, columns] = np.where(near, distances[nearest], np.nan)
        paths.append(_write_map(folder, view.name, _shares_of_distances(shown, gsd)))
    return paths


def _write_map(folder: Path, station: str, shares: NDArray[np.floating]) -> Path:
    """A PNG of `colors_of` these numbers (H×W), colored in parts because that takes much memory."""
    colors = np.empty((*shares.shape, 3), np.uint8)
    for rows in chunks(*shares.shape):
        colors[rows] = colors_of(shares[rows])
    path = folder / f"{station}.png"
    write_bytes(path, encode(colors, "PNG"))
    return path


def _shares_of_distances(distances: NDArray[np.float32], gsd: float) -> NDArray[np.float32]:
    """The numbers whose colors stand for these distances: blue is in front, as in the maps of a station."""
    return np.asarray((1 - distances / (_MOST_DISTANCE_GSD * gsd)) / 2, np.float32)


def _turntable(
    mesh: TexturedMesh,
    full: ObjectMesh,
    gsd: float,
    unit: str,
    views: Sequence[View],
    distances: NDArray[np.float32] | None,
) -> dict[str, Any]:
    """The textured mesh as a GLB file, its albedo, vertex colors of the maps (stations, sigma, reference), and which station sees which vertex.

    The viewer opens with the first station's view of the object.
    """
    first = views[0]
    to_eye = first.eye - (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    nearest = NearestVertices(full)(mesh.vertices)
    small = _for_the_page(mesh)
    seen = np.stack([sees(view, mesh.vertices, full.normals[nearest]) for view in views])
    sigma = np.where(full.measured[nearest], full.sigma[nearest] / (2 * gsd), np.nan)
    return {
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.triangles),
        "glb": base64_text(glb(small, "m", "object", webp=True)),
        "albedo": None if small.albedo is None else base64_text(encoded(small.albedo, "WEBP")),
        "stations": pack(colors_of(1 - seen.mean(0)).T),
        "seen_by": [view.name for view in views],
        "seen": pack(seen, 8),
        "sigma": pack(colors_of(sigma).T),
        "reference": None if distances is None else pack(colors_of(_shares_of_distances(distances[nearest], gsd)).T),
        "meters": METERS[unit],
        "extent": np.ptp(mesh.vertices, axis=0).tolist(),
        "eye": (to_eye / np.linalg.norm(to_eye)).tolist(),
        "up": (-first.rotation[1]).tolist(),
    }


def _for_the_page(mesh: TexturedMesh) -> TexturedMesh:
    """The mesh with textures that are small enough for the page."""
    return replace(
        mesh,
        color=_small(mesh.color, _TEXTURE_SIDE),
        normal_map=_small(mesh.normal_map, _TEXTURE_SIDE),
        albedo=None if mesh.albedo is None else _small(mesh.albedo, _TEXTURE_SIDE),
    )


def _small(pixels: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    picture = Image.fromarray(pixels)
    picture.thumbnail((side, side))
    return np.asarray(picture)


@dataclass(frozen=True)
class _Map:
    """A station's map as the page shows it: cropped to the pixels with data, with a scale bar."""

    png: str
    width: int
    height: int
    bar_percent: float
    bar_label: str


def _maps(folder: Path, quality: Mapping[str, Any]) -> dict[str, _Map]:
    pixels = {row["station"]: row["gsd"] for row in quality["stations"] if row["status"] == "done"}
    return {path.stem: _map(path, pixels[path.stem], quality["unit"]) for path in sorted(folder.glob("*.png"))}


def _map(path: Path, gsd: float, unit: str) -> _Map:
    with PngImageFile(path) as image:  # Image.open refuses maps of more than 179 megapixels
        colors = np.asarray(image)
    rows, columns = (np.nonzero((colors != _NOTHING).any(axis=(2, axis)))[0] for axis in (1, 0))
    if len(rows):
        colors = colors[_with_room(rows, colors.shape[0]), _with_room(columns, colors.shape[1])]
    across = colors.shape[1] * gsd
    length, label = scale_bar(across, unit)
    small = _small(colors, _MAP_SIDE)
    return _Map(base64_text(encode(small, "PNG")), small.shape[1], small.shape[0], 100 * length / across, label)


def _with_room(places: NDArray[np.intp], size: int) -> slice:
    room = int(_ROOM * (places[-1] - places[0]))
    return slice(max(0, int(places[0]) - room), min(size, int(places[-1]) + room + 1))


def reasons_of(stations: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Why stations are not fully trusted: each sentence once, with the stations that it applies to. Numbers that differ between the
    stations become a range.
    """
    said: dict[tuple[str, ...], list[tuple[str, list[str]]]] = {}
    for row in stations:
        # No blank follows a decimal point.
        for sentence in filter(None, re.split(r"(?<=\.) (?=[A-Z])", row["reasons"])):
            words = tuple(_NUMBER.split(sentence))
            said.setdefault(words, []).append((row["station"], _NUMBER.findall(sentence)))
    return [
        (_filled(words, [numbers for _, numbers in told]), [station for station, _ in told])
        for words, told in said.items()
    ]


def _filled(words: Sequence[str], numbers: Sequence[Sequence[str]]) -> str:
    """A sentence of these words, with the ranges of the stations' numbers between them."""
    spans = [_span(sorted(column, key=float)) for column in zip(*numbers, strict=True)]
    return words[0] + "".join(span + after for span, after in zip(spans, words[1:], strict=True))


def _span(ordered: Sequence[str]) -> str:
    return ordered[0] if ordered[0] == ordered[-1] else f"{ordered[0]} to {ordered[-1]}"


def reasons_without_albedo(unknown: Mapping[str, str]) -> list[str]:
    """Why the own color of stations is not known: each reason once, after the stations that it applies to."""
    told: dict[str, list[str]] = {}
    for station, reason in unknown.items():
        told.setdefault(reason.removeprefix(f"{station}: "), []).append(station)
    return [f"{', '.join(stations)}: {reason}" for reason, stations in told.items()]


def _other_warnings(quality: Mapping[str, Any]) -> list[str]:
    """The warnings that do not repeat a reason for their station's confidence."""
    reasons = {row["station"]: row.get("reasons", "") for row in quality["stations"]}
    told = [warning.split(": ", 2) for warning in quality["warnings"]]  # station, step, sentence
    return [": ".join(parts) for parts in told if parts[-1] not in reasons.get(parts[0], "")]


def write_page(
    folder: Path,
    quality: Mapping[str, Any],
    mesh: TexturedMesh,
    full: ObjectMesh,
    views: Sequence[View],
    comparison: Comparison | None,
    *,
    linked: bool,
) -> Path:
    """Write report/index.html in `folder` (self-contained except for the links to the stations' reports); returns its path."""
    # The page must not reveal the scan's path on this computer.
    scan = quality.get("reference")
    page = template("object.html.j2").render(
        quality=quality,
        scan_name=Path(scan["file"]).name if scan else None,
        other_warnings=_other_warnings(quality),
        view=_turntable(
            mesh, full, quality["gsd"], quality["unit"], views, None if comparison is None else comparison.distances
        ),
        maps=_maps(folder / "agreement", quality),
        distances=_maps(folder / "reference", quality),
        shown=partial(shown, unit=quality["unit"]),
        size=sides(quality["mesh"]["extent"], quality["unit"]),
        reasons=reasons_of([row for row in quality["stations"] if row.get("confidence", "high") != "high"]),
        without_albedo=reasons_without_albedo(quality["albedo"]["unknown"]),
        linked=linked,
        version=_core.version,
    )
    path = folder / "report" / "index.html"
    write_text(path, page)
    return path
