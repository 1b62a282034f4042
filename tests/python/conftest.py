"""Fixtures: a small station cut out of the demo, and ways to run the programs."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import tifffile

from malus import synthetic

# Ctrl-C is ignored in a shell's background jobs, and so by the programs that are started here, unless it is handled.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "relief"
SHARED = ROOT.parent / "shared"
#: Window of the demo's images that the small station shows: the flat label and carving around it.
WINDOW = (380, 240, 580, 400)

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
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=300, **options)  # type: ignore[call-overload]
    return Outcome(done.returncode, done.stdout, done.stderr)


def malus(*arguments: str | Path, **options: object) -> Outcome:
    """`malus …` of this environment."""
    return run_program(sys.executable, "-m", "malus.cli", *arguments, **options)


def malus_here(*arguments: str | Path) -> Outcome:
    """`malus …` within this process, for short commands: a program's start takes longer than most of them."""
    from malus import cli

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = cli.main([str(word) for word in arguments])
    return Outcome(code, out.getvalue(), err.getvalue())


def malus_station(*arguments: str | Path, **options: object) -> Outcome:
    """The C++ executable of the build tree."""
    program = Path(os.environ.get("MALUS_STATION", ROOT / "build" / "malus-station"))
    if not program.exists():
        pytest.skip(f"{program} is not built")
    return run_program(program, *arguments, **options)


@pytest.fixture(scope="session")
def scene() -> synthetic.Scene:
    """A small carved stone with exact truth."""
    return synthetic.relief(240, 180, seed=3)


@pytest.fixture(scope="session")
def sensor() -> synthetic.Sensor:
    return synthetic.Sensor()


@pytest.fixture(scope="session")
def images(scene: synthetic.Scene, sensor: synthetic.Sensor) -> list[np.ndarray]:
    """The stone through the polarizer, linear, in [0, 1] of the white level."""
    return [image / np.float32(16383) for image in synthetic.render(scene, sensor=sensor)]


@pytest.fixture(scope="session")
def small_station_source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A 200 × 160 px window of the demo station as a station of its own (principal point moved along)."""
    import matplotlib.image

    folder = tmp_path_factory.mktemp("small") / "station"
    x0, y0, x1, y1 = WINDOW
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
        """
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
box = [38, 45, 157, 115]

[[profile]]
name = "1"
from = [10, 80]
to = [190, 80]
"""
    )
    return folder


@pytest.fixture(scope="session")
def finished_grid(small_station_source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Workspace of `malus run --fusion grid` on the small station; read it, do not change it."""
    work = tmp_path_factory.mktemp("finished") / "work"
    outcome = malus("run", small_station_source / "station.toml", "-o", work, "--fusion", "grid", "--threads", "2")
    assert outcome.code == 0, outcome.err
    return work


@pytest.fixture
def small_station(small_station_source: Path, tmp_path: Path) -> Path:
    """A private copy of the small station's file, for tests that change it."""
    folder = tmp_path / "station"
    shutil.copytree(small_station_source, folder)
    return folder / "station.toml"


def half_written(folder: Path) -> list[Path]:
    """Files below a folder that have the name of those not finished, which both programs give them."""
    return list(folder.rglob(".*.partial-*"))


def edit(path: Path, old: str, new: str) -> Path:
    """Replace one piece of a text file; it must be there."""
    text = path.read_text()
    assert old in text, f"{old!r} is not in {path}"
    path.write_text(text.replace(old, new))
    return path
