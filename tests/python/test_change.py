"""Two dates of one object whose difference is known by construction: a stone, and the same stone with a dent and a lump."""

from __future__ import annotations

import csv
import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

import malus
from conftest import DENT, LATER, LUMP, malus_here
from malus.change import Change
from malus.change.regions import find_regions
from malus.change.registration import _from_features, register
from malus.change.run import _warnings
from malus.change.significance import Distances, measure
from malus.exports.exporter import Exporter

pytest.importorskip("py4dgeo")
pytest.importorskip("cv2")


@pytest.fixture(scope="module")
def outcome(dates: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("compared") / "change"
    told = malus_here("compare", *dates, "-o", folder, "--threads", "2")
    assert told.code == 0, told.err
    return folder, told.out


def test_dent_and_lump_are_found_with_their_depth(dates: tuple[Path, Path], outcome: tuple[Path, str]) -> None:
    folder, told = outcome
    gsd = malus.Workspace(dates[0]).quality["gsd"]
    figures = json.loads((folder / "change.json").read_text())
    found = {
        tuple(sorted((DENT, LUMP), key=lambda c: np.hypot(c[0][0] - r["u"], c[0][1] - r["v"]))[0]): r
        for r in figures["regions"]
    }
    assert len(figures["regions"]) == 2 and set(found) == {DENT, LUMP}
    distance, limit = (tifffile.imread(folder / f"{name}.tif") for name in ("distance", "limit"))
    v, u = np.indices(distance.shape)
    for ((u0, v0, radius), deep), region in found.items():
        inner = np.hypot(u - u0, v - v0) < radius - 6
        # The measured depth is the true one within the detection limit that the comparison states.
        assert abs(np.median(distance[inner]) + deep * gsd) < np.median(limit[inner]) < 2 * gsd
        assert abs(region["u"] - u0) < 3 and abs(region["v"] - v0) < 3
        area = np.pi * radius**2 * (gsd**2)
        assert region["area_mm2"] == pytest.approx(area, rel=0.4)
        assert np.sign(region["volume_mm3"]) == -np.sign(deep)
    untouched = np.ones(distance.shape, bool)
    for (u0, v0, radius), _ in (DENT, LUMP):
        untouched &= np.hypot(u - u0, v - v0) > radius + 12
    known = untouched & np.isfinite(distance)
    assert known.sum() > 0.75 * distance.size
    # Where nothing changed, few pixels are called significant.
    assert (np.abs(distance) > limit)[known].mean() < 0.05
    assert "2 changed parts" in told and "lost" in told and "added" in told


def test_registration_by_features_recovers_the_frame(dates: tuple[Path, Path], outcome: tuple[Path, str]) -> None:
    figures = json.loads((outcome[0] / "change.json").read_text())
    registration = figures["registration"]
    rotation, translation = LATER
    # Both cameras stand at the same place, so the earlier world frame is the later camera's frame.
    assert registration["by"] == "features"
    # Stereo errors of half a GSD over a hundred pixels tilt both surfaces.
    np.testing.assert_allclose(registration["rotation"], rotation, atol=5e-3)
    gsd = malus.Workspace(dates[0]).quality["gsd"]
    middle = malus.Workspace(dates[1]).surface().depth.mean()
    at = rotation.T @ (np.array([0, 0, middle]) - translation)
    moved = np.array(registration["rotation"]) @ at + registration["translation"]
    np.testing.assert_allclose(moved, [0, 0, middle], atol=gsd)
    assert registration["size_after_over_before"] == pytest.approx(1, abs=2e-3)


def test_frames_far_from_the_origin_are_found_by_features(
    dates: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with coordinates of a national grid: 5000 km from its origin."""
    before, after = (Exporter(malus.Workspace(work)) for work in dates)
    near = _from_features(before, after)
    far = np.array([5e8, 5.4e9, 3e5])
    points = malus.Workspace.points
    monkeypatch.setattr(malus.Workspace, "points", lambda *given: points(*given) + far)
    found = _from_features(before, after)
    assert near is not None and found is not None
    assert found[1] > 0.9 * near[1] and found[2] == pytest.approx(near[2], abs=1e-3)
    np.testing.assert_allclose(found[0].rotation, near[0].rotation, atol=1e-3)


def test_files_are_readable_by_other_programs(dates: tuple[Path, Path], outcome: tuple[Path, str]) -> None:
    rasterio = pytest.importorskip("rasterio")
    folder, _ = outcome
    with rasterio.open(folder / "distance_dem.tif") as file, rasterio.open(dates[0] / "fused/dem.tif") as dem:
        assert file.transform == dem.transform and file.shape == dem.shape
        assert np.nanmin(file.read(1)) < -3 * malus.Workspace(dates[0]).quality["gsd"]
    with (folder / "regions.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert [row["number"] for row in rows] == ["1", "2"] and float(rows[0]["area_mm2"]) > 0
    page = (folder / "index.html").read_text()
    assert page.count("data:image/webp") == 5 and "http" not in page.replace("http://www.w3.org", "")
    assert not re.search(r"\de[+-]\d", re.sub(r"data:image/webp[^\"]*|<script.*?</script>", "", page, flags=re.DOTALL))
    assert f", {dates[0].name}. After: " in page and 'class="bar"' in page
    assert {path.name for path in (folder / "figures").iterdir()} == {
        f"{name}.{kind}" for name in ("distance", "significant", "limit") for kind in ("png", "csv")
    }


def test_only_regions_that_chance_does_not_explain_are_reported(dates: tuple[Path, Path]) -> None:
    before = Exporter(malus.Workspace(dates[0]))
    gsd = float(before.workspace.quality["gsd"])
    limit = np.full(before.surface.depth.shape, gsd, np.float32)
    distance = np.zeros_like(limit)
    distance[20:26, 20:26] = (
        1.4 * gsd
    )  # 1.5 sections of a cylinder of radius 2.8 px: chance among the 1700 independent places here
    distance[20:28, 60:68] = 2 * gsd
    distance[80:120, 80:120] = -1.4 * gsd
    found = find_regions(before, Distances(distance, limit, before.surface.depth, 2.8 * gsd))
    assert sorted((round(region.u), round(region.v)) for region in found) == [(64, 24), (100, 100)]


def test_the_largest_distance_of_a_part_is_its_largest(dates: tuple[Path, Path]) -> None:
    """A scratch in a dent, less than a hundredth of its area, was cut off."""
    before = Exporter(malus.Workspace(dates[0]))
    gsd = float(before.workspace.quality["gsd"])
    limit = np.full(before.surface.depth.shape, gsd, np.float32)
    distance = np.zeros_like(limit)
    distance[80:120, 80:120] = -1.4 * gsd
    distance[90:93, 90:93] = -3 * gsd
    (region,) = find_regions(before, Distances(distance, limit, before.surface.depth, 2.8 * gsd))
    assert region.extreme_um == pytest.approx(-3000 * gsd, rel=1e-5)
    assert region.mean_um == pytest.approx(-1409 * gsd, rel=1e-2)


def test_a_surface_compared_with_itself_shows_no_change(
    dates: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(dates[0])
    change = malus.compare(".", dates[0], tmp_path / "none", threads=2)
    page = (tmp_path / "none/index.html").read_text()
    assert f", {dates[0].name}. After: " in page and "by them lengths on the later one differ by " in page
    gsd = malus.Workspace(dates[0]).quality["gsd"]
    assert change.regions == [] and np.nanmax(np.abs(change.distance)) < 0.2 * gsd
    assert np.nanmedian(np.abs(change.distance)) < 0.02 * gsd
    assert "no change" in malus.change.change_summary(change.figures)[0]
    # A comparison may overwrite the folder of an earlier one, but no other folder.
    malus.compare(dates[0], dates[0], tmp_path / "none", same_frame=True, threads=2)
    with pytest.raises(malus.InputError, match="is there already"):
        malus.compare(dates[0], dates[0], dates[1])
    assert (dates[1] / "quality.json").exists()


def test_a_folder_that_holds_a_workspace_is_not_replaced(dates: tuple[Path, Path], tmp_path: Path) -> None:
    shutil.copytree(dates[0], tmp_path / "work")
    (tmp_path / "change.json").write_text("{}")
    for works in ((tmp_path / "work", dates[1]), (dates[1], tmp_path / "work")):
        with pytest.raises(malus.InputError, match="holds the workspace"):
            malus.compare(*works, tmp_path)
    assert (tmp_path / "work/quality.json").exists()


def test_same_frame_refuses_surfaces_in_different_frames(dates: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(malus.DataError, match="does not lie on that of"):
        malus.compare(*dates, tmp_path / "elsewhere", same_frame=True)
    assert not (tmp_path / "elsewhere").exists()


def test_an_offset_between_surfaces_in_the_same_frame_gives_a_warning(dates: tuple[Path, Path]) -> None:
    before, after = (Exporter(malus.Workspace(dates[0])) for _ in range(2))
    gsd = before.workspace.quality["gsd"]
    surface = after.surface
    after.surface = malus.fusion.FusedSurface(surface.depth - 4 * gsd, surface.normals, surface.sigma, surface.camera)
    registration = register(before, after, same_frame=True, threads=2)
    assert registration.offset == pytest.approx(4 * gsd, rel=0.05)
    (warning,) = _warnings(before, after, registration)
    assert "in front of the earlier one" in warning
    as_before = register(before, before, same_frame=True, threads=2)
    assert _warnings(before, before, as_before) == []
    (warning,) = _warnings(before, before, replace(as_before, size=1.0041))
    assert "differ by +0.41 % from those on the earlier one" in warning


def test_limit_without_scatter_includes_the_registration_error(
    dates: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = Exporter(malus.Workspace(dates[0]))
    gsd = before.workspace.quality["gsd"]
    registration = replace(register(before, before, same_frame=True, threads=2), error=0.5 * gsd)
    monkeypatch.setattr(
        malus.m3c2, "distances", lambda *given, **options: (np.zeros(len(given[2])), np.full(len(given[2]), np.nan))
    )
    found = measure(before, before, registration, 2)
    expected = 1.96 * (np.sqrt(2) * before.surface.sigma + 0.5 * gsd)
    inner = (slice(4, -4), slice(4, -4))
    assert np.nanmedian(np.abs(found.limit / expected - 1)[inner]) < 0.01


def test_features_of_large_views_are_found_in_smaller_pictures(
    dates: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 100 megapixels SIFT would take 30 GB."""
    before, after = (Exporter(malus.Workspace(work)) for work in dates)
    whole = _from_features(before, after)
    monkeypatch.setattr(malus.change.registration, "_FEATURES_SIDE_PX", 120)
    found = _from_features(before, after)
    assert whole is not None and found is not None and found[1] < whole[1] / 2
    middle = np.nanmean(after.workspace.points(), axis=(0, 1))
    gsd = before.workspace.quality["gsd"]
    np.testing.assert_allclose(found[0].apply(middle), whole[0].apply(middle), atol=gsd)


def test_every_distance_at_the_rim_of_an_object_has_a_limit(
    dates: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A missing deviation beside the rim made the limit there NaN, and with it the figures of the whole comparison."""
    raster = malus.Workspace.raster

    def masked(workspace: malus.Workspace, name: str) -> np.ndarray:
        found = raster(workspace, name).copy()
        v, u = np.indices(found.shape[:2])
        if name.startswith("fused/"):
            found[np.hypot(u - found.shape[1] / 2, v - found.shape[0] / 2) > 50] = np.nan
        return found

    monkeypatch.setattr(malus.Workspace, "raster", masked)
    before = Exporter(malus.Workspace(dates[0]))
    found = measure(before, before, register(before, before, same_frame=True, threads=2), 2)
    compared = np.isfinite(found.distance)
    assert compared.sum() > 0.99 * np.isfinite(before.surface.depth).sum()
    np.testing.assert_array_equal(np.isfinite(found.limit), compared)


@pytest.mark.parametrize("option", ["--json", "--quiet"])
def test_json_and_quiet_output_keep_every_warning(tmp_path: Path, option: str, monkeypatch: pytest.MonkeyPatch) -> None:
    change = Change(np.zeros(0), np.zeros(0), [], {"warnings": ["one [thing]", "another"]}, tmp_path)
    monkeypatch.setattr(malus, "compare", lambda *given, **options: change)
    told = malus_here("compare", "a", "b", option)
    assert told.code == 0
    if option == "--json":
        events = [json.loads(line) for line in told.out.splitlines()]
        assert [event["message"] for event in events if event.get("level") == "warning"] == ["one [thing]", "another"]
    else:
        assert told.out == "" and told.err.splitlines() == ["warning: one [thing]", "warning: another"]


def test_missing_package_is_named(dates: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(malus.ExternalError, match=r"opencv-contrib.*malus\[compare\]"):
        malus.compare(*dates, tmp_path / "out")
