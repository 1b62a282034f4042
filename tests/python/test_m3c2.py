"""M3C2 against a scan whose distance is known by construction."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile

import malus
from conftest import malus_here
from malus import m3c2

# The packages that py4dgeo imports warn about each other.
uses_py4dgeo = pytest.mark.filterwarnings("ignore")


@pytest.fixture
def work(finished_grid: Path, tmp_path: Path) -> Path:
    shutil.copytree(finished_grid, tmp_path / "work")
    return tmp_path / "work"


def scan_behind(work: Path, distance: float, path: Path) -> Path:
    """The surface's points moved away from the camera along the mean normal, as XYZ text."""
    cloud = malus.exports.Exporter(malus.Workspace(work)).mesh()
    normal = cloud.normals.astype(float).mean(0)
    normal /= np.linalg.norm(normal)
    np.savetxt(path, cloud.vertices - distance * normal, "%.6f")
    return path


@uses_py4dgeo
def test_distance_to_a_moved_copy_is_the_motion(
    work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("py4dgeo")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    figures = m3c2.compare(work, scan_behind(work, 0.2, tmp_path / "scan.xyz"))
    assert capsys.readouterr() == ("", "")
    assert not list(Path().iterdir())
    gsd = malus.Workspace(work).quality["gsd"]
    distance = tifffile.imread(work / "fused/m3c2_distance.tif")
    assert distance.shape == (160, 200)
    # The surface is in front of the scan: positive. Slopes make the distance along the normal a little shorter.
    assert np.nanmedian(distance) == pytest.approx(0.2, rel=0.1)
    assert figures["distance_gsd"]["median"] == pytest.approx(np.nanmedian(distance) / gsd, rel=1e-3)
    assert figures["compared_fraction"] > 0.95
    assert json.loads((work / "m3c2.json").read_text()) == figures
    malus.write_report(work)
    page = (work / "report/index.html").read_text()
    assert f'data-path="m3c2.distance_gsd.median">{figures["distance_gsd"]["median"]:.3g}<' in page
    assert (work / "report/figures/m3c2_distance.png").exists()
    # A new surface makes the distances of the old one invalid.
    station = malus.Workspace(work).manifest["station"]["file"]
    changed = malus_here("run", station, "-o", work, "--fusion", "grid", "--set", "prior.smoothing_px=4", "--quiet")
    assert changed.code == 0, changed.err
    assert not (work / "m3c2.json").exists() and not (work / "fused/m3c2_distance.tif").exists()
    assert "m3c2" not in (work / "report/index.html").read_text()


@uses_py4dgeo
def test_a_scan_elsewhere_is_refused(work: Path, tmp_path: Path) -> None:
    pytest.importorskip("py4dgeo")
    with pytest.raises(malus.DataError, match="same frame and unit"):
        m3c2.compare(work, scan_behind(work, 1e4, tmp_path / "scan.xyz"))
    assert not (work / "m3c2.json").exists()


@uses_py4dgeo
def test_a_scan_that_was_changed_since_it_was_assessed_is_refused(work: Path, tmp_path: Path) -> None:
    """Its distances would be those of one scan in the place of another."""
    pytest.importorskip("py4dgeo")
    scan = scan_behind(work, 0.2, tmp_path / "scan.xyz")
    station = malus.Workspace(work).manifest["station"]["file"]
    assert malus_here("assess", station, "-o", work, "--fusion", "grid", "--reference", scan, "--quiet").code == 0
    m3c2.compare(work, scan)
    scan_behind(work, 0.3, scan)
    with pytest.raises(malus.InputError, match="was changed since"):
        m3c2.compare(work, scan)


@pytest.mark.parametrize("step", [1, 2, 3, 10])
def test_each_pixel_has_the_value_of_the_nearest_core_point(step: int) -> None:
    """Maps and changed parts of large stations lay up to half a block right of and below their place (4.5 pixels of 18 megapixels)."""
    row, column = np.indices((47, 61))
    for place in (row, column):
        spread = m3c2.spread_out(place[::step, ::step].ravel().astype(float), step, np.ones(place.shape, bool))
        assert spread.shape == place.shape and spread.dtype == np.float32
        off = (spread - place)[:-step, :-step]
        assert np.abs(off).max() <= step // 2 and abs(off.mean()) <= 1


@pytest.mark.parametrize(("spacing", "part"), [(1, 1.0), (1, 0.3), (3, 1.0), (3, 0.5)])
def test_the_spacing_of_a_scan_is_that_where_it_has_points(work: Path, spacing: int, part: float) -> None:
    """The scan of a part counted as one of the whole with points far apart, that of an object with its other side as a denser one."""
    points = malus.Workspace(work).points()
    rows, columns = (int(part * side) for side in points.shape[:2])
    front = points[:rows:spacing, :columns:spacing].reshape(-1, 3)
    front = front[np.isfinite(front).all(1)]
    rotation = malus.Workspace(work).pose[0]
    gsd = malus.Workspace(work).quality["gsd"]
    back = points[np.isfinite(points).all(-1)] + 60 * gsd * rotation[2]
    found = m3c2._spacing_px(malus.Workspace(work), np.concatenate([front, back]))
    assert found == pytest.approx(spacing, rel=0.15)


def test_the_direction_of_positive_distances_is_aligned_as_the_points_are() -> None:
    motion = {"scale": 2.0, "rotation": [1, 0, 0, 0, 0, -1, 0, 1, 0], "translation": [1, 2, 3]}
    point, towards = np.array([[0.0, 0.0, 5.0]]), np.array([0.0, 0.0, -1.0])
    moved, turned = m3c2._aligned(point, towards, {"reference_from_surface": motion})
    nearer, _ = m3c2._aligned(point + towards, towards, {"reference_from_surface": motion})
    np.testing.assert_allclose((nearer - moved)[0], 2 * turned)


def test_distances_without_a_limit_are_not_called_insignificant() -> None:
    """They counted as below their limit, although a cylinder with too few points has none."""
    found, limits = np.array([2.0, 0.1, 3.0, 4.0, np.nan]), np.array([1.0, 1.0, np.nan, np.nan, np.nan])
    figures = m3c2._summary(found, limits, 1.0)
    assert figures["significant_fraction"] == 0.5
    assert figures["compared_fraction"] == 0.8 and figures["distance_gsd"]["count"] == 4
    assert m3c2._summary(found, np.full(5, np.nan), 1.0)["significant_fraction"] is None


def test_m3c2_without_a_reference_is_refused(small_station: Path, tmp_path: Path) -> None:
    outcome = malus_here("assess", small_station, "-o", tmp_path / "work", "--m3c2")
    assert outcome.code == 2 and "--reference" in outcome.err


def test_missing_py4dgeo_is_named(work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "py4dgeo", None)
    with pytest.raises(malus.ExternalError, match=r"py4dgeo.*malus\[m3c2\]"):
        m3c2.compare(work, work / "fused/surface.ply")


def test_missing_py4dgeo_is_named_before_the_run(
    small_station: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "py4dgeo", None)
    cloud = small_station.parent / "dense/cloud.ply"
    outcome = malus_here("assess", small_station, "-o", tmp_path / "work", "--reference", cloud, "--m3c2")
    assert outcome.code == 4 and "malus[m3c2]" in " ".join(outcome.err.split())
    assert not (tmp_path / "work").exists()
