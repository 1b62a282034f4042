"""Whatever the machine refuses and whatever files strangers name: an exit code of the table, a message, nothing that looks finished."""

from __future__ import annotations

import csv
import fcntl
import glob
import json
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngImageFile

from conftest import (
    Outcome,
    edit,
    half_written,
    malus,
    malus_here,
    malus_station,
    needs_plain_memory,
    turns_of_another_thread,
)
from malus import _core, _patterns
from malus._files import new_folder, read_record, replacing, scratch_folder, write_record
from malus._patterns import matching
from malus.batch import _as_text
from malus.encoding import Encoding, encoding_of
from malus.errors import InputError, ending_of
from malus.exif import tags_of
from malus.photogrammetry import exclusive
from malus.photogrammetry.photos import describe_photo, list_photos

MB = 1 << 20


def limited(kind: int, value: int) -> dict[str, Callable[[], None]]:
    """For run_program: the process gets at most so much."""
    return {"preexec_fn": lambda: resource.setrlimit(kind, (value, value))}


def run_both(*arguments: str | Path) -> list[Outcome]:
    return [malus("run", *arguments), malus_station(*arguments)]


@needs_plain_memory
@pytest.mark.parametrize("limit_mb", [150, 256, 320, 400, 480])
def test_a_limit_of_address_space_ends_a_run_and_the_next_one_finishes(
    small_station: Path, tmp_path: Path, limit_mb: int
) -> None:
    """OpenBLAS asks for its buffers forever when the system refuses, deaf to signals."""
    arguments = (small_station, "-o", tmp_path / "work", "--fusion", "grid", "--until", "prior", "--quiet")
    outcome = malus_station(*arguments, **limited(resource.RLIMIT_AS, limit_mb * MB))
    assert outcome.code in (0, 5), outcome
    assert outcome.code == 0 or "memory" in outcome.err
    assert not half_written(tmp_path)
    assert malus_station(*arguments).code == 0


@needs_plain_memory
def test_compressed_text_of_a_png_takes_no_memory(tmp_path: Path) -> None:
    """A few KB of it would be kept as megabytes."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    Image.new("L", (8, 6)).save(tmp_path / "plain.png")
    plain = (tmp_path / "plain.png").read_bytes()
    head = plain.index(b"IDAT") - 4
    text = chunk(b"zTXt", b"key\0\0" + zlib.compress(b"a" * (7 * MB)))
    (tmp_path / "text.png").write_bytes(plain[:head] + 16 * text + plain[head:])
    reads = (
        "import resource, sys; from malus import _core; before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss;"
        "_core.read_image_dn(sys.argv[1]); print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    done = subprocess.run(
        [sys.executable, "-c", reads, tmp_path / "text.png"], capture_output=True, text=True, check=True
    )
    assert int(done.stdout) << 10 < 32 * MB


@needs_plain_memory
def test_too_little_memory_to_start_is_said(small_station: Path) -> None:
    outcome = malus("check", small_station, **limited(resource.RLIMIT_AS, 300 * MB))
    assert (outcome.code, outcome.err.count("\n")) == (5, 1)
    assert "300 MB" in outcome.err


def test_libraries_that_found_no_room_are_said(
    finished_grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pillow leaves out a kind of image whose library cannot be loaded; saving one was then KeyError: 'WEBP'."""
    shutil.copytree(finished_grid, tmp_path / "work")
    Image.init()
    monkeypatch.delitem(Image.SAVE, "WEBP")
    outcome = malus_here("report", tmp_path / "work")
    assert outcome.code == 5 and "Pillow cannot write WEBP" in outcome.err and "report it" not in outcome.err
    lost = ImportError("libxcb.so.1: failed to map segment from shared object")
    assert ending_of(lost) == (5, "out of memory; see `malus check` for what the station needs")
    assert "report it" in ending_of(ImportError("libxcb.so.1: no such file"))[1]


def test_paths_that_cannot_be_used_are_no_lack_of_resources(tmp_path: Path) -> None:
    """Every error of the system that no one expected ended with exit code 5, out of disk or memory."""
    codes = {error.errno: ending_of(error)[0] for error in (FileNotFoundError(2, ""), PermissionError(13, ""))}
    assert codes == {2: 2, 13: 2}
    lacking = (OSError(28, "No space left on device"), BlockingIOError(11, "no more processes"), OSError("?"))
    assert [ending_of(error)[0] for error in lacking] == [5, 5, 5]
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="Not a directory"), exclusive(tmp_path / "file" / "below"):
        pass
    long = tmp_path / ("x" * 300)
    outcome = malus_here("run", tmp_path / "station.toml", "-o", tmp_path / "work", "--reference", long)
    assert outcome.code == 2 and long.name in outcome.err


