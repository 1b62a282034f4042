"""COLMAP through the package pycolmap: choice of the backend, errors of its child process. test_photos.py runs the real package."""

from __future__ import annotations

import contextlib
import sqlite3
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest

import malus as package
from malus.photogrammetry import database, program, pycolmap_driver
from malus.photogrammetry.journal import Journal
from malus.photogrammetry.program import Colmap, SearchStoppedError, as_colmap_3

#: A stand-in for the package pycolmap; `mapper` does what the environment variable FAKE says.
FAKE = """
import os, sys, time
from types import SimpleNamespace
__version__ = os.environ.get("FAKE_VERSION", "4.2.1")
logging = SimpleNamespace()
def set_random_seed(seed): pass
class IncrementalPipelineOptions:
    num_threads = -1
def incremental_mapping(database, images, output, options):
    mode = os.environ["FAKE"]
    if mode == "raise":
        raise ValueError("[sfm.cc:1] no such thing")
    if mode == "abort":
        print("F2026 x.cc:3] Check failed: something inside", file=sys.stderr)
        print("\\n".join("    @  0x7f  (pycolmap/_core.so)" for _ in range(9)), file=sys.stderr, flush=True)
        os.abort()
    print(f"Registering image #7 (num_reg_frames={options.num_threads})", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def fake_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put the fake package in place of any real one."""
    folder = tmp_path / "packages"
    folder.mkdir()
    (folder / "pycolmap.py").write_text(FAKE)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    return folder / "pycolmap.py"


def there_is(monkeypatch: pytest.MonkeyPatch, *, colmap: bool, pycolmap: bool) -> None:
    monkeypatch.delenv("MALUS_COLMAP", raising=False)
    monkeypatch.setattr(program, "shutil", SimpleNamespace(which=lambda name: f"/bin/{name}" if colmap else None))
    finder = SimpleNamespace(find_spec=lambda name: object() if pycolmap else None)
    monkeypatch.setattr(program, "importlib", SimpleNamespace(util=finder))


@pytest.mark.parametrize(
    ("backend", "colmap", "pycolmap", "expected"),
    [
        ("auto", True, True, "colmap"),
        ("auto", True, False, "colmap"),
        ("auto", False, True, "pycolmap"),
        ("colmap", True, True, "colmap"),
        ("pycolmap", True, True, "pycolmap"),
    ],
)
def test_choice_of_the_backend(
    monkeypatch: pytest.MonkeyPatch, backend: str, colmap: bool, pycolmap: bool, expected: str
) -> None:
    there_is(monkeypatch, colmap=colmap, pycolmap=pycolmap)
    monkeypatch.setenv("MALUS_COLMAP", "")  # names no program
    found, start = program._find(backend)
    assert found == expected
    assert start[0] == ("/bin/colmap" if expected == "colmap" else sys.executable)


@pytest.mark.parametrize(
    ("backend", "colmap", "pycolmap"), [("auto", False, False), ("colmap", False, True), ("pycolmap", True, False)]
)
def test_missing_backend_is_reported_with_both_remedies(
    monkeypatch: pytest.MonkeyPatch, backend: str, colmap: bool, pycolmap: bool
) -> None:
    there_is(monkeypatch, colmap=colmap, pycolmap=pycolmap)
    with pytest.raises(package.ExternalError) as failure:
        Colmap(1, backend)
    assert "apt install colmap" in str(failure.value)
    assert "pip install 'malus[pycolmap]'" in str(failure.value)


