"""From an object file to one surface: stations as a campaign, then their fusion, mesh, texture, figures and page."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from malus import _core, batch, scans
from malus._files import new_folder, read_record, sha256_of, write_record
from malus.batch import Outcome
from malus.errors import DataError, InputError, MalusError
from malus.lengths import shown, sides
from malus.object import agreement, meshing, page, reference, texture
from malus.object.agreement import Agreement, OrientedPoints
from malus.object.albedo import Albedos
from malus.object.arrays import GrowingArray, chunks, on_disk
from malus.object.color import Paint
from malus.object.definition import Object
from malus.object.glb import write_levels
from malus.object.implicit import pieces, pixel_side
from malus.object.joining import joined_mesh
from malus.object.meshing import ObjectMesh
from malus.object.ply import columns, write_ply
from malus.object.reference import Comparison
from malus.object.sharpening import Phases, sharpened, telling
from malus.object.views import Floats, View, load_view, may_see, sees, stored
from malus.object.words import said_of_object
from malus.photogrammetry import Outline, exclusive, find_object_cameras
from malus.photogrammetry.front_end import camera_of
from malus.photogrammetry.program import Colmap
from malus.photogrammetry.shared_frame import save_cameras, save_failure
from malus.reconstruction import unpolarized_scene
from malus.threads import ALL_CORES
from malus.workspace import Workspace

#: Receives the progress of the fusion: the share that is done, and the next step.
Progress = Callable[[float, str], None]
#: Most triangles of a mesh that is simplified as a whole.
_MOST_TO_SIMPLIFY = 4_000_000
#: Stations that lie off the others by more than this many standard deviations (RMS) get a warning (docs/tutorials/whole-object.md).
_WORTH_A_WARNING = 2.0
#: So do stations of whose surface more than this share is too unsure for the mesh.
_MOST_UNSURE = 1 / 3


def run_object(
    thing: Object,
    output: str | Path,
    *,
    jobs: int = 1,
    threads: int | None = None,
    scheduler: str | None = None,
    shard: tuple[int, int] | None = None,
    progress: Callable[[str, float, str], None] | None = None,
) -> list[Outcome]:
    """Run the stations of an object that are not done, and join all stations into one surface.

    OUTPUT gets the files of malus.batch.run_campaign, photogrammetry/ if stations are found among photos, and object/: mesh.ply (full
    mesh, with sigma), mesh.glb (textured), albedo.glb, reference/, agreement/NAME.png, quality.json, report/index.html. jobs, threads,
    scheduler and shard: as in malus.batch.run_campaign. The surface is made from the stations that are done, once no station is pending.
    It is not made again while these stations and the object file are unchanged. progress: step, share done, message. Returns the
    outcomes of the stations. Raises DataError if no station is done, and the errors of malus.reconstruct; an error in making the surface
    leaves none, nor an earlier one.
    """
    say = progress or (lambda *_: None)
    thing.require_ready()
    frame = None if thing.shared is None else find_frame(thing, Path(output), threads or ALL_CORES, say)
    outcomes = batch.run_campaign(
        thing.campaign, output, jobs=jobs, threads=threads, scheduler=scheduler, shard=shard,
        cameras=None if frame is None else frame.cameras,
        progress=lambda done, total, outcome: say("stations", done / total, f"{outcome['station']}: {outcome['status']}"),
    )  # fmt: skip
    # Stations of other shards are pending; the shard that ends last makes the surface.
    if any(outcome["status"] == "pending" for outcome in outcomes):
        return outcomes
    done = [outcome for outcome in outcomes if outcome["status"] == "done"]
    if not done:
        error = batch.failure(outcomes) or DataError(f"{thing.name}: has no stations")
        raise _with_warnings(error, [] if frame is None else frame.warnings)
    say("stations", 1.0, f"{len(done)} of {len(outcomes)} done")  # Stations of an earlier run reported no progress.
    folder = Path(output) / "object"
    key = _key(thing, outcomes, frame)
    # If two shards end at once, one makes the surface and the other gets an InputError.
    with exclusive(folder):
        if not _is_made(folder, key):
            _clear(folder)
            try:
                _fuse(
                    thing,
                    outcomes,
                    frame,
                    folder,
                    key,
                    threads or ALL_CORES,
                    lambda share, message: say("object", share, message),
                )
            except BaseException:
                # A mesh without its page, or with that of another surface, would look finished.
                _clear(folder)
                raise
    say("object", 1.0, str(folder / "report" / "index.html"))
    return outcomes


@dataclass(frozen=True)
class Frame:
    """Stations found among an object's photos. cameras: folder with a file for each station. figures: for quality.json, on the photos,
    on each station and on the scale.
    """

    cameras: Path
    figures: dict[str, Any]
    warnings: list[str]


def find_frame(thing: Object, output: Path, threads: int, say: Callable[[str, float, str], None]) -> Frame:
    """Find all stations among the object's photos, and write each station's cameras for its own run.

    For a station that fails or cannot be placed, the error is written instead, and the station's own run ends with this error. Stages
    whose inputs did not change are not repeated. An error that ends the search has the warnings before it as notes.
    """
    assert thing.shared is not None
    folder, options = output / "photogrammetry", thing.campaign.options
    kept = folder / "stations"
    warnings = thing.unmasked()
    tasks = thing.campaign.tasks(output, threads, kept)
    with exclusive(folder, wait=True):
        kept.mkdir(exist_ok=True)
        views = {}
        outlines = {}
        for count, task in enumerate(tasks):
            say("photos", 0.3 * count / len(tasks), f"polarization of {task.identifier}")
            station, begun = task.load(), folder / "polarization" / task.identifier
            try:
                scene, mask = unpolarized_scene(station, options, begun, threads)
                said = station.describe()
                views[task.identifier] = (camera_of(said["camera"]), scene)
                if said["mask"] is not None:
                    outlines[task.identifier] = Outline(mask, Path(said["mask"]))
                _begin(task.workspace, begun)
            except MalusError as error:
                save_failure(Path(task.cameras), error)
        if not views:
            return Frame(kept, {}, warnings)
        try:
            found = find_object_cameras(
                thing.shared, views, folder, outlines=outlines if thing.turntable else None, options=options, threads=threads,
                log=lambda level, text: warnings.append(text) if level == "warning" else None,
                progress=lambda share, message: say("photos", 0.3 + 0.7 * share, message),
            )  # fmt: skip
        except MalusError as error:
            _with_warnings(error, warnings)
            raise
        for task in tasks:
            if task.identifier in found:
                cameras = replace(found[task.identifier], warnings=list(warnings))
                save_cameras(Path(task.cameras), cameras, folder / "model")
            elif task.identifier in views:
                save_failure(
                    Path(task.cameras),
                    DataError(
                        f"{task.identifier} could not be placed among the photos of the object; take a few photos near its direction, "
                        "and check that [camera] is the polarized images' own calibration"
                    ),
                )
    if not found:
        return Frame(kept, {}, warnings)
    figures = {name: cameras.figures["photogrammetry"]["station"] for name, cameras in found.items()}
    whole = next(iter(found.values())).figures
    return Frame(
        kept,
        {
            **whole["photogrammetry"],
            "station": figures,
            **{name: whole[name] for name in ("scale", "control") if name in whole},
        },
        warnings,
    )


def _with_warnings(error: MalusError, warnings: Sequence[str]) -> MalusError:
    """The error with the warnings before it as notes: they often say why, and no report will show them."""
    for warning in warnings:
        error.add_note(f"warning before it: {warning}")
    return error


def _begin(workspace: Path, begun: Path) -> None:
    """Start a station's workspace with the polarization step that was computed for finding the station."""
    if not workspace.exists():
        with new_folder(workspace) as new:
            shutil.copytree(begun, new, ignore=shutil.ignore_patterns(".lock"), dirs_exist_ok=True)


