"""malus.evidence on arrays: mistakes in the inputs are reported before anything is fused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import malus
from malus import Camera, evidence, polarization, synthetic


@pytest.fixture(scope="module")
def angles(sensor: synthetic.Sensor) -> np.ndarray:
    return np.deg2rad(sensor.angles_deg)


@pytest.fixture(scope="module")
def state(images: list[np.ndarray], angles: np.ndarray) -> polarization.PolarizationState:
    return polarization.decompose(images, angles, frames_averaged=16)


@pytest.fixture(scope="module")
def camera(scene: synthetic.Scene) -> Camera:
    return scene.camera


def points(scene: synthetic.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Points in the camera frame (N×3) and their colors as a camera without a polarizer sees them."""
    fx, fy, cx, cy = scene.camera.params
    v, u = np.indices(scene.depth.shape)
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u, float)], -1)
    colors = np.clip(255 * scene.albedo, 0, 255).astype(np.uint8)
    return (scene.depth[..., None] * rays).reshape(-1, 3), np.repeat(colors.reshape(-1, 1), 3, axis=1)


def normals(scene: synthetic.Scene) -> np.ndarray:
    grid = points(scene)[0].reshape(*scene.depth.shape, 3)
    result = np.cross(np.gradient(grid, axis=0), np.gradient(grid, axis=1))
    return result / np.linalg.norm(result, axis=-1, keepdims=True)


def test_phase_fits_the_slopes_and_contradicts_a_wrong_direction(
    scene: synthetic.Scene,
    images: list[np.ndarray],
    angles: np.ndarray,
    state: polarization.PolarizationState,
    camera: Camera,
) -> None:
    right = evidence.check_phase(state, normals(scene), camera=camera)
    assert right.severity == "note", right.message
    assert "fits the slopes" in right.message
    assert right.parts.shape == (6, 6, 4)
    wrong = polarization.decompose(images, -angles, frames_averaged=16)
    against = evidence.check_phase(wrong, normals(scene), camera=camera)
    assert against.severity == "error", against.message
    assert "angle_direction" in against.suggestion


def test_cloud_in_place_and_shifted(
    scene: synthetic.Scene, state: polarization.PolarizationState, camera: Camera
) -> None:
    cloud, colors = points(scene)
    right = evidence.check_cloud(cloud, state, camera, colors=colors)
    assert right.severity == "note", right.message
    assert right.instead == ""
    aside = evidence.check_cloud(cloud + [7 * scene.gsd, 0, 0], state, camera, colors=colors)
    assert aside.severity == "warning", aside.message
    assert aside.figures["right_px"] == pytest.approx(-7, abs=0.7)
    assert "too far right" in aside.message
    meters = evidence.check_cloud(cloud / 1000 + [0, 0, 5], state, camera, colors=colors)
    assert meters.severity != "note", meters.message


def test_depth_map_in_place(scene: synthetic.Scene, state: polarization.PolarizationState, camera: Camera) -> None:
    assert evidence.check_depth(scene.depth, state, camera).severity == "note"
    with pytest.raises(malus.InputError, match="depth map"):
        evidence.check_depth(scene.depth[:-1], state, camera)


def test_size_is_stated_and_a_wrong_unit_reported(scene: synthetic.Scene, camera: Camera) -> None:
    cloud, _ = points(scene)
    right = evidence.check_size(cloud, camera, unit="mm")
    assert right.severity == "note"
    assert "one pixel is" in right.message
    assert right.figures["gsd"] == pytest.approx(scene.gsd, rel=0.05)
    wrong = evidence.check_size(cloud / 1000, camera, unit="mm")
    assert wrong.severity == "warning"
    assert 'unit = "m"' in wrong.suggestion


def test_order_and_response(images: list[np.ndarray], angles: np.ndarray) -> None:
    assert evidence.check_order(images, angles).severity == "note"
    swapped = evidence.check_order([images[k] for k in (0, 3, 2, 1, 4, 5)], angles)
    assert swapped.severity == "warning", swapped.message
    assert np.rad2deg(swapped.angles_rad) == pytest.approx([0, 90, 60, 30, 120, 150])
    assert evidence.check_response(images, angles).severity == "note"
    with pytest.raises(malus.InputError, match='response = "gamma:0", expected "gamma:X" with X from 0.1 to 10'):
        evidence.check_response(images, angles, response="gamma:0")
    counts = [np.rint(65535 * image).astype(np.uint16) for image in images]
    assert evidence.check_order(counts, angles).message == evidence.check_order(images, angles).message
    assert evidence.check_response(counts, angles).message == evidence.check_response(images, angles).message


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda state, camera: evidence.check_cloud(np.zeros((4, 2)), state, camera), "points has shape"),
        (
            lambda state, camera: evidence.check_cloud(np.ones((4, 3)), state, camera, colors=np.zeros((3, 3))),
            "colors has shape",
        ),
        (
            lambda state, camera: evidence.check_cloud(np.ones((4, 3)), state, camera, colors=np.full((4, 3), 0.5)),
            "colors has values from 0.5 to 0.5, expected 0 to 255",
        ),
        (
            lambda state, camera: evidence.check_cloud(np.ones((4, 3)), state, camera, colors=np.full((4, 3), 40000)),
            "colors has values from 40000 to 40000, expected 0 to 255",
        ),
        (
            lambda state, camera: evidence.check_cloud(np.ones((4, 3)), state, camera, scene=np.zeros((3, 3))),
            "scene has shape",
        ),
        (
            lambda state, camera: evidence.check_cloud(np.ones((4, 3)), state, replace(camera, width=8, height=6)),
            "camera has shape",
        ),
        (lambda state, camera: evidence.check_phase(state, np.zeros((3, 3))), "normals has shape"),
        (lambda _, camera: evidence.check_size(np.zeros(3), camera), "points_in_cam has shape"),
    ],
)
def test_wrong_shapes(state: polarization.PolarizationState, camera: Camera, call: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call(state, camera)  # type: ignore[operator]