def test_files_over_the_limit_of_size_are_like_a_full_disk(small_station: Path, tmp_path: Path) -> None:
    arguments = (small_station, "-o", tmp_path / "work", "--until", "polarization", "--quiet")
    outcome = malus_station(*arguments, **limited(resource.RLIMIT_FSIZE, 20_000))
    assert outcome.code == 5
    assert "File too large" in outcome.err
    assert not half_written(tmp_path)


def test_what_a_killed_run_had_begun_to_write_is_removed_by_the_next(small_station: Path, tmp_path: Path) -> None:
    for name in (".depth.tif.partial-1-2", "fused/.surface.partial-0a1b.ply"):
        path = tmp_path / "work" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"half")
    (tmp_path / "work/fused").rename(tmp_path / "fused")
    arguments = (small_station, "-o", tmp_path / "work", "--until", "polarization", "--quiet")
    assert malus_station(*arguments).code == 0
    (tmp_path / "fused").rename(tmp_path / "work/fused")
    assert malus_station(*arguments).code == 0
    assert not half_written(tmp_path)
    (tmp_path / "work/report").mkdir()
    (tmp_path / "work/report/.page.partial-0a1b.png").write_bytes(b"half")
    _core.forget_step(str(tmp_path / "work"), "report")  # as the next report begins
    assert not half_written(tmp_path)


def test_both_writers_name_unfinished_files_alike(tmp_path: Path) -> None:
    with replacing(tmp_path / "page.html") as temporary:
        temporary.write_text("x")
        assert half_written(tmp_path) == [temporary]


def test_a_run_that_does_not_end_by_itself_is_ended(small_station: Path, tmp_path: Path) -> None:
    """SIGALRM is what the program sends itself some time after SIGTERM."""
    program = Path(os.environ.get("MALUS_STATION", Path(__file__).parents[2] / "build/malus-station"))
    if not program.exists():
        pytest.skip(f"{program} is not built")
    run = subprocess.Popen([program, small_station, "-o", tmp_path / "work"], stderr=subprocess.PIPE, text=True)
    while not (tmp_path / "work/manifest.json").exists():
        time.sleep(0.01)
    run.send_signal(signal.SIGALRM)
    _, err = run.communicate(timeout=60)
    assert run.returncode == 130
    assert "did not end by itself" in err


@pytest.mark.parametrize(("ignored", "code"), [(False, 130), (True, 0)])
def test_a_shell_that_closes_ends_a_run_unless_told_not_to(
    small_station: Path, tmp_path: Path, ignored: bool, code: int
) -> None:
    arguments = (small_station, "-o", tmp_path / "work", "--quiet")
    program = Path(os.environ.get("MALUS_STATION", Path(__file__).parents[2] / "build/malus-station"))
    commands: list[list[str | Path]] = [[sys.executable, "-m", "malus.cli", "height", *arguments]]
    if program.exists():
        commands.append([program, *arguments, "--until", "height"])
    for command in commands:
        run = subprocess.Popen(
            command,
            stderr=subprocess.DEVNULL,
            preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL),
        )
        while not (tmp_path / "work/polarization/valid.png").exists():
            assert run.poll() is None
            time.sleep(0.01)
        run.send_signal(signal.SIGHUP)
        assert run.wait(300) == code
        shutil.rmtree(tmp_path / "work")


@pytest.mark.parametrize("pattern", ["/*/*/../*/../*/../*/../*", "*/../*/../*/../*/../*/../*/../*/../*"])
def test_patterns_that_go_through_the_whole_disk_end_soon(small_station: Path, tmp_path: Path, pattern: str) -> None:
    text = small_station.read_text()
    begin, end = text.index("images = ["), text.index("angles_deg")
    small_station.write_text(text[:begin] + f'images = "{pattern}"\n' + text[end:])
    for index in range(20):
        (small_station.parent / f"folder{index}").mkdir()
    for outcome in run_both(small_station, "-o", tmp_path / "work", "--quiet"):
        assert outcome.code == 2
        assert "[polarized].images" in outcome.err


@pytest.mark.parametrize("pattern", ["(" * 100_000, r"(\\d+)" + "a?" * 100_000, r"(a*)*(\\1)" * 1000])
def test_patterns_that_overflow_a_parser_are_refused(small_station: Path, tmp_path: Path, pattern: str) -> None:
    text = small_station.read_text()
    begin, end = text.index("images = ["), text.index("frames_averaged")
    small_station.write_text(text[:begin] + f'images = "pol"\nangle_pattern = "{pattern}"\n' + text[end:])
    for outcome in run_both(small_station, "-o", tmp_path / "work", "--quiet"):
        assert outcome.code == 2
        assert "angle_pattern" in outcome.err
        assert len(outcome.err) < 2000


