"""An object's mesh beside a reference scan: its place, distances and completeness, and references that are wrong."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from conftest import edit, malus_here
from malus import DataError, InputError, _core, registration
from malus.object import Object, joined_mesh, page, pieces, reference
from malus.object.agreement import OrientedPoints
from malus.object.meshing import ObjectMesh
from malus.object.ply import write_ply
from malus.object.reference import Reference
from test_object_detail import above

CELL = 0.5
Points = NDArray[np.float64]


def stone(points: Points) -> tuple[Points, Points]:
    """Directions (N×3) as places of an uneven stone, and its normals there."""

    def radius(direction: Points) -> Points:
        x, y, z = direction.T
        return np.asarray(10 + 2 * x + np.sin(5 * x + 2 * z) + 0.8 * np.cos(6 * y) + 0.5 * np.sin(7 * z + 3 * x))

    step = 1e-5
    at = points * radius(points)[:, None]
    sides = []
    for axis in np.eye(3):
        along = np.cross(points, axis) + 1e-3 * np.roll(axis, 1)
        along -= (along * points).sum(1, keepdims=True) * points
        near = points + step * along
        near /= np.linalg.norm(near, axis=1, keepdims=True)
        sides.append(near * radius(near)[:, None] - at)
    normals = np.stack([np.cross(sides[k], sides[k - 1]) for k in range(3)])
    normals *= np.sign((normals * points).sum(-1, keepdims=True))
    best = normals[np.linalg.norm(normals, axis=-1).argmax(0), np.arange(len(points))]
    return at, best / np.linalg.norm(best, axis=1, keepdims=True)


def directions(count: int) -> Points:
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    return np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], -1)


@pytest.fixture(scope="module")
def mesh(tmp_path_factory: pytest.TempPathFactory) -> ObjectMesh:
    """The upper part of the stone."""
    points, normals = stone(directions(30000))
    some = points[:, 2] > -5
    count = int(some.sum())
    cloud = OrientedPoints(points[some], normals[some], np.full(count, 0.1), np.ones(count, np.int64))
    return joined_mesh(pieces(cloud, CELL), tmp_path_factory.mktemp("stone"), 1.0)


@pytest.mark.parametrize("is_mesh", [True, False])
def test_distances_have_their_side_all_around_and_what_is_missing_counts(mesh: ObjectMesh, is_mesh: bool) -> None:
    larger = Reference(mesh.vertices + 0.2 * mesh.normals, mesh.triangles.astype(np.uint32) if is_mesh else None)
    beside = reference.compare(larger, mesh, CELL, 1)
    assert beside.figures["distance_gsd"]["median"] == pytest.approx(-0.4, abs=0.04)
    assert beside.figures["absolute_median_gsd"] == pytest.approx(0.4, abs=0.04)
    assert beside.figures["within_1_gsd"] > 0.99 and beside.figures["compared_fraction"] > 0.99
    assert beside.figures["completeness"]["1_gsd"] > 0.99
    whole = Reference(stone(directions(20000))[0], None)
    beside = reference.compare(whole, mesh, CELL, 1)
    assert beside.figures["within_1_gsd"] > 0.99
    # The mesh ends four cells beyond its points; what lies so many GSD further still counts.
    there = beside.figures["completeness"]
    least, most = ((whole.points[:, 2] > -5 - cells * CELL).mean() for cells in (0, 6))
    assert 0.7 < least <= there["1_gsd"] < most < 0.95
    assert there["1_gsd"] < there["2_gsd"] < there["4_gsd"] < 1


def test_triangles_of_a_reference_count_by_their_areas(mesh: ObjectMesh) -> None:
    """A corner with many small triangles on the mesh, and one large triangle elsewhere of the same size."""
    near = np.linspace(0, 1, 40)
    small = np.stack([*(axis.ravel() for axis in np.meshgrid(near, near)), np.full(1600, 40.0)], 1)
    rows = np.arange(1600).reshape(40, 40)
    fine = np.concatenate(
        [np.stack([rows[:-1, :-1], rows[1:, :-1], rows[:-1, 1:]], -1).reshape(-1, 3),
         np.stack([rows[1:, :-1], rows[1:, 1:], rows[:-1, 1:]], -1).reshape(-1, 3)]
    )  # fmt: skip
    coarse = np.array([[90.0, 0, 0], [90 + 2**0.5, 0, 0], [90, 2**0.5, 0]])
    both = Reference(np.concatenate([small, coarse]), np.concatenate([fine, [[1600, 1601, 1602]]]).astype(np.uint32))
    areas = both.areas()
    assert areas[:1600].sum() == pytest.approx(areas[1600:].sum())


def test_a_mesh_too_large_is_searched_in_parts(mesh: ObjectMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    scan = Reference(mesh.vertices + 0.2 * mesh.normals, mesh.triangles.astype(np.uint32))
    expected = reference.compare(scan, mesh, CELL, 1)
    monkeypatch.setattr(reference, "_MOST_AT_ONCE", len(mesh.vertices) // 3)
    found = reference.compare(scan, mesh, CELL, 1)
    np.testing.assert_array_equal(found.distances, expected.distances)
    assert found.figures["completeness"]["1_gsd"] == pytest.approx(expected.figures["completeness"]["1_gsd"], abs=0.02)
    # What lies far beside the mesh or in a hole of it is missing, though the planes through the vertices beside it reach there.
    near = np.linalg.norm(mesh.vertices - mesh.vertices[0], axis=1) < 6 * CELL
    torn = replace(mesh, triangles=mesh.triangles[~near[mesh.triangles].any(1)])
    used, renumbered = np.unique(torn.triangles, return_inverse=True)
    torn = replace(
        mesh, vertices=mesh.vertices[used], normals=mesh.normals[used], sigma=mesh.sigma[used],
        measured=mesh.measured[used], triangles=renumbered.reshape(-1, 3),
    )  # fmt: skip
    whole = Reference(stone(directions(20000))[0], None)
    there = reference.compare(whole, torn, CELL, 1).figures["completeness"]
    monkeypatch.undo()
    assert there == pytest.approx(reference.compare(whole, torn, CELL, 1).figures["completeness"], abs=0.015)


def test_scans_and_surfaces_in_rows_are_taken_evenly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a scan 5000 points wide, every 500th point lies in one of ten columns."""
    taken: list[Points] = []

    def placed(*points: Points) -> registration.Placement:
        taken.extend(points)
        raise DataError("nowhere")

    monkeypatch.setattr(registration, "place_reference", placed)
    monkeypatch.setattr(reference, "_REFERENCE_POINTS", 1000)
    monkeypatch.setattr(reference, "_SURFACE_POINTS", 64)
    rows, columns = np.indices((100, 500))
    scan = np.stack([columns, rows, 0 * rows], -1).reshape(-1, 3).astype(float)
    with pytest.raises(DataError, match="nowhere"):
        reference.place(Reference(scan, None), [above("a", 1.0)])
    surface, _, scan = taken
    assert len(np.unique(np.rint(surface[:, 0]))) > 40 and len(np.unique(scan[:, 0])) > 300


