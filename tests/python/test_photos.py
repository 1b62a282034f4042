"""Stations whose prior is made from photos: errors are explained, and finished stages are not repeated."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
import unicodedata
import zipfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import malus as package
from conftest import EXAMPLE, QUICK, QUICK_WORDS, demo_with_photos, edit, malus, malus_here, malus_station, run_program
from malus import _core
from malus._files import sha256_of
from malus.photogrammetry import (
    database,
    diagnosis,
    photo_cameras,
    scale,
    station_pose,
    station_sweep,
    window_matching,
)
from malus.photogrammetry.bench import Bench
from malus.photogrammetry.features import _search, find_features
from malus.photogrammetry.journal import UNFINISHED, Journal
from malus.photogrammetry.marks import marks_in_files, require_marks_in_photos
from malus.photogrammetry.metashape import read_metashape
from malus.photogrammetry.model import SparseModel
from malus.photogrammetry.photos import Photo, list_photos, photos_of, stray_masks, to_bytes, with_masks
from malus.photogrammetry.program import Colmap, SearchStoppedError
from malus.photogrammetry.station_pose import STATION_IMAGE, StationView, station_image
from malus.planning import expected_times
from malus.workspace import STEPS

#: A stand-in for `colmap` that behaves as the environment variable FAKE says, and logs the commands it is given.
FAKE = """#!{python}
import os, sqlite3, sys, time
command = sys.argv[1]
if command == "help":
    print("COLMAP 3.8 -- fake")
    sys.exit(0)
with open(os.environ["FAKE_LOG"], "a") as log:
    log.write(command + "\\n")
arguments = dict(zip(sys.argv[2::2], sys.argv[3::2]))
mode = os.environ.get("FAKE", "")
if mode == "fail":
    print("Check failed: something inside", file=sys.stderr)
    sys.exit(1)
if mode == "unfixed" and command == "mapper":
    print("ERROR: failed to create sparse model")
    sys.exit(1)
if mode == "hang" and command == "mapper":
    time.sleep(600)
if command == "feature_extractor":
    base = sqlite3.connect(arguments["--database_path"])
    base.executescript(
        "CREATE TABLE IF NOT EXISTS cameras (camera_id INTEGER PRIMARY KEY AUTOINCREMENT, model INTEGER, width INTEGER, height INTEGER,"
        " params BLOB, prior_focal_length INTEGER);"
        "CREATE TABLE IF NOT EXISTS images (image_id INTEGER PRIMARY KEY AUTOINCREMENT, name TEXT, camera_id INTEGER);"
        "CREATE TABLE IF NOT EXISTS keypoints (image_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB);"
        "CREATE TABLE IF NOT EXISTS descriptors (image_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB);"
        "CREATE TABLE IF NOT EXISTS matches (pair_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB);"
        "CREATE TABLE IF NOT EXISTS two_view_geometries (pair_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB, config INTEGER)")
    base.execute("INSERT OR IGNORE INTO cameras VALUES (1, 4, 96, 64, x'', 0)")
    for name in open(arguments["--image_list_path"]).read().split():
        found = base.execute("SELECT image_id FROM images WHERE name = ?", (name,)).fetchone()
        if found is None:
            found = (base.execute("INSERT INTO images (name, camera_id) VALUES (?, 1)", (name,)).lastrowid,)
        number = found[0]
        rows = 10 if mode == "plain" else 900
        base.execute("INSERT INTO keypoints VALUES (?, ?, 6, x'')", (number, rows))
        base.execute("INSERT INTO descriptors VALUES (?, 0, 128, x'')", (number,))
    base.commit()
elif command == "matches_importer":
    base = sqlite3.connect(arguments["--database_path"])
    if mode != "apart":
        numbers = [row[0] for row in base.execute("SELECT image_id FROM images")]
        for a in numbers:
            for b in numbers:
                if a < b and not (mode == "stranger" and b == numbers[-1]):
                    base.execute("INSERT INTO two_view_geometries VALUES (?, 100, 2, x'', 3)", (a * 2147483647 + b,))
    base.commit()
"""


@pytest.fixture
def photo_station(small_station: Path) -> Path:
    """The small station with four small photos in place of camera pose and prior."""
    folder = small_station.parent / "views"
    folder.mkdir()
    for number in range(4):
        with Image.open(EXAMPLE / "views" / f"view_0{number}.jpg") as image:
            image.resize((96, 64)).save(folder / f"view {number}.jpg")
    edit(small_station, 'colmap_model = "sparse"\nimage = "station.jpg"',
         'model = "PINHOLE"\nwidth = 200\nheight = 160\nparams = [1937.0, 1937.0, 100.0, 80.0]')  # fmt: skip
    edit(small_station, '[prior]\ncloud = "dense/cloud.ply"', '[photos]\nfolder = "views"')
    return small_station


@pytest.fixture
def fake_colmap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put the fake program in place; returns the file with the commands it was given."""
    program = tmp_path / "fake" / "colmap"
    program.parent.mkdir()
    program.write_text(FAKE.format(python=sys.executable))
    program.chmod(0o755)
    log = tmp_path / "fake" / "commands"
    monkeypatch.setenv("MALUS_COLMAP", str(program))
    monkeypatch.setenv("FAKE_LOG", str(log))
    return log


def fails(station: Path, work: Path, code: int, *words: str) -> str:
    outcome = malus_here("prior", station, "-o", work, "--threads", "1")
    assert outcome.code == code, outcome
    for word in words:
        assert word in outcome.err, f"{word!r} is not in {outcome.err!r}"
    assert "Traceback" not in outcome.err
    assert not (work / "prior" / "depth.tif").exists()
    return outcome.err


def test_program_is_missing(photo_station: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MALUS_COLMAP", "colmap-that-is-not-there")
    fails(photo_station, tmp_path / "work", 4, "colmap-that-is-not-there", "apt install colmap")


def test_program_fails(photo_station: Path, tmp_path: Path, fake_colmap: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE", "fail")
    fails(photo_station, tmp_path / "work", 4, "feature_extractor", "exit code 1", "something inside", "features.log")


def test_two_photos_only(photo_station: Path, tmp_path: Path, fake_colmap: Path) -> None:
    for number in (2, 3):
        (photo_station.parent / "views" / f"view {number}.jpg").unlink()
    fails(photo_station, tmp_path / "work", 3, "2 photos", "at least 3")


def test_damaged_photo_is_named(photo_station: Path, tmp_path: Path, fake_colmap: Path) -> None:
    path = photo_station.parent / "views" / "view 2.jpg"
    path.write_bytes(path.read_bytes()[:600])
    fails(photo_station, tmp_path / "work", 2, "view 2.jpg")
    path.write_bytes(b"not an image")
    fails(photo_station, tmp_path / "work", 2, "view 2.jpg")


def test_a_pose_that_the_photos_replace_is_named(photo_station: Path) -> None:
    warning = "the pose in [camera] is not used: the station is placed among the [photos]"
    assert warning not in package.check(package.Station.load(photo_station))["warnings"]
    edit(photo_station, "100.0, 80.0]", "100.0, 80.0]\nqvec = [1, 0, 0, 0]\ntvec = [0, 0, 99999]")
    assert warning in package.check(package.Station.load(photo_station))["warnings"]


def test_excluded_photo_that_is_not_there(photo_station: Path, tmp_path: Path, fake_colmap: Path) -> None:
    edit(photo_station, 'folder = "views"', 'folder = "views"\nexclude = ["none.jpg"]')
    fails(photo_station, tmp_path / "work", 2, "exclude", "none.jpg")


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("plain", ("features", "texture")),
        ("apart", ("same surface", "photograph")),
        ("", ("focal length", "tilted")),
        ("unfixed", ("no first pair fixes the geometry",)),
        ("stranger", ("view 3.jpg", "nothing in common")),
    ],
)
def test_unsuitable_photos_are_refused(
    photo_station: Path,
    tmp_path: Path,
    fake_colmap: Path,
    monkeypatch: pytest.MonkeyPatch,
    mode: str,
    words: tuple[str, ...],
) -> None:
    """Plain photos, photos without overlap, no first pair, a photo of something else."""
    monkeypatch.setenv("FAKE", mode)
    fails(photo_station, tmp_path / "work", 3, *words)