def _key(thing: Object, outcomes: Sequence[Outcome], frame: Frame | None) -> str:
    """Hash of what the surface is made from, and of what its page says about stations that are not in it and about the photos."""
    scan = None if thing.reference is None else [str(thing.reference), sha256_of(thing.reference), thing.register]
    wanted = [
        thing.name, thing.unit, thing.closed, thing.max_sigma_gsd, thing.faces, thing.texture_format,
        thing.campaign.report, scan,
    ]  # fmt: skip
    stations = [[outcome["station"], outcome["reason"] or outcome["manifest"]] for outcome in outcomes]
    photos = None if frame is None else [frame.figures, frame.warnings]
    return hashlib.sha256(json.dumps([_core.version, wanted, stations, photos]).encode()).hexdigest()


def _is_made(folder: Path, key: str) -> bool:
    """Whether the surface with this key exists and all its files are unchanged."""
    quality = read_record(folder / "quality.json")
    try:
        return (
            quality is not None
            and quality["key"] == key
            and all(sha256_of(folder / name) == digest for name, digest in quality["files"].items())
        )
    except (InputError, KeyError):
        return False


def _clear(folder: Path) -> None:
    """Remove an earlier surface, which may have had other stations, and what an interrupted run left."""
    for name in ("quality.json", "mesh.ply", "mesh.glb", "albedo.glb"):
        (folder / name).unlink(missing_ok=True)
    for left in (*(folder / name for name in ("levels", "agreement", "reference", "report")), *folder.glob(".mesh-*")):
        shutil.rmtree(left, ignore_errors=True)


