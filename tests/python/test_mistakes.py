"""The mistakes that benchmarks/wrong_inputs.py makes are as their names say, and its table lists their outcomes."""

from __future__ import annotations

import importlib
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import malus
from conftest import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))
mistakes: Any = importlib.import_module("mistakes")
capture: Any = importlib.import_module("capture_mistakes")
wrong_inputs: Any = importlib.import_module("wrong_inputs")

ANGLES = np.deg2rad(np.arange(0, 180, 30))
WIDTH, HEIGHT = 90, 60


def intensity(angles: Any) -> Any:
    """K×H×W: degree and phase change across the image, brightness down it."""
    v, u = np.indices((HEIGHT, WIDTH))
    degree, phase = 0.1 + 0.3 * u / WIDTH, 0.05 * u
    return ((0.2 + 0.3 * v / HEIGHT) * (1 + degree * np.cos(2 * (np.asarray(angles)[:, None, None] - phase)))).astype(
        np.float32
    )


@pytest.fixture
def inputs() -> Any:
    cloud = np.zeros(200, [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")])
    turn, shift = Rotation.from_euler("y", 20, degrees=True).as_matrix(), np.array([3.0, 4, 5])
    points = (np.random.default_rng(1).uniform([-20, -10, 495], [20, 10, 505], (200, 3)) - shift) @ turn
    for axis, name in enumerate("xyz"):
        cloud[name] = points[:, axis]
        cloud["n" + name] = -turn[2, axis]
    camera = malus.Camera("PINHOLE", WIDTH, HEIGHT, [600.0, 600.0, 44.5, 29.5])
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    return mistakes.Inputs(
        "plane",
        intensity(ANGLES),
        ANGLES,
        mask,
        camera,
        cloud,
        turn,
        shift,
        "mm",
        dict(frames_averaged=4),
        {},
    )


def degrees(inputs: Any) -> Any:
    s0, s1, s2 = capture.stokes(inputs)
    return np.hypot(s1, s2) / s0


def made(name: str, inputs: Any) -> Any:
    return capture.CAPTURE_MISTAKES[name](inputs)


def test_images_at_other_angles_follow_the_sinusoid(inputs: Any) -> None:
    np.testing.assert_allclose(
        made("turned by 20° instead of 30°", inputs).images, intensity(ANGLES * 2 / 3), atol=1e-5
    )
    moved = made("polarizer set by hand, ± 3°", inputs)
    assert 0.001 < np.abs(moved.images - inputs.images).max() < 0.1
    assert (moved.angles == inputs.angles).all(), "the station file does not know of it"


def test_filters(inputs: Any) -> None:
    np.testing.assert_allclose(degrees(made("filter film", inputs)), degrees(inputs) * 2 / 3, rtol=1e-4)
    assert degrees(made("circular filter, back to front", inputs)).max() < 0.01


def test_exposures(inputs: Any) -> None:
    means = made("auto exposure", inputs).images.mean(axis=(1, 2))
    np.testing.assert_allclose(means, means[0], rtol=1e-5)
    over = made("one image overexposed by 2 stops", inputs).images / inputs.images
    np.testing.assert_allclose(over[2], 4, rtol=1e-5)
    np.testing.assert_allclose(over[[0, 1, 3, 4, 5]], 1)
    colored = made("auto white balance", inputs).images
    assert colored.shape == (6, HEIGHT, WIDTH, 3)
    np.testing.assert_allclose(colored[..., 1], inputs.images, rtol=1e-6)


def test_crops_are_about_the_middle(inputs: Any) -> None:
    larger = capture.enlarged(inputs, 1.06).images[0]
    np.testing.assert_allclose(larger[30, 45], inputs.images[0][30, 45], rtol=1e-3)
    np.testing.assert_allclose(larger[30, 45 + 21], inputs.images[0][30, 45 + 20], rtol=0.02)


def test_the_displaced_pose_looks_at_the_same_place(inputs: Any) -> None:
    aside = made("pose of a photo 8° aside", inputs)
    np.testing.assert_allclose(np.median(aside.in_camera(), 0), np.median(inputs.in_camera(), 0), atol=0.5)
    assert Rotation.from_matrix(aside.rotation @ inputs.rotation.T).magnitude() == pytest.approx(np.radians(8))


@pytest.mark.parametrize("name", [*mistakes.MISTAKES, *capture.CAPTURE_MISTAKES])
def test_every_mistake_is_written_as_a_station(inputs: Any, tmp_path: Path, name: str) -> None:
    mistake = mistakes.MISTAKES.get(name) or capture.CAPTURE_MISTAKES[name]
    path = mistakes.write(mistake(inputs), tmp_path / "station")
    written = tomllib.loads(path.read_text())
    right = tomllib.loads(mistakes.write(inputs, tmp_path / "right").read_text())
    same = written == right and all(
        (tmp_path / "right" / file.name).read_bytes() == file.read_bytes() for file in path.parent.iterdir()
    )
    assert same == (name == "as it is" or name == "mask too large by 20 px"), "the mask is the whole image here"


def test_portrait_images_are_rotated_by_exif_only(inputs: Any, tmp_path: Path) -> None:
    path = mistakes.write(made("portrait by EXIF", inputs), tmp_path / "station")
    with Image.open(path.parent / "0.jpg") as image:
        assert image.size == (HEIGHT, WIDTH) and image.getexif()[0x0112] == 6


def test_the_table_has_outcomes_and_figures() -> None:
    said = {
        "coin": {"mask black": wrong_inputs.Said("exit code 2", ["black"])},
        "bust": {"cloud aside": wrong_inputs.Said("converged, low", ["aside"], dict(rmse=1.0, mad=0.5, normals=2.0))},
    }
    assert wrong_inputs.table(said).splitlines() == [
        "| mistake | coin | bust |",
        "|---|---|---|",
        "| mask black | exit code 2 | – |",
        "| cloud aside | – | converged, low; 1.00 0.50 2.00 |",
    ]