def test_interrupted_run_can_be_resumed_and_leaves_no_child(
    photo_station: Path, tmp_path: Path, fake_colmap: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE", "hang")
    command = [sys.executable, "-m", "malus.cli", "prior", str(photo_station), "-o", str(tmp_path / "work"), "--quiet"]
    run = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    # A busy machine may take long to start the run.
    for _ in range(1200):
        if fake_colmap.exists() and "mapper" in fake_colmap.read_text():
            break
        time.sleep(0.1)
    run.send_signal(signal.SIGINT)
    _, err = run.communicate(timeout=120)
    assert run.returncode == 130, err
    children = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert str(tmp_path / "fake" / "colmap") not in children

    before = fake_colmap.read_text().split()
    assert list(dict.fromkeys(before)) == ["feature_extractor", "matches_importer", "mapper"]
    monkeypatch.setenv("FAKE", "")
    fails(photo_station, tmp_path / "work", 3, "focal length")
    after = fake_colmap.read_text().split()[len(before) :]
    # Without a model, photos are matched once more, along epipolar lines, and mapped again. Finished stages are not repeated.
    again = after.index("matches_importer")
    assert set(after[:again]) == set(after[again + 1 :]) == {"mapper"}


def test_check_lists_what_a_run_would_do(photo_station: Path, fake_colmap: Path, tmp_path: Path) -> None:
    outcome = malus("check", photo_station, cwd=tmp_path)
    assert outcome.code == 0, outcome
    for words in ("4 with 1 self-calibrated lens", "6 pairs", "COLMAP 3.8", "neither [[scale]] nor", "EXIF"):
        assert words in outcome.out, words
    with photo_station.open("a") as file:
        for words in ("distance = 30\ntargets = [1, 2]", "distance = 40\ntargets = [2, 3]\ncheck = true"):
            file.write(f'\n[[scale]]\n{words}\ntargets_dictionary = "aruco_4x4_50"\n')
    assert "scale: 1 known distance; 1 more checks it" in package.check(package.Station.load(photo_station))["does"]
    assert not fake_colmap.exists()


def test_wrong_masks_of_photos_are_all_told_before_features_are_searched(
    photo_station: Path, fake_colmap: Path, tmp_path: Path
) -> None:
    """A black one was told once all cameras had been found, and then the next one."""
    masks = photo_station.parent / "masks"
    masks.mkdir()
    for count, path in enumerate(sorted((photo_station.parent / "views").iterdir())):
        picture = (Image.new("L", (96, 64), 0), Image.open(path).convert("L"), Image.new("L", (96, 64), 255))[
            min(count, 2)
        ]
        picture.save(masks / f"{path.name}.png")
    edit(photo_station, 'folder = "views"', 'folder = "views"\nmasks = "masks"')
    words = (
        f"[photos] masks: mask {masks / 'view 0.jpg.png'} is black everywhere, expected white where the object is",
        f"; mask {masks / 'view 1.jpg.png'} looks like a photograph",
    )
    assert "view 2" not in fails(photo_station, tmp_path / "work", 2, *words)
    station = package.Station.load(photo_station)
    for run in (package.check, package.reconstruct):
        with pytest.raises(package.InputError) as error:
            run(station)
        assert all(word in str(error.value) for word in words)
    assert not fake_colmap.exists(), "COLMAP was not asked for anything"
    Image.new("L", (96, 64), 255).save(masks / "view 0.jpg.png")
    assert "view 0" not in fails(photo_station, tmp_path / "work", 2, words[1][2:]), "the file is read again"


def test_check_asks_for_masks_that_viewers_do_not_turn_with_their_photos(
    photo_station: Path, fake_colmap: Path, tmp_path: Path
) -> None:
    exif = Image.Exif()
    exif[274] = 3
    photo, masks = photo_station.parent / "views" / "view 1.jpg", photo_station.parent / "masks"
    masks.mkdir()
    for path in sorted(photo.parent.iterdir()):
        Image.new("L", (96, 64), 255).save(masks / f"{path.name}.png")
    edit(photo_station, 'folder = "views"', 'folder = "views"\nmasks = "masks"')

    def asked() -> list[str]:
        said = package.check(package.Station.load(photo_station))["warnings"]
        return [warning for warning in said if "viewers turn" in warning]

    assert not asked()
    with Image.open(photo) as image:
        image.save(photo, exif=exif)
    assert len(asked()) == 1 and "viewers turn view 1.jpg by EXIF data" in asked()[0]


def test_the_fusion_between_two_sweeps_is_expected_without_zenith_and_height(
    photo_station: Path, fake_colmap: Path
) -> None:
    station = package.Station.load(photo_station)

    def seconds(until: str | None = None, **options: Any) -> dict[str, float]:
        return dict(expected_times(station, package.Options(**options), until=until, threads=1))

    twice, once = seconds(), seconds(sweep={"again": False})
    fusing = sum(twice[step] for step in ("prior", "polarizer", "evidence", "fuse"))
    assert twice["sweep"] - once["sweep"] == pytest.approx(fusing + once["sweep"])
    assert seconds("prior")["sweep"] == twice["sweep"], "a run that ends with the prior sweeps twice, too"
    assert not fake_colmap.exists()


def test_cpp_program_refers_to_malus_run(photo_station: Path, tmp_path: Path) -> None:
    outcome = malus_station(photo_station, "-o", tmp_path / "work", "--quiet")
    assert outcome.code == 2
    assert "malus run" in outcome.err


def test_a_program_named_by_a_relative_path_starts_in_every_folder(
    fake_colmap: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(fake_colmap.parent)
    monkeypatch.setenv("MALUS_COLMAP", "./colmap")
    (tmp_path / "elsewhere").mkdir()
    Colmap(1).run("model_converter", {}, tmp_path / "log", working_folder=tmp_path / "elsewhere")
    assert fake_colmap.read_text() == "model_converter\n"


def test_a_last_line_without_line_feed_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "colmap"
    program.write_text("#!/bin/sh\n[ $1 = help ] && echo COLMAP 3.8 && exit\nprintf 'first\\nout of memory'\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("MALUS_COLMAP", str(program))
    with pytest.raises(package.ExternalError, match="first / out of memory"):
        Colmap(1).run("mapper", {}, tmp_path / "log")


def test_folder_belongs_to_one_process(tmp_path: Path) -> None:
    with package.photogrammetry.exclusive(tmp_path / "a"):
        with pytest.raises(package.InputError, match="in use"), package.photogrammetry.exclusive(tmp_path / "a"):
            pass
    with pytest.raises(package.ResourceError, match="No space"), package.photogrammetry.exclusive(tmp_path / "a"):
        raise OSError(28, "No space left on device")


def test_a_full_disk_is_not_taken_for_a_damaged_database(tmp_path: Path) -> None:
    with (
        pytest.raises(package.ResourceError, match="full"),
        package.photogrammetry.exclusive(tmp_path),
        closing(sqlite3.connect(":memory:")) as base,
    ):
        base.execute("PRAGMA max_page_count = 2")
        base.execute("CREATE TABLE matches (data BLOB)")
        base.execute("INSERT INTO matches VALUES (?)", (bytes(10000),))
    (tmp_path / "features.db").write_bytes(b"no database" * 100)
    with pytest.raises(package.ExternalError, match="is damaged"), package.photogrammetry.exclusive(tmp_path):
        database.feature_counts(tmp_path / "features.db")


def test_a_folder_is_free_again_though_a_forked_child_lives(tmp_path: Path) -> None:
    script = (
        "import os, signal, sys; from malus.photogrammetry import exclusive\n"
        "with exclusive(folder := __import__('pathlib').Path(sys.argv[1])):\n"
        "    if (child := os.fork()) == 0: signal.pause()\n"
        "try:\n"
        "    with exclusive(folder): print('free')\n"
        "finally: os.kill(child, signal.SIGKILL); os.waitpid(child, 0)\n"
    )
    done = run_program(sys.executable, "-c", script, tmp_path / "a")
    assert done.out == "free\n", done.err


def placed_lens(station: Path) -> package.Camera:
    """The camera of the small station, which its COLMAP model places."""
    _, width, height, params, rotation, translation = (
        _core.ColmapModel.read(str(station.parent / "sparse")).images()["station.jpg"][0]
    )  # fmt: skip
    return package.Camera("PINHOLE", width, height, params, rotation, translation)


def test_unchanged_steps_are_run_once(small_station: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A station without [camera], whose photos give the camera and the prior that its files gave before: the surface for the
    second sweep is made from the registered images, and a second run keeps every step.
    """
    lens = placed_lens(small_station)
    prior = package.reconstruct(package.Station.load(small_station), until="prior")
    edit(small_station, '[camera]\ncolmap_model = "sparse"\nimage = "station.jpg"\n', "")
    shutil.copytree(small_station.parent / "pol", small_station.parent / "views")
    edit(small_station, '[prior]\ncloud = "dense/cloud.ply"', '[photos]\nfolder = "views"')
    views = small_station.parent / "views"
    figures = {"photogrammetry": {"files": {path.name: sha256_of(path) for path in views.iterdir()}}}
    surfaces = []

    def find(*_: object, log: Callable[[str, str], None], **__: object) -> SimpleNamespace:
        log("warning", "few photos")
        return SimpleNamespace(station=lens, figures=figures, times={"seconds": 1.0}, warnings=[])

    def sweep(*_: object, fuse: Callable[[Any], Any], **__: object) -> package.photogrammetry.Swept:
        assert prior.prior_depth is not None and prior.prior_sigma is not None
        swept = package.photogrammetry.Swept(prior.prior_depth, prior.prior_sigma, None, {}, {"seconds": 2.0})
        if not surfaces:
            surfaces.append(fuse(swept).depth)
        return swept

    monkeypatch.setattr(package.photogrammetry, "find_cameras", find)
    monkeypatch.setattr(package.photogrammetry, "sweep_station", sweep)
    station, options = package.Station.load(small_station), package.Options(refine=QUICK)
    events: list[package.Progress] = []
    result = package.reconstruct(station, options, workspace=tmp_path / "work", progress=events.append)
    begun = {event.message.split(": ")[1] for event in events if event.step == "sweep" and event.fraction == 0}
    assert begun == {"prior", "polarizer", "evidence", "fuse"}
    np.testing.assert_array_equal(surfaces[0], result.depth)
    record = package.Workspace(tmp_path / "work")
    assert record.manifest["times"]["photos"] == {"seconds": 1.0}
    assert "photos: few photos" in record.quality["warnings"]

    events.clear()
    package.reconstruct(station, options, workspace=tmp_path / "work", progress=events.append)
    steps = [step for step in STEPS if step not in ("photos", "sweep", "m3c2", "paper", "report")]
    kept = {event.step for event in events if event.message == "kept from an earlier run"}
    assert kept == set(steps)
    pytest.importorskip("rocrate")
    pytest.importorskip("bagit")
    shutil.copy(views / "pol_030.tif", views / "later.tif")
    with zipfile.ZipFile(package.export(tmp_path / "work", "archive")) as file:
        packed = {name.partition("/inputs/")[2] for name in file.namelist()}
        graph = json.loads(file.read("small/data/ro-crate-metadata.json"))["@graph"]
    assert {f"{folder}/pol_030.tif" for folder in ("pol", "views")} <= packed
    assert "views/later.tif" not in packed  # the surface was not made from it
    stated = {entity["@id"]: entity.get("sha256") for entity in graph}
    assert stated["inputs/views/pol_030.tif"] == sha256_of(views / "pol_030.tif")
    (views / "pol_030.tif").write_bytes((views / "pol_060.tif").read_bytes())
    with pytest.raises(package.InputError, match=r"views/pol_030\.tif: was changed since"):
        package.export(tmp_path / "work", "archive")


def test_the_archive_of_a_station_of_an_object_has_photos_and_masks(
    small_station: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The [photos] stand in the object's file, without which the station's file has neither a pose nor a coarse surface."""
    pytest.importorskip("rocrate")
    pytest.importorskip("bagit")
    folder, lens = small_station.parent, placed_lens(small_station)
    prior = package.reconstruct(package.Station.load(small_station), until="prior")
    assert prior.prior_depth is not None and prior.prior_sigma is not None
    shutil.copytree(folder / "pol", folder / "views")
    mask = folder / "masks/pol_030.png"
    mask.parent.mkdir()
    Image.new("L", (lens.width, lens.height), 255).save(mask)
    (folder / "object.toml").write_text('[photos]\nfolder = "views"\nmasks = "masks"\n')
    fx, fy, cx, cy = lens.params
    params = f"params = [{fx}, {fy}, {cx + 0.5}, {cy + 0.5}]"
    stated_lens = f'model = "PINHOLE"\nwidth = {lens.width}\nheight = {lens.height}\n{params}\n'
    edit(small_station, 'colmap_model = "sparse"\nimage = "station.jpg"\n', stated_lens)
    edit(small_station, '[prior]\ncloud = "dense/cloud.ply"', "")
    figures = {"photogrammetry": {"files": {path.name: sha256_of(path) for path in (folder / "views").iterdir()}}}
    cameras = SimpleNamespace(station=lens, figures=figures, times={}, warnings=[])
    hull = station_sweep.Hull(prior.prior_depth, prior.prior_sigma, {}, {mask: sha256_of(mask)})
    swept = station_sweep.Swept(prior.prior_depth, prior.prior_sigma, None, {}, {}, hull)
    monkeypatch.setattr(package.photogrammetry, "find_cameras", lambda *_, **__: cameras)
    monkeypatch.setattr(package.photogrammetry, "sweep_station", lambda *_, **__: swept)
    station = package.Station.load(small_station, photos_of=folder / "object.toml")
    package.reconstruct(station, package.Options(refine=QUICK), workspace=tmp_path / "work")
    with zipfile.ZipFile(package.export(tmp_path / "work", "archive")) as file:
        graph = json.loads(file.read("small/data/ro-crate-metadata.json"))["@graph"]
    stated = {entity["@id"]: entity.get("sha256") for entity in graph}
    for name in ("views/pol_030.tif", "masks/pol_030.png"):
        assert stated[f"inputs/{name}"] == sha256_of(folder / name)
    Image.new("L", (lens.width, lens.height), 200).save(mask)
    with pytest.raises(package.InputError, match=r"masks/pol_030\.png: was changed since"):
        package.export(tmp_path / "work", "archive")


def test_journal_repeats_only_what_changed(tmp_path: Path) -> None:
    runs: list[str] = []

    def stage(journal: Journal, name: str, value: int) -> None:
        def run() -> dict[str, object]:
            runs.append(name)
            (tmp_path / name).write_text("x" * value)
            return {}

        journal.stage(name, {"value": value}, [name], run)

    for first, second, expected in ((1, 1, ["a", "b"]), (1, 1, []), (1, 2, ["b"]), (2, 2, ["a", "b"])):
        runs.clear()
        journal = Journal(tmp_path, print)
        stage(journal, "a", first)
        stage(journal, "b", second)
        assert runs == expected
    (tmp_path / "b").unlink()
    runs.clear()
    journal = Journal(tmp_path, print)
    stage(journal, "a", 2)
    stage(journal, "b", 2)
    assert runs == ["b"]


def test_stages_after_one_that_ended_otherwise_run_again(tmp_path: Path) -> None:
    """The search that was cut short finds more in the next run: the adjustment must not be that of the first one's model."""
    runs: list[str] = []

    def go(models: str, unfinished: bool) -> None:
        def search() -> dict[str, object]:
            (tmp_path / "images.bin").write_text(models)
            return {UNFINISHED: unfinished}

        def adjust() -> dict[str, object]:
            runs.append((tmp_path / "images.bin").read_text())
            return {}

        journal = Journal(tmp_path, print)
        journal.stage("mapping", {}, ["images.bin"], search)
        journal.stage("adjustment", {}, [], adjust)

    for models, unfinished in (("three", True), ("three", True), ("nine", False), ("nine", False)):
        go(models, unfinished)
    assert runs == ["three", "nine"]


def test_journal_repeats_warnings_and_sees_flipped_bytes(tmp_path: Path) -> None:
    runs: list[str] = []
    outputs = ["a.tif", "images.bin"]

    def run_once() -> list[str]:
        warned: list[str] = []
        journal = Journal(tmp_path, lambda level, message: warned.append(f"{level} {message}"))

        def run() -> dict[str, object]:
            runs.append("a")
            journal.log("info", "nothing")
            journal.log("warning", "blurred")
            for name in outputs:
                (tmp_path / name).write_bytes(b"1234")
            return {"kept": 1}

        assert journal.stage("a", {}, outputs, run) == {"kept": 1}
        assert journal.times["a"]["seconds"] >= 0
        return warned

    assert run_once() == ["info nothing", "warning blurred"]
    assert run_once() == ["warning blurred"] and runs == ["a"]
    for count, name in enumerate(outputs, start=2):
        (tmp_path / name).write_bytes(b"1294")
        run_once()
        assert runs == ["a"] * count


def test_journal_discards_a_stage_whose_photos_changed_meanwhile(tmp_path: Path) -> None:
    photo = tmp_path / "photo.jpg"
    photo.write_bytes(b"first")
    runs: list[bytes] = []

    def run_once(then: bytes) -> None:
        journal = Journal(tmp_path / "work", print)
        hashes = journal.watch({"photo": photo})

        def run() -> dict[str, object]:
            runs.append(photo.read_bytes())
            photo.write_bytes(then)
            (tmp_path / "work/model.bin").write_bytes(runs[-1])
            return {}

        journal.stage("a", hashes, ["model.bin"], run)

    with pytest.raises(package.InputError, match="photo.jpg was changed while it was read"):
        run_once(b"other")
    photo.write_bytes(b"first")
    run_once(b"first")
    run_once(b"first")
    assert runs == [b"first", b"first"], "what was read when the photo changed counts for neither"


def test_photos_are_listed_in_natural_order_and_excluded_by_pattern(tmp_path: Path) -> None:
    for name in ("p_10.png", "p_9.png", "sub/p_1.png", "blurred_1.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        _core.write_png(str(tmp_path / name), np.zeros((8, 12), np.uint8))
    photos = list_photos(tmp_path, ["blurred_*"])
    assert [photo.name for photo in photos] == ["p_9.png", "p_10.png", "sub/p_1.png"]
    assert (photos[0].width, photos[0].height) == (12, 8)


def test_photos_of_other_formats_are_counted(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.png", "c.tif", "h_blurred.jpg"):
        Image.fromarray(np.zeros((8, 12), np.uint8)).save(tmp_path / name)
    others = ("a.NEF", "d.nef", "sub/e.HEIC", "f.webp", "notes.txt", ".hidden.nef", "masks/g.webp", "g_blurred.nef")
    for name in others:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    said = {"folder": str(tmp_path), "exclude": ["*_blurred*"], "masks": None}
    warnings: list[str] = []
    photos = photo_cameras.enough_photos_of(said, lambda _, message: warnings.append(message))
    assert [photo.name for photo in photos] == ["a.jpg", "b.png", "c.tif"]
    # a.NEF lies beside its JPEG.
    assert warnings == ["[photos]: 4 files (.heic, .nef, .webp) cannot be read as photos, expected PNG, TIFF or JPEG"]
    (tmp_path / "c.tif").unlink()
    with pytest.raises(package.DataError, match=r"has 2 photos, .*; 4 files \(\.heic, \.nef, \.webp\) cannot be read"):
        photo_cameras.enough_photos_of(said, lambda *_: None)


def test_masks_of_photos_are_found_by_their_names(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.jpg", "c.jpg", "sub/d.jpg", "e.jpg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        Image.fromarray(np.zeros((8, 12), np.uint8)).save(tmp_path / name)
    masks = tmp_path / "masks"
    for name in ("a.jpg.png", "b.png", "c_mask.png", "sub/d.jpg.mask.png"):
        (masks / name).parent.mkdir(exist_ok=True, parents=True)
        _core.write_png(str(masks / name), np.full((8, 12), 255, np.uint8))
    said = {"folder": str(tmp_path), "exclude": [], "masks": str(masks)}
    found = {photo.name: photo.mask for photo in photos_of(said)}
    assert found == {
        "a.jpg": masks / "a.jpg.png", "b.jpg": masks / "b.png", "c.jpg": masks / "c_mask.png", "e.jpg": None,
        "sub/d.jpg": masks / "sub/d.jpg.mask.png",
    }  # fmt: skip
    _core.write_png(str(masks / "e.png"), np.full((8, 11), 255, np.uint8))
    with pytest.raises(package.InputError, match="e.png: is 11 x 8 pixels, expected 12 x 8 as e.jpg"):
        photos_of(said)
    _core.write_png(str(masks / "e.png"), np.full((12, 8), 255, np.uint8))
    with pytest.raises(package.InputError, match="e.png: is 8 x 12 pixels.*EXIF orientation is ignored"):
        photos_of(said)
    _core.write_png(str(masks / "b.png"), np.full((9, 12), 255, np.uint8))
    with pytest.raises(package.InputError, match="b.png: is 12 x 9 pixels, .*; .*e.png: is 8 x 12 pixels"):
        photos_of(said)
    empty = tmp_path / "none"
    empty.mkdir()
    with pytest.raises(package.InputError, match="has no mask of any photo, expected for example a.jpg.png"):
        photos_of({**said, "masks": str(empty), "exclude": ["*.png"]})


def test_masks_of_no_photo_are_named(photo_station: Path, fake_colmap: Path) -> None:
    """A mask whose name was mistyped was left out in silence, and its photo counted as one without a mask."""
    masks = photo_station.parent / "views/masks"
    masks.mkdir()
    for name in ("view 0.jpg.png", "view 1_mask.png", "view 2.png", "view 3.jpg.png"):
        Image.new("L", (96, 64), 255).save(masks / name)
    edit(photo_station, 'folder = "views"', 'folder = "views"\nmasks = "views/masks"\nexclude = ["view 3.jpg"]')

    def said() -> str:
        outcome = malus_here("check", photo_station)
        assert outcome.code == 0, outcome
        return " ".join((outcome.out + outcome.err).split())

    assert "of no photo" not in said()
    (masks / "view 2.png").rename(masks / "view_2.png")
    expected = (
        "[photos] masks: view_2.png: is the mask of no photo, expected a name such as view 0.jpg.png for view 0.jpg"
    )
    assert expected in said()


@pytest.mark.parametrize("rich_first", [True, False])
def test_photos_are_searched_at_twice_their_size_only_if_they_lack_features(tmp_path: Path, rich_first: bool) -> None:
    """Photos of coarse noise have many features, a photo of spots has few; the largest 500 of each are kept."""
    noise = np.kron(np.random.default_rng(4).normal(128, 40, (2, 80, 100)), np.ones((1, 5, 5)))
    v, u = np.mgrid[:400, :500]
    spots = 255 * np.exp(-((u % 100 - 50.0) ** 2 + (v % 100 - 50.0) ** 2) / 18)
    pixels = {"noise 1.png": noise[0], "noise 2.png": noise[1], "spots.png": spots}
    bench = Bench(
        Colmap(2, "program"), tmp_path, Journal(tmp_path, print), package.Options(photos={"max_features": 500}), lambda *_: None, print,
    )  # fmt: skip
    bench.images.mkdir()
    for name, image in pixels.items():
        _core.write_png(str(bench.images / database.quoted(name)), np.clip(image, 0, 255).astype(np.uint8))
    names = list(pixels) if rich_first else list(pixels)[::-1]
    find_features(bench, "features", tmp_path / "adaptive.db", names, {"camera_model": "OPENCV"})

    def direct(octave: int) -> dict[str, int]:
        target = tmp_path / f"{octave}.db"
        _search(bench, "features", target, names, {"camera_model": "OPENCV"}, octave)
        return database.feature_counts(target)

    found, original, doubled = database.feature_counts(tmp_path / "adaptive.db"), direct(0), direct(-1)
    assert found["spots.png"] == doubled["spots.png"]
    assert original["noise 1.png"] != doubled["noise 1.png"]
    assert found["noise 1.png"] == (original if rich_first else doubled)["noise 1.png"]
    with closing(sqlite3.connect(tmp_path / "adaptive.db")) as base:
        assert base.execute("SELECT DISTINCT camera_id FROM images").fetchall() == [(1,)]
        assert base.execute("SELECT COUNT(*) FROM cameras").fetchone() == (1,)


def write_features(file: Path, points: dict[str, NDArray[np.floating]]) -> None:
    """A database of COLMAP's with keypoints (N×6) by image; all values of a descriptor are its keypoint's number."""
    with closing(sqlite3.connect(file)) as base, base:
        base.executescript(
            "CREATE TABLE images (image_id INTEGER PRIMARY KEY, name TEXT, camera_id INTEGER);"
            "CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB);"
            "CREATE TABLE descriptors (image_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, data BLOB);"
        )
        for number, (name, some) in enumerate(points.items(), 1):
            descriptors = np.repeat(np.arange(len(some), dtype=np.uint8), 128)
            base.execute("INSERT INTO images VALUES (?, ?, 1)", (number, name))
            base.execute(
                "INSERT INTO keypoints VALUES (?, ?, 6, ?)", (number, len(some), some.astype(np.float32).tobytes())
            )
            base.execute("INSERT INTO descriptors VALUES (?, ?, 128, ?)", (number, len(some), descriptors.tobytes()))


def test_features_outside_a_mask_do_not_count(tmp_path: Path) -> None:
    """COLMAP's coordinates: the first pixel reaches from 0 to 1."""
    file = tmp_path / "features.db"
    keypoints = np.array([[0.9, 0.9], [1.1, 0.9], [2.5, 1.5], [4.0, 2.0]], np.float32)
    points = np.hstack([keypoints, np.ones((4, 4), np.float32)])
    write_features(file, {"view%201.jpg": points, "other.jpg": points, "plain.jpg": points[:0]})
    mask = np.zeros((2, 4), np.uint8)
    mask[0, 1] = mask[1, 3] = 255
    for name in ("view 1.jpg", "plain.jpg", "none.jpg"):
        database.keep_features(file, name, 4, mask)
    assert database.feature_counts(file) == {"view 1.jpg": 2, "other.jpg": 4, "plain.jpg": 0}
    kept = database.read_descriptors(file)
    assert kept["view 1.jpg"][:, 0].tolist() == [1, 3] and len(kept["other.jpg"]) == 4
    with closing(sqlite3.connect(file)) as base:
        (data,) = base.execute("SELECT data FROM keypoints WHERE image_id = 1").fetchone()
    np.testing.assert_array_equal(np.frombuffer(data, np.float32).reshape(2, 6), points[[1, 3]])
    database.keep_features(file, "other.jpg", 4, np.zeros((2, 4), np.uint8))
    assert database.feature_counts(file)["other.jpg"] == 0


def test_no_more_features_are_kept_than_asked_for(tmp_path: Path) -> None:
    """The largest ones inside the mask, in their order. A feature's four last numbers are an affine shape."""
    file = tmp_path / "features.db"
    sizes = np.array([3, 1, 4, 1.5, 5, 2], np.float32)
    places = np.column_stack([np.arange(6) + 0.5, np.full(6, 0.5)])
    # Turned by 30 degrees, and by 90, where all of the scale is off the diagonal.
    turn = np.radians([30, 30, 30, 30, 90, 90])
    shapes = sizes[:, None] * np.column_stack([np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)])
    write_features(file, {"all.jpg": np.hstack([places, shapes]), "masked.jpg": np.hstack([places, shapes])})
    database.keep_features(file, "all.jpg", 3)
    database.keep_features(file, "masked.jpg", 3, np.array([[1, 1, 1, 1, 0, 1]], np.uint8))
    kept = database.read_descriptors(file)
    assert kept["all.jpg"][:, 0].tolist() == [0, 2, 4]
    assert kept["masked.jpg"][:, 0].tolist() == [0, 2, 5]
    assert database.feature_counts(file) == {"all.jpg": 3, "masked.jpg": 3}


@pytest.mark.parametrize("turntable", [True, False])
def test_masks_hide_the_background_on_a_turntable_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, turntable: bool
) -> None:
    photos = []
    for name in ("a.png", "b.png"):
        _core.write_png(str(tmp_path / name), np.full((8, 12), 255, np.uint8))
        photos.append(Photo(name, tmp_path / name, 12, 8, mask=tmp_path / name if name == "a.png" else None))
    hidden: list[tuple[str, int, int | None]] = []
    monkeypatch.setattr(photo_cameras, "find_features", lambda *_: None)
    monkeypatch.setattr(
        database,
        "keep_features",
        lambda _, name, most, mask: hidden.append((name, most, None if mask is None else int((mask != 0).sum()))),
    )
    monkeypatch.setattr(database, "feature_counts", lambda _: {"a.png": 300, "b.png": 300})
    journal = Journal(tmp_path, print)
    bench = Bench(None, tmp_path, journal, package.Options(), print, print, turntable)  # type: ignore[arg-type]
    photo_cameras._find_features(bench, photo_cameras.group_by_camera(photos, None))
    assert hidden == [("a.png", 8192, 96 if turntable else None), ("b.png", 8192, None)]
    assert list(photo_cameras._masks(bench, photos)) == (["masks"] if turntable else [])


def test_a_turntable_with_few_features_is_not_told_to_put_texture_around_the_object() -> None:
    with pytest.raises(package.DataError, match="only features inside the masks count on a turntable"):
        diagnosis.check_features({"a": 3, "b": 4}, print, inside_masks=True)
    with pytest.raises(package.DataError, match="place texture around the object"):
        diagnosis.check_features({"a": 3, "b": 4}, print)


def test_masks_beside_the_photos_or_above_them_are_no_photos(tmp_path: Path) -> None:
    views = tmp_path / "views"
    for name in ("a.jpg", "a.jpg.mask.png", "b.png", "b_mask.png", "sub/c.jpg", "sub/c.jpg.png", "d.jpg"):
        (views / name).parent.mkdir(parents=True, exist_ok=True)
        _core.write_png(str(views / name), np.zeros((8, 12), np.uint8))
    names = ["a.jpg", "b.png", "d.jpg", "sub/c.jpg"]
    photos = list_photos(views, [], views)
    assert [photo.name for photo in photos] == names
    masks = [photo.mask and photo.mask.name for photo in with_masks(photos, views)]
    assert masks == ["a.jpg.mask.png", "b_mask.png", None, "c.jpg.png"]
    assert set(names) < {photo.name for photo in list_photos(views, [], tmp_path)}


def test_pictures_of_results_below_the_photos_are_no_photos(tmp_path: Path) -> None:
    made = (
        "work/report/figures/depth.png",
        "batch/stations/a/p.tif",
        "object/photogrammetry/images/p.jpg",
        "station-check.png",
    )
    for name in ("p.jpg", "sub/q.jpg", "iiif/q.jpg", *made):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        _core.write_png(str(tmp_path / name), np.zeros((8, 12), np.uint8))
    (tmp_path / "work/manifest.json").write_text('{"steps": {}}')
    (tmp_path / "iiif/manifest.json").write_text('{"items": []}')
    (tmp_path / "batch/campaign.json").write_text("{}")
    (tmp_path / "object/photogrammetry/features.db").touch()
    assert [photo.name for photo in list_photos(tmp_path, [])] == ["iiif/q.jpg", "p.jpg", "sub/q.jpg"]


def test_a_search_for_another_model_has_the_whole_time_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(photo_cameras.time, "monotonic", lambda: now)
    gone_on: list[bool] = []

    class Mapper:
        threads = 1

        def run(self, *_: object, on_line: Callable[[str], None], keep_going: Callable[[], bool]) -> None:
            nonlocal now
            first = ["Finding good initial image pair", *(f"Registering image #{i} ({i})" for i in range(2, 5))]
            for after, lines in ((25, first), (500, first[:1]), (29, ()), (2, ())):
                now += after
                for line in lines:
                    on_line(line)
                gone_on.append(keep_going())
            raise SearchStoppedError

    bench = Bench(Mapper(), tmp_path, Journal(tmp_path, print), package.Options(), lambda *_: None, print)  # type: ignore[arg-type]
    photos = [Photo(f"{i}.jpg", tmp_path, 12, 8) for i in range(4)]
    groups = photo_cameras.group_by_camera(photos, None)
    assert photo_cameras._run_mapper(bench, tmp_path / "a.db", 0, groups, 4, False) == ({}, True)
    assert gone_on == [True, True, True, False]


def test_a_search_that_ran_out_of_time_is_not_remembered(tmp_path: Path) -> None:
    runs: list[bool] = []
    for stopped in (True, False, False):
        journal = Journal(tmp_path, print)
        journal.stage("mapping", {}, [], lambda stopped=stopped: runs.append(stopped) or {UNFINISHED: stopped})  # type: ignore[misc]
    assert runs == [True, False]


@pytest.mark.parametrize(
    ("attempts", "unfinished"),
    [
        ([(0, False), (0, True), (0, False)], True),
        ([(3, False), (0, True), (0, False)], True),  # a search that was cut short might have found more
        ([(0, True), (6, False)], False),
        ([(3, True), (0, False), (0, False)], False),
    ],
)
def test_a_search_that_any_assumed_lens_left_unfinished_is_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, attempts: list[tuple[int, bool]], unfinished: bool
) -> None:
    """Attempts: number of photos in the model (0 = no model), and whether the time of a search ran out."""
    photos = [Photo(f"{i}.jpg", tmp_path, 12, 8) for i in range(6)]
    names = [photo.name for photo in photos]
    results = iter([({"0": names[:count]} if count else {}, stopped) for count, stopped in attempts])
    monkeypatch.setattr(photo_cameras, "_run_mapper", lambda *_: next(results))
    for name in ("copy", "set_camera", "camera_of"):
        monkeypatch.setattr(photo_cameras.database, name, lambda *_: 1)
    groups = photo_cameras.group_by_camera(photos, None)
    pairs = dict.fromkeys(itertools.pairwise(names), 50)
    found = photo_cameras._map(SimpleNamespace(folder=tmp_path), groups, pairs, sparing=False)  # type: ignore[arg-type]
    assert found[UNFINISHED] == unfinished


@pytest.mark.parametrize(
    ("mapping", "ran_out", "said", "unsaid"),
    [
        ({"assumed": 3, "calibrated": False}, False, "3 assumptions on the unknown focal length", "search_limit_s"),
        ({"assumed": 3, "calibrated": False}, True, "ran out of time.*photos.search_limit_s", "Check"),
        ({"assumed": 0, "calibrated": True}, False, r"Check \[photos\] camera", "EXIF"),
        ({"assumed": 0, "calibrated": False}, False, "EXIF focal length that is not theirs", "Check"),
    ],
)
def test_why_there_is_no_model_of_the_photos(mapping: dict[str, Any], ran_out: bool, said: str, unsaid: str) -> None:
    with pytest.raises(package.DataError, match=said) as caught:
        diagnosis.check_mapping({"best": None, **mapping}, ["a", "b"], {}, print, ran_out=ran_out)
    assert unsaid not in str(caught.value) and "no first pair fixes the geometry" in str(caught.value)


def test_no_photo_has_the_name_of_a_stations_image(tmp_path: Path) -> None:
    """One named malus_station.png, as in the folder of an earlier run, ended in "COLMAP's database is damaged"."""
    for name in ("malus_station.png", "malus_station_0.png", STATION_IMAGE, station_image(0)):
        Image.new("L", (96, 64)).save(tmp_path / name)
    assert [photo.name for photo in list_photos(tmp_path, [])] == ["malus_station.png", "malus_station_0.png"]


def test_warnings_call_the_stations_of_an_object_by_their_names() -> None:
    """They named malus_station_1.png, an image that no user made."""
    told: list[str] = []
    bench = SimpleNamespace(log=lambda _, message: told.append(message))
    views = {station_image(1): StationView(np.zeros((2, 3), np.float32), None, title="station left")}
    figures = {"status": "converged", "with_few_matches": ["a.jpg", station_image(1)], "lens_sigma": []}
    window_matching._warn(bench, figures, views)  # type: ignore[arg-type]
    assert len(told) == 1 and "too few windows in a.jpg, station left: " in told[0]


def test_a_given_lens_that_is_not_the_one_of_the_images_is_doubted() -> None:
    """With a calibration 30 % off, a run ended without a word, and its cameras stood a third of their distance away."""

    def doubts(photos: tuple[float, float], station: tuple[float, float], status: str = "converged") -> list[str]:
        images = {"a%20b.jpg": photos, STATION_IMAGE: station}
        focal = {name: given for name, (given, _) in images.items()}

        def refined(lenses: dict[str, str]) -> dict[str, Any]:
            assert lenses == dict.fromkeys(images, "without_principal_point")
            focal.update({name: found for name, (_, found) in images.items()})
            return {"status": status, "lens_sigma": {"a%20b.jpg": [0.24, 0.24], STATION_IMAGE: [2.4, 2.4]}}

        def values() -> dict[str, Any]:
            return {name: (("PINHOLE", 3, 2, [px, px, 1, 1], None, None), 0, 0) for name, px in focal.items()}

        model = SimpleNamespace(images=values)
        compared = window_matching._compared(model, list(images), refined)  # type: ignore[arg-type]
        told: list[str] = []
        bench = SimpleNamespace(log=lambda _, message: told.append(message))
        views = {
            STATION_IMAGE: StationView(np.zeros((2, 3), np.float32), package.Camera("PINHOLE", 3, 2, [5, 5, 1, 1]))
        }
        figures = {"status": "converged", "with_few_matches": [], "lens_sigma": [], "given_lenses": compared}
        window_matching._warn(bench, figures, views)  # type: ignore[arg-type]
        return told

    assert doubts((1080, 1077), (1290, 1280)) == []
    (doubt,) = doubts((1184, 1077), (1290, 1280))
    assert doubt.startswith(
        "[photos].camera has a focal length of 1184 px, but the images show one of 1077 px (± 0.24 px)"
    )
    (doubt,) = doubts((1080, 1077), (1290, 1250))
    assert doubt.startswith("[camera] of the station has a focal length of 1290 px")
    assert doubts((1184, 1077), (1290, 1250), "not converged") == []


def test_each_photo_that_is_left_out_is_named_once_with_its_cause() -> None:
    """A stray photo was said to have nothing in common with the others, and to have no position for lack of matches."""
    linked = [*itertools.combinations("abcde", 2), *itertools.combinations("xyz", 2)]
    mapping = {"best": "0", "models": {"0": ["a", "b", "c"], "1": ["x", "y", "z"], "2": ["c", "d"]}}
    told: list[str] = []
    diagnosis.check_mapping(
        mapping,
        [*"abcdexyz", "stray"],
        dict.fromkeys(linked, 50),
        lambda _, message: told.append(message),
        ran_out=False,
    )
    expected = ("x, y, z: nothing in common", "stray: nothing in common with the other 5", "d are left out", "for e:")
    assert len(told) == len(expected)
    for words, warning in zip(expected, told, strict=True):
        assert words in warning


@pytest.mark.parametrize(("photos_of_lenses", "freed"), [([6], True), ([5], False), ([6, 5], False)])
def test_a_principal_point_is_adjusted_if_enough_photos_of_its_lens_have_a_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, photos_of_lenses: list[int], freed: bool
) -> None:
    """However many photos were given."""
    images = {
        f"{lens}_{number}.jpg": SimpleNamespace(camera_group=(lens,))
        for lens, count in enumerate(photos_of_lenses)
        for number in range(count)
    }
    model = SimpleNamespace(images=images)
    monkeypatch.setattr(photo_cameras.SparseModel, "read", lambda _: model)
    said: list[dict[str, bool]] = []
    bench = SimpleNamespace(folder=tmp_path, report=lambda *_: None, adjust=lambda *_, **how: said.append(how))
    photo_cameras._adjust(bench, "sparse", False)  # type: ignore[arg-type]
    assert said == [{"lens": True, "principal_point": freed}]
    solved = SimpleNamespace(calibrated=False, model=model)
    free = window_matching._freedom(solved, {}, model)  # type: ignore[arg-type]
    assert [how == "all" for how in free.values()] == [count >= 6 for count in photos_of_lenses]


def test_a_photo_with_brackets_in_its_name_is_excluded_by_its_name(tmp_path: Path) -> None:
    for name in ("p_1.png", "p_1 [edited].png", "sub/p_2 [edited].png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        _core.write_png(str(tmp_path / name), np.zeros((8, 12), np.uint8))
    photos = list_photos(tmp_path, ["p_1 [edited].png", "sub/p_2 [edited].png"])
    assert [photo.name for photo in photos] == ["p_1.png"]


@pytest.mark.parametrize("of_photo", ["NFC", "NFD"])
def test_accents_of_names_are_alike_however_they_are_written(tmp_path: Path, of_photo: Literal["NFC", "NFD"]) -> None:
    """The photos of a Mac were not found by the names that one types elsewhere, and had no masks."""
    other: Literal["NFC", "NFD"] = "NFD" if of_photo == "NFC" else "NFC"
    for name in ("Büste é1.png", "Büste é2.png"):
        _core.write_png(str(tmp_path / unicodedata.normalize(of_photo, name)), np.zeros((8, 12), np.uint8))
    mask = tmp_path / "masks" / unicodedata.normalize(other, "Büste é1_mask.png")
    mask.parent.mkdir()
    _core.write_png(str(mask), np.full((8, 12), 255, np.uint8))
    said = {"folder": str(tmp_path), "exclude": [unicodedata.normalize(other, "*é2.png")], "masks": str(mask.parent)}
    assert [photo.mask for photo in photos_of(said)] == [mask]
    assert stray_masks(said) == []


def test_a_photo_whose_name_is_not_utf8_is_named(tmp_path: Path) -> None:
    _core.write_png(str(tmp_path / "p.png"), np.zeros((8, 12), np.uint8))
    (tmp_path / "p.png").rename(tmp_path / os.fsdecode(b"B\xfcste.png"))
    with pytest.raises(package.InputError, match=r"B\\xfcste.png: this name is not in UTF-8"):
        list_photos(tmp_path, [])
    assert list_photos(tmp_path, ["B*ste.png"]) == []


def test_names_of_all_scripts_fit_into_colmaps_files() -> None:
    for name in ("国" * 80 + ".jpg", "Я" * 120 + ".jpg", "a b%20\u2028c\u3000d/\u00e9 1².png"):
        quoted = database.quoted(name)
        assert database.unquoted(quoted) == name
        assert len(quoted.encode()) <= 255 and len(quoted.split()) == 1 == len(quoted.splitlines())


@pytest.mark.parametrize(
    ("calibrated", "lens", "found", "adjusted"), [(True, False, 1, 0), (False, False, 1, 1), (True, True, 0, 0)]
)
def test_a_calibrated_lens_of_the_photos_is_not_adjusted(
    calibrated: bool, lens: bool, found: int, adjusted: int
) -> None:
    """Not for a station of unknown lens either, whose own lens is sought."""
    known = package.Camera("PINHOLE", 3, 2, [5.0, 5.0, 1.0, 0.5]) if lens else None
    view = station_pose.StationView(np.zeros((2, 3), np.float32), known)
    mapper, adjustment = station_pose._lens_options({"station.png": view}, calibrated)
    assert set(mapper.values()) == {found}
    assert adjustment == adjusted


def test_a_dictionary_of_targets_that_is_not_known_is_named() -> None:
    with pytest.raises(package.InputError, match='dictionary = "aruco_4x4" is not known; did you mean aruco_4x4_50'):
        _core.detect_targets(np.zeros((16, 16), np.uint8), "aruco_4x4")


def test_a_target_that_a_photo_shows_twice_is_not_taken_from_it(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = {"a": [(3, 10.0, 20.0), (3, 500.0, 90.0), (7, 30.0, 40.0)], "b": [(3, 11.0, 21.0)]}
    monkeypatch.setattr(scale, "read_gray", lambda path: path.name)
    monkeypatch.setattr(scale, "to_bytes", lambda name, gamma: name)
    monkeypatch.setattr(scale, "_core", SimpleNamespace(detect_targets=lambda name, dictionary: seen[name]))
    photos = [Photo(name, Path(name), 640, 480) for name in seen]
    assert scale.find_targets(photos, "aruco_4x4_50") == {7: [("a", 30.0, 40.0)], 3: [("b", 11.0, 21.0)]}


def test_distances_that_cannot_give_a_size_are_refused_before_the_photos_are_matched() -> None:
    def bar(*images: str, **more: object) -> dict[str, object]:
        end = [{"image": image} for image in images]
        return {"a": end, "b": end, "targets": None, "targets_dictionary": None, "check": False} | more

    def require(*bars: dict[str, object]) -> None:
        scale.require_scale({"path": "s.toml", "scale": bars}, ["a.jpg", "b.jpg"])

    require()
    require(bar("a.jpg", "b.jpg", "station.jpg"), bar("a.jpg", "station.jpg"))
    require(bar(targets=[3, 7], targets_dictionary="aruco_4x4_50"))
    for bars, said in (
        ([bar("a.jpg", "station.jpg")], r"s\.toml: \[\[scale\]\]: no distance .* marks in station.jpg do not count"),
        ([bar("a.jpg", "b.jpg", check=True)], "no distance without check = true"),
    ):
        with pytest.raises(package.InputError, match=said):
            require(*bars)


def test_distances_that_contradict_each_other_are_refused() -> None:
    cameras = {
        name: image.camera
        for name, image in SparseModel.read(EXAMPLE / "sparse").images.items()
        if name in ("view_00.jpg", "view_03.jpg", "view_05.jpg", "view_08.jpg")
    }
    a, b, c = np.array([-60.0, -30, 0]), np.array([55.0, 35, 0]), np.array([50.0, -33, 0])

    def end(point: np.ndarray) -> list[dict[str, Any]]:
        marks = []
        for name, camera in cameras.items():
            rotation, translation = camera.pose()
            x = rotation @ point + translation
            fx, fy, cx, cy = camera.params[:4]
            marks.append({"image": name, "x": fx * x[0] / x[2] + cx, "y": fy * x[1] / x[2] + cy})
        return marks

    def bar(first: np.ndarray, second: np.ndarray, distance: float = 1.0) -> dict[str, Any]:
        ends: dict[str, Any] = {"a": end(first), "b": end(second), "targets": None, "check": False}
        return {**ends, "distance": distance * float(np.linalg.norm(first - second))}

    def adjust(*bars: dict[str, Any]) -> tuple[float, list[str]]:
        said: list[str] = []
        found = scale.adjust_scale(bars, [], cameras, package.Options(), lambda _, text: said.append(text))
        assert found is not None
        return found["scale"], said

    assert adjust(bar(a, b), bar(b, c)) == (pytest.approx(1, abs=1e-4), [])
    size, said = adjust(bar(a, b), bar(b, c, 1.03))
    assert abs(size - 1) < 0.02 and "disagree by" in said[0]
    exchanged = bar(a, b)
    exchanged["a"][1], exchanged["b"][1] = exchanged["b"][1], exchanged["a"][1]
    for wrong in ([bar(a, b), bar(b, c, 0.1)], [exchanged]):
        with pytest.raises(
            package.InputError, match=r"do not fit.*the worst mark is that of \[\[scale\]\] \d in view_0\d"
        ):
            adjust(*wrong)


def test_exif_gives_the_focal_length(tmp_path: Path) -> None:
    image = Image.new("L", (3000, 2000))
    exif = image.getexif()
    exif[0x0110] = "Camera"
    exif.get_ifd(0x8769)[0xA405] = 50
    image.save(tmp_path / "a.jpg", exif=exif)
    photo = list_photos(tmp_path, [])[0]
    assert photo.maker == "Camera"
    assert photo.focal_px == pytest.approx(50 / 43.27 * np.hypot(3000, 2000), rel=1e-3)


def test_a_resolution_of_another_size_of_a_photo_gives_no_focal_length(tmp_path: Path) -> None:
    """Programs that develop or resize photos keep it. With twice its focal length, taken as known, COLMAP finds no or a wrong model."""

    def focal_px(
        width: int, written: int, resolution: float, equivalent: int | None, focal_mm: float = 50
    ) -> float | None:
        image = Image.new("L", (width, width * 2 // 3))
        exif = image.getexif()
        detail = exif.get_ifd(0x8769)
        detail.update({0x920A: focal_mm, 0xA20E: resolution, 0xA210: 3, 0xA002: written, 0xA003: written * 2 // 3})
        if equivalent is not None:
            detail[0xA405] = equivalent
        image.save(tmp_path / "a.jpg", exif=exif)
        return list_photos(tmp_path, [])[0].focal_px

    resolution = 6000 / 3.6  # per centimeter, of a sensor of 36 mm
    whole, half = 50 / 36 * 6000, 50 / 36 * 3000
    assert focal_px(6000, 6000, resolution, 50) == pytest.approx(whole, rel=1e-3)
    assert focal_px(3000, 6000, resolution, 50) == pytest.approx(half, rel=1e-3)
    assert focal_px(3000, 3000, resolution, 50) == pytest.approx(half, rel=5e-3)  # it says the new size
    assert focal_px(3000, 6000, resolution, None) == pytest.approx(half, rel=1e-3)
    # As of a Fujifilm X-M1, in a TIFF that another program developed: the resolution is that of the RAW file's preview.
    assert focal_px(4896, 4896, 820, 38, 25.6) == pytest.approx(5167, rel=1e-3)


def test_marks_lie_in_their_photos() -> None:
    photos = [Photo("a.jpg", Path("a.jpg"), 600, 400)]

    def check(x: float, y: float, image: str = "a.jpg") -> None:
        mark = {"image": image, "x": x, "y": y}
        none: dict[str, object] = {"scale": [], "control": [], "path": "s.toml"}
        require_marks_in_photos({**none, "scale": [{"a": [], "b": [mark]}]}, photos)
        require_marks_in_photos({**none, "control": [{"name": "T1", "marks": [mark]}]}, photos)

    check(-0.5, 399.5)
    check(350, 560, "excluded.jpg")
    with pytest.raises(package.InputError, match=r"s.toml: \[\[scale\]\] 1: .*x = 350, y = 560 .* 600 x 400 .*EXIF"):
        check(350, 560)  # as in a viewer that turns the photo
    with pytest.raises(package.InputError, match=r"x = 601, y = 3 lies outside of a.jpg, which has 600 x 400 pixels$"):
        check(601, 3)
    with pytest.raises(package.InputError, match="pixels$"):
        check(-1, 3)  # outside of the turned photo, too


def test_marks_name_photos_however_accents_are_written() -> None:
    """Of a Mac's photos, they were in files that are not among the photos."""
    name = {"NFC": unicodedata.normalize("NFC", "Büste.jpg"), "NFD": unicodedata.normalize("NFD", "Büste.jpg")}
    photos = [Photo(name["NFD"], Path(name["NFD"]), 600, 400)]
    marks = [{"image": image, "x": 1, "y": 2} for image in (name["NFC"], "other.jpg")]
    said = {
        "path": "s.toml",
        "scale": [{"a": marks, "b": [], "check": True}],
        "control": [{"name": "A", "marks": marks}],
    }
    found = marks_in_files(said, photos)
    for of_table in (found["scale"][0]["a"], found["control"][0]["marks"]):
        assert of_table == [{**marks[0], "image": name["NFD"]}, marks[1]]
    assert found["scale"][0]["check"] and found["control"][0]["name"] == "A"


def test_a_zoom_lens_at_two_focal_lengths_is_two_lenses(tmp_path: Path) -> None:
    # A camera that writes the focal length alone, neither the size of its pixels nor the equivalent on 35 mm film.
    for name, focal_mm in (("a", 35.0), ("b", 35.0), ("c", 70.0)):
        image = Image.new("L", (30, 20))
        exif = image.getexif()
        exif[0x0110] = "Camera"
        exif.get_ifd(0x8769)[0x920A] = focal_mm
        image.save(tmp_path / f"{name}.jpg", exif=exif)
    photos = list_photos(tmp_path, [])
    assert [photo.focal_px for photo in photos] == [None] * 3
    groups = photo_cameras.group_by_camera(photos, None)
    assert [[photo.name for photo in group.photos] for group in groups] == [["a.jpg", "b.jpg"], ["c.jpg"]]


def test_two_bodies_of_one_model_are_two_cameras(tmp_path: Path) -> None:
    for name, serial in (("a", "0123"), ("b", "0123"), ("c", "0456")):
        image = Image.new("L", (30, 20))
        exif = image.getexif()
        exif[0x0110] = "Camera"
        exif.get_ifd(0x8769)[0xA431] = serial
        image.save(tmp_path / f"{name}.jpg", exif=exif)
    first, _, other = list_photos(tmp_path, [])
    groups = photo_cameras.group_by_camera(list_photos(tmp_path, []), None)
    assert [[photo.name for photo in group.photos] for group in groups] == [["a.jpg", "b.jpg"], ["c.jpg"]]
    assert first.maker == "Camera" and first.serial == "0123" and not first.may_share_lens(other)
    # A program that developed the station's images may have left the serial number out.
    assert first.may_share_lens(Photo("station", first.path, 30, 20, "Camera"))
    assert not first.may_share_lens(Photo("station", first.path, 30, 20, "Other"))


def test_photos_of_several_lenses_are_told() -> None:
    def photo(name: str, focal_mm: float | None, width: int = 60, height: int = 40) -> Photo:
        return Photo(name, Path(name), width, height, "" if focal_mm is None else "Camera", focal_mm=focal_mm)

    lens = package.Camera("PINHOLE", 60, 40, [70, 70, 30, 20])
    wide, tele = [photo(f"{k}.jpg", 35) for k in range(3)], [photo(f"{k}.jpg", 70) for k in range(7, 9)]
    assert photo_cameras.doubts_of_lenses([*wide, photo("edited.jpg", None)], lens) == []
    (doubt,) = photo_cameras.doubts_of_lenses([*wide, *tele], lens)
    assert "are of 2: Camera, 35 mm (0.jpg, 1.jpg, 2.jpg); Camera, 70 mm (7.jpg, 8.jpg)" in doubt
    (doubt,) = photo_cameras.doubts_of_lenses([*wide, *tele], None)
    assert "are of 2 cameras" in doubt and "7.jpg, 8.jpg share theirs" in doubt and "turned" not in doubt
    assert photo_cameras.doubts_of_lenses([*wide, *tele, photo("9.jpg", 70)], None) == []
    bodies = [replace(one, serial=f"n{k % 2}") for k, one in enumerate(wide)]
    assert (
        "Camera, n0, 35 mm (0.jpg, 2.jpg); Camera, n1, 35 mm (1.jpg)" in photo_cameras.doubts_of_lenses(bodies, lens)[0]
    )
    assert photo_cameras.doubts_of_lenses(tele, None) == []
    upright = photo("upright.jpg", 35, 40, 60)
    assert "turned when they were saved" in photo_cameras.doubts_of_lenses([*wide, upright], None)[0]
    with pytest.raises(package.InputError, match="40 x 60 pixels.*for 60 x 40; it was turned when it was saved"):
        photo_cameras.group_by_camera([*wide, upright], lens)
    with pytest.raises(package.InputError, match="leave the camera out"):
        photo_cameras.group_by_camera([*wide, photo("small.jpg", 35, 30, 20)], lens)


def test_a_photograph_that_is_there_twice_is_refused(photo_station: Path, fake_colmap: Path, tmp_path: Path) -> None:
    views = photo_station.parent / "views"
    assert malus_here("check", photo_station).code == 0
    shutil.copy(views / "view 0.jpg", views / "view 0 (1).jpg")
    for number in range(9):
        with Image.open(views / f"view {number % 3 + 1}.jpg") as image:
            image.save(views / f"view {number % 3 + 1}.{('tif', 'png', 'jpeg')[number // 3]}")
    for command in (("check", photo_station), ("run", photo_station, "-o", tmp_path / "work")):
        outcome = malus_here(*command)
        said = " ".join(outcome.err.split())
        assert outcome.code == 2 and "view 0 (1).jpg and view 0.jpg; view 1.jpeg and view 1.jpg;" in said
        assert "and 4 more are the same photographs" in said
    edit(photo_station, 'folder = "views"', 'folder = "views"\nexclude = ["* (1).jpg", "*.tif", "*.png", "*.jpeg"]')
    assert malus_here("check", photo_station).code == 0
    with (views / "view 3.jpg").open("r+b") as file:  # of the same length as its copy, and different at its end
        shutil.copy(views / "view 3.jpg", views / "other.jpg")
        file.seek(-3, os.SEEK_END)
        file.write(b"x")
    assert malus_here("check", photo_station).code == 0


def test_copies_are_stretched_to_the_full_range() -> None:
    values = np.linspace(0.1, 0.3, 10000, dtype=np.float32).reshape(100, 100)
    values[0, 0] = np.nan
    stretched = to_bytes(values, gamma=1.0)
    assert stretched.min() == 0
    assert stretched.max() == 255
    assert abs(int(stretched[50, 0]) - 127) <= 2


def test_pairs_of_many_photos_are_few() -> None:
    names = [str(k) for k in range(200)]
    pairs = photo_cameras.pairs_to_match(names, 80)
    assert len(pairs) == len(set(pairs)) < 3000
    assert ("0", "1") in pairs and ("3", "67") in pairs
    assert ("0", "199") in pairs and ("4", "194") in pairs and ("4", "193") not in pairs
    assert len(photo_cameras.pairs_to_match(names[:20], 80)) == 190


def test_groups_of_connected_photos() -> None:
    groups = database.connected_groups(["a", "b", "c", "d"], {("a", "b"): 20, ("b", "c"): 30})
    assert groups == [["a", "b", "c"], ["d"]]


METASHAPE = """<document version="1.5.0"><chunk><sensors><sensor id="0" label="cam" type="frame">
<resolution width="1000" height="800"/><calibration class="adjusted"><f>2000</f><cx>3.5</cx><cy>-2</cy><k1>-0.1</k1>
<p1>1e-3</p1><p2>2e-3</p2></calibration></sensor></sensors>
<cameras><camera id="0" label="a.jpg" sensor_id="0"><transform>1 0 0 1  0 1 0 2  0 0 1 3  0 0 0 1</transform></camera>
<camera id="1" label="unplaced" sensor_id="0"/></cameras>
<transform><rotation>0 -1 0 1 0 0 0 0 1</rotation><translation>10 20 30</translation><scale>2</scale></transform>
</chunk></document>"""


def test_metashape_cameras(tmp_path: Path) -> None:
    path = tmp_path / "cameras.xml"
    path.write_text(METASHAPE)
    cameras = read_metashape(path)
    assert list(cameras) == ["a.jpg"]
    camera = cameras["a.jpg"]
    rotation, translation = camera.pose()
    # The center (1, 2, 3) of the chunk, doubled, turned by 90° about z and moved.
    np.testing.assert_allclose(-rotation.T @ translation, [10 - 4, 20 + 2, 30 + 6], atol=1e-12)
    assert camera.params[:4] == [2000, 2000, 503.0, 397.5]
    assert list(camera.params[4:9]) == [-0.1, 0.0, 2e-3, 1e-3, 0.0]
    # Newer versions have the transform with the component that the camera belongs to.
    transform = METASHAPE[METASHAPE.index("<transform><rotation>") : METASHAPE.index("</chunk>")]
    components = f'<components><component id="0">{transform}</component><component id="1"/></components></chunk>'
    divided = METASHAPE.replace(transform, "").replace("</chunk>", components)
    path.write_text(divided.replace('sensor_id="0">', 'sensor_id="0" component_id="0">'))
    (in_component,) = read_metashape(path).values()
    for values, expected in zip(in_component.pose(), camera.pose(), strict=True):
        np.testing.assert_array_equal(values, expected)
    path.write_text(divided.replace('sensor_id="0">', 'sensor_id="0" component_id="1">'))
    rotation, translation = read_metashape(path)["a.jpg"].pose()
    np.testing.assert_allclose(-rotation.T @ translation, [1, 2, 3], atol=1e-12)
    path.write_text(METASHAPE.replace("<k1>", "<b2>0.5</b2><k1>"))
    with pytest.raises(package.InputError, match="b2"):
        read_metashape(path)
    coded = '<?xml version="1.0" encoding="{}"?><document></document>'
    for damaged in ("<document>", coded.format("none-such"), coded.format("shift_jis"), coded.format("hex")):
        path.write_text(damaged)
        with pytest.raises(package.InputError, match=r"cameras\.xml"):
            read_metashape(path)


@pytest.mark.skipif(shutil.which("colmap") is None, reason="COLMAP is not installed")
def test_real_colmap_finds_cameras_scale_and_prior(tmp_path: Path) -> None:
    """The demo station with six of its photos; scale from two points of the demo's own model. With pycolmap: test_control.py."""
    station, used = demo_with_photos(tmp_path / "station")
    truth = _core.ColmapModel.read(str(EXAMPLE / "sparse")).images()
    options = ("--set", "photos.max_features=1500", "--set", "photos.backend=colmap", *QUICK_WORDS)
    # The surface that the second sweep starts from need not be good.
    options += (
        "--set",
        "refine.iterations=1",
        "--set",
        "refine.more_iterations=0",
        "--threads",
        str(os.cpu_count() or 1),
    )
    outcome = malus("prior", station, "-o", tmp_path / "work", *options)
    assert outcome.code == 0, outcome
    model = _core.ColmapModel.read(str(tmp_path / "work" / "prior" / "colmap" / "model")).images()
    assert set(used) <= set(model)
    log = (tmp_path / "work" / "prior" / "colmap" / "features.log").read_text()
    assert "pycolmap_driver" not in log

    def centers(images: dict[str, tuple[package.photogrammetry.RegisteredImage, int, int]]) -> np.ndarray:
        return np.array([-np.array(images[n][0][4]).T @ images[n][0][5] for n in used])  # type: ignore[index]

    found, true = centers(model), centers(truth)
    spread = [np.linalg.norm(c - c.mean(axis=0)) for c in (found, true)]
    assert spread[0] / spread[1] == pytest.approx(1, abs=2e-3)
    again = malus_here("prior", station, "-o", tmp_path / "work", *options, "--json")
    steps = [json.loads(line) for line in again.out.splitlines()]
    assert any(step.get("message") == "kept from an earlier run" and step["step"] == "prior" for step in steps)