def _fuse(
    thing: Object,
    outcomes: Sequence[Outcome],
    frame: Frame | None,
    folder: Path,
    key: str,
    threads: int,
    say: Progress,
) -> None:
    done = [outcome for outcome in outcomes if outcome["status"] == "done"]
    with tempfile.TemporaryDirectory(prefix=".mesh-", dir=folder) as temporary:
        scratch = Path(temporary)
        say(0.0, "reading the stations")
        views = [
            stored(
                load_view(name, folder.parent / "stations" / name, thing.max_sigma_gsd, threads),
                scratch / "views" / name,
            )
            for name in (outcome["station"] for outcome in done)
        ]
        gsd = float(np.median([view.gsd for view in views]))
        most_sigma = (
            max(view.most_sigma for view in views) if thing.max_sigma_gsd is None else thing.max_sigma_gsd * gsd
        )
        say(0.1, "combining what stations see")
        # Agreement is measured before sharpening: surfaces that were moved to the same phases are less independent.
        agreements = [
            replace(met, ratio=on_disk(met.ratio, scratch / "agreement" / met.view))
            for met in agreement.agreements_of(views, threads=threads)
        ]
        phases = [
            Phases.of(Workspace(folder.parent / "stations" / view.name), scratch / "phases" / view.name)
            for view in views
        ]
        told = telling(views, phases, threads=threads)
        views = [
            stored(view, scratch / "sharpened" / view.name, ("depth", "normals"))
            for view in sharpened(views, told, threads=threads)
        ]
        everything = agreement.object_points(views, _clouds(thing, done, folder.parent, gsd, threads), threads=threads)
        say(0.3, f"a mesh of {len(everything.points)} points")
        mesh = joined_mesh(pieces(everything, gsd, threads), scratch / "open", most_sigma)
        if thing.closed:
            mesh = meshing.closed_surface(mesh, gsd, folder, Colmap(1, thing.campaign.options.photos.backend))
        paint = Paint.of(views, mesh.vertices, mesh.normals)
        say(0.5, f"texture of {len(mesh.triangles)} triangles")
        simpler = _simpler(thing, mesh, everything, gsd, most_sigma, scratch, threads)
        albedos = Albedos.of(views, folder.parent / "stations", scratch / "albedo")
        baked = texture.levels_of_detail(mesh, thing.faces, paint, gsd, simpler, albedos.paint(mesh))
        say(0.8, "writing")
        said = said_of_object(thing, done, folder.parent, gsd)
        coverage = _write_mesh(folder / "mesh.ply", mesh, paint, said, scratch)
        files, levels = write_levels(folder, baked, thing.unit, thing.name, thing.texture_format, said)
        comparison, compared = _compared(thing, mesh, views, gsd, threads)
        files += _write_comparison(folder, comparison, mesh, views, gsd, thing)
        files += page.write_maps(folder / "agreement", agreements)
        figures = mesh_figures(mesh, gsd, thing.closed)
        stations = _station_figures(outcomes, views, agreements, coverage, gsd)
        found = [] if frame is None else frame.warnings
        quality = {
            "name": thing.name, "unit": thing.unit, "version": _core.version, "key": key, "gsd": gsd, "stations": stations,
            "points": {"stations": int((everything.stations > 0).sum()), "stereo": int((everything.stations == 0).sum())},
            "mesh": figures, "levels": levels, "albedo": albedos.figures(), "reference": compared, "agreement": agreement.agreement_figures(agreements, gsd),
            "sharpened_by": [view.name for view, _ in told],
            "photogrammetry": None if frame is None else frame.figures,
            "warnings": _warnings(outcomes, found, figures["closed"], thing, folder.parent, compared) + doubts_of_stations(stations),
        }  # fmt: skip
        files += [
            folder / "mesh.ply",
            page.write_page(folder, quality, baked[0], mesh, views, comparison, linked=thing.campaign.report),
        ]
        quality["files"] = {str(path.relative_to(folder)): sha256_of(path) for path in files}
        _require_unchanged(thing, outcomes, frame, folder, key)
    # After the temporary folder is gone: a run that finds the record removes nothing.
    write_record(folder / "quality.json", quality)


