"""Stations of different resolution in one object: a gently curved ground with fine waves, seen from far and, in part, from near."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from malus import _core
from malus.object import (
    ObjectMesh,
    OrientedPoints,
    Paint,
    Piece,
    View,
    closed_surface,
    combine,
    implicit,
    joined_mesh,
    meshing,
    pieces,
    textured,
)
from malus.object import reference as references
from malus.object.agreement import object_points
from malus.object.figures import mesh_figures
from malus.object.implicit import _edge_number, exact_vertices, pixel_side
from malus.object.levels import FINEST, Cube, Levels, _crossings, refined
from malus.object.mesh_file import coverage_of
from malus.object.meshing import edges_of, face_normals
from malus.object.reference import Reference
from malus.object.sharpening import sharpened
from malus.object.texture import NearestVertices, _levels
from malus.photogrammetry.program import Colmap
from test_object import sphere_view
from test_object_sharpening import phases_of, rough

#: Pixels across, focal length, and how far away a station has a GSD of one.
SIDE, FOCAL = 64, 60.0
#: Amplitude and length of the waves, in GSD of the far stations: 6 pixels of a station four times nearer.
HIGH, LONG = 0.2, 1.5

Floats = NDArray[np.float64]


def ground(x: Floats, y: Floats, waves: bool) -> Floats:
    """Height of the ground; the waves are in the middle."""
    fade = np.clip((6 - np.maximum(np.abs(x), np.abs(y))) / 2, 0, 1)
    return np.asarray(
        -(x**2 + y**2) / 4000 + waves * HIGH * fade * np.cos(2 * np.pi * x / LONG) * np.cos(2 * np.pi * y / LONG)
    )


def above(name: str, gsd: float, x: float = 0.0, y: float = 0.0, waves: bool = True, noise: float = 0.0) -> View:
    """A station that looks down on the ground at (x, y); noise: of depth, in its own GSD."""
    eye, rotation = np.array([x, y, FOCAL * gsd]), np.diag([1.0, -1.0, -1.0])
    rows, columns = np.indices((SIDE, SIDE))
    rays = np.stack([(columns - 31.5) / FOCAL, (rows - 31.5) / FOCAL, np.ones((SIDE, SIDE))], -1) @ rotation
    depth = np.full((SIDE, SIDE), eye[2])
    for _ in range(20):
        points = eye + rays * depth[..., None]
        depth = depth + 0.7 * (points[..., 2] - ground(points[..., 0], points[..., 1], waves))
    points = eye + rays * depth[..., None]
    step = 1e-5
    slopes = [
        (ground(points[..., 0] + a, points[..., 1] + b, waves) - ground(points[..., 0] - a, points[..., 1] - b, waves))
        / (2 * step)
        for a, b in ((step, 0), (0, step))
    ]
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(depth)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    cosine = -(normals * rays).sum(-1) / np.linalg.norm(rays, axis=-1)
    depth = depth + noise * gsd * np.random.default_rng(len(name)).standard_normal(depth.shape)
    return View(
        name=name, gsd=gsd, focal=(FOCAL, FOCAL), center=(31.5, 31.5), rotation=rotation, translation=-rotation @ eye,
        depth=depth.astype(np.float32), normals=normals.astype(np.float32),
        sigma=np.full(depth.shape, 0.3 * gsd, np.float32), cosine=cosine.astype(np.float32),
        usable=np.ones(depth.shape, bool), object=np.ones(depth.shape, bool),
        color=np.full((SIDE, SIDE, 1), 0.5, np.float32),
    )  # fmt: skip


FAR = [above("far", 1.0), above("left", 1.0, x=-3.3), above("right", 1.0, x=3.4, y=1.7)]


@pytest.fixture(scope="module")
def near() -> View:
    return above("near", 0.25, noise=0.1)


def mesh_of(views: list[View], folder: Path) -> ObjectMesh:
    return joined_mesh(pieces(object_points(views, []), 1.0), folder, 4.0)


@pytest.fixture(scope="module")
def fine(near: View, tmp_path_factory: pytest.TempPathFactory) -> ObjectMesh:
    return mesh_of([*FAR, near], tmp_path_factory.mktemp("fine"))


def off_the_ground(mesh: ObjectMesh, within: float) -> Floats:
    x, y, z = mesh.vertices[np.abs(mesh.vertices[:, :2]).max(1) < within].T
    return np.asarray(z - ground(x, y, True))


def inner_borders(mesh: ObjectMesh, right: float = 24.0) -> int:
    """Edges with one triangle, as a hole has them, away from the rim of the ground."""
    edges = np.sort(edges_of(np.asarray(mesh.triangles)), 1)
    once, count = np.unique(edges, axis=0, return_counts=True)
    x, y, _ = mesh.vertices[once[count == 1]].mean(1).T
    return int(((x > -24) & (x < right) & (np.abs(y) < 24)).sum())


def test_a_near_station_keeps_its_detail_and_the_rest_its_triangles(fine: ObjectMesh, tmp_path: Path) -> None:
    coarse = mesh_of(FAR, tmp_path)
    assert np.sqrt((off_the_ground(coarse, 4) ** 2).mean()) > 0.4 * HIGH
    assert np.sqrt((off_the_ground(fine, 4) ** 2).mean()) < 0.15 * HIGH
    # The far stations' points blur the border only.
    assert np.sqrt((off_the_ground(fine, 7) ** 2).mean()) < 0.2 * HIGH
    assert coarse.level is None and fine.level is not None
    sides = [(np.abs(mesh.vertices[:, 1]) > 27).sum() for mesh in (coarse, fine)]
    assert sides[1] == sides[0]


def test_coarse_and_fine_parts_of_the_mesh_have_no_slit_between_them(fine: ObjectMesh) -> None:
    assert inner_borders(fine) == 0
    _, count = np.unique(np.sort(edges_of(np.asarray(fine.triangles)), 1), axis=0, return_counts=True)
    assert count.max() == 2
    up = face_normals(fine.vertices, fine.triangles)[:, 2]
    assert (up > -1e-9).all()


def test_points_of_a_coarse_cloud_join_the_surface_of_the_stations(tmp_path: Path) -> None:
    """The cloud has a point for 36 pixels, beyond the ground that the stations see, and no hole between them."""
    x, y = np.meshgrid(np.arange(35.0, 75, 6), np.arange(-30.0, 31, 6))
    flat = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3) + np.random.default_rng(0).normal(0, 0.1, (x.size, 3))
    side = pixel_side(flat, 1)
    assert 1.5 < side < 3
    seen = object_points([replace(view, name=f"{view.name}{k}") for k, view in enumerate(FAR)], [])
    up = np.tile([0.0, 0, 1], (len(flat), 1))
    parts = (
        np.concatenate([seen.points, flat]), np.concatenate([seen.normals, up]),
        np.concatenate([seen.sigma, np.full(len(flat), 0.3)]), np.concatenate([seen.stations, np.zeros(len(flat), int)]),
    )  # fmt: skip
    pixels = np.concatenate([np.ones(len(seen.points)), np.full(len(flat), side)])
    joined, apart = (
        joined_mesh(pieces(OrientedPoints(*parts, scale), 1.0), tmp_path / name, 4.0)
        for name, scale in (("joined", pixels), ("apart", None))
    )
    area = {name: np.linalg.norm(face_normals(mesh.vertices, mesh.triangles), axis=1).sum() / 2 for name, mesh in
            (("joined", joined), ("apart", apart))}  # fmt: skip
    assert inner_borders(joined, right=70.0) == 0
    assert area["joined"] > 1.05 * area["apart"]
    far = joined.vertices[:, 0] > 45
    assert np.abs(joined.vertices[far, 2]).max() < 0.5


def test_parts_of_three_finenesses_meet(near: View, tmp_path: Path) -> None:
    """Also where the surface is so rough that its sections with a coarse and a fine lattice differ."""
    random = np.random.default_rng(0)
    far = [replace(view, depth=view.depth + random.normal(0, 0.8, view.depth.shape).astype(np.float32)) for view in FAR]
    others = [above("fourth", 1.0), above("middle", 0.5, x=9.0), above("nearest", 0.11, x=-20.0, y=-20.0)]
    mesh = mesh_of([*far, near, *others], tmp_path)
    assert mesh.level is not None and set(np.unique(mesh.level)) == {0, 1, 2, 3}
    assert inner_borders(mesh) == 0


def test_a_vertex_has_one_number_in_coarse_and_in_fine_cells() -> None:
    """At the limit from which on a vertex counts as on its edge and no more on the node beside it."""
    marching_cubes = pytest.importorskip("skimage.measure").marching_cubes
    at = 100 + (1 / 512 + 1e-5) / 8

    def number(field: Floats, finer: int, first: int) -> int:
        values = np.broadcast_to(field.astype(np.float32)[:, None], (2, 129, 2))
        vertices = exact_vertices(values, marching_cubes(values, 0.0, gradient_direction="descent")[0])
        (found,) = _edge_number((vertices[(vertices[:, [0, 2]] == 0).all(1)] + [0, first, 0]) * finer)
        return int(found)

    nodes = np.arange(129)
    assert number(nodes - at, 8, 0) == number(8 * (96 + nodes / 8 - at), 1, 8 * 96)


def test_pixels_far_smaller_than_the_finest_cells_leave_no_holes(tmp_path: Path) -> None:
    times = 30
    scale = _core.scales_of([*(view.gsd for view in FAR), 1 / times])[-1]
    across = np.array([[1.0, -1, 0], [1, 1, -2]]) / np.sqrt([[2], [6]])
    places = np.stack(np.meshgrid(*2 * [np.arange(-1.5, 1.5, 1 / times)]), -1).reshape(-1, 2)
    up, one = np.tile(np.ones(3) / np.sqrt(3), (len(places), 1)), np.ones(len(places))
    points = OrientedPoints(places @ across, up, one, one.astype(np.int64), scale * one)
    mesh = joined_mesh(pieces(points, 1.0), tmp_path, 4.0)
    middle = (np.abs(mesh.vertices[mesh.triangles].mean(1) @ across.T) < 1).all(1)
    areas = np.linalg.norm(face_normals(mesh.vertices, mesh.triangles), axis=1) / 2
    assert areas[middle].sum() == pytest.approx(4, rel=0.03)


def test_gsds_that_differ_by_less_than_a_quarter_change_nothing(tmp_path: Path) -> None:
    views = [above("a", 1.0), above("b", 0.9, x=2), above("c", 1.12, y=2)]
    assert combine(views)[0].scale is None
    assert mesh_of(views, tmp_path).level is None
    points = combine([*FAR, above("d", 0.6)])[0]
    assert points.scale is not None and np.unique(points.levels()).tolist() == [0, 1]


def test_a_far_station_does_not_blur_a_near_one(near: View) -> None:
    alone, _ = combine([near])
    points, _ = combine([*FAR, near])
    own = points.select(points.scales() < 1)
    # They see the same ground, and say so on average over their pixels.
    np.testing.assert_allclose(own.points, alone.points, atol=0.02 * HIGH)
    np.testing.assert_allclose(own.normals, alone.normals, atol=0.02)
    assert (own.stations > 1).mean() > 0.95
    # One that is less sure has no detail to lose.
    unsure = replace(near, sigma=np.full_like(near.sigma, 0.9))
    points, _ = combine([*FAR, unsure])
    assert not np.isin(alone.points, points.points).all()


def test_a_near_station_at_a_flat_angle_is_not_the_finer_one(near: View) -> None:
    far, cosines = FAR[0], np.array([1.0, 0.3, 0.19])
    assert near.finer(cosines, far, np.ones(3)).tolist() == [True, False, False]
    assert not far.finer(np.ones(3), near, np.full(3, 0.2)).any()


def farther(times: float, sigma: float) -> View:
    """A station of so many times larger pixels, of which 28 in the middle are used, beside the others."""
    view = above("farther", times, x=14 * times + 20, waves=False)
    middle = np.abs(np.arange(SIDE) - 31.5) < 14
    return replace(view, usable=middle[:, None] & middle, sigma=np.full_like(view.sigma, sigma))


@pytest.mark.parametrize("times", [3.0, 5.0])
def test_what_only_a_station_from_farther_away_sees_has_no_holes(times: float, tmp_path: Path) -> None:
    mesh = mesh_of([*FAR, farther(times, 0.3)], tmp_path)
    assert mesh.vertices[:, 0].max() > 26 * times + 20
    assert inner_borders(mesh, 24 * times + 20) == 0


def test_what_a_farther_station_is_sure_of_at_its_own_pixels_is_not_left_out(tmp_path: Path) -> None:
    mesh = mesh_of([*FAR, farther(5.0, 5.0)], tmp_path)
    assert mesh.vertices[:, 0].max() > 26 * 5 + 20


def test_blocks_have_all_points_that_reach_into_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of larger pixels reach farther."""
    far = farther(5.0, 0.3)
    noise = np.random.default_rng(0).normal(0, 2, far.depth.shape)
    views = [*FAR, replace(far, depth=(far.depth + noise).astype(np.float32))]
    whole = mesh_of(views, tmp_path / "whole")
    monkeypatch.setattr(implicit, "BLOCK_CELLS", 64)
    many = mesh_of(views, tmp_path / "many")
    assert len(many.vertices) == len(whole.vertices)
    heights = [np.sort(mesh.vertices[:, 2]) for mesh in (whole, many)]
    np.testing.assert_allclose(*heights, atol=1e-3)