@pytest.fixture
def within_a_minute() -> Iterator[None]:
    """Ends a test that waits for what never comes."""

    def end(*_: object) -> None:
        raise TimeoutError("still waiting after a minute")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("within_a_minute")
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_pipes_and_devices_are_no_files(small_station: Path, tmp_path: Path, kind: str) -> None:
    """A pipe without a writer would be waited for, and a device never ends."""
    path = tmp_path / "odd.toml"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    images, station = small_station.parent / "pol", tmp_path / "new.toml"
    for arguments in (
        ("check", path),
        ("check", small_station, "--options", path),
        ("batch", path, "-o", tmp_path / "out"),
        ("object", path, "-o", tmp_path / "out"),
        ("import", images, "--table", path, "-o", station),
        ("import", images, "--metashape", path, "--label", "a", "-o", station),
    ):
        outcome = malus_here(*arguments)
        assert (outcome.code, "not a regular file" in outcome.err) == (2, True), (arguments, outcome)
    assert tags_of(path) == {}


@pytest.mark.usefixtures("within_a_minute")
def test_links_in_a_circle_are_said(finished_grid: Path, small_station: Path, tmp_path: Path) -> None:
    (tmp_path / "circle").symlink_to("circle")
    circle, listed = tmp_path / "circle", tmp_path / "listed.toml"
    campaign, thing = (
        '[campaign]\nstations = ["circle"]\n',
        f'[object]\nstations = ["{small_station}"]\nreference = "circle"\n',
    )
    for text, arguments in (
        ("", ("check", circle)),
        ("", ("view", circle)),
        ("", ("compare", finished_grid, circle, "-o", tmp_path / "out")),
        (campaign, ("batch", listed, "-o", tmp_path / "out")),
        (thing, ("object", listed, "-o", tmp_path / "out")),
    ):
        listed.write_text(text)
        outcome = malus_here(*arguments)
        assert outcome.code == 2, (arguments, outcome)
        assert "circle" in outcome.err and "error of its own" not in outcome.err, (arguments, outcome)


def test_patterns_of_campaigns_find_what_a_shell_finds(tmp_path: Path) -> None:
    for name in ("a/station.toml", "a/b/station.toml", "a/b/.c/station.toml", ".d/station.toml", "[e]/f.toml"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    for pattern in (
        "*/station.toml",
        "**/station.toml",
        "**/*.toml",
        "a/**",
        "a/*/../b/*",
        ".*/*",
        "[[]e]/?.toml",
        "x/*",
    ):
        found = [path.relative_to(tmp_path).as_posix() for path in matching(tmp_path, pattern, "here")]
        expected = {Path(name).as_posix() for name in glob.glob(pattern, root_dir=tmp_path, recursive=True)}
        assert sorted(found) == sorted(expected), pattern
    assert matching(tmp_path, str(tmp_path / "a" / "*.toml"), "here") == [tmp_path / "a/station.toml"]


def test_patterns_pass_over_what_cannot_be_looked_at(tmp_path: Path) -> None:
    """A name that is too long, like one in a folder without permission, ended with an error of its own."""
    (tmp_path / "a").mkdir()
    assert matching(tmp_path, "*/" + "n" * 300, "here") == []


@pytest.mark.usefixtures("within_a_minute")
@pytest.mark.parametrize("pattern", ["*/../*/../*/../*/x", "**/**/**/x", "/**/x", "*/" * 2000, "\\u0000", "**/\\u0000"])
def test_patterns_of_campaigns_end_soon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pattern: str) -> None:
    monkeypatch.setattr(_patterns, "MOST_NAMES", 5000)
    for k in range(20):
        (tmp_path / f"folder{k}" / "in").mkdir(parents=True)
    (tmp_path / "folder0/in/out").symlink_to(tmp_path)
    (tmp_path / "campaign.toml").write_text(f'[campaign]\nstations = ["{pattern}"]\n')
    outcome = malus_here("batch", tmp_path / "campaign.toml", "-o", tmp_path / "out")
    assert outcome.code == 2 and "error of its own" not in outcome.err, outcome
    assert "campaign.stations" in outcome.err or "no file name has" in outcome.err, outcome


