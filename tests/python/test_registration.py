"""A reference in any pose is registered onto a surface; a reference that does not match is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import malus
from conftest import QUICK_WORDS, malus_here
from malus import registration
from malus.object.ply import columns, write_ply
from malus.registration import place_reference

CAMERA = np.array([0.0, 0.0, 1.0])


def relief(seed: int, side: int = 90) -> np.ndarray:
    """Bumps on a square of 60 × 40, seen from +z: N×3."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-30, 30, side), np.linspace(-20, 20, side))
    z = np.zeros_like(x)
    for _ in range(25):
        u, v, height, width = random.uniform((-28, -18, -2, 2), (28, 18, 2, 6))
        z += height * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * width**2))
    return np.stack([x, y, z], -1).reshape(-1, 3)


def turned(points: np.ndarray, degrees: float, axis: tuple[float, float, float]) -> np.ndarray:
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return points @ rotation.T


@pytest.mark.parametrize("axis", [(0, 0, 1), (1, 0, 0), (0.48, 0.6, 0.64)])
def test_a_reference_turned_by_90_degrees_and_moved_by_its_size_is_found(axis: tuple[float, float, float]) -> None:
    surface = relief(1)
    scan = relief(1, 150)
    moved = turned(scan, 90, axis) + np.array([60, -40, 60])
    noisy = surface + np.random.default_rng(5).normal(0, 0.02, surface.shape)
    found = place_reference(noisy, CAMERA, moved)
    back = moved @ found.rotation.T + found.translation
    # The cells of the last search are 0.5 wide; ICP, which follows in the comparison, makes the pose exact.
    assert np.sqrt(((back - scan) ** 2).sum(1).mean()) < 0.25
    assert found.correlation > 0.98 and np.linalg.det(found.rotation) == pytest.approx(1)


def test_a_reference_that_is_larger_than_the_surface_is_found() -> None:
    scan = relief(2, 200)
    inside = (np.abs(scan[:, 0] - 5) < 20) & (np.abs(scan[:, 1] + 3) < 15)
    moved = turned(scan, 130, (0.2, -0.5, 1)) + np.array([0, 500, 0])
    found = place_reference(scan[inside][::3], CAMERA, moved)
    assert np.sqrt(((moved @ found.rotation.T + found.translation - scan) ** 2).sum(1).mean()) < 0.4


@pytest.mark.parametrize("unit", [1000, 0.001])
def test_the_place_does_not_depend_on_the_unit(unit: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """In micrometers the last steps turned the reference, but did not shift it."""
    monkeypatch.setattr(registration, "_DIRECTIONS", 4)
    scan = relief(1, 150)
    moved = turned(scan, 33, (0, 0, 1)) + np.array([60, -40, 60])
    found = place_reference(unit * relief(1), CAMERA, unit * moved)
    back = unit * moved @ found.rotation.T + found.translation
    assert np.sqrt(((back / unit - scan) ** 2).sum(1).mean()) < 0.1


def test_another_object_is_refused() -> None:
    with pytest.raises(malus.DataError, match="no place of the reference stands out"):
        place_reference(relief(1), CAMERA, relief(3, 150))


def test_a_rotationally_symmetric_shape_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registration, "_DIRECTIONS", 12)
    x, y = np.meshgrid(np.linspace(-1, 1, 120), np.linspace(-1, 1, 120))
    cap = np.stack([x, y, np.sqrt(4 - x**2 - y**2)], -1).reshape(-1, 3)[(x**2 + y**2 < 1).ravel()]
    with pytest.raises(malus.DataError, match="looks alike in several directions"):
        place_reference(cap, CAMERA, cap)


def test_another_unit_is_refused() -> None:
    with pytest.raises(malus.DataError, match="times as large as the surface"):
        place_reference(relief(1), CAMERA, 1000 * relief(1))


def test_arrays_of_a_wrong_shape_are_named() -> None:
    with pytest.raises(ValueError, match=r"reference has shape \(3, 100\), expected \(N, 3\)"):
        place_reference(relief(1), CAMERA, relief(1)[:100].T)


def test_the_command_finds_the_place_of_a_scan(small_station: Path, tmp_path: Path) -> None:
    """The fused surface itself, rotated and moved away, is brought back to its place."""
    work = tmp_path / "work"
    assert malus_here("fuse", small_station, "-o", work, *QUICK_WORDS, "--threads", "2", "--quiet").code == 0
    points = malus.Workspace(work).points().reshape(-1, 3)
    points = points[np.isfinite(points).all(1)]
    scan = tmp_path / "scan.xyz"
    np.savetxt(scan, turned(points, 90, (0.1, 0.2, 1)) + np.array([300, -200, 100]))
    outcome = malus_here("assess", small_station, "-o", work, "--reference", scan, "--register", *QUICK_WORDS)
    assert outcome.code == 0, outcome.err
    quality = json.loads((work / "quality.json").read_text())
    assert quality["reference"]["compared_fraction"] > 0.99
    assert quality["reference"]["distance_gsd"]["rmse"] < 0.05
    found = json.loads((work / "reference/registration.json").read_text())
    assert found["correlation"] > 0.99 and found["next_best"] < found["correlation"]
    alone = malus_here("assess", small_station, "-o", work, "--register", *QUICK_WORDS)
    assert alone.code == 2 and "--register needs a reference" in alone.err
    # What was registered stays as long as it is the reference, and no longer.
    placed = work / "reference/registered.ply"
    for words in (("--reference", placed), ()):
        assert (work / "reference/registration.json").exists() and placed.exists()
        later = malus_here("assess", small_station, "-o", work, *words, *QUICK_WORDS)
        assert later.code == 0, later.err
    assert not (work / "reference").exists()