def test_figures_count_all_of_the_surface_alike(fine: ObjectMesh, near: View, tmp_path: Path) -> None:
    area = np.linalg.norm(face_normals(fine.vertices, fine.triangles), axis=1)
    middle = np.abs(fine.vertices[fine.triangles].mean(1)[:, :2]).max(1) < 8
    share = area[middle].sum() / area.sum()
    paint = Paint.of([*FAR, near], fine.vertices, fine.normals)
    seen = coverage_of(fine, paint.views, tmp_path).seen
    assert seen[3] == pytest.approx(share, rel=0.15)
    assert 0.7 < seen[0] < 0.9
    # Most vertices, but little of the surface, are those of the near station, which is surer.
    assert (np.abs(fine.vertices[:, :2]).max(1) < 7.5).mean() > 2 * share
    assert mesh_figures(fine, 1.0, False)["sigma_median_gsd"] == pytest.approx(0.3, abs=0.02)


def test_distances_from_a_reference_count_all_of_the_surface_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    def square(left: float, step: float, height: float) -> Floats:
        x, y = np.meshgrid(np.arange(0, 20, step) + left, np.arange(0, 20, step))
        return np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], 1)

    parts = [square(0, 1, 0.0), square(20, 0.25, 0.8)]
    vertices = np.concatenate(parts)
    level = np.repeat(np.array([0, 2], np.uint8), [len(part) for part in parts])
    up = np.tile([0.0, 0, 1], (len(vertices), 1))
    corners = np.array([[-9.0, -9, 0], [60, -9, 0], [60, 40, 0], [-9, 40, 0]])
    plane = Reference(corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))
    some = np.array([[0, 1, 20]])
    mesh = ObjectMesh(vertices, up, some, np.ones(len(vertices)), np.ones(len(vertices), bool), level)
    monkeypatch.setattr(references, "_completeness", lambda *_: {})
    figures = references.compare(plane, mesh, 1.0, 1).figures
    assert figures["distance_gsd"]["mean"] == pytest.approx(0.4, abs=0.05)