def _require_unchanged(thing: Object, outcomes: Sequence[Outcome], frame: Frame | None, folder: Path, key: str) -> None:
    """InputError if stations, their clouds or the reference changed while the surface was made."""
    now = batch.outcomes_of(thing.campaign, folder.parent, None if frame is None else frame.cameras)
    for before, after in zip(outcomes, now, strict=True):
        if after != before:
            raise InputError(
                f"{before['file']}: its files or results were changed while the surface was made; run again"
            )
    if _key(thing, outcomes, frame) != key:
        raise InputError(f"{thing.reference}: was changed while the surface was made; run again")


def _simpler(
    thing: Object, mesh: ObjectMesh, points: OrientedPoints, gsd: float, most_sigma: float, scratch: Path, threads: int
) -> ObjectMesh | None:
    """The same surface on a coarser lattice, to simplify from if the mesh is too large to be simplified at once; else None."""
    if thing.closed or len(mesh.triangles) <= _MOST_TO_SIMPLIFY:
        return None
    coarser = math.sqrt(len(mesh.triangles) / _MOST_TO_SIMPLIFY)
    # As many points per cell as on the fine lattice. A random choice leaves them equally dense in all directions.
    chosen = np.random.default_rng(0).random(len(points.points)) < 1 / coarser**2
    coarse = pieces(points.select(chosen), coarser * gsd, threads)
    return joined_mesh(coarse, scratch / "coarse", most_sigma)


def _clouds(thing: Object, done: Sequence[Outcome], output: Path, gsd: float, threads: int) -> list[OrientedPoints]:
    """The stations' clouds that have normals, without duplicates, as large as known distances make them. Their points count as pixels
    that are large enough to join each other to a surface.
    """
    parts = []
    clouds: dict[str, tuple[str, float]] = {}
    for outcome in done:
        said = thing.campaign.station(outcome["file"]).describe()
        if "prior_cloud" in said:
            clouds.setdefault(said["prior_cloud"], (outcome["station"], said["prior_scale"]))
    for cloud, (station, scale) in clouds.items():
        points, normals = _read_cloud(Path(cloud), thing.unit)
        noise = Workspace(output / "stations" / station).manifest["steps"]["prior"]["notes"]["noise"]
        if normals is not None:
            count, points = len(points), scale * points
            # Limited as the scales of views are: the margins about blocks are no wider.
            (*_, side) = _core.scales_of([gsd, gsd, max(gsd, pixel_side(points, threads))])
            parts.append(
                OrientedPoints(
                    points, normals, np.full(count, float(noise)), np.zeros(count, np.int64),
                    np.full(count, side, np.float32) if side > 1 else None,
                )
            )  # fmt: skip
    return parts


def _read_cloud(path: Path, unit: str) -> tuple[Floats, Floats | None]:
    """Points and unit normals of a station's cloud, a file or a workspace of COLMAP's dense stereo."""
    if scans.is_scan(path):
        points, normals = scans.read_scan(path, unit)
        return points, None if normals is None else normals.astype(np.float64)
    return _core.read_oriented_points(str(path))


def _compared(
    thing: Object, mesh: ObjectMesh, views: Sequence[View], gsd: float, threads: int
) -> tuple[Comparison | None, dict[str, Any] | None]:
    """Comparison of the mesh with the object's reference (None without a reference or if it does not fit), and its entry in quality.json."""
    scan = thing.read_reference()
    if scan is None:
        return None, None
    said: dict[str, Any] = {"file": str(thing.reference), "registered": thing.register}
    try:
        if thing.register:
            placed = reference.place(scan, views)
            scan, at_rest = reference.aligned(scan.moved(placed.rotation, placed.translation), mesh, gsd, threads)
            said |= {
                "correlation": placed.correlation, "next_best": placed.next_best, "alignment_converged": at_rest
            }  # fmt: skip
        comparison = reference.compare(scan, mesh, gsd, threads)
    except DataError as error:
        # A failed comparison must not discard the surface, which is valid and took hours.
        return None, {**said, "status": str(error)}
    return comparison, {**said, "status": "done", **comparison.figures}


