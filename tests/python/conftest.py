"""Fixtures: a small station cut out of the demo, and ways to run the programs."""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

import malus as package
from malus import _core, synthetic

# A background job of a shell ignores Ctrl-C (SIGINT), and so do the programs that it starts. With a handler they do not.
signal.signal(signal.SIGINT, signal.default_int_handler)

#: Whether this is the Python of `scripts/test --sanitize python`, under which everything takes several times as long.
SANITIZED = "/libasan.so" in Path("/proc/self/maps").read_text()
#: What a sanitizer writes where it finds something.
FOUND = re.compile("ERROR: AddressSanitizer|: runtime error: ")

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "relief"
SHARED = ROOT.parent / "shared"
#: Windows of the demo's images that the small stations show, and the flat patch in each. The first window has the flat label
#: and the carving around it; the tiny one is a smaller part of both, for tests that do not check the surface.
WINDOW, PATCH = (380, 240, 580, 400), (38, 45, 157, 115)
TINY_WINDOW, TINY_PATCH = (380, 240, 480, 320), (40, 48, 95, 77)

#: The two changes between the dates of one object: center (u, v) and radius in pixels, and depth in GSD (positive: material lost).
DENT, LUMP = ((70, 60, 14), 6.0), ((170, 40, 12), -5.0)
#: The later survey has a world frame of its own: rotation and translation from it to the camera.
ANGLE = np.radians(25)
LATER = (
    np.array([[np.cos(ANGLE), -np.sin(ANGLE), 0], [np.sin(ANGLE), np.cos(ANGLE), 0], [0, 0, 1]]),
    np.array([120.0, -45.0, 60.0]),
)

#: Refinement for tests that do not check the surface: without the fits of highlight and surroundings, which take most of the time.
QUICK = {"lobe": False, "surroundings": False}
QUICK_WORDS = tuple(word for name in QUICK for word in ("--set", f"refine.{name}=false"))

