"""Angles, exposures and zero of the polarizer's scale, through the whole program."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image

import malus
from conftest import EXAMPLE, edit, malus_station
from malus import _core
from malus.synthetic import write_station

ANGLES = "angles_deg = [0, 30, 60, 90, 120, 150]"


#: The part of the demo's images that is used, with the flat label and the carving around it.
LEFT, TOP, RIGHT, BOTTOM = 220, 140, 620, 420


def write_part(folder: Path) -> Path:
    """A part of the demo station as a station of its own (principal point moved along), without patches and profiles."""
    (folder / "pol").mkdir(parents=True)
    for path in (EXAMPLE / "pol").glob("*.png"):
        with Image.open(path) as image:
            image.crop((LEFT, TOP, RIGHT, BOTTOM)).save(folder / "pol" / path.name)
    for name in ("dense", "sparse"):
        shutil.copytree(EXAMPLE / name, folder / name)
    cameras = (folder / "sparse/cameras.txt").read_text()
    lens = next(line for line in cameras.splitlines() if line.startswith("2 "))
    fx, fy, cx, cy = (float(word) for word in lens.split()[4:8])
    part = f"2 PINHOLE {RIGHT - LEFT} {BOTTOM - TOP} {fx} {fy} {cx - LEFT} {cy - TOP}"
    edit(folder / "sparse/cameras.txt", lens, part)
    (folder / "station.toml").write_text((EXAMPLE / "station.toml").read_text().split("[[")[0])
    return folder / "station.toml"


@pytest.fixture
def relief(tmp_path: Path) -> Path:
    """The part of the demo station, to be changed."""
    return write_part(tmp_path / "relief")


def calibration(station: Path, *options: str) -> tuple[dict[str, Any], Path]:
    work = station.parent / "work"
    outcome = malus_station(station, "-o", work, "--until", "polarizer", "--threads", "2", *options)
    assert outcome.code == 0, outcome.err
    manifest = json.loads((work / "manifest.json").read_text())
    return manifest["steps"]["polarizer"]["notes"]["calibration"], work


@pytest.fixture(scope="module")
def correct(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """What is found for the part as it is; read its workspace, do not change it."""
    return calibration(write_part(tmp_path_factory.mktemp("correct") / "relief"))


def phase_difference_deg(work: Path, other: Path, least_degree: float = 0.02) -> float:
    """Median difference over the pixels whose degree is above `least_degree`."""
    phase, reference = (tifffile.imread(w / "polarization/phase.tif").astype(float) for w in (work, other))
    strong = tifffile.imread(other / "polarization/degree.tif") > least_degree
    return float(np.degrees(np.median(((phase - reference + np.pi / 2) % np.pi - np.pi / 2)[strong])))


def brighten(path: Path, factor: float) -> None:
    import matplotlib.image

    pixels = np.rint(matplotlib.image.imread(path) * 65535 * factor).astype(np.uint16)
    Image.fromarray(pixels).save(path)


def test_correct_angles_are_not_changed(correct: tuple[dict[str, Any], Path]) -> None:
    found, work = correct
    assert not found["from_images"]
    assert not found["from_surface"]
    assert found["angles_deg"] == pytest.approx([0, 30, 60, 90, 120, 150])
    assert found["gains"] == pytest.approx([1] * 6)
    assert abs(found["zero_error_deg"]) < 0.3
    assert found["warnings"] == []
    for name in ("unpolarized", "degree", "phase"):
        measured = tifffile.imread(work / f"polarization/measured/{name}.tif")
        np.testing.assert_array_equal(tifffile.imread(work / f"polarization/{name}.tif"), measured)


def test_exposure_drift_is_found(relief: Path) -> None:
    factors = [1, 0.97, 1.02, 1, 0.99, 1.01]
    for angle, factor in zip(range(0, 180, 30), factors, strict=True):
        brighten(relief.parent / f"pol/pol_{angle:03d}.png", factor)
    found, _ = calibration(relief)
    assert found["from_images"]
    expected = np.array(factors) / np.exp(np.mean(np.log(factors)))
    np.testing.assert_allclose(found["gains"], expected, atol=0.002)
    assert found["residual_after"] < 0.5 * found["residual_before"]
    # Exposures are relative to their own mean: the stated errors must be of the size of the real ones.
    assert max(found["gains_sigma"]) < 0.005


def test_unknown_angles_are_found(relief: Path, correct: tuple[dict[str, Any], Path]) -> None:
    edit(relief, ANGLES, 'angles_deg = "auto"')
    found, work = calibration(relief)
    errors = (np.array(found["angles_deg"]) - np.arange(0, 180, 30) + 90) % 180 - 90
    assert np.abs(errors).max() < 0.3
    assert abs(phase_difference_deg(work, correct[1])) < 0.3


def test_wrong_zero_is_corrected_and_reported_and_only_reported_when_calibration_is_off(relief: Path) -> None:
    edit(relief, ANGLES, ANGLES + "\nangle_zero_deg = 7")
    found, _ = calibration(relief)
    assert found["from_surface"]
    assert found["zero_error_deg"] == pytest.approx(7, abs=0.3)
    assert any("zero of the polarizer's scale" in warning for warning in found["warnings"])
    found, _ = calibration(relief, "--set", "polarizer.calibrate_angles=off")
    assert not found["from_surface"]
    assert found["angles_deg"][1] == pytest.approx(23)
    assert any("zero of the polarizer's scale" in warning for warning in found["warnings"])


def test_wrong_zero_is_corrected_on_arrays(relief: Path) -> None:
    """Only the run of a station could."""
    coarse = malus.reconstruct(malus.Station.load(relief), until="prior", threads=2)
    assert coarse.prior_depth is not None and coarse.camera is not None
    normals = malus.surface.normals_from_depth(coarse.prior_depth, coarse.camera)
    readings = np.arange(0.0, 180.0, 30.0)
    images = [_core.read_image_dn(str(path))[0] / 16383 for path in sorted((relief.parent / "pol").glob("*.png"))]
    state = malus.polarization.decompose(images, np.radians(readings - 7), frames_averaged=16)
    light = malus.height.light(state.unpolarized, normals, camera=coarse.camera)["light"][:3]
    given: dict[str, Any] = {"camera": coarse.camera, "light": light}
    corrected, found = malus.polarization.calibrate_with_surface(state, normals, **given)
    assert found["from_surface"] and found["surface_check"] == "ok"
    assert found["zero_error_deg"] == pytest.approx(7, abs=0.5)
    turned = (corrected.phase_rad - state.phase_rad + np.pi / 2) % np.pi - np.pi / 2
    assert np.degrees(np.nanmedian(turned)) == pytest.approx(7, abs=0.5)

    kept = malus.Options(polarizer={"calibrate_angles": "off"})
    unchanged, found = malus.polarization.calibrate_with_surface(state, normals, options=kept, **given)
    assert not found["from_surface"] and any("zero of the polarizer's scale" in line for line in found["warnings"])
    np.testing.assert_array_equal(unchanged.phase_rad, state.phase_rad)
    backwards = malus.polarization.decompose(images, -np.radians(readings), frames_averaged=16)
    with pytest.raises(malus.InputError, match="the wrong way round"):
        malus.polarization.calibrate_with_surface(backwards, normals, **given)
    with pytest.raises(ValueError, match=r"normals has shape \(10, 10, 3\), expected"):
        malus.polarization.calibrate_with_surface(state, normals[:10, :10])


def test_correct_angles_are_not_changed_by_a_wide_highlight(tmp_path: Path) -> None:
    station = write_station(tmp_path / "station", 612, 408, prior="depth")
    found, _ = calibration(station)
    assert not found["from_surface"]
    assert found["angles_deg"] == pytest.approx(range(0, 180, 30))
    assert not found["warnings"]


def test_wrong_angle_direction_is_an_error(relief: Path) -> None:
    edit(relief, 'angle_direction = "ccw"', 'angle_direction = "cw"')
    work = relief.parent / "work"
    outcome = malus_station(relief, "-o", work)
    assert outcome.code == 2
    assert "angle_direction is the wrong way round" in outcome.err
    assert not (work / "fused/depth.tif").exists()
    assert not (work / "quality.json").exists()


@pytest.mark.parametrize(
    ("read_off", "errors", "least", "most"),
    [
        ([0, 60, 120], [2, -3, 1], 2.9, 3.1),
        ([0, 45, 90, 135], [2, -3, 1, 0], 0.3, 2.0),
        ([0, 36, 72, 108, 144], [2, -3, 1, 1, -1], 0.0, 0.2),
    ],
    ids=["three: not at all", "four: in part", "five: found"],
)
def test_five_images_determine_reading_errors_and_four_in_part(
    read_off: list[float], errors: list[float], least: float, most: float
) -> None:
    """As docs/capture.md says."""
    v, u = np.mgrid[:120, :160]
    intensity = 0.5 + 0.2 * np.sin(u / 17) * np.cos(v / 23)
    degree, azimuth = 0.125 * (1 + np.sin(u / 31 + v / 19)), u / 40 + v / 29
    turned = np.radians(np.add(read_off, errors))
    noise = np.random.default_rng(1).normal(0, 1e-3, (len(turned), *u.shape))
    images = intensity * (1 + degree * np.cos(2 * (turned[:, None, None] - azimuth))) / 2 + noise
    found = malus.polarization.calibrate(images, np.radians(read_off), full_well_e=1e6, threads=1)
    left = np.degrees(found["angles_rad"] - turned)
    assert least <= np.abs(left - left.mean()).max() <= most


def test_unknown_angles_need_five_images(relief: Path) -> None:
    text = relief.read_text()
    start = text.index("images = [")
    text = (
        text[:start]
        + 'images = ["pol/pol_000.png", "pol/pol_030.png", "pol/pol_060.png"]'
        + text[text.index("]", start) + 1 :]
    )
    relief.write_text(text.replace(ANGLES, 'angles_deg = "auto"'))
    outcome = malus_station(relief, "-o", relief.parent / "work")
    assert outcome.code == 3
    assert "at least 5 polarizer positions" in outcome.err


def test_unknown_angles_cannot_be_left_uncalibrated(relief: Path) -> None:
    edit(relief, ANGLES, 'angles_deg = "auto"')
    outcome = malus_station(relief, "-o", relief.parent / "work", "--set", "polarizer.calibrate_angles=off")
    assert outcome.code == 2
    assert "calibrate_angles" in outcome.err


def test_angles_in_another_order_are_reported_but_not_adopted(relief: Path) -> None:
    edit(relief, ANGLES, "angles_deg = [0, 90, 60, 30, 120, 150]")
    outcome = malus_station(relief, "-o", relief.parent / "work", "--until", "polarizer")
    assert outcome.code == 0, outcome.err
    assert "in the order of the images" in outcome.err
    manifest = json.loads((relief.parent / "work/manifest.json").read_text())
    assert not manifest["steps"]["polarizer"]["notes"]["calibration"]["from_images"]


def test_many_pixels_off_the_sinusoid_are_reported(relief: Path) -> None:
    brighten(relief.parent / "pol/pol_060.png", 0.8)
    options = ("--set", "polarizer.calibrate_angles=off")
    outcome = malus_station(relief, "-o", relief.parent / "work", "--until", "polarization", *options)
    assert outcome.code == 0, outcome.err
    assert "do not follow the polarizer's sinusoid" in outcome.err
