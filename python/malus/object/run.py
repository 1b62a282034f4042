"""From an object file to one surface: stations as a campaign, then their fusion, mesh, texture, figures and page."""

from __future__ import annotations

import hashlib
import json
import math
import secrets
import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from malus import _core, batch
from malus._files import read_record, sha256_of, with_relative_paths, write_record
from malus.batch import Outcome
from malus.errors import DataError, InputError, MalusError
from malus.object import agreement, meshing, page, texture
from malus.object.agreement import OrientedPoints
from malus.object.albedo import Albedos
from malus.object.arrays import on_disk
from malus.object.clouds import clouds_of
from malus.object.color import Paint
from malus.object.comparison import compared_with_reference, write_comparison
from malus.object.definition import Object
from malus.object.doubts import doubts_of_object, left_out, warnings_of
from malus.object.figures import mesh_figures, station_figures
from malus.object.frame import Frame, find_frame, key_of_photos, with_warnings
from malus.object.glb import write_levels
from malus.object.implicit import pieces
from malus.object.joining import joined_mesh
from malus.object.mesh_file import coverage_of, write_mesh
from malus.object.meshing import MOST_TO_SIMPLIFY, ObjectMesh
from malus.object.sharpening import Phases, sharpened, telling
from malus.object.views import load_view, stored
from malus.object.words import said_of_object
from malus.photogrammetry import exclusive
from malus.photogrammetry.program import Colmap
from malus.threads import ALL_CORES
from malus.workspace import Workspace

#: Receives the progress of the fusion: the share that is done, and the next step.
Progress = Callable[[float, str], None]


def run_object(
    thing: Object,
    output: str | Path,
    *,
    jobs: int = 1,
    threads: int | None = None,
    scheduler: str | None = None,
    shard: tuple[int, int] | None = None,
    progress: Callable[[str, float, str], None] | None = None,
    ended: Callable[[Outcome], None] | None = None,
) -> list[Outcome]:
    """Run the stations of an object that are not done, and join all stations into one surface.

    OUTPUT gets the files of malus.batch.run_campaign, photogrammetry/ if stations are found among photos, and object/: mesh.ply (full
    mesh, with sigma), mesh.glb (textured), albedo.glb, reference/, agreement/NAME.png, quality.json, report/index.html. jobs, threads,
    scheduler and shard: as in malus.batch.run_campaign. The surface is made from the stations that are done, once no station is pending.
    It is not made again while these stations and the object file are unchanged. progress: step, share done, message. ended: gets the
    outcome of each station that this run has run. Returns the outcomes of all stations.

    Raises DataError if there is no station, the first station's error if none is done, and the errors of malus.reconstruct. An
    earlier surface is removed before any work that would make another one: before the search for the cameras if it is not of the same
    object file, photos and stations, and before the stations are run if it is not of their present results and the object file. It
    is also removed if the photos give no cameras (DataError), if no station is done, or if making the new surface fails. If another
    error ends the search for the cameras, it stays. The warnings before an error are its notes.
    """
    say = progress or (lambda *_: None)
    thing.require_ready()
    folder = Path(output) / "object"
    frame, photos = None, None
    try:
        if thing.shared is not None:
            photos = _key_of_files(thing, output)
            # An earlier surface would look like one of the files as they are now, also if the search is interrupted.
            _discard(folder, unless=lambda: _recorded(folder).get("photos_key") == photos)
            frame = find_frame(thing, Path(output), threads or ALL_CORES, say)
    except MalusError as error:
        # A full disk or a missing COLMAP does not make an earlier surface of these photos wrong. (If the disk with the photos is missing,
        # Object.load has failed before.)
        if isinstance(error, DataError) or photos is None:
            _discard(folder)
        raise
    cameras = None if frame is None else frame.cameras

    def surface_is_current() -> bool:
        outcomes = batch.outcomes_of(thing.campaign, output, cameras)
        return not _any_pending(outcomes) and _recorded(folder).get("key") == _key(thing, outcomes, frame)

    # If this run is interrupted, or leaves stations to other shards, an earlier surface would look like its result.
    _discard(folder, unless=surface_is_current)

    def station_ended(count: int, total: int, outcome: Outcome) -> None:
        say("stations", count / total, f"{outcome['station']}: {outcome['status']}")
        if ended is not None:
            ended(outcome)

    outcomes = batch.run_campaign(
        thing.campaign, output, jobs=jobs, threads=threads, scheduler=scheduler, shard=shard, cameras=cameras,
        progress=station_ended,
    )  # fmt: skip
    # Stations of other shards are pending; the shard that ends last makes the surface.
    return outcomes if _any_pending(outcomes) else _joined(thing, folder, frame, photos, threads or ALL_CORES, say)