def test_program_named_by_the_environment_is_not_replaced(fake_package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MALUS_COLMAP", "colmap-that-is-not-there")
    with pytest.raises(package.ExternalError, match="colmap-that-is-not-there"):
        Colmap(1)
    assert Colmap(1, "pycolmap").title == "COLMAP 4.2.1 (pycolmap)"


def test_backend_option_is_checked() -> None:
    assert package.Options().photos.backend == "auto"
    with pytest.raises(package.InputError, match="pycolmap"):
        package.Options(photos={"backend": "metashape"})


def test_old_or_broken_package_is_reported(fake_package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_VERSION", "3.13.0")
    with pytest.raises(package.ExternalError, match=r"3\.13\.0, expected 4\.2 or later"):
        Colmap(1, "pycolmap")
    fake_package.write_text("raise ImportError('libGL.so.1: cannot open shared object file')")
    with pytest.raises(package.ExternalError, match=r"does not start: ImportError: libGL\.so\.1"):
        Colmap(1, "pycolmap")


def map_images(folder: Path, **watching: object) -> None:
    """Run `mapper` with the package."""
    paths = {name: folder for name in ("database_path", "image_path", "output_path")}
    Colmap(2, "pycolmap").run("mapper", {**paths, "Mapper.num_threads": 2}, folder / "mapper.log", **watching)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("mode", "words"),
    [("raise", "exit code 1: ValueError: .* no such thing"), ("abort", "signal 6: .*something inside")],
)
def test_failure_of_the_child_process_is_explained(
    fake_package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: str, words: str
) -> None:
    monkeypatch.setenv("FAKE", mode)
    with pytest.raises(package.ExternalError, match=f"pycolmap mapper .*{words}"):
        map_images(tmp_path)
    assert words.split("*")[-1] in (tmp_path / "mapper.log").read_text()


def test_child_process_ends_when_the_search_is_stopped(
    fake_package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE", "hang")
    lines: list[str] = []
    start = time.monotonic()
    with pytest.raises(SearchStoppedError):
        map_images(tmp_path, on_line=lines.append, keep_going=lambda: not lines)
    assert time.monotonic() - start < 20
    assert lines == ["Registering image #7 (3)"]
    children = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert str(tmp_path) not in children


@pytest.mark.skipif(find_spec("pycolmap") is None, reason="pycolmap is not installed")
def test_errors_of_the_real_package_are_explained(tmp_path: Path) -> None:
    colmap = Colmap(1, "pycolmap")
    paths = {"input_path": tmp_path / "none", "output_path": tmp_path}
    with pytest.raises(package.ExternalError, match=r"bundle_adjuster failed .*do not exist"):
        colmap.run("bundle_adjuster", paths, tmp_path / "log")
    with pytest.raises(package.ExternalError, match=r"no --BundleAdjustment\.refine_everything"):
        colmap.run("bundle_adjuster", {**paths, "BundleAdjustment.refine_everything": 1}, tmp_path / "log")


def test_progress_of_colmap_4_is_translated_to_that_of_3() -> None:
    assert as_colmap_3("I2026 x.cc:9] Processing block [3/7]").endswith("Matching block [3/7]")
    assert as_colmap_3("I2026 x.cc:6] Registering image #5 (num_reg_frames=2)").endswith("image #5 (3)")
    assert as_colmap_3("Registering image #5 (3)") == "Registering image #5 (3)"


def test_driver_knows_its_options_and_refuses_others(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = pycolmap_driver.Arguments(["--A.threads", "3", "--A.refine", "0", "--A.angle", "8", "--path", "p"])
    target = SimpleNamespace(threads=-1, refine=True, inner=SimpleNamespace(angle=16.0))
    arguments.fill(target, {"A.threads": "threads", "A.refine": "refine", "A.angle": "inner.angle"})
    assert (target.threads, target.refine, target.inner.angle) == (3, False, 8.0)
    with pytest.raises(pycolmap_driver.UsageError, match="--path"):
        arguments.finish()
    assert pycolmap_driver.main(["stereo_fusion"]) == 1
    assert pycolmap_driver.main(["mapper", "--odd"]) == 1
    assert "expected a command" in capsys.readouterr().err


@pytest.mark.parametrize("calibrated", [True, False])
def test_object_on_a_board_keeps_its_matches_without_a_calibration(calibrated: bool) -> None:
    """COLMAP 4.x by default keeps only the board's matches, those of a homography."""
    cameras = [SimpleNamespace(has_prior_focal_length=True), SimpleNamespace(has_prior_focal_length=calibrated)]
    given: list[SimpleNamespace] = []
    base = contextlib.nullcontext(SimpleNamespace(read_all_cameras=lambda: cameras))
    colmap = SimpleNamespace(
        FeatureMatchingOptions=SimpleNamespace,
        TwoViewGeometryOptions=lambda: SimpleNamespace(max_H_inlier_ratio=0.8, min_num_inliers=15),
        ImportedPairingOptions=SimpleNamespace,
        Database=SimpleNamespace(open=lambda path: base),
        Device=SimpleNamespace(cpu="cpu"),
        match_image_pairs=lambda database, matching, pairing, geometry, device: given.append(geometry),
    )
    words = ["--database_path", "a.db", "--match_list_path", "pairs", "--SiftMatching.min_num_inliers", "20"]
    pycolmap_driver.import_matches(colmap, pycolmap_driver.Arguments(words))
    assert given[0].min_num_inliers == 20
    assert given[0].max_H_inlier_ratio == (0.8 if calibrated else 1.0)


def test_copy_of_a_database_leaves_no_files_of_the_old_one(tmp_path: Path) -> None:
    """COLMAP 4 keeps a write-ahead log, which stays behind when COLMAP is killed."""
    source, target = tmp_path / "a.db", tmp_path / "b.db"
    writer = sqlite3.connect(source)
    writer.execute("PRAGMA journal_mode=WAL")
    writer.execute("CREATE TABLE images (name TEXT)")
    writer.execute("INSERT INTO images VALUES ('new')")
    writer.commit()
    for suffix in ("", "-wal", "-shm"):
        (tmp_path / f"b.db{suffix}").write_bytes(b"old")
    database.copy(source, target)
    writer.close()
    assert not list(tmp_path.glob("b.db-*"))
    copied = sqlite3.connect(target)
    assert copied.execute("SELECT name FROM images").fetchall() == [("new",)]
    copied.close()
    (tmp_path / "b.db-wal").write_bytes(b"old")
    Journal(tmp_path, print).stage("copy", {}, ["b.db"], dict)
    assert not list(tmp_path.glob("b.db*"))