def test_colors_are_those_of_the_station_that_shows_most_detail(fine: ObjectMesh, near: View) -> None:
    red = [replace(view, color=np.tile(np.float32([0.6, 0.1, 0.1]), (SIDE, SIDE, 1))) for view in FAR]
    blue = replace(near, color=np.tile(np.float32([0.1, 0.1, 0.6]), (SIDE, SIDE, 1)))
    paint = Paint.of([*red, blue], fine.vertices, fine.normals)
    x, y = np.abs(fine.vertices[:, :2]).T
    colors = paint.linear(fine.vertices, fine.normals)
    assert (colors[np.maximum(x, y) < 6] @ [-1, 0, 1] > 0).all()
    assert (colors[np.maximum(x, y) > 9] @ [-1, 0, 1] < 0).all()


def test_texels_are_smaller_where_the_mesh_is_finer(
    fine: ObjectMesh, near: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    paint = Paint.of([*FAR, near], fine.vertices, fine.normals)

    def texels(mesh_side: int) -> tuple[float, float]:
        """Texels for each GSD in the middle and beside it."""
        monkeypatch.setattr("malus.object.texture._MOST_SIDE", mesh_side)
        low = textured(fine, 3000, paint, 1.0)
        corners, uv = low.vertices[low.triangles], low.uv[low.triangles] * len(low.color)
        real = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        drawn = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        middle = np.abs(corners.mean(1)[:, :2]).max(1)
        # Triangles of the flat ground beside the fine cells are long.
        inside, outside = middle < 6, middle > 28
        return tuple(float(np.sqrt(drawn[some].sum() / real[some].sum())) for some in (inside, outside))  # type: ignore[return-value]

    inside, outside = texels(8192)
    assert inside == pytest.approx(4 * outside, rel=0.1)
    # A texture that would be too large loses the fine texels first.
    inside, outside = texels(150)
    assert inside == pytest.approx(outside, rel=0.1)


def test_a_closed_mesh_keeps_the_detail(fine: ObjectMesh, tmp_path: Path) -> None:
    closed = closed_surface(fine, 1.0, tmp_path, Colmap(1))
    assert closed.level is not None and closed.level.max() == 2
    top = closed.measured & (closed.normals[:, 2] > 0) & (closed.vertices[:, 2] > -1)
    x, y, z = closed.vertices[top & (np.abs(closed.vertices[:, :2]).max(1) < 4)].T
    assert np.sqrt(((z - ground(x, y, True)) ** 2).mean()) < 0.2 * HIGH


def test_the_level_of_a_closed_mesh_is_that_of_its_octree(
    fine: ObjectMesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The octree of a large object cannot have the finest cells."""
    monkeypatch.setattr(meshing, "poisson_mesh", lambda points, gsd, folder, colmap, halved: replace(fine, level=None))
    for depth, finest in ((13, 2), (7, 1)):
        monkeypatch.setattr(meshing, "_MOST_DEPTH", depth)
        level = closed_surface(fine, 1.0, tmp_path, Colmap(1)).level
        assert level is not None and level.max() == finest
    monkeypatch.setattr(meshing, "_MOST_DEPTH", 6)
    assert closed_surface(fine, 1.0, tmp_path, Colmap(1)).level is None


def test_the_levels_of_a_large_mesh_are_found_in_parts(fine: ObjectMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    places = fine.vertices[fine.triangles[::7]].mean(1)
    expected = _levels(fine, places)
    assert set(np.unique(expected)) == {0, 2}
    searched: list[int] = []
    among = NearestVertices._among

    def counted(self: NearestVertices, rows: NDArray[np.int64]) -> object:
        searched.append(len(rows))
        return among(self, rows)

    monkeypatch.setattr("malus.object.texture._MOST_IN_MEMORY", 10)
    monkeypatch.setattr(NearestVertices, "_among", counted)
    np.testing.assert_array_equal(_levels(fine, places), expected)
    assert max(searched) < len(fine.vertices) / 4


def test_phases_of_larger_pixels_do_not_smooth_a_surface() -> None:
    near, axis = rough(sphere_view("near", (1, 0, 0))), (1, 0.2, 0)
    far = sphere_view("far", axis)
    phases, misleading = phases_of(sphere_view("near", (1, 0, 0))), phases_of(far, turned=20.0)
    alone, same = (
        next(sharpened([near], stations)) for stations in ([(near, phases)], [(near, phases), (far, misleading)])
    )
    assert not np.array_equal(alone.depth, same.depth, equal_nan=True)
    larger = replace(far, gsd=3 * far.gsd)
    after = next(sharpened([near], [(near, phases), (larger, misleading)]))
    both = near.usable & (near.cosine > 0.7)
    np.testing.assert_array_equal(after.depth[both], alone.depth[both])


def test_the_lattice_is_no_finer_than_its_numbers_allow() -> None:
    levels = Levels(128)
    levels.add(np.array([[200.0, 200, 200]]), np.array([9]), np.array([1.0]))
    cubes = levels.cubes([(0, 0, 0), (1, 1, 1)])
    assert {cube.level for cube in cubes} == {0, FINEST}
    assert cubes[0] == Cube((0, 0, 0), 128, 0)
    assert sum(cube.size**3 for cube in cubes) == 2 * 128**3


def test_a_part_is_large_or_small_by_its_surface_and_not_by_its_triangles(tmp_path: Path) -> None:
    """A separate part of a hundredth of the surface stays beside a fine part that has most of the triangles."""

    def part(count: int, level: int, first: int) -> Piece:
        x, y = np.meshgrid(np.arange(count) / 2**level, np.arange(count) / 2**level)
        vertices = np.stack([x.ravel() + 1000 * first, y.ravel(), np.zeros(x.size)], 1)
        corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
        triangles = np.concatenate(
            [
                np.stack([corner, corner + 1, corner + count], 1),
                np.stack([corner + 1, corner + count + 1, corner + count], 1),
            ]
        )
        up, sigma = np.tile([0.0, 0, 1], (len(vertices), 1)), np.ones(len(vertices))
        mesh = ObjectMesh(vertices, up, triangles, sigma, np.ones(len(vertices), bool))
        return Piece(mesh, np.full(len(vertices), -1), first, level)

    mesh = joined_mesh([part(301, 3, 0), part(5, 0, 1)], tmp_path / "joined", 2.0)
    assert mesh.vertices[:, 0].max() > 1000
    assert mesh.level is not None and set(np.unique(mesh.level)) == {0, 3}


def test_an_edge_has_the_vertices_of_its_own_branch() -> None:
    """Two edges of coarse triangles in one cell of a side: the finer lattice's vertices are at one of them each."""
    corners = np.array([[1.0, -1.5], [-1.5, 1.0]], np.float32)
    ends = np.array([[0.4, 0.0], [0.0, 0.4]]), np.array([[1.0, 0.6], [0.6, 1.0]])
    one, other = (_crossings(corners, 4, end) for end in ends)
    assert len(one) == len(other) == 2
    assert (one.sum(1) < 1).all() and (other.sum(1) > 1).all()
    values = refined(corners, 4)
    assert values.shape == (5, 5) and values[2, 2] == pytest.approx(-0.25)
    assert (np.diff(one @ (ends[0][1] - ends[0][0])) > 0).all()


def test_a_far_station_confirms_detail_that_it_cannot_show() -> None:
    """Three pixels of the near station deep: less than one of the far one."""
    near, far = above("near", 0.25), above("far", 1.0, waves=False)
    near = replace(near, depth=near.depth + np.float32(0.75), sigma=np.full_like(near.sigma, 0.02))
    far = replace(far, sigma=np.full_like(far.sigma, 0.02))
    points, _ = combine([near, far])
    assert (points.stations[points.scales() < 1] == 2).mean() > 0.8