def _joined(
    thing: Object,
    folder: Path,
    frame: Frame | None,
    photos: str | None,
    threads: int,
    say: Callable[[str, float, str], None],
) -> list[Outcome]:
    """Make the surface of the finished stations, unless it is made; returns the outcomes of all stations."""
    found = [] if frame is None else frame.warnings
    # If two shards end at once, one makes the surface, and the other one finds it made.
    with exclusive(folder, wait=True):
        # Another shard may have run a station again, with another result, while this one waited.
        outcomes = batch.outcomes_of(thing.campaign, folder.parent, None if frame is None else frame.cameras)
        if _any_pending(outcomes):
            return outcomes
        done = [outcome for outcome in outcomes if outcome["status"] == "done"]
        if not done:
            _clear(folder)
            raise with_warnings(batch.failure(outcomes) or DataError(f"{thing.name}: has no stations"), found)
        say("stations", 1.0, f"{len(done)} of {len(outcomes)} done")  # Stations of an earlier run reported no progress.
        key = _key(thing, outcomes, frame)
        if not _is_made(folder, key):
            _clear(folder)
            try:
                _fuse(
                    thing, outcomes, frame, folder, key, photos, threads,
                    lambda share, message: say("object", share, message),
                )  # fmt: skip
            except BaseException as error:
                # A mesh without its page, or with that of another surface, would look finished.
                _clear(folder)
                if isinstance(error, MalusError):
                    with_warnings(error, [*found, *left_out(outcomes)])
                raise
    say("object", 1.0, str(folder / "report" / "index.html"))
    return outcomes


def _any_pending(outcomes: Sequence[Outcome]) -> bool:
    return any(outcome["status"] == "pending" for outcome in outcomes)


def _recorded(folder: Path) -> dict[str, Any]:
    """What quality.json says of an earlier surface; nothing without one."""
    return read_record(folder / "quality.json") or {}


def _key(thing: Object, outcomes: Sequence[Outcome], frame: Frame | None) -> str:
    """Hash of what the surface is made from, and of what its page says about stations that are not in it and about the photos."""
    stations = [[outcome["station"], outcome["reason"] or outcome["manifest"]] for outcome in outcomes]
    photos = None if frame is None else [frame.figures, frame.warnings]
    return hashlib.sha256(json.dumps([_core.version, _wanted(thing), stations, photos]).encode()).hexdigest()


def _key_of_files(thing: Object, output: str | Path) -> str:
    """Hash of what is known of a surface before the search for cameras: object file, photos, and the stations' files by size and time."""
    assert thing.shared is not None
    stations = [task.key() for task in thing.campaign.tasks(output, 1)]
    said = [_wanted(thing), thing.turntable, key_of_photos(thing.shared), stations]
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()


def _wanted(thing: Object) -> list[Any]:
    """What the object file says of the surface."""
    scan = None if thing.reference is None else [str(thing.reference), sha256_of(thing.reference), thing.register]
    return [
        thing.name, thing.unit, thing.closed, thing.max_sigma_gsd, thing.faces, thing.texture_format,
        thing.campaign.report, scan,
    ]  # fmt: skip


def _is_made(folder: Path, key: str) -> bool:
    """Whether the surface with this key exists and all its files are unchanged."""
    quality = _recorded(folder)
    try:
        return quality["key"] == key and all(
            sha256_of(folder / name) == digest for name, digest in quality["files"].items()
        )
    except (InputError, KeyError):
        return False


def _clear(folder: Path) -> None:
    """Remove an earlier surface, which may have had other stations, and what an interrupted run left.

    All of it first gets hidden names, the page before the rest: removing takes longer, and a part that an interruption left would look
    like the whole.
    """
    for name in ("report", "quality.json", "mesh.ply", "mesh.glb", "albedo.glb", "levels", "agreement", "reference"):
        with suppress(FileNotFoundError):
            (folder / name).rename(folder / f".mesh-{secrets.token_hex(8)}")
    for left in folder.glob(".mesh-*"):
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
        else:
            left.unlink(missing_ok=True)