def test_folders_that_a_killed_writer_left_are_removed_by_the_next(tmp_path: Path) -> None:
    left, held, of_other = (tmp_path / f".{name}" for name in ("a.zip.partial-1", "a.zip.partial-2", "b.zip.partial-3"))
    for folder in (left, held, of_other):
        (folder / "deep").mkdir(parents=True)
        os.utime(folder, (0, 0))
    # A file that is open for writing: on NFS other machines see no lock of a folder.
    descriptor = os.open(held / ".lock", os.O_RDWR | os.O_CREAT)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    os.utime(held, (0, 0))
    with scratch_folder(tmp_path / "a.zip") as scratch:
        assert set(tmp_path.iterdir()) == {held, of_other, scratch}
        os.utime(scratch, (0, 0))
        with scratch_folder(tmp_path / "a.zip") as another:
            assert set(tmp_path.iterdir()) == {held, of_other, scratch, another}
    os.close(descriptor)
    assert set(tmp_path.iterdir()) == {held, of_other}


def test_the_working_folder_and_a_linked_one_can_be_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "linked").symlink_to(tmp_path / "out")
    monkeypatch.chdir(tmp_path / "out")
    for said in (Path(), tmp_path / "linked"):
        with new_folder(said, replace=True) as new:
            (new / "result").write_text(str(said))
        assert (tmp_path / "out/result").read_text() == str(said)
    assert (tmp_path / "linked").is_symlink() and len(list(tmp_path.iterdir())) == 2


def test_what_appears_in_place_of_a_new_folder_is_not_removed(tmp_path: Path) -> None:
    """An export takes minutes, in which others may use its folder."""
    with pytest.raises(InputError, match="out: cannot be written"), new_folder(tmp_path / "out") as new:
        (new / "result").write_text("result")
        (tmp_path / "out").mkdir()
        (tmp_path / "out/notes").write_text("mine")
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")] == ["out", "out/notes"]


def test_thousands_of_images_are_answered_soon(small_station: Path, tmp_path: Path) -> None:
    text = small_station.read_text()
    begin, end = text.index("images = ["), text.index("frames_averaged")
    small_station.write_text(text[:begin] + 'images = "many"\nangles_deg = "auto"\n' + text[end:])
    (small_station.parent / "many").mkdir()
    for index in range(10_000):
        (small_station.parent / f"many/{index}.png").touch()
    for outcome in run_both(small_station, "-o", tmp_path / "work", "--quiet"):
        assert (outcome.code, "at most 1000" in outcome.err) == (2, True), outcome


def test_names_that_are_not_utf8_are_refused(small_station: Path, tmp_path: Path) -> None:
    odd = Path(os.fsdecode(bytes(tmp_path) + b"/\xff\xe4"))
    try:
        small_station.parent.rename(odd)
    except OSError:
        pytest.skip("this file system has UTF-8 names only")
    for outcome in run_both(odd / "station.toml", "-o", tmp_path / "work", "--quiet"):
        assert (outcome.code, "UTF-8" in outcome.err) == (2, True), outcome
    odd.rename(tmp_path / "right")
    for outcome in run_both(tmp_path / "right/station.toml", "-o", odd, "--quiet"):
        assert (outcome.code, "UTF-8" in outcome.err) == (2, True), outcome


@pytest.mark.parametrize("what", ["deep", "notes"])
def test_a_damaged_manifest_is_said(small_station: Path, tmp_path: Path, what: str) -> None:
    arguments = (small_station, "-o", tmp_path / "work", "--until", "polarization", "--quiet")
    assert malus_station(*arguments).code == 0
    path = tmp_path / "work/manifest.json"
    if what == "deep":
        path.write_text('{"format": ' + "[" * 200_000 + "]" * 200_000 + "}")
        for outcome in run_both(small_station, "-o", tmp_path / "work", "--quiet"):
            assert (outcome.code, "manifest.json is damaged" in outcome.err) == (2, True), outcome
        return
    notes = path.read_text()
    assert '"warnings": []' in notes
    path.write_text(notes.replace('"warnings": []', '"warnings": ""'))
    outcome = malus_station(*arguments)
    assert (outcome.code, "manifest.json" in outcome.err) == (2, True), outcome


def test_another_coding_of_the_system_garbles_nothing(small_station: Path, tmp_path: Path) -> None:
    folder = tmp_path / "größe"
    small_station.parent.rename(folder)
    system = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    outcome = malus("check", folder / "station.toml", env=system, cwd=tmp_path)
    assert outcome.code == 0, outcome.err


def test_damaged_tags_are_no_tags(tmp_path: Path) -> None:
    for content in (b"II*\0", b"II*\0\x08", b"MM\0*\0\0\0\x08\xff\xff", b"\xff\xd8", b"\x89PNG", b""):
        (tmp_path / "image").write_bytes(content)
        assert tags_of(tmp_path / "image") == {}