def _write_comparison(
    folder: Path, comparison: Comparison | None, mesh: ObjectMesh, views: Sequence[View], gsd: float, thing: Object
) -> list[Path]:
    """Write maps of the distances in the stations' images, and the moved reference if it was registered."""
    if comparison is None:
        return []
    files = page.write_distances(folder / "reference", comparison.distances, mesh, views, gsd)
    if thing.register:
        path, scan = folder / "reference" / "registered.ply", comparison.reference
        triangles = None if scan.triangles is None else scan.triangles.astype(np.int64)
        write_ply(path, columns("xyz", scan.points, "f8"), triangles, "reference moved onto the surface")
        files.append(path)
    return files


@dataclass(frozen=True)
class Coverage:
    """Shares of the surface that each station sees, and that no other station sees."""

    seen: Floats
    alone: Floats


def _write_mesh(path: Path, mesh: ObjectMesh, paint: Paint, said: Mapping[str, str], scratch: Path) -> Coverage:
    colors, stations = GrowingArray(scratch / "colors", np.uint8, 3), GrowingArray(scratch / "stations", np.uint8)
    seen, alone = np.zeros(len(paint.views)), np.zeros(len(paint.views))
    total = 0.0
    for rows in chunks(len(mesh.vertices)):
        points, normals = mesh.vertices[rows], mesh.normals[rows]
        by = np.zeros((len(paint.views), len(points)), bool)
        for k in may_see(paint.views, points):
            by[k] = sees(paint.views[k], points, normals)
        colors.add(paint.srgb(points, normals))
        stations.add(np.minimum(by.sum(0), 255))  # a byte in the file
        share = mesh.shares(rows)
        seen += by @ share
        alone += (by & (by.sum(0) == 1)) @ share
        total += float(share.sum())
    # Coordinates far from the origin need more than single precision.
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    far = np.maximum(-low, high).max() > 1e4 * (high - low).max() / 1e3
    values = columns("xyz", mesh.vertices, "f8" if far else "f4")
    values |= columns(("nx", "ny", "nz"), mesh.normals, "f4")
    values |= columns(("red", "green", "blue"), colors.array(), "u1")
    values |= {"sigma": (mesh.sigma, "f4"), "measured": (mesh.measured, "u1"), "stations": (stations.array(), "u1")}
    write_ply(path, values, mesh.triangles, *(f"{key}: {words}" for key, words in said.items()))
    return Coverage(seen / total, alone / total)


def is_closed(triangles: NDArray[np.int64]) -> bool:
    """Whether every edge has two triangles that run along it in opposite directions."""
    edges = meshing.edges_of(triangles)
    count = int(triangles.max()) + 1
    there, back = (np.sort(edges[:, k] * count + edges[:, 1 - k]) for k in (0, 1))
    return bool((there[1:] != there[:-1]).all() and (there == back).all())


def mesh_figures(mesh: ObjectMesh, gsd: float, wanted_closed: bool) -> dict[str, Any]:
    """Size of the mesh, whether it is closed, how much of it was measured and how well."""
    measured = mesh.measured & mesh.even()
    return {
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.triangles),
        # The check takes the whole mesh into memory. Closing does so, too; a large mesh with open borders stays on disk.
        "closed": (wanted_closed or len(mesh.triangles) <= _MOST_TO_SIMPLIFY) and is_closed(mesh.triangles),
        "measured_fraction": mesh.measured_fraction(),
        "sigma_median_gsd": float(np.median(mesh.sigma[measured]) / gsd) if measured.any() else None,
        "extent": np.ptp(mesh.vertices, axis=0).tolist(),
    }


def _station_figures(
    outcomes: Sequence[Outcome],
    views: Sequence[View],
    agreements: Sequence[Agreement],
    coverage: Coverage,
    gsd: float,
) -> list[dict[str, Any]]:
    known = {view.name: k for k, view in enumerate(views)}
    rows = []
    for outcome in outcomes:
        row: dict[str, Any] = {"station": outcome["station"], "status": outcome["status"], "reason": outcome["reason"]}
        if outcome["station"] in known:
            k = known[outcome["station"]]
            row |= {
                "gsd": views[k].gsd,
                "quality": outcome["figures"].get("quality"),
                "confidence": outcome["figures"].get("confidence"),
                "reasons": outcome["figures"].get("reasons", ""),
                "seen_fraction": float(coverage.seen[k]),
                "alone_fraction": float(coverage.alone[k]),
                "unsure_fraction": views[k].unsure,
                "max_sigma_gsd": views[k].most_sigma / views[k].gsd,
                "agreement": agreement.agreement_figures([agreements[k]], gsd),
            }
        rows.append(row)
    return rows