#: Files whose tests take longest. They run first, so that no pytest-xdist worker is still busy with one when all others are done.
LONGEST_FIRST = (
    "test_docs.py",
    "test_object.py",
    "test_studio_in_haste.py",
    "test_photos.py",
    "test_studio.py",
    "test_pipeline.py",
    "test_batch.py",
    "test_exports.py",
    "test_paper.py",
    "test_polarizer.py",
    "test_object_reference.py",
    "test_report.py",
    "test_control.py",
    "test_limits.py",
    "test_registration.py",
    "test_benchmarks.py",
    "test_object_detail.py",
    "test_bad_input.py",
    "test_mosaic.py",
    "test_archive.py",
    "test_synthetic.py",
    "test_evidence.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    places = {name: place for place, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: places.get(item.path.name, len(places)))


def turns_of_another_thread(work: Callable[[], object]) -> int:
    """How often another thread ran while `work` did: never, if it holds the interpreter's lock."""
    ended = threading.Event()
    ticks: list[float] = []

    def tick() -> None:
        while not ended.wait(0.002):
            ticks.append(time.monotonic())

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        begin = time.monotonic()
        work()
        end = time.monotonic()
    finally:
        ended.set()
        thread.join()
    return sum(begin < at < end for at in ticks)


needs_plain_memory = pytest.mark.skipif(
    SANITIZED, reason="AddressSanitizer takes terabytes of address space and keeps memory that is given back"
)

needs_shared = pytest.mark.skipif(not (SHARED / "data").exists(), reason="the test data in ../shared is not here")

needs_distributed = pytest.mark.skipif(find_spec("distributed") is None, reason="the extra dask is not installed")


@dataclass
class Outcome:
    """What a program did."""

    code: int
    out: str
    err: str


def run_program(*command: str | Path, **options: object) -> Outcome:
    """Run a command line, without a terminal."""
    patience = 3000 if SANITIZED else 300
    done = subprocess.run(  # type: ignore[call-overload]
        [str(word) for word in command], capture_output=True, text=True, timeout=patience, **options
    )
    assert not FOUND.search(done.stderr), done.stderr
    return Outcome(done.returncode, done.stdout, done.stderr)


def malus(*arguments: str | Path, **options: object) -> Outcome:
    """Run `malus …` of this environment."""
    return run_program(sys.executable, "-m", "malus.cli", *arguments, **options)


def malus_here(*arguments: str | Path) -> Outcome:
    """Run `malus …` within this process: starting a program takes longer than most commands."""
    from malus import cli

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = cli.main([str(word) for word in arguments])
        except SystemExit as end:  # after --help and --version
            code = int(end.code or 0)
    return Outcome(code, out.getvalue(), err.getvalue())


def malus_station(*arguments: str | Path, **options: object) -> Outcome:
    """Run the C++ executable of the build tree."""
    program = Path(os.environ.get("MALUS_STATION", ROOT / "build" / "malus-station"))
    if not program.exists():
        pytest.skip(f"{program} is not built")
    return run_program(program, *arguments, **options)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run each test in a folder of its own, so that files a command leaves in the current folder do not end up in the repository."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="session")
def scene() -> synthetic.Scene:
    """A small carved stone with exact truth."""
    return synthetic.relief(240, 180, seed=3)


@pytest.fixture(scope="session")
def sensor() -> synthetic.Sensor:
    return synthetic.Sensor()


@pytest.fixture(scope="session")
def images(scene: synthetic.Scene, sensor: synthetic.Sensor) -> list[np.ndarray]:
    """Images of the stone through the polarizer: linear, in [0, 1], the white level being the upper end."""
    return [image / np.float32(16383) for image in synthetic.render(scene, sensor=sensor)]


@pytest.fixture(scope="session")
def small_station_source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """200 × 160 px of the demo station as a station of its own."""
    return made_once(tmp_path_factory, "small", lambda folder: cut_out(folder / "station", WINDOW, PATCH)) / "station"


@pytest.fixture(scope="session")
def tiny_station_source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """100 × 80 px of the demo station as a station of its own."""
    made = made_once(tmp_path_factory, "tiny", lambda folder: cut_out(folder / "station", TINY_WINDOW, TINY_PATCH))
    return made / "station"


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """A folder that is made once per test run, by the first pytest-xdist worker that needs it."""
    root = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent
    with (root / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (root / f"{name}.made").exists():
            make(root / name)
            (root / f"{name}.made").touch()
    return root / name


def cut_out(folder: Path, window: tuple[int, int, int, int], patch: tuple[int, int, int, int]) -> None:
    """A window of the demo station in a new folder (principal point moved along), with a flat patch and a profile."""
    import matplotlib.image

    x0, y0, x1, y1 = window
    (folder / "pol").mkdir(parents=True)
    for path in sorted((EXAMPLE / "pol").glob("*.png")):
        # matplotlib reads 16-bit PNG as floats in [0, 1] of 65535.
        pixels = np.rint(matplotlib.image.imread(path) * 65535).astype(np.uint16)
        tifffile.imwrite(folder / "pol" / f"{path.stem}.tif", pixels[y0:y1, x0:x1])
    shutil.copytree(EXAMPLE / "dense", folder / "dense")
    shutil.copytree(EXAMPLE / "sparse", folder / "sparse")
    cameras = folder / "sparse" / "cameras.txt"
    lines = []
    for line in cameras.read_text().splitlines():
        words = line.split()
        if words[0] == "2":
            fx, fy, cx, cy = (float(word) for word in words[4:8])
            line = f"2 PINHOLE {x1 - x0} {y1 - y0} {fx} {fy} {cx - x0} {cy - y0}"
        lines.append(line)
    cameras.write_text("\n".join(lines) + "\n")
    (folder / "station.toml").write_text(
        f"""
[station]
name = "small"
unit = "mm"

[object]
identifier = "X 1907.4"
title = "Relief & label"
maker = "unknown mason"
collection = "Museum of Tests"
recorded_by = "A. Recorder"
license = "CC-BY-4.0"

[polarized]
images = ["pol/pol_000.tif", "pol/pol_030.tif", "pol/pol_060.tif", "pol/pol_090.tif", "pol/pol_120.tif", "pol/pol_150.tif"]
angles_deg = [0, 30, 60, 90, 120, 150]
frames_averaged = 16
full_well_e = 20000
read_noise_e = 8
white_level = 16383

[camera]
colmap_model = "sparse"
image = "station.jpg"

[prior]
cloud = "dense/cloud.ply"

[[patch]]
name = "label"
box = {list(patch)}

[[profile]]
name = "1"
from = [10, {(y1 - y0) // 2}]
to = [{x1 - x0 - 10}, {(y1 - y0) // 2}]
"""
    )


def write_pair(source: Path, folder: Path) -> Path:
    """An object file with two copies of one station, whose surfaces therefore agree everywhere."""
    for k in range(2):
        shutil.copytree(source, folder / f"o{k}")
    file = folder / "object.toml"
    file.write_text(
        '[object]\nname = "pair"\nstations = ["o0/station.toml", "o1/station.toml"]\nclosed = false\nreport = false\nfaces = 3000\n'
        '[options]\nfusion = "grid"\n[options.prior]\nsmoothing_px = 4\n[options.height]\niterations = 2\n'
    )
    return file


@pytest.fixture
def pair(tiny_station_source: Path, tmp_path: Path) -> Path:
    """The object file of a pair of one's own."""
    return write_pair(tiny_station_source, tmp_path)


@pytest.fixture(scope="session")
def finished_grid(small_station_source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Workspace of `malus run --fusion grid` on the small station; read it, do not change it."""

    def run(work: Path) -> None:
        outcome = malus("run", small_station_source / "station.toml", "-o", work, "--fusion", "grid", "--threads", "2")
        assert outcome.code == 0, outcome.err

    return made_once(tmp_path_factory, "finished_grid", run)


def _changed(scene: synthetic.Scene) -> synthetic.Scene:
    """The scene with a flat dent and a flat lump, whose edges are three pixels wide."""
    depth = scene.depth.copy()
    v, u = np.indices(depth.shape)
    for (u0, v0, radius), gsd in (DENT, LUMP):
        depth += gsd * scene.gsd * np.clip((radius - np.hypot(u - u0, v - v0)) / 3 + 0.5, 0, 1)
    return replace(scene, depth=depth)


def _finish(scene: synthetic.Scene, folder: Path, *, seed: int) -> None:
    images = [image / np.float32(16383) for image in synthetic.render(scene, seed=seed)]
    station = package.Station(
        images,
        synthetic.Sensor().angles_deg,
        scene.camera,
        prior_depth=synthetic.stereo_depth(scene, seed=seed),
        name=folder.name,
        full_well_e=20000,
        read_noise_e=8,
        frames_averaged=16,
    )
    package.reconstruct(station, package.Options(assess={"polarization_height": False}), workspace=folder, threads=2)


@pytest.fixture(scope="session")
def dates(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Workspaces of a stone before and after a dent and a lump, the later one in its own world frame; read them, do not change them."""
    scene = synthetic.relief(240, 180, seed=3)
    rotation, translation = LATER
    camera = replace(scene.camera, rotation=rotation, translation=translation)
    later = replace(_changed(scene), camera=camera)

    def run(folder: Path) -> None:
        _finish(scene, folder / "y2020", seed=1)
        _finish(later, folder / "y2025", seed=2)

    folder = made_once(tmp_path_factory, "dates", run)
    return folder / "y2020", folder / "y2025"


@pytest.fixture
def small_station(small_station_source: Path, tmp_path: Path) -> Path:
    """A private copy of the small station's file, for tests that change it."""
    folder = tmp_path / "station"
    shutil.copytree(small_station_source, folder)
    return folder / "station.toml"


@pytest.fixture
def tiny_station(tiny_station_source: Path, tmp_path: Path) -> Path:
    """The same of the tiny station, for tests that do not check the surface."""
    folder = tmp_path / "station"
    shutil.copytree(tiny_station_source, folder)
    return folder / "station.toml"


def metashape_cameras(station: Path, label: str, scale: float = 0.25) -> str:
    """The cameras.xml of a Metashape project in meters for a station in millimeters; one unit of the chunk is `scale` m."""
    camera = package.Station.load(station).describe()["camera"]
    fx, fy, cx, cy = camera["params"][:4]
    width, height = camera["width"], camera["height"]
    pose = np.eye(4)
    pose[:3, :3] = np.transpose(camera["rotation"])
    pose[:3, 3] = -pose[:3, :3] @ camera["translation"] / 1000 / scale
    return f"""<document><chunk><sensors><sensor id="0" type="frame"><resolution width="{width}" height="{height}"/>
<calibration class="adjusted"><f>{fy}</f><b1>{fx - fy}</b1><cx>{cx + 0.5 - width / 2}</cx><cy>{cy + 0.5 - height / 2}</cy>
</calibration></sensor></sensors><cameras><camera id="0" sensor_id="0" label="{label}">
<transform>{" ".join(f"{value:.17g}" for value in pose.ravel())}</transform></camera></cameras>
<transform><scale>{scale}</scale></transform></chunk></document>"""


def cloud_of(station: Path) -> np.ndarray:
    """Fields xyz, normal and color of the points of a station that is cut out of the demo."""
    data = (station.parent / "dense/cloud.ply").read_bytes()
    head, end = data.partition(b"end_header\n")[0], data.index(b"end_header\n") + len(b"end_header\n")
    count = int(re.findall(rb"element vertex (\d+)", head)[0])
    return np.frombuffer(data, [("xyz", "<f4", 3), ("normal", "<f4", 3), ("color", "u1", 3)], count, end)


def cloud_in_meters(station: Path, path: Path) -> None:
    """Write the cloud of a station (millimeters) as a program that works in meters would."""
    import trimesh

    trimesh.PointCloud(trimesh.load(station.parent / "dense/cloud.ply").vertices / 1000).export(path)


def half_written(folder: Path) -> list[Path]:
    """Unfinished files below a folder. Both programs give a file such a name until it is complete."""
    return list(folder.rglob(".*.partial-*"))


def edit(path: Path, old: str, new: str) -> Path:
    """Replace `old` in a text file; `old` must occur in it."""
    text = path.read_text()
    assert old in text, f"{old!r} is not in {path}"
    path.write_text(text.replace(old, new))
    return path


def demo_with_photos(folder: Path) -> tuple[Path, list[str]]:
    """Write the demo station without pose and prior, with six of its photos and a scale from two points marked by the demo's own model.

    Returns the station file and the photos' names.
    """
    (folder / "views").mkdir(parents=True)
    (folder / "pol").mkdir()
    used = ["view_00.jpg", "view_02.jpg", "view_03.jpg", "view_05.jpg", "view_07.jpg", "view_09.jpg"]
    truth = _core.ColmapModel.read(str(EXAMPLE / "sparse")).images()
    marks: dict[str, list[str]] = {"a": [], "b": []}
    ends = {"a": np.array([-60.0, -30.0, 0.0]), "b": np.array([55.0, 35.0, 0.0])}
    for name in used:
        with Image.open(EXAMPLE / "views" / name) as image:
            image.save(folder / "views" / name, quality=97)
        _, _, _, (fx, fy, cx, cy), rotation, translation = truth[name][0]
        for end, point in ends.items():
            x = rotation @ point + translation
            u, v = fx * x[0] / x[2] + cx, fy * x[1] / x[2] + cy
            marks[end].append(f'{{ image = "{name}", x = {u:.3f}, y = {v:.3f} }}')
    for path in sorted((EXAMPLE / "pol").glob("*.png")):
        shutil.copy(path, folder / "pol")
    _, width, height, (fx, fy, cx, cy), *_ = truth["station.jpg"][0]
    _, photo_width, photo_height, (px, py, pcx, pcy), *_ = truth[used[0]][0]
    (folder / "station.toml").write_text(f"""
[polarized]
images = "pol"
white_level = 16383
[camera]
model = "PINHOLE"
width = {width}
height = {height}
params = [{fx}, {fy}, {cx + 0.5}, {cy + 0.5}]
[photos]
folder = "views"
camera = {{ model = "PINHOLE", width = {photo_width}, height = {photo_height}, params = [{px}, {py}, {pcx + 0.5}, {pcy + 0.5}] }}
[[scale]]
distance = {np.linalg.norm(ends["a"] - ends["b"])}
a = [{", ".join(marks["a"])}]
b = [{", ".join(marks["b"])}]
""")
    return folder / "station.toml", used
