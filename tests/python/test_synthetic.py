"""Synthetic stations follow the forward model, and the pipeline gets their surface back."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import malus
from conftest import QUICK, QUICK_WORDS, malus_here
from malus import synthetic
from malus.camera import Camera


def sphere(radius_px: float = 90, size: int = 200) -> synthetic.Scene:
    """A gray ball in the middle of the view, a plane behind it."""
    focal, distance = 2000.0, 1000.0
    camera = Camera("PINHOLE", size, size, [focal, focal, 0.5 * (size - 1), 0.5 * (size - 1)])
    v, u = np.mgrid[:size, :size]
    rays = np.stack([(u - camera.params[2]) / focal, (v - camera.params[3]) / focal, np.ones(u.shape)], -1)
    radius = radius_px * distance / focal
    a, b = (rays**2).sum(-1), distance * rays[..., 2]
    root = b**2 - a * (distance**2 - radius**2)
    depth = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, distance)
    return synthetic.Scene(depth, np.full(depth.shape, 0.5, np.float32), camera)


def test_stokes_of_a_ball() -> None:
    scene = sphere()
    matte = synthetic.Reflectance(sky=0.0, roughness=0.01, light=(0.0, 0.0, -1.0))
    bands = list(synthetic.stokes(scene, matte))
    s0, s1, s2 = (np.concatenate([band[k] for band in bands]) for k in (1, 2, 3))
    middle = (scene.camera.height - 1) / 2
    v, u = np.mgrid[: scene.camera.height, : scene.camera.width]
    radius = np.hypot(u - middle, v - middle)
    # At 45° and 60° of zenith Eq 6 gives these degrees of polarization, and the phase is the azimuth. Image y points down.
    for zenith, degree in ((45, 0.045), (60, 0.096)):
        ring = np.abs(radius - 90 * np.sin(np.deg2rad(zenith))) < 0.7
        assert np.median((np.hypot(s1, s2) / s0)[ring]) == pytest.approx(degree, abs=0.004)
        phase, azimuth = 0.5 * np.arctan2(s2, s1), np.arctan2(middle - v, u - middle)
        difference = np.angle(np.exp(2j * (phase - azimuth)))[ring] / 2
        assert np.abs(difference).max() < np.deg2rad(3)


def test_mirrored_sky_is_polarized_across_the_azimuth() -> None:
    scene = sphere()
    black = synthetic.Scene(scene.depth, np.zeros_like(scene.albedo), scene.camera)
    glass = synthetic.Reflectance(lamp=0.0, sky=1.0)
    bands = list(synthetic.stokes(black, glass))
    s0, s1, s2 = (np.concatenate([band[k] for band in bands]) for k in (1, 2, 3))
    assert np.hypot(s1, s2)[99, 164] / s0[99, 164] == pytest.approx(0.83, abs=0.03)  # 46°, Eq 8
    assert s1[99, 164] < 0  # to the right of the middle: vertical
    assert s1[35, 99] > 0  # above: horizontal


@pytest.mark.parametrize(("prior", "refinement"), [("cloud", {}), ("depth", QUICK)])
def test_station_is_reconstructed(tmp_path: Path, prior: str, refinement: dict[str, bool]) -> None:
    station = synthetic.write_station(tmp_path / prior, 160, 120, prior=prior)
    result = malus.reconstruct(malus.Station.load(station), malus.Options(fusion="refined", refine=refinement))
    truth = np.load(station.parent / "gt" / "depth_normal_mask.npz")["depth"].astype(float)
    gsd = json.loads((station.parent / "meta.json").read_text())["gsd_mm"]
    error = (np.asarray(result.depth, float) - truth)[8:-8, 8:-8] / gsd
    error -= np.median(error)
    assert 1.4826 * np.median(np.abs(error)) < 1
    described = tomllib.loads(station.read_text())
    assert len(described["polarized"]["images"]) == 6


def test_a_ball_that_stands_for_the_object_has_a_mesh(tmp_path: Path) -> None:
    """A stated deviation of 14 GSD is above the usual limit of 10 GSD: the run ended without a mesh."""
    station = synthetic.write_station(tmp_path, 120, 120, prior="depth")
    distance = float(np.median(np.load(station.parent / "gt" / "depth_normal_mask.npz")["depth"]))
    gsd = json.loads((station.parent / "meta.json").read_text())["gsd_mm"]
    ball = f"sphere = {{ center = [0, 0, {2 * distance}], radius = {distance} }}\nsigma = {14 * gsd}"
    station.write_text(re.sub("^depth = .*$", ball, station.read_text(), flags=re.MULTILINE))
    outcome = malus_here("assess", str(station), "-o", str(tmp_path / "work"), *QUICK_WORDS)
    assert outcome.code == 0, outcome.err
    assert malus.Workspace(tmp_path / "work").quality["confidence"]["level"] == "low"
    assert (tmp_path / "work/fused/surface.ply").exists()


def test_the_angles_of_a_station_may_be_of_any_type(tmp_path: Path) -> None:
    sensor = synthetic.Sensor(angles_deg=np.arange(0, 180, 45))
    station = synthetic.write_station(tmp_path, 160, 120, sensor=sensor)
    assert tomllib.loads(station.read_text())["polarized"]["angles_deg"] == [0, 45, 90, 135]


def test_repeated_exposures_have_files_of_their_own(tmp_path: Path) -> None:
    """The second image of an angle replaced the first one: both were the same, with the same noise."""
    path = synthetic.write_station(tmp_path, 120, 120, sensor=synthetic.Sensor(angles_deg=(0, 60, 120, 0)))
    images = malus.Station.load(path).describe()["images"]
    assert len(set(images)) == 4
    assert Path(images[0]).read_bytes() != Path(images[3]).read_bytes()


def test_image_size_does_not_change_the_steepness() -> None:
    steepness = []
    for width, height in ((240, 160), (720, 480)):
        scene = synthetic.relief(width, height, seed=3)
        assert scene.gsd == pytest.approx(0.06, rel=0.1)
        along = np.diff(scene.depth, axis=1) / scene.gsd
        steepness.append(np.median(np.abs(along - np.median(along))))
    assert steepness[1] == pytest.approx(steepness[0], rel=0.35)


def test_bad_arguments(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected 'cloud' or 'depth'"):
        synthetic.write_station(tmp_path, 240, 160, prior="mesh")
    with pytest.raises(ValueError, match="at least 120"):
        synthetic.write_station(tmp_path, 240, 60)