def _warnings(
    outcomes: Sequence[Outcome],
    found: Sequence[str],
    closed: bool,
    thing: Object,
    output: Path,
    compared: Mapping[str, Any] | None,
) -> list[str]:
    """Warnings of all stations and of the object itself. Warnings about finding the stations (`found`), which every station repeats,
    are listed once.
    """
    shared = [f"photos: {warning}" for warning in found]
    warnings = list(shared)
    for outcome in outcomes:
        name = outcome["station"]
        if outcome["status"] != "done":
            warnings.append(f"{name}: is not in the surface: {outcome['reason']}")
            continue
        own = Workspace(output / "stations" / name).quality["warnings"]
        warnings += [f"{name}: {warning}" for warning in own if warning not in shared]
    if thing.closed and not closed:
        warnings.append("object: the mesh was to be closed, but it has open edges")
    if compared is not None and compared["status"] != "done":
        warnings.append(f"object: is not compared with {compared['file']}: {compared['status']}")
    return warnings


def doubts_of_stations(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Warnings about stations in the surface that add nothing to it, or that the others do not confirm. rows: `stations` of quality.json."""
    done = [row for row in rows if row["status"] == "done"]
    warnings = []
    for row in done:
        name, off = row["station"], row["agreement"]["rms_ratio"]
        if row["unsure_fraction"] > _MOST_UNSURE:
            warnings.append(
                f"object: {name}: {100 * row['unsure_fraction']:.0f} % of its surface is left out, because its standard deviation is above "
                f"{row['max_sigma_gsd']:.3g} GSD (object.max_sigma_gsd)"
            )
        if row["seen_fraction"] == 0:
            warnings.append(
                f"object: {name}: no part of the mesh is its surface, which is less sure than object.max_sigma_gsd allows, or which "
                "others see better or contradict"
            )
        elif off is None and len(done) > 1:
            warnings.append(
                f"object: {name}: no other station has a surface where it has its own, so that nothing checks its place; if others see the "
                "same places, a pose or a scale is wrong"
            )
        elif off is not None and off > _WORTH_A_WARNING:
            warnings.append(
                f"object: {name}: the surfaces of other stations lie {off:.2g} standard deviations (RMS) off its own, expected 1: are its "
                "pose and its scale right?"
            )
    return warnings


def object_summary(quality: Mapping[str, Any]) -> list[str]:
    """The figures that matter first, a line each, for the terminal; the warnings last."""
    mesh, met, unit = quality["mesh"], quality["agreement"], quality["unit"]
    sigma = mesh["sigma_median_gsd"]
    used = sum(row["status"] == "done" for row in quality["stations"])
    lines = [
        f"{quality['name']}: {sides(mesh['extent'], unit)}, {used} of {len(quality['stations'])} stations, one pixel is "
        f"{shown(quality['gsd'], unit)}",
        f"  accuracy: {shown(sigma * quality['gsd'], unit)} (one standard deviation of what was measured, median)"
        if sigma is not None
        else "  accuracy: not known",
        f"  mesh: {mesh['triangles']} triangles, {'closed' if mesh['closed'] else 'open'}; "
        f"{100 * mesh['measured_fraction']:.1f} % of the surface measured",
    ]
    if met["rms_ratio"] is not None:
        lines.append(
            f"  stations off each other: median {met['median_gsd']:.3g} GSD, RMS {met['rms_ratio']:.3g} standard deviations, "
            f"{100 * met['within_two_sigma']:.0f} % within two"
        )
    lines += [f"  {line}" for line in doubted_stations(quality)]
    scan = quality["reference"]
    if scan is not None and scan["status"] == "done":
        lines.append(
            f"  off the reference: median {scan['absolute_median_gsd']:.3g} GSD, {100 * scan['within_1_gsd']:.0f} % within 1 GSD; "
            f"{100 * scan['completeness']['1_gsd']:.0f} % of it is there"
        )
    return lines + [f"  warning: {warning}" for warning in quality["warnings"]]


def doubted_stations(quality: Mapping[str, Any]) -> list[str]:
    """Confidence, with its reasons, of each station in the surface whose confidence is not high."""
    done = [row for row in quality["stations"] if row["status"] == "done" and row["confidence"] != "high"]
    return [f"{row['station']}: confidence {row['confidence']}: {row['reasons']}" for row in done]
