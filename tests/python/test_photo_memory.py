"""Memory for photos: a sweep holds each photo once, stages record time and memory, free memory limits the feature search."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

import malus
from conftest import EXAMPLE, needs_plain_memory
from malus import _core
from malus.photogrammetry import cost, features, memory
from malus.photogrammetry.bench import Bench
from malus.photogrammetry.journal import Journal
from malus.photogrammetry.program import Colmap
from test_stereo import FOCAL, HEIGHT, WIDTH, camera_at, seen

MB = 1e6

SWEEP = """
import os, sys
from pathlib import Path
import malus
from malus.photogrammetry import memory
from test_photo_memory import enlarged, scene

station, views, points = scene()
photos = [(Path(sys.argv[1]) / f"{k}.tif", enlarged(camera)) for k, (_, camera) in enumerate(views)]
options = malus.Options(sweep={"station_gamma": 1.0, "min_level_px": 40})
before = memory.resident_mb()
found = malus.stereo.sweep(station[0], station[1], photos, points, options=options, threads=2)
assert found.completeness > 0.9, found.completeness
print(memory.peak_mb(os.getpid()) - before)
"""

#: Along each side, a photo has this many pixels for each pixel of the station.
FACTOR = 20


def scene() -> tuple[tuple[np.ndarray, malus.Camera], list[tuple[np.ndarray, malus.Camera]], np.ndarray]:
    """The plane of test_stereo: the station, its photos, and points."""
    station = camera_at((0, 0, 0))
    image, depth = seen(station)
    cameras = [camera_at((90 * np.cos(a), 90 * np.sin(a), 0)) for a in 2 * np.pi * np.arange(12) / 12]
    v, u = np.mgrid[5:HEIGHT:12, 5:WIDTH:12]
    z = depth[v, u]
    points = np.stack([(u - 59.5) / FOCAL * z, (v - 49.5) / FOCAL * z, z], -1).reshape(-1, 3)
    return (image, station), [(seen(camera)[0], camera) for camera in cameras], points


def enlarged(camera: malus.Camera) -> malus.Camera:
    """The camera of a photo whose pixels are each repeated FACTOR times along both sides."""
    fx, fy, cx, cy = camera.params
    shift = (FACTOR - 1) / 2
    params = [FACTOR * fx, FACTOR * fy, FACTOR * cx + shift, FACTOR * cy + shift]
    return malus.Camera(
        "PINHOLE", FACTOR * camera.width, FACTOR * camera.height, params, camera.rotation, camera.translation
    )


@needs_plain_memory
def test_a_sweep_holds_photos_once(tmp_path: Path) -> None:
    _, views, _ = scene()
    megabytes = 0.0
    for k, (image, _) in enumerate(views):
        pixels = np.kron(np.uint16(65535 * image), np.ones((FACTOR, FACTOR), np.uint16))
        _core.write_tiff16(str(tmp_path / f"{k}.tif"), pixels)
        megabytes += 4 * pixels.size / MB
    done = subprocess.run(
        [sys.executable, "-c", SWEEP, str(tmp_path)], capture_output=True, text=True, cwd=Path(__file__).parent
    )
    assert done.returncode == 0, done.stderr
    # In addition: one photo in 16 bits per thread while files are read, and a quarter of a photo while the photo is halved.
    assert float(done.stdout) < 1.5 * megabytes, f"{done.stdout} MB for photos of {megabytes} MB"


HUNGRY = """#!{python}
import sys, time
if sys.argv[1] == "help":
    print("COLMAP 3.8 -- hungry")
    sys.exit()
taken = bytearray(200_000_000)
taken[::4096] = b"x" * len(taken[::4096])
end = time.process_time() + 0.3
while time.process_time() < end:
    pass
