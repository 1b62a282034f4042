"""Mistakes at the camera show in the images, and the checks report them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from conftest import Outcome, malus_station

Images = NDArray[np.float64]
ANGLES = np.deg2rad(np.arange(0, 180, 30))
WAVES = np.stack([np.ones(6), np.cos(2 * ANGLES), np.sin(2 * ANGLES)], -1) / 2


def measured(station: Path, change: Callable[[Images], Images]) -> tuple[Outcome, dict[str, Any]]:
    """Run the station with changed images (6×H×W) up to its checks; returns the outcome and the findings by check."""
    files = sorted((station.parent / "pol").glob("*.tif"))
    images = np.stack([tifffile.imread(file) for file in files]).astype(float)
    for file, image in zip(files, change(images), strict=True):
        tifffile.imwrite(file, np.rint(np.clip(image, 0, 65535)).astype(np.uint16))
    work = station.parent.parent / "work"
    outcome = malus_station(station, "-o", work, "--until", "evidence", "--threads", "2")
    assert outcome.code == 0, outcome.err
    return outcome, {found["check"]: found for found in json.loads((work / "evidence/findings.json").read_text())}


def stokes(images: Images) -> Images:
    return np.tensordot(np.linalg.pinv(WAVES), images, 1)


def test_correct_images_raise_no_finding(small_station: Path) -> None:
    _, found = measured(small_station, lambda images: images)
    assert not {"angles", "misfits", "polarization"} & set(found)


def test_a_filter_without_effect_on_polarization_is_reported(small_station: Path) -> None:
    def circular(images: Images) -> Images:
        """The images differ by noise alone: sixteen frames of 20000 electrons at 16383."""
        half = stokes(images)[0] / 2
        noise = np.random.default_rng(1).standard_normal(images.shape)
        return np.asarray(half + noise * np.sqrt(half * 16383 / 20000 / 16))

    outcome, found = measured(small_station, circular)
    assert found["polarization"]["severity"] == "caution"
    assert "nothing is polarized" in outcome.err and "circular" in outcome.err


def test_an_object_that_is_polarized_in_part_is_not_called_unpolarized(small_station: Path) -> None:
    def in_part(images: Images) -> Images:
        """The left two thirds differ by noise alone, as a background of matte paper would."""
        half = stokes(images)[0] / 2
        noise = np.random.default_rng(1).standard_normal(images.shape)
        left = np.arange(images.shape[2]) < 2 / 3 * images.shape[2]
        return np.where(left, half + noise * np.sqrt(half * 16383 / 20000 / 16), images)

    outcome, found = measured(small_station, in_part)
    assert found["polarization"]["severity"] == "caution"
    assert 0.2 < found["polarization"]["figures"]["polarized_fraction"] < 0.4
    assert "of the object is polarized beyond the noise" in outcome.err
    assert "nothing is polarized" not in outcome.err


def test_angles_that_differ_from_the_station_file_are_reported(small_station: Path) -> None:
    def turned_less(images: Images) -> Images:
        """The polarizer turns by 20° from image to image; the station file says 30°."""
        angles = ANGLES * 2 / 3
        waves = np.stack([np.ones(6), np.cos(2 * angles), np.sin(2 * angles)], -1) / 2
        return images + np.tensordot(waves - WAVES, stokes(images), 1)

    outcome, found = measured(small_station, turned_less)
    assert found["angles"]["severity"] == "caution"
    assert "the images fit other polarizer angles" in outcome.err and "(counter-clockwise)" in outcome.err
    assert found["angles"]["figures"]["largest_angle_change_deg"] > 15


@pytest.mark.parametrize(("share", "severity"), [(0.3, "caution"), (1, "warning")])
def test_a_lamp_turned_on_is_more_severe_the_more_it_lights(small_station: Path, share: float, severity: str) -> None:
    def lit(images: Images) -> Images:
        width = images.shape[2]
        lamp = np.where(np.arange(width) < share * width, np.linspace(0.1, 0.6, width), 0)
        factors = np.ones((6, 1, width))
        factors[3:] += lamp
        return np.asarray(0.5 * images * factors)

    _, found = measured(small_station, lit)
    assert found["misfits"]["severity"] == severity