def test_tags_of_a_png_are_found_without_its_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.png"
    exif = Image.Exif()
    exif[271] = "Maker"
    exif.get_ifd(34665)[33434] = 0.25
    Image.fromarray(np.arange(1200, dtype=np.uint16).reshape(30, 40)).save(path, exif=exif)
    monkeypatch.setattr(PngImageFile, "load", lambda _: pytest.fail("decoded"))
    before = tags_of(path)
    assert (before[271], before[33434]) == ("Maker", 0.25)
    content = path.read_bytes()
    start = content.index(b"eXIf") - 4
    end = start + 12 + int.from_bytes(content[start : start + 4], "big")
    path.write_bytes(content[:start] + content[end:-12] + content[start:end] + content[-12:])
    assert tags_of(path) == before
    path.write_bytes(content[:start] + content[end:])
    assert tags_of(path) == {}


def photo(path: Path, resolution_unit: object = 2) -> None:
    exif = Image.Exif()
    exif[271] = "Maker"
    exif.get_ifd(34665).update({37386: 50.0, 41486: 1000.0, 41488: resolution_unit})
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.zeros((30, 40), np.uint8)).save(path, exif=exif)


@pytest.mark.parametrize("unit", [2, 77, (1, 2), "cm"])
def test_an_odd_unit_of_resolution_is_inches(tmp_path: Path, unit: object) -> None:
    photo(tmp_path / "a.jpg", unit)
    focal_px = describe_photo(tmp_path / "a.jpg", "a.jpg").focal_px
    # (1, 2): the first of two values, which says that there is no unit.
    assert focal_px == pytest.approx(50 * 1000 / 25.4)


def test_tags_of_images_larger_than_pillow_opens(tmp_path: Path) -> None:
    Image.MAX_IMAGE_PIXELS, before = 100, Image.MAX_IMAGE_PIXELS
    try:
        photo(tmp_path / "a.jpg")
        assert tags_of(tmp_path / "a.jpg")[271] == "Maker"
        assert encoding_of(tmp_path / "a.jpg") == Encoding(False, "it is a JPEG file of a camera")
    finally:
        Image.MAX_IMAGE_PIXELS = before


def test_photos_below_a_hidden_folder_are_listed(tmp_path: Path) -> None:
    folder = tmp_path / ".archive" / "views"
    for name in ("1²2.jpg", "10.jpg", ".thumbnail.jpg", ".cache/9.jpg"):
        photo(folder / name)
    assert [photo.name for photo in list_photos(folder, [])] == ["1²2.jpg", "10.jpg"]


def test_cells_of_tables_are_no_formulas() -> None:
    assert [_as_text(text) for text in ("=1+1", "@x", "-2", "a=b", -2.0)] == ["'=1+1", "'@x", "'-2", "a=b", -2.0]


def test_a_station_named_like_a_formula_is_text_in_the_table(tiny_station: Path, tmp_path: Path) -> None:
    edit(tiny_station, 'name = "small"', 'name = "=HYPERLINK(1)"')
    (tmp_path / "campaign.toml").write_text(
        '[campaign]\nstations = ["station/station.toml"]\nreport = false\n[options]\nfusion = "grid"\n'
    )
    assert malus("batch", tmp_path / "campaign.toml", "-o", tmp_path / "out", "--quiet").code == 0
    with (tmp_path / "out/campaign.csv").open(newline="") as file:
        assert next(csv.DictReader(file))["name"] == "'=HYPERLINK(1)"
    marker = next((tmp_path / "out/done").iterdir())
    assert read_record(marker) is not None
    edit(marker, '"coverage": ', '"coverage": 1')
    assert read_record(marker) is None, "edited"


def test_records_are_read_as_they_were_written_only(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    write_record(path, {"a": [1, 2.5], "b": {10: None, 9: "x"}})
    assert read_record(path) == {"a": [1, 2.5], "b": {"10": None, "9": "x"}}
    for content in ("", "[]", "[" * 200_000, json.dumps({"a": 1}), path.read_text().replace("2.5", "3.5")):
        path.write_text(content)
        assert read_record(path) is None


def test_other_threads_run_while_files_are_read_and_written(tmp_path: Path) -> None:
    """A progress display and Studio's server stood still meanwhile."""
    raster = np.zeros((6000, 6000), np.float32)
    assert turns_of_another_thread(lambda: _core.write_float_tiff(str(tmp_path / "a.tif"), raster)) > 3