def _discard(folder: Path, unless: Callable[[], bool] = lambda: False) -> None:
    """Clear the folder of an earlier surface, if there is one. Waits for a process that is making a surface; `unless` then refers to that
    surface.
    """
    if folder.exists():
        with exclusive(folder, wait=True):
            if not unless():
                _clear(folder)


def _fuse(
    thing: Object,
    outcomes: Sequence[Outcome],
    frame: Frame | None,
    folder: Path,
    key: str,
    photos: str | None,
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
        clouds, bare = clouds_of(thing, done, folder.parent, gsd, threads)
        everything = agreement.object_points(views, clouds, threads=threads)
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
        comparison, compared = compared_with_reference(thing, mesh, views, gsd, threads)
        figures = mesh_figures(mesh, gsd, thing.closed)
        shown = _for_others(outcomes, thing.folder)
        coverage = coverage_of(mesh, views, scratch)
        stations = station_figures(shown, views, agreements, coverage, gsd)
        doubts = doubts_of_object(stations, figures["closed"], thing, compared, bare)
        said = said_of_object(thing, done, folder.parent, gsd, [*left_out(shown), *doubts])
        write_mesh(folder / "mesh.ply", mesh, gsd, paint, coverage.stations, said, scratch)
        files, levels = write_levels(folder, baked, thing.unit, thing.name, thing.texture_format, said)
        files += write_comparison(folder, comparison, mesh, views, gsd, thing)
        files += page.write_maps(folder / "agreement", agreements)
        found = [] if frame is None else frame.warnings
        quality = {
            "name": thing.name, "unit": thing.unit, "version": _core.version, "key": key, "photos_key": photos, "gsd": gsd, "stations": stations,
            "points": {"stations": int((everything.stations > 0).sum()), "stereo": int((everything.stations == 0).sum())},
            "mesh": figures, "levels": levels, "albedo": albedos.figures(), "reference": compared, "agreement": agreement.agreement_figures(agreements, gsd),
            "sharpened_by": [view.name for view, _ in told],
            "photogrammetry": None if frame is None else frame.figures,
            "warnings": warnings_of(shown, found, folder.parent) + doubts,
        }  # fmt: skip
        files += [
            folder / "mesh.ply",
            page.write_page(folder, quality, baked[0], mesh, views, comparison, linked=thing.campaign.report),
        ]
        quality["files"] = {str(path.relative_to(folder)): sha256_of(path) for path in files}
        _require_unchanged(thing, outcomes, frame, folder, key)
    # After the temporary folder is gone: a run that finds the record removes nothing.
    write_record(folder / "quality.json", quality)


def _for_others(outcomes: Sequence[Outcome], folder: Path) -> list[Outcome]:
    """The outcomes for files that are given away: reasons name files relative to the object's folder, not by their place on this computer."""
    return [outcome | {"reason": with_relative_paths(outcome["reason"], folder)} for outcome in outcomes]


def _require_unchanged(thing: Object, outcomes: Sequence[Outcome], frame: Frame | None, folder: Path, key: str) -> None:
    """InputError if stations, their clouds or the reference changed while the surface was made."""
    now = batch.outcomes_of(thing.campaign, folder.parent, None if frame is None else frame.cameras)
    for before, after in zip(outcomes, now, strict=True):
        # Another shard may have run a station again that failed as before. Only its time differs then.
        if after | {"seconds": 0} != before | {"seconds": 0}:
            raise InputError(
                f"{before['file']}: its files or results were changed while the surface was made; run again"
            )
    if _key(thing, outcomes, frame) != key:
        raise InputError(f"{thing.reference}: was changed while the surface was made; run again")


def _simpler(
    thing: Object, mesh: ObjectMesh, points: OrientedPoints, gsd: float, most_sigma: float, scratch: Path, threads: int
) -> ObjectMesh | None:
    """The same surface on a coarser lattice, to simplify from if the mesh is too large to be simplified at once; else None."""
    if thing.closed or len(mesh.triangles) <= MOST_TO_SIMPLIFY:
        return None
    coarser = math.sqrt(len(mesh.triangles) / MOST_TO_SIMPLIFY)
    # As many points per cell as on the fine lattice. A random choice leaves them equally dense in all directions.
    chosen = np.random.default_rng(0).random(len(points.points)) < 1 / coarser**2
    coarse = pieces(points.select(chosen), coarser * gsd, threads)
    return joined_mesh(coarse, scratch / "coarse", most_sigma)
