"""Control points: a camera's pose, the frame of a photo model, and the messages about points that do not fit."""

from __future__ import annotations

import json
import os
import re
import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import malus as package
from conftest import EXAMPLE, demo_with_photos, malus, malus_here
from malus import _core
from malus.photogrammetry.control import adjust_datum, move_model
from malus.photogrammetry.model import SparseModel

#: Targets of the small station: column and row in its image, and depth as a share of the object's.
TARGETS = {
    "A": (12, 15, 0.9),
    "B": (185, 20, 1.1),
    "C": (190, 150, 0.95),
    "D": (20, 140, 1.08),
    "E": (110, 70, 0.88),
    "F": (70, 90, 1.01),
}


def seen(camera: package.Camera, point: np.ndarray) -> np.ndarray:
    """Pixel of a world point in a camera without distortion."""
    rotation, translation = camera.pose()
    x, y, z = rotation @ point + translation
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


def as_toml(points: dict[str, np.ndarray], pixels: dict[str, np.ndarray], check: str = "") -> str:
    return "".join(
        f'\n[[control]]\nname = "{name}"\nxyz = {xyz.tolist()}\npixel = {pixels[name].tolist()}\n'
        + ("check = true\n" if name == check else "")
        for name, xyz in points.items()
    )


def test_pose_of_a_camera_on_arrays() -> None:
    camera = package.Camera("OPENCV", 1200, 900, [2600.0, 2610.0, 595.0, 455.0, -0.05, 0.02, 1e-4, 2e-4])
    at_camera = [
        [-160, -110, 900],
        [150, -120, 1100],
        [160, 125, 950],
        [-135, 110, 1080],
        [30, -40, 880],
        [-55, 20, 1010],
    ]
    points = np.array(at_camera) + [4.3e6, 5.6e6, 0]
    truth = package.Camera("OPENCV", 1200, 900, camera.params, np.eye(3), [-4.3e6, -5.6e6, 0])
    k1, k2, p1, p2 = camera.params[4:]
    x, y, z = (points - [4.3e6, 5.6e6, 0]).T
    u, v = x / z, y / z
    r2 = u * u + v * v
    radial = 1 + k1 * r2 + k2 * r2 * r2
    pixels = np.column_stack([
        2600 * (u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)) + 595,
        2610 * (v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v) + 455,
    ])  # fmt: skip
    found, figures = camera.resected(points, pixels)
    rotation, translation = found.pose()
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(-rotation.T @ translation, -truth.pose()[1], atol=1e-2)
    assert figures["rms_px"] < 1e-3 and figures["doubtful"] is None and figures["residuals_px"].shape == (6, 2)
    pixels[4] += [9, -4]
    assert camera.resected(points, pixels)[1]["doubtful"] == 4
    with pytest.raises(ValueError, match=r"pixels has shape \(5, 2\), expected \(6, 2\)"):
        camera.resected(points, pixels[:5])
    with pytest.raises(ValueError, match=r"expected \(N, 3\)"):
        camera.resected(points[:, :2], pixels)
    with pytest.raises(package.InputError, match="at least 4"):
        camera.resected(points[:3], pixels[:3])
    points[2, 1] = np.nan
    with pytest.raises(package.InputError, match="point 2 has a coordinate or a mark that is not a finite number"):
        camera.resected(points, pixels)


@pytest.fixture
def resected(small_station: Path) -> tuple[Path, package.Camera, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The small station with a lens but no pose; its true camera, the targets' world coordinates and their pixels."""
    camera = package.Camera.from_description(package.Station.load(small_station).describe()["camera"])
    rotation, translation = camera.pose()
    depth = float((rotation @ _core.read_points(str(EXAMPLE / "dense" / "cloud.ply"))[0] + translation)[2])
    points = {}
    for name, (u, v, share) in TARGETS.items():
        ray = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1])
        points[name] = rotation.T @ (share * depth * ray - translation)
    text = small_station.read_text()
    lens = f'model = "PINHOLE"\nwidth = {camera.width}\nheight = {camera.height}\nparams = {[camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5]}\n'
    text = text.replace('colmap_model = "sparse"\nimage = "station.jpg"\n', lens)
    assert lens in text
    small_station.write_text(text)
    return small_station, camera, points, {name: seen(camera, point) for name, point in points.items()}