@pytest.mark.parametrize(
    ("reference", "left"),
    [
        (None, set()),
        ("scan.ply", {"scan.ply"}),
        ("registered.ply", {"registered.ply", "registration.json", "scan.ply"}),
    ],
)
def test_files_of_an_earlier_reference_go(tmp_path: Path, reference: str | None, left: set[str]) -> None:
    folder = tmp_path / "reference"
    folder.mkdir()
    for name in ("registered.ply", "registration.json", "scan.ply"):
        (folder / name).touch()
    registration.forget_registration(tmp_path, None if reference is None else folder / reference)
    assert {path.name for path in folder.glob("*")} == left and folder.exists() == bool(left)
    registration.forget_registration(tmp_path / "none", None)


def test_a_registered_mesh_is_still_a_mesh(
    finished_grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its vertices alone, which may lie far apart, would be compared as a cloud."""
    work = shutil.copytree(finished_grid, tmp_path / "work")
    mesh = malus.exports.Exporter(malus.Workspace(work)).mesh()
    turn, shift = turned(np.eye(3), 30, (0, 0, 1)).T, np.array([300.0, -200, 100])
    placement = registration.Placement(turn, shift, 0.99, 0.5)
    monkeypatch.setattr(registration, "place_reference", lambda *_: placement)
    write_ply(tmp_path / "scan.ply", columns("xyz", mesh.vertices, "f8"), mesh.triangles, "scan")
    registered = registration.register_reference(work, tmp_path / "scan.ply")
    points, triangles = malus._core.read_cloud_or_mesh(str(registered))
    np.testing.assert_allclose(points, mesh.vertices @ turn.T + shift)
    np.testing.assert_array_equal(triangles, mesh.triangles)


def test_a_reference_that_is_nowhere_near_does_not_end_the_run(
    finished_grid: Path, small_station_source: Path, tmp_path: Path
) -> None:
    """Such as a scan in another unit or frame."""
    np.savetxt(tmp_path / "scan.xyz", relief(1) + 1e4)
    work, station = shutil.copytree(finished_grid, tmp_path / "work"), small_station_source / "station.toml"
    outcome = malus_here(
        "run", station, "-o", work, "--fusion", "grid", "--reference", tmp_path / "scan.xyz", "--threads", "2"
    )
    assert outcome.code == 0, outcome.err
    assert "distance to the reference: no pixel near the reference" in outcome.out
    assert "expected in the station's unit and frame" in " ".join(outcome.err.split())
    assert "no pixel near the reference" in (work / "report/index.html").read_text(encoding="utf-8")


def test_thinning_counts_only_points_that_the_surface_has(
    finished_grid: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nine tenths of the surface are missing, but as many points are compared as for a whole surface."""
    points = malus.Workspace(finished_grid).points()
    holes = np.where(np.random.default_rng(1).random(points.shape[:2]) < 0.9, np.nan, 1.0)
    monkeypatch.setattr(malus.Workspace, "points", lambda _: points * holes[..., None])
    monkeypatch.setattr(registration, "_SURFACE_POINTS", 1000)
    compared: list[int] = []

    def record(surface: np.ndarray, *_: np.ndarray) -> None:
        compared.append(len(surface))
        raise malus.DataError("enough")

    monkeypatch.setattr(registration, "place_reference", record)
    scan = tmp_path / "scan.xyz"
    np.savetxt(scan, points[np.isfinite(points).all(-1)][:10])
    with pytest.raises(malus.DataError, match="enough"):
        registration.register_reference(finished_grid, scan)
    assert 1000 <= compared[0] < 2000


@pytest.mark.parametrize("width", [600, 601, 20])
def test_points_of_a_grid_are_thinned_evenly(width: int) -> None:
    """Every n-th point of 24 megapixels, 6000 wide, lay in one of five columns."""
    rows, columns = np.divmod(np.arange(240_000), width)
    chosen = registration._some(np.stack([columns, rows, rows], -1).astype(float), 2000)
    assert len(chosen) == 2000 and len(np.unique(chosen, axis=0)) == 2000
    counts = np.histogram(chosen[:, 0], bins=20, range=(-0.5, width - 0.5))[0]
    assert counts.min() > 80 and counts.max() < 120