def test_the_map_of_a_reference_shows_what_is_in_the_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A station sees the ground; the mesh has the left half of it."""
    view = above("a", 1.0, waves=False)
    points = view.points_at(*np.indices(view.depth.shape))
    left = points[points[..., 0] < 0]
    half = ObjectMesh(left, left, np.zeros((1, 3), np.int64), np.ones(len(left)), np.ones(len(left), bool))
    monkeypatch.setattr("malus.object.arrays.CHUNK", 1000)
    (path,) = page.write_distances(tmp_path, np.zeros(len(left), np.float32), half, [view], 1.0)
    colors = np.asarray(Image.open(path)).astype(int)
    shown = (colors == colors[0, 0]).all(-1)
    assert colors[0, 0].min() > 240 and shown[points[..., 0] < 3].all()
    assert not shown[points[..., 0] > 5].any() and (colors[~shown] == colors[0, -1]).all()


def test_alignment_brings_a_scan_that_is_nearly_there_onto_the_mesh(mesh: ObjectMesh) -> None:
    scan = stone(directions(20000))[0]
    turn = np.radians(2)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    moved, _ = reference.aligned(Reference(scan, None).moved(rotation, np.array([0.3, -0.2, 0.1])), mesh, CELL, 1)
    assert np.abs(moved.points - scan).max() < 0.05
    with pytest.raises(DataError, match="no part of the mesh is within 50 GSD"):
        reference.aligned(Reference(scan + 1000, None), mesh, CELL, 1)
    with pytest.raises(DataError, match="no part of the mesh is within 50 GSD"):
        reference.compare(Reference(scan + 1000, None), mesh, CELL, 1)


def test_a_scan_that_lies_anywhere_is_compared_and_shown(pair: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The mesh itself, turned and moved: it is found again; the stations' cloud as it lies; and something else."""
    output = pair.parent / "out"
    assert malus_here("object", pair, "-o", output, "--quiet").code == 0
    scan = _core.read_points(str(output / "object/mesh.ply"))
    turn = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    moved = scan @ turn.T + np.array([400.0, 20, -3])
    write_ply(pair.parent / "scan.ply", {axis: (moved[:, k], "f8") for k, axis in enumerate("xyz")}, None, "")
    edit(pair, "closed = false", 'closed = false\nreference = "scan.ply"')
    outcome = malus_here("object", pair, "-o", output, "--threads", "1")
    assert outcome.code == 0, outcome.err
    quality = json.loads((output / "object/quality.json").read_text())
    found = quality["reference"]
    assert found["status"] == "done" and found["registered"] and found["correlation"] > 0.7
    assert found["file"] == "scan.ply" and str(pair.parent) not in (output / "object/quality.json").read_text()
    assert found["absolute_median_gsd"] < 1 and found["within_1_gsd"] > 0.6
    assert {"reference/o0.png", "reference/o1.png", "reference/registered.ply"} <= set(quality["files"])
    back = _core.read_points(str(output / "object/reference/registered.ply"))
    assert np.linalg.norm(back - scan, axis=1).max() < 2 * quality["gsd"]
    told = " ".join(outcome.out.split())
    assert re.search(r"off the reference, near which \d+\.\d % of what was measured lies: median", told)
    page = (output / "object/report/index.html").read_text()
    assert "<p>scan.ply, registered" in page and str(pair.parent) not in page
    assert "querySelectorAll('.scroll')" in page  # wide tables are scrolled by keyboard
    assert "Distance from the reference as o1 sees it" in page and '<option value="reference">' in page
    assert "registered.ply" in page

    edit(pair, 'reference = "scan.ply"', 'reference = "o0/dense/cloud.ply"\nregister = false')
    assert malus_here("object", pair, "-o", output, "--quiet").code == 0
    found = json.loads((output / "object/quality.json").read_text())["reference"]
    assert found["status"] == "done" and "correlation" not in found and found["absolute_median_gsd"] < 1
    assert not (output / "object/reference/registered.ply").exists()

    write_ply(
        pair.parent / "scan.ply",
        {axis: (np.random.default_rng(1).normal(0, 30, 4000), "f8") for axis in "xyz"},
        None,
        "",
    )
    edit(pair, 'reference = "o0/dense/cloud.ply"\nregister = false', 'reference = "scan.ply"')
    # Random points fit nowhere, however many stations and directions are tried.
    monkeypatch.setattr(reference, "_MOST_STATIONS", 1)
    monkeypatch.setattr(registration, "_DIRECTIONS", 12)
    outcome = malus_here("object", pair, "-o", output)
    assert outcome.code == 0, outcome.err
    quality = json.loads((output / "object/quality.json").read_text())
    assert "stands out" in quality["reference"]["status"]
    assert any("is not compared with scan.ply: " in warning for warning in quality["warnings"])
    assert str(pair.parent) not in (output / "object/report/index.html").read_text()
    assert "--register" not in quality["reference"]["status"]
    assert not (output / "object/reference").exists()


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ('reference = "none.ply"', "object.reference = 'none.ply', expected a file"),
        ("reference = 3", "object.reference = 3, expected a string"),
        ('reference = "o0/dense/cloud.ply"\nregister = 1', "object.register = 1, expected true or false"),
        ("register = false", "object.register needs object.reference"),
    ],
)
def test_references_that_are_wrong(pair: Path, said: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        Object.load(edit(pair, "closed = false", said))
    assert expected in str(caught.value)


def test_a_reference_that_cannot_be_read_is_said_before_any_work(pair: Path) -> None:
    (pair.parent / "scan.ply").write_text("no scan")
    edit(pair, "closed = false", 'reference = "scan.ply"')
    output = pair.parent / "out"
    for command in (("object", pair, "-o", output), ("check", pair)):
        outcome = malus_here(*command)
        assert outcome.code == 2 and "scan.ply" in outcome.err and "Traceback" not in outcome.err
    assert not (output / "stations").exists()


def test_blue_is_in_front_of_the_reference_as_in_a_stations_map() -> None:
    shares = page._shares_of_distances(np.float32([2.0, -2.0, np.nan]), 1.0)
    outside, inside, unknown = page.colors_of(shares).astype(int)
    assert outside[2] > outside[0] + 100 and inside[0] > inside[2] + 100 and (unknown == unknown[0]).all()