def test_a_station_takes_its_pose_from_its_control_points(
    resected: tuple[Path, package.Camera, dict[str, np.ndarray], dict[str, np.ndarray]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path, camera, points, pixels = resected
    monkeypatch.chdir(tmp_path)  # a check writes its picture into the current folder
    text = path.read_text()
    path.write_text(text + as_toml(points, pixels, check="F"))
    found = package.Station.load(path).describe()
    centers = [-np.array(r).T @ t for r, t in (camera.pose(), (found["camera"]["rotation"], found["camera"]["translation"]))]  # fmt: skip
    assert np.linalg.norm(centers[0] - centers[1]) < 1e-3 * np.linalg.norm(centers[0] - points["A"])
    outcome = malus_here("check", path)
    assert outcome.code == 0 and "position of the camera from 5 control points" in outcome.out

    work = tmp_path / "work"
    outcome = malus_here("run", path, "-o", work, "--fusion", "grid", "--threads", "2")
    assert outcome.code == 0, outcome.err
    control = json.loads((work / "quality.json").read_text())["control"]
    assert control["datum"] is None
    image = control["image"]
    assert image["use"] == "resection" and image["rms_px"] < 0.05 and image["doubtful"] is None
    assert [fit["name"] for fit in image["points"] if fit["check"]] == ["F"]
    page = (work / "report" / "index.html").read_text()
    assert "Control points" in page and "The pose of the camera is computed from the points" in page

    pixels["C"] += [4, 3]
    path.write_text(text + as_toml(points, pixels))
    outcome = malus_here("check", path)
    assert outcome.code == 0 and re.search(r"\[\[control\]\] C: without\s+this point", outcome.out + outcome.err)
    pixels["C"] -= [70, 50]
    path.write_text(text + as_toml(points, pixels))
    outcome = malus_here("check", path)
    assert outcome.code == 2 and "without point C the others do" in outcome.err


def model_and_points(folder: Path) -> tuple[dict[str, package.Camera], np.ndarray]:
    model = SparseModel.read(folder)
    cameras = {name: image.camera for name, image in model.images.items() if name.startswith("view")}
    cloud = _core.read_points(str(EXAMPLE / "dense" / "cloud.ply"))
    return cameras, cloud[:: len(cloud) // 6][:6]


def control_points(cameras: dict[str, package.Camera], points: np.ndarray, known: np.ndarray) -> list[dict[str, Any]]:
    """Control points as `Station.describe` lists them: points of the model, marked in four photos, with known coordinates."""
    entries = []
    for number, (place, xyz) in enumerate(zip(points, known, strict=True)):
        pixels = {name: seen(cameras[name], place) for name in sorted(cameras)[:: len(cameras) // 4][:4]}
        marks = [{"image": name, "x": float(u), "y": float(v)} for name, (u, v) in pixels.items()]
        entries.append({"name": f"P{number}", "xyz": xyz.tolist(), "pixel": None, "marks": marks, "check": False})
    return entries


def test_a_photo_model_is_brought_into_the_frame_of_known_points(tmp_path: Path) -> None:
    cameras, points = model_and_points(EXAMPLE / "sparse")
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    known = 0.31 * points @ turn.T + [1.2e6, -3e5, 40]
    entries = control_points(cameras, points, known)
    entries[5]["check"] = True
    said: list[tuple[str, str]] = []
    datum = adjust_datum(entries, cameras, 0.3, lambda level, text: said.append((level, text)))
    assert datum["scale"] == pytest.approx(0.31, rel=1e-6) and datum["sigma"] < 1e-4 and not said
    assert datum["check_rms"] == pytest.approx(0, abs=1e-4)
    np.testing.assert_allclose(datum["rotation"], turn, atol=1e-5)

    move_model(EXAMPLE / "sparse", tmp_path / "moved", datum)
    # A station of another shard may be reading what another run writes again.
    before = {path.name: path.stat().st_ino for path in (tmp_path / "moved").iterdir()}
    move_model(EXAMPLE / "sparse", tmp_path / "moved", datum)
    assert {path.name: path.stat().st_ino for path in (tmp_path / "moved").iterdir()} == before and before
    assert [path.name for path in tmp_path.iterdir()] == ["moved"]
    moved = {name: image.camera for name, image in SparseModel.read(tmp_path / "moved").images.items()}
    for entry in entries:
        for mark in entry["marks"]:
            assert np.hypot(*(seen(moved[mark["image"]], np.array(entry["xyz"])) - [mark["x"], mark["y"]])) < 0.02

    # The extent of the frame is stated without the points that only check.
    size = float(np.linalg.norm(np.ptp(known[:5], axis=0)))
    apart = [{**entry, "xyz": [*entry["xyz"][:2], entry["xyz"][2] + shift * size]} for entry, shift in
             zip(entries, [.012, -.012, .012, -.012, .012, 20], strict=True)]  # fmt: skip
    sigma = adjust_datum(apart, cameras, 0.3, lambda level, text: said.append((level, text)))["sigma"]
    assert 0.005 * size < sigma < 0.05 * size
    assert said.pop(0)[1].startswith(f"[[control]]: coordinates and marks differ by {sigma:.3g} over ")
    said.clear()

    entries[1]["xyz"][2] += 2
    datum = adjust_datum(entries, cameras, 0.3, lambda level, text: said.append((level, text)))
    assert datum["doubtful"] == "P1" and "[[control]] P1" in said[-1][1] and said[-1][0] == "warning"
    for entry in entries[2:]:
        entry["marks"] = entry["marks"][:1]
    with pytest.raises(package.InputError, match=r"2 points .* expected at least 3"):
        adjust_datum(entries, cameras, 0.3, lambda level, text: said.append((level, text)))
    assert "marked in 1 photos with a position" in said[-1][1]
    # The last one is held out.
    assert said[-1][1].endswith(": it checks nothing") and said[-2][1].endswith(": it does not give the frame")


def test_a_frame_that_exchanged_axes_turn_inside_out_is_doubted() -> None:
    cameras, points = model_and_points(EXAMPLE / "sparse")
    centers = np.array([-camera.pose()[0].T @ camera.pose()[1] for camera in cameras.values()])
    flat, tall = points * [1, 1, 0], points * [1, 1, 0] + [[0, 0, 8 * (k % 2)] for k in range(6)]
    outwards = np.diag([1, 1, 1]) if centers[:, 2].mean() > 0 else np.diag([1, -1, -1])

    def said_of(place: np.ndarray, known: np.ndarray) -> list[str]:
        said: list[str] = []
        adjust_datum(control_points(cameras, place, known), cameras, 0.3, lambda _, text: said.append(text))
        return said

    assert said_of(flat, flat @ outwards) == said_of(tall, tall @ outwards) == []
    (doubt,) = said_of(flat, (flat @ outwards)[:, [1, 0, 2]])
    assert "taken from below it" in doubt and "X and Y exchanged" in doubt
    # A wall has no side that is more likely.
    wall = flat @ outwards @ [[1, 0, 0], [0, 0, 1], [0, 1, 0]]
    assert said_of(flat, wall) == said_of(flat, wall[:, [1, 0, 2]]) == []


def test_too_few_control_points_are_reported_before_photos_are_matched(tmp_path: Path) -> None:
    station, used = demo_with_photos(tmp_path / "station")
    cameras, points = model_and_points(EXAMPLE / "sparse")
    lines = []
    for entry in control_points({name: cameras[name] for name in used}, points[:3], points[:3]):
        marks = ", ".join(f'{{ image = "{mark["image"]}", x = 4, y = 5 }}' for mark in entry["marks"])
        held_out = "check = true\n" if entry["name"] == "P2" else ""
        lines.append(f'[[control]]\nname = "{entry["name"]}"\nxyz = {entry["xyz"]}\nmarks = [{marks}]\n{held_out}')
    station.write_text(station.read_text().split("[[scale]]")[0] + "\n".join(lines))
    expected = "[[control]]: 2 points without check = true are marked in two photos or more, expected at least 3"
    for command in (("check", station), ("run", station, "-o", tmp_path / "work")):
        outcome = malus_here(*command)
        assert outcome.code == 2 and expected in " ".join(outcome.err.split()), outcome
    assert not list((tmp_path / "work").rglob("database.db"))
    station.write_text(station.read_text().replace("check = true\n", ""))
    assert "frame and size from 3 control points" in malus_here("check", station).out


@pytest.mark.skipif(
    shutil.which("colmap") is None and find_spec("pycolmap") is None, reason="neither COLMAP nor pycolmap is installed"
)
def test_photos_of_a_station_take_the_frame_of_its_control_points(tmp_path: Path) -> None:
    """The demo station with points of its own model, whose known coordinates are in a rotated and moved frame.

    With pycolmap where it is installed: what follows the cameras is the same for both. With COLMAP: test_photos.py.
    """
    backend = "colmap" if find_spec("pycolmap") is None else "pycolmap"
    station, used = demo_with_photos(tmp_path / "station")
    cameras, points = model_and_points(EXAMPLE / "sparse")
    marked = {name: cameras[name] for name in used}
    turn = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    lines = []
    for entry in control_points(marked, points, points @ turn.T + [500, 0, 0]):
        marks = ", ".join(f'{{ image = "{mark["image"]}", x = {mark["x"]}, y = {mark["y"]} }}' for mark in entry["marks"])  # fmt: skip
        lines.append(f'[[control]]\nname = "{entry["name"]}"\nxyz = {entry["xyz"]}\nmarks = [{marks}]\n')
    station.write_text(station.read_text().split("[[scale]]")[0] + "\n".join(lines))
    options = ("--set", "photos.max_features=1500", "--set", f"photos.backend={backend}", "--set", "sweep.again=false")
    options += ("--threads", str(os.cpu_count() or 1))
    outcome = malus("prior", station, "-o", tmp_path / "work", *options)
    assert outcome.code == 0, outcome
    log = (tmp_path / "work" / "prior" / "colmap" / "features.log").read_text()
    assert ("pycolmap_driver" in log) == (backend == "pycolmap")
    model = SparseModel.read(tmp_path / "work" / "prior" / "colmap" / "model")
    assert set(used) <= set(model.images)
    distance = np.linalg.norm(-np.array(cameras[used[0]].pose()[0]).T @ cameras[used[0]].pose()[1] - points[0])
    for name in used:
        centers = [-camera.pose()[0].T @ camera.pose()[1] for camera in (cameras[name], model.images[name].camera)]
        assert np.linalg.norm(turn @ centers[0] + [500, 0, 0] - centers[1]) < 1e-3 * distance
    again = malus_here("prior", station, "-o", tmp_path / "work", *options, "--json")
    steps = [json.loads(line) for line in again.out.splitlines()]
    assert any(step.get("message") == "kept from an earlier run" and step["step"] == "prior" for step in steps)