time.sleep(0.5)
"""


def test_stages_record_time_and_memory_of_colmap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "colmap"
    program.write_text(HUNGRY.format(python=sys.executable))
    program.chmod(0o755)
    monkeypatch.setenv("MALUS_COLMAP", str(program))
    colmap = Colmap(1)
    journal = Journal(tmp_path, print, colmap)

    def run() -> dict[str, object]:
        colmap.run("mapper", {}, tmp_path / "mapper.log")
        return {}

    journal.stage("mapping", {}, [], run)
    journal.stage("nothing", {}, [], dict)
    taken, nothing = journal.times["mapping"], journal.times["nothing"]
    assert taken["seconds"] > 0.7
    assert taken["cpu_seconds"] > 0.3
    assert taken["peak_mb"] > nothing["peak_mb"] + 190
    again = Journal(tmp_path, print)
    again.stage("mapping", {}, [], lambda: pytest.fail("it is done"))
    assert again.times["mapping"] == taken


@pytest.mark.parametrize(("left_mb", "threads"), [(10_000, 8), (3000, 7), (1500, 3), (500, 1), (100, 1)])
def test_free_memory_limits_the_threads_of_the_feature_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, left_mb: float, threads: int
) -> None:
    monkeypatch.setattr(memory, "available_mb", lambda: left_mb)
    given: dict[str, object] = {}
    warned: list[str] = []
    colmap = SimpleNamespace(threads=8, run=lambda command, arguments, log, on_line: given.update(arguments))
    options = malus.Options(photos={"max_side_px": 1200})
    made = Bench(colmap, tmp_path, Journal(tmp_path, print), options, print, lambda level, text: warned.append(text))  # type: ignore[arg-type]
    made.images.mkdir()
    for name, size in (("small.png", (60, 40)), ("large%20one.png", (2400, 1600))):
        Image.new("L", size).save(made.images / name)
    features._search(made, "features", tmp_path / "features.db", ["small.png", "large one.png"], {}, -1)
    assert features.sift_mb([(60, 40), (2400, 1600)], 1200) == pytest.approx(288)
    assert features.sift_mb([(60, 40), (2400, 1600)], 1200, 0) == pytest.approx(72)
    assert given["SiftExtraction.num_threads"] == threads
    assert bool(warned) == (left_mb == 100), warned


def test_free_memory_is_within_the_limit_of_the_control_group(monkeypatch: pytest.MonkeyPatch) -> None:
    free = memory.available_mb()
    assert 10 < free < 1e8
    monkeypatch.setattr(memory, "group_limits_mb", lambda: [1e9, memory.resident_mb() + 5])
    assert memory.available_mb() < 10
    assert memory.limit_mb() == pytest.approx(memory.resident_mb() + 5, abs=5)


@pytest.mark.parametrize(
    ("groups", "files", "limits"),
    [
        ("0::/\n", {"memory.max": "4000000\n"}, [4]),
        # A job of a batch queue: the limit is that of a group around the one of its step.
        (
            "0::/slurm/job_7/step_0\n",
            {
                "slurm/job_7/step_0/memory.max": "max\n",
                "slurm/job_7/memory.max": "3000000\n",
                "slurm/memory.max": "max\n",
            },
            [3],
        ),
        ("0::/\n", {"memory.max": "max\n"}, []),
        (
            "5:cpu,cpuacct:/job\n4:memory:/job\n0::/\n",
            {"memory/job/memory.limit_in_bytes": "2000000\n", "memory/memory.limit_in_bytes": "9000000\n"},
            [2, 9],
        ),
        # A container that sees the host's path, but has only its own group.
        ("4:memory:/docker/1f\n", {"memory/memory.limit_in_bytes": "2000000\n"}, [2]),
        (None, {}, []),
    ],
)
def test_limits_of_control_groups_are_found(
    tmp_path: Path, groups: str | None, files: dict[str, str], limits: list[float]
) -> None:
    (tmp_path / "proc/self").mkdir(parents=True)
    if groups is not None:
        (tmp_path / "proc/self/cgroup").write_text(groups)
    for name, text in files.items():
        file = tmp_path / "sys/fs/cgroup" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    assert memory.group_limits_mb(tmp_path) == limits


def test_expected_memory_is_that_of_the_largest_stage() -> None:
    def work(count: int, width: int, threads: int = 2, **photos: float) -> cost.Work:
        options = malus.Options(photos=photos)
        return cost.Work([(width, width * 2 // 3)] * count, count * (count - 1) // 2, 18.0, options, threads)

    def floats_mb(count: int, width: int) -> float:
        return 4 * count * width * (width * 2 // 3) / MB

    many, few = work(40, 5196), work(3, 5196)
    # Windows are matched on pyramids of all photos; with few photos the search for features takes more memory than that.
    assert cost.photos_cost(many).memory_mb > 4 / 3 * floats_mb(40, 5196)
    assert cost.photos_cost(few).memory_mb > 2 * features.sift_mb(few.sizes, 3200) > 4 / 3 * floats_mb(3, 5196)
    assert cost.photos_cost(work(3, 5196, threads=4)).memory_mb > cost.photos_cost(few).memory_mb + 4000
    assert cost.photos_cost(work(3, 5196, max_side_px=1600)).memory_mb < cost.photos_cost(few).memory_mb - 2000
    assert cost.sweep_cost(many).memory_mb > 5 / 4 * floats_mb(40, 5196)
    assert cost.sweep_cost(work(40, 2598)).memory_mb < cost.sweep_cost(many).memory_mb - floats_mb(40, 5196) / 2


def test_other_words_for_the_freedom_of_a_lens_are_refused() -> None:
    """Any word but "all" was taken for the other one."""
    model = _core.ColmapModel.read(str(EXAMPLE / "sparse"))
    with pytest.raises(malus.InputError, match='freedom = "al" is not known; did you mean all'):
        model.refine({}, "station.jpg", {"station.jpg": "al"}, malus.Options().to_json(), 1, None)


def test_windows_are_read_from_files() -> None:
    model = _core.ColmapModel.read(str(EXAMPLE / "sparse"))
    names = list(model.images())
    pictures = {name: str(EXAMPLE / "views" / name) for name in names}

    def refine() -> str:
        found = model.refine(pictures, "station.jpg", {}, malus.Options().to_json(), 2, None)
        return str(found["status"])

    assert refine() == "too few matches"  # The model has no points, but every photo is looked at.
    pictures[names[3]] = str(EXAMPLE / "pol" / "pol_000.png")
    with pytest.raises(malus.InputError, match="is 720 x 480 pixels, expected 960 x 640"):
        refine()
    pictures[names[3]] = "/nowhere/photo.jpg"
    with pytest.raises(malus.InputError, match="/nowhere/photo.jpg: no such file"):
        refine()
