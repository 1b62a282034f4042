"""Whole objects: a sphere that stations see in part, object files, and the command line on copies of a station."""

from __future__ import annotations

import html
import importlib
import json
import os
import pickle
import re
import shutil
import signal
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from conftest import EXAMPLE, Outcome, demo_with_photos, edit, half_written, malus_here, needs_distributed, write_pair
from conftest import malus as run_malus
from malus import (
    Camera,
    DataError,
    ExternalError,
    InputError,
    Options,
    Progress,
    ResourceError,
    Station,
    _core,
    reconstruct,
)
from malus._files import with_relative_paths, write_record
from malus.object import (
    Object,
    OrientedPoints,
    Paint,
    TexturedMesh,
    View,
    agreement_figures,
    closed_surface,
    clouds,
    combine,
    doubts,
    implicit,
    joined_mesh,
    joining,
    levels_of_detail,
    pieces,
    poisson_mesh,
    run_object,
    texture,
    textured,
    unseen_stereo,
)
from malus.object import frame as object_frame
from malus.object import run as object_run
from malus.object.agreement import agreements_of, object_points
from malus.object.albedo import Albedos
from malus.object.cloud_file import read_cloud
from malus.object.clouds import clouds_of
from malus.object.doubts import doubts_of_stations, warnings_of
from malus.object.figures import is_closed, mesh_figures, station_figures
from malus.object.frame import Frame, find_frame
from malus.object.glb import write_levels
from malus.object.mesh_file import Coverage, needs_double
from malus.object.meshing import ObjectMesh, closed_up, face_normals
from malus.object.ply import columns, read_mesh, write_ply
from malus.object.texture import NearestVertices, _tangents
from malus.object.views import load_view, stored
from malus.pages import template
from malus.photogrammetry import Outline, RegisteredImage, SparseModel, StationCameras, exclusive, front_end
from malus.photogrammetry.bench import Bench
from malus.photogrammetry.program import Colmap
from malus.photogrammetry.shared_frame import load_cameras, save_cameras
from malus.photogrammetry.station_pose import StationView
from malus.planning import expected_times
from malus.workspace import Workspace
from view_scale import drawn_mm, pixel_mm, turning_view

RADIUS, FAR, FOCAL, SIDE = 10.0, 60.0, 300.0, 128
SIGMA = 0.05
#: Views use no places that they see flatter.
LEAST_COSINE = 0.17


def sphere_view(name: str, direction: tuple[float, float, float], offset: float = 0.0, light: float = 1.0) -> View:
    """A sphere about the origin as a camera in this direction sees it, `offset` too large, lit by `light`."""
    back = np.array(direction) / np.linalg.norm(direction)
    right = np.cross([0.1, 0.2, 1.0], back)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-back, right), -back])
    translation = np.array([0, 0, FAR])
    rows, columns = np.indices((SIDE, SIDE))
    rays = np.stack([(columns - 63.5) / FOCAL, (rows - 63.5) / FOCAL, np.ones((SIDE, SIDE))], -1)
    a, b, c = (rays**2).sum(-1), -FAR, FAR**2 - (RADIUS + offset) ** 2
    inside = b**2 - a * c > 0
    rim = b**2 - a * (FAR**2 - (RADIUS + offset + 2 * FAR / FOCAL) ** 2) > 0
    depth = np.where(inside, (-b - np.sqrt(np.maximum(b**2 - a * c, 0))) / a, np.nan)
    points = (rays * depth[..., None] - translation) @ rotation
    normals = points / (RADIUS + offset)
    eye = -rotation.T @ translation
    to_eye = eye - points
    cosine = (normals * to_eye).sum(-1) / np.linalg.norm(to_eye, axis=-1)
    color = light * np.where(points[..., 2:] > 0, 0.6, 0.2)
    return View(
        name=name, gsd=FAR / FOCAL, focal=(FOCAL, FOCAL), center=(63.5, 63.5), rotation=rotation, translation=translation,
        depth=depth, normals=normals, sigma=np.full(depth.shape, SIGMA), cosine=cosine,
        usable=inside & (cosine > LEAST_COSINE), object=rim, color=np.nan_to_num(color),
    )  # fmt: skip


def points_of(view: View) -> NDArray[np.float64]:
    """World points (H×W×3) of all pixels."""
    rows, columns = np.indices(view.depth.shape)
    return view.points_at(rows, columns)


def stereo(points: NDArray[np.float64], normals: NDArray[np.float64]) -> OrientedPoints:
    """A cloud."""
    return OrientedPoints(points, normals, np.full(len(points), 0.1), np.zeros(len(points), np.int64))


AXES = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]


@pytest.fixture(scope="module")
def views() -> list[View]:
    return [sphere_view(f"s{k}", axis) for k, axis in enumerate(AXES)]


def test_stations_that_agree_give_the_surface_and_say_so(views: list[View]) -> None:
    points, agreements = combine(views)
    off = np.abs(np.linalg.norm(points.points, axis=1) - RADIUS)
    assert np.percentile(off, 95) < 0.02 and off.max() < 0.1  # what the plane of a pixel seen flat leaves of a sphere
    assert (points.stations > 1).mean() > 0.5
    figures = agreement_figures(agreements, views[0].gsd)
    assert figures["within_two_sigma"] == 1.0
    assert figures["rms_ratio"] is not None and figures["rms_ratio"] < 0.1


def test_agreement_with_each_station_is_the_same_one_by_one(views: list[View]) -> None:
    for found, expected in zip(agreements_of(views), combine(views)[1], strict=True):
        assert found.view == expected.view
        for values in ("ratio", "distances", "expected"):
            np.testing.assert_array_equal(getattr(found, values), getattr(expected, values))


def joined(parts: list[OrientedPoints]) -> OrientedPoints:
    """All points of several sets, in their order."""
    fields = ("points", "normals", "sigma", "stations")
    together = [np.concatenate([getattr(part, field) for part in parts]) for field in fields]
    without = all(part.scale is None for part in parts)
    return OrientedPoints(*together, None if without else np.concatenate([part.scales() for part in parts]))


def test_threads_and_files_change_nothing(views: list[View], tmp_path: Path) -> None:
    """Large stations are read from files."""
    direction = np.random.default_rng(1).normal(size=(20000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    cloud = stereo(RADIUS * direction, direction)
    whole = object_points(views[:5], [cloud], threads=1)
    on_disk = [stored(view, tmp_path / view.name) for view in views[:5]]
    assert isinstance(on_disk[0].depth, np.memmap)
    parts = object_points(on_disk, [cloud], threads=2)
    assert (whole.stations == 0).any() and (whole.stations > 1).any()
    for field in ("points", "normals", "sigma", "stations"):
        np.testing.assert_array_equal(getattr(parts, field), getattr(whole, field))


def test_maps_in_single_precision_are_not_copied(views: list[View]) -> None:
    """Those of many stations are mapped files, and do not fit into memory together."""
    view = replace(views[0], depth=views[0].depth.astype(np.float32))
    middle = np.array([SIDE // 2])
    before = view.points_at(middle, middle)
    view.depth[SIDE // 2, SIDE // 2] += 1
    assert np.linalg.norm(view.points_at(middle, middle) - before) == pytest.approx(1, abs=1e-4)


def test_maps_of_a_view_have_one_size(views: list[View]) -> None:
    with pytest.raises(InputError, match="s0: sigma is 128 x 127 pixels"):
        combine([replace(views[0], sigma=views[0].sigma[1:]), *views[1:]])
    with pytest.raises(InputError, match="s0: pixel is outside the image"):
        views[0].points_at(np.array([0]), np.array([SIDE]))


def test_stations_that_disagree_meet_in_the_middle_by_their_variances() -> None:
    first, second = sphere_view("a", (1, 0, 0)), sphere_view("b", (1, 0.1, 0), offset=0.1)
    points, agreements = combine([first, second])
    both = points.stations == 2
    # Seen alike and stated alike: the mean; and the stated standard deviation does not shrink.
    assert np.median(np.linalg.norm(points.points[both], axis=1)) == pytest.approx(RADIUS + 0.05, abs=0.005)
    assert points.sigma[both] == pytest.approx(SIGMA)
    figures = agreement_figures(agreements, first.gsd)
    assert figures["rms_ratio"] == pytest.approx(0.1 / (np.sqrt(2) * SIGMA), rel=0.02)


def test_what_one_station_sees_flat_is_there_if_stereo_found_it_too() -> None:
    """A rim that one view makes stand off the sphere is not in the cloud."""
    view = sphere_view("a", (1, 0, 0))
    wrong = points_of(view)[..., 1] > 0
    beside = replace(view, depth=np.where(wrong, view.depth - 3, view.depth))
    directions = np.random.default_rng(1).normal(size=(60000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    alone, _ = combine([beside])
    told, _ = combine([beside], stereo(RADIUS * directions, directions))
    flat = view.usable & (view.cosine <= 0.5)
    assert len(alone.points) == (view.usable & ~flat).sum()
    assert len(told.points) - len(alone.points) == pytest.approx((flat & ~wrong).sum(), rel=0.01)
    nobody, _ = combine([beside], stereo(RADIUS * directions[:3], directions[:3]))
    assert len(nobody.points) == len(alone.points)


def test_a_station_that_says_it_is_unsure_of_a_flat_place_counts_as_it_does_elsewhere() -> None:
    """What a station states of its places differs more than their errors do; of two that state the same as a whole it is the mean."""
    first, second = sphere_view("a", (1, 0, 0)), sphere_view("b", (1, 0.1, 0), offset=0.1)
    unsure = replace(second, sigma=np.where(np.abs(points_of(second)[..., 2]) > 5, 4 * SIGMA, SIGMA))
    points, _ = combine([first, unsure])
    both = (points.stations == 2) & (np.abs(points.points[:, 2]) > 5.5) & (np.abs(points.points[:, 2]) < 7)
    assert both.sum() > 100
    assert np.median(np.linalg.norm(points.points[both], axis=1)) == pytest.approx(RADIUS + 0.05, abs=0.01)
    # The one that is surer of it tells how sure the mean is.
    assert np.median(points.sigma[both]) == pytest.approx(np.sqrt(2 / (1 + 1 / 16)) * SIGMA, rel=0.05)


def test_stereo_counts_where_no_station_looks_and_not_off_the_object(views: list[View]) -> None:
    direction = np.array([0.0, 0.0, 1.0])
    cloud = np.array([RADIUS * direction, -RADIUS * direction, 1.3 * RADIUS * direction, [30.0, 0, 0]])
    normals = np.array([direction, -direction, direction, direction])
    points, _ = combine(views[:5])  # nobody sees the sphere from below
    kept = unseen_stereo(stereo(cloud, normals), views[:5], points)
    assert kept.points == pytest.approx(cloud[1:2])
    assert kept.stations.tolist() == [0]


def test_one_station_with_the_whole_object_in_it_tells_what_lies_beside(views: list[View]) -> None:
    # Ground under the object: hidden behind it for all who look down, beside it for the one who looks along the ground.
    down = [sphere_view(f"down {k}", axis) for k, axis in enumerate([(0, 0, 1), (1, 0, 1), (-1, 0, 1), (0, 1, 1)])]
    ground, up = np.array([[0.0, 0.0, -1.2 * RADIUS]]), np.array([[0.0, 0.0, 1.0]])
    along = views[0]
    points, _ = combine([*down, along])
    assert len(unseen_stereo(stereo(ground, up), down, points).points) == 1
    assert len(unseen_stereo(stereo(ground, up), [*down, along], points).points) == 0
    # A station that was told to reconstruct a part says nothing of the rest.
    part = replace(along, object=along.object & (np.arange(SIDE) < SIDE / 2))
    assert len(unseen_stereo(stereo(ground, up), [*down, part], points).points) == 1


def test_stereo_beside_what_stations_see_is_left_out(views: list[View]) -> None:
    # A crease that no station's surface enters: what the cloud has there is off the surface beside it.
    angles = np.radians([100.0, 175.0])
    cloud = (RADIUS - 0.3) * np.stack([np.sin(angles), 0 * angles, np.cos(angles)], 1)
    normals = np.tile([0.0, 1.0, 0.0], (2, 1))
    points, _ = combine(views[:5])
    unbounded = unseen_stereo(stereo(cloud, normals), views[:5], points.select(np.zeros(len(points.points), bool)))
    assert unbounded.points == pytest.approx(cloud)
    assert unseen_stereo(stereo(cloud, normals), views[:5], points).points == pytest.approx(cloud[1:])
    # Farther in than six of its standard deviations it counts.
    deep = np.array([[RADIUS - 0.5], [RADIUS - 0.8]]) * cloud[0] / np.linalg.norm(cloud[0])
    nearest = np.linalg.norm(points.points - deep[:, None], axis=2).min(1)
    assert nearest / stereo(deep, normals).sigma == pytest.approx([5, 8], abs=0.3)
    assert unseen_stereo(stereo(deep, normals), views[:5], points).points == pytest.approx(deep[1:])


@pytest.fixture(scope="module")
def sphere(views: list[View], tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    points, _ = combine(views)
    return poisson_mesh(points, views[0].gsd, tmp_path_factory.mktemp("poisson"), Colmap(1))


def test_mesh_is_closed_and_on_the_sphere(sphere) -> None:  # type: ignore[no-untyped-def]
    assert is_closed(sphere.triangles)
    assert np.abs(np.linalg.norm(sphere.vertices, axis=1) - RADIUS).max() < 0.1
    outward = (sphere.normals * sphere.vertices).sum(1) / RADIUS
    assert np.degrees(np.arccos(np.clip(outward, -1, 1))).max() < 5
    assert sphere.sigma[sphere.measured] == pytest.approx(SIGMA, rel=0.01)


def test_holes_that_touch_are_closed(sphere) -> None:  # type: ignore[no-untyped-def]
    """They got one fan together, whose middle edge had four triangles: the mesh was not closed."""
    corner = sphere.triangles[0, 0]
    about, apart = np.flatnonzero((sphere.triangles == corner).any(1)), []
    for face in about.tolist():  # triangles about a vertex that have no other vertex in common
        if all(len(np.intersect1d(sphere.triangles[face], sphere.triangles[other])) == 1 for other in apart):
            apart.append(face)
    assert len(apart) > 1
    vertices, triangles = closed_up(sphere.vertices, np.delete(sphere.triangles, apart, 0))
    assert is_closed(triangles) and len(vertices) == len(sphere.vertices) + len(apart)
    # One large hole, and what is no surface: it is not closed, but it ends.
    vertices, triangles = closed_up(sphere.vertices, np.delete(sphere.triangles, about, 0))
    assert is_closed(triangles) and len(vertices) == len(sphere.vertices) + 1
    assert not is_closed(closed_up(sphere.vertices, np.concatenate([sphere.triangles, [[0, 1, 2]], [[1, 0, 3]]]))[1])


def test_closed_mesh_is_manifold_as_others_see_it(sphere) -> None:  # type: ignore[no-untyped-def]
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(sphere.vertices, sphere.triangles, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.01)
    assert np.unique(np.sort(sphere.triangles, 1), axis=0).shape == sphere.triangles.shape


def test_what_nobody_sees_is_marked(views: list[View], tmp_path: Path) -> None:
    points, _ = combine(views[:5])
    closed = poisson_mesh(points, views[0].gsd, tmp_path, Colmap(1))
    assert is_closed(closed.triangles)
    below = closed.vertices[:, 2] < -0.99 * RADIUS
    assert not closed.measured[below].any()
    assert (closed.sigma[below] > 5 * SIGMA).all()


@pytest.fixture(scope="module")
def thin(views: list[View]) -> OrientedPoints:
    """Every fifth point of the sphere: about one in a square of two GSD."""
    points, _ = combine(views)
    return points.select(np.arange(len(points.points)) % 5 == 0)


CELL = 2 * FAR / FOCAL


def test_open_mesh_lies_on_the_sphere_and_ends_where_nobody_looks(thin: OrientedPoints, tmp_path: Path) -> None:
    mesh = joined_mesh(pieces(thin.select(thin.points[:, 2] > -0.5 * RADIUS), CELL), tmp_path, 1.0)
    assert not is_closed(mesh.triangles)
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS).max() < 0.1
    outward = (mesh.normals * mesh.vertices).sum(1) / np.linalg.norm(mesh.vertices, axis=1)
    assert np.degrees(np.arccos(np.clip(outward, -1, 1))).max() < 5
    corners = mesh.vertices[mesh.triangles]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((faces * corners[:, 0]).sum(1) >= 0).all()
    assert -0.5 * RADIUS - 4 * CELL < mesh.vertices[:, 2].min() < -0.5 * RADIUS
    assert mesh.sigma == pytest.approx(SIGMA, rel=0.01)


def test_closed_surface_is_the_open_one_and_a_marked_guess(thin: OrientedPoints, tmp_path: Path) -> None:
    mesh = joined_mesh(pieces(thin.select(thin.points[:, 2] > -0.5 * RADIUS), CELL), tmp_path / "open", 1.0)
    closed = closed_surface(mesh, CELL, tmp_path / "closed", Colmap(1))
    assert is_closed(closed.triangles)
    assert [path.name for path in (tmp_path / "closed").iterdir()] == ["poisson.log"]
    off = np.abs(np.linalg.norm(closed.vertices, axis=1) - RADIUS)
    assert off[closed.measured & (closed.vertices[:, 2] > -0.4 * RADIUS)].max() < 0.2
    assert closed.measured[closed.vertices[:, 2] > -0.4 * RADIUS].all()
    below = closed.vertices[:, 2] < -0.5 * RADIUS - 4 * CELL
    assert below.any() and not closed.measured[below].any()
    # The guess has large triangles, but counts by its surface.
    areas = np.linalg.norm(face_normals(closed.vertices, closed.triangles), axis=1)
    share = (areas * closed.measured[closed.triangles].mean(1)).sum() / areas.sum()
    assert mesh_figures(closed, CELL, True)["measured_fraction"] == pytest.approx(share, abs=1e-9)
    assert share < closed.measured.mean() - 0.01


def test_what_a_killed_run_leaves_of_closing_a_mesh_is_removed(
    thin: OrientedPoints, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """COLMAP's cloud, mesh and its own files of many gigabytes, if neither it nor the program could tidy up."""

    def killed(self: Colmap, command: str, arguments: dict[str, Any], log: Path, *, working_folder: Path) -> None:
        (working_folder / "PR_part").touch()
        shutil.copytree(tmp_path, killed_at)

    killed_at = tmp_path.with_name(f"{tmp_path.name}-killed")
    monkeypatch.setattr(Colmap, "run", killed)
    mesh = joined_mesh(pieces(thin, CELL), tmp_path.with_name(f"{tmp_path.name}-open"), 1.0)
    with pytest.raises(FileNotFoundError):
        closed_surface(mesh, CELL, tmp_path, Colmap(1))
    assert not list(tmp_path.iterdir()) and len(list(killed_at.rglob("*"))) == 3
    object_run._clear(killed_at)
    assert not list(killed_at.iterdir())


def test_parts_far_apart_keep_their_own_seams(
    thin: OrientedPoints, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two spheres, 400 000 cells apart along every axis: a monument at the resolution of a close view."""
    monkeypatch.setattr(implicit, "BLOCK_CELLS", 20)
    one = joined_mesh(pieces(thin, CELL), tmp_path / "one", 1.0)
    far = replace(thin, points=thin.points + 400_000 * CELL)
    both = joined_mesh(pieces(joined([thin, far]), CELL), tmp_path / "both", 1.0)
    assert is_closed(both.triangles)
    assert len(both.triangles) == pytest.approx(2 * len(one.triangles), rel=0.01)
    farther = replace(thin, points=thin.points + 1_100_000 * CELL)
    with pytest.raises(DataError, match="spread over 11000.* at most 1048576:"):
        next(pieces(joined([thin, farther]), CELL))
    fine = replace(far, scale=np.full(len(far.points), 0.2))
    with pytest.raises(DataError, match="spread over 4000.* at most 262144:"):
        next(pieces(joined([thin, fine]), CELL))


def test_blocks_meet_exactly_and_change_nothing(
    thin: OrientedPoints, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = joined_mesh(pieces(thin, CELL), tmp_path / "whole", 1.0)
    assert is_closed(whole.triangles)
    monkeypatch.setattr(implicit, "BLOCK_CELLS", 20)
    many = list(pieces(thin, CELL))
    assert len(many) > 20
    joined = joined_mesh(many, tmp_path / "many", 1.0)
    assert is_closed(joined.triangles)
    assert len(joined.triangles) == pytest.approx(len(whole.triangles), abs=20)
    assert len(joined.vertices) < sum(len(piece.mesh.vertices) for piece in many)  # seams are made one
    x, y = (np.sort(mesh.vertices[:, 0])[[0, 100, -100, -1]] for mesh in (joined, whole))
    assert x == pytest.approx(y, abs=1e-3)


def test_a_surface_near_a_node_between_blocks_has_no_slit(
    thin: OrientedPoints, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One block gave the node two vertices, the other one."""
    monkeypatch.setattr(implicit, "BLOCK_CELLS", 12)
    assert is_closed(joined_mesh(pieces(thin, CELL), tmp_path, 1.0).triangles)


def test_crumbs_and_what_is_unsure_are_left_out(
    thin: OrientedPoints, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(joining, "LEAST_PART", 0.02)  # the crumb is 1.2 % of this small mesh
    sigma = np.where(thin.points[:, 2] > 0, 1.0, SIGMA)
    near = np.linalg.norm(thin.points - [0, 0, -RADIUS], axis=1) < 3 * CELL
    points, normals = (
        np.concatenate([thin.points, thin.points[near] - [0, 0, RADIUS]]),
        np.concatenate([thin.normals, thin.normals[near]]),
    )
    sigma = np.concatenate([sigma, sigma[near]])
    with_crumb = list(pieces(OrientedPoints(points, normals, sigma, np.ones(len(sigma), np.int64)), CELL))
    assert min(piece.mesh.vertices[:, 2].min() for piece in with_crumb) < -1.9 * RADIUS
    mesh = joined_mesh(with_crumb, tmp_path, 0.5)
    assert -1.1 * RADIUS < mesh.vertices[:, 2].min() < -0.99 * RADIUS
    assert mesh.vertices[:, 2].max() < 2 * CELL
    with pytest.raises(DataError, match="agree on no surface"):
        joined_mesh(with_crumb, tmp_path, 0.01)


def test_texture_has_the_color_of_the_place_in_any_light(sphere) -> None:  # type: ignore[no-untyped-def]
    lit = [sphere_view(f"s{k}", axis, light=1.0 if k % 2 else 0.5) for k, axis in enumerate(AXES)]
    paint = Paint.of(lit, sphere.vertices, sphere.normals)
    mesh = textured(sphere, 2000, paint, lit[0].gsd)
    assert len(mesh.triangles) <= 2100
    corner = np.minimum((mesh.uv * mesh.color.shape[0]).astype(int), mesh.color.shape[0] - 1)
    shown = mesh.color[corner[:, 1], corner[:, 0]].mean(1)
    above, below = mesh.vertices[:, 2] > 2, mesh.vertices[:, 2] < -2
    assert np.ptp(np.percentile(shown[above], [5, 95])) < 12 and np.ptp(np.percentile(shown[below], [5, 95])) < 12
    assert shown[above].mean() > shown[below].mean() + 60
    # A fine normal is a third component near 1: the decimated sphere is smooth.
    assert np.median(mesh.normal_map[corner[:, 1], corner[:, 0], 2]) > 250


def test_what_one_station_was_told_to_leave_out_has_the_color_that_others_see(sphere, views: list[View]) -> None:  # type: ignore[no-untyped-def]
    outside = points_of(views[0])[..., 2] > 4
    part = replace(
        views[0], usable=views[0].usable & ~outside, color=np.where(outside[..., None], np.nan, views[0].color)
    )
    paints = [Paint.of([first, *views[1:]], sphere.vertices, sphere.normals) for first in (views[0], part)]
    expected, found = (paint.linear(sphere.vertices, sphere.normals) for paint in paints)
    np.testing.assert_allclose(found, expected, rtol=0.02)


def test_an_albedo_that_is_not_known_is_not_black(
    sphere: ObjectMesh, views: list[View], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = {view.name: view.color.astype(np.float32) for view in views}
    images["s0"][points_of(views[0])[..., 2] > 4] = np.nan
    monkeypatch.setattr("malus.object.albedo.albedo_of", lambda workspace: images[workspace.folder.name])
    paint = Albedos.of(views, tmp_path, tmp_path / "scratch").paint(sphere)
    assert paint is not None
    expected = Paint.of(views, sphere.vertices, sphere.normals).linear(sphere.vertices, sphere.normals)
    np.testing.assert_allclose(paint.linear(sphere.vertices, sphere.normals), expected, rtol=0.02)


def test_between_rims_the_color_is_that_of_the_place_beside(
    sphere: ObjectMesh, views: list[View], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No station sees a belt of ten GSD; it has no specks of the color that stands for what is far from anything seen."""
    belted = [replace(view, usable=view.usable & (np.abs(points_of(view)[..., 1]) > 1)) for view in views]
    belt = np.abs(sphere.vertices[:, 1]) < 0.8
    above, below = belt & (sphere.vertices[:, 2] > 2), belt & (sphere.vertices[:, 2] < -2)
    whole, paint = (Paint.of(some, sphere.vertices, sphere.normals) for some in (views, belted))
    expected, found = (paint_.linear(sphere.vertices, sphere.normals) for paint_ in (whole, paint))
    for part in (above, below):
        np.testing.assert_allclose(found[part], expected[part], rtol=0.02)
    far = sphere.vertices[:, 0] < -2
    alone = Paint.of(belted[:1], sphere.vertices, sphere.normals)
    assert (alone.linear(sphere.vertices[far], sphere.normals[far]) == alone.missing / alone.white).all()
    # Nor is it lent much farther if only some places of a large mesh are searched.
    monkeypatch.setattr("malus.object.color._SAMPLE", len(sphere.vertices) // 64)
    far = sphere.vertices[:, 0] < -4
    alone = Paint.of(belted[:1], sphere.vertices, sphere.normals)
    assert (alone.linear(sphere.vertices[far], sphere.normals[far]) == alone.missing / alone.white).all()


def test_albedo_has_a_texture_of_its_own(sphere, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """The photographs are lit from one side and differ in exposure; the albedos do only the latter, and one station has none."""
    lit = [replace(view, color=view.color * (1.2 + view.normals[..., :1])) for view in
           (sphere_view(f"s{k}", axis) for k, axis in enumerate(AXES))]  # fmt: skip
    images = [sphere_view(f"s{k}", axis, light=1.0 if k % 2 else 0.5).color for k, axis in enumerate(AXES)]
    paint = Paint.of(lit, sphere.vertices, sphere.normals)
    bare = Paint.of(lit[:-1], sphere.vertices, sphere.normals, images[:-1])
    levels = levels_of_detail(sphere, 2000, paint, lit[0].gsd, albedo=bare)
    mesh = levels[0]
    assert mesh.albedo is not None
    corner = np.minimum((mesh.uv * len(mesh.color)).astype(int), len(mesh.color) - 1)
    side = mesh.vertices[:, 2] > 2
    shown, own = (image[corner[side, 1], corner[side, 0]].mean(1) for image in (mesh.color, mesh.albedo))
    assert np.ptp(np.percentile(shown, [5, 95])) > 60 and np.ptp(np.percentile(own, [5, 95])) < 12
    below = mesh.vertices[:, 2] < -2
    # The station that looks from below has no albedo: what it alone sees is the median of the rest.
    assert own.mean() > mesh.albedo[corner[below, 1], corner[below, 0]].mean() + 30
    files, figures = write_levels(tmp_path, levels, "mm", "sphere")
    assert files[-1].name == "albedo.glb" and len(figures) == len(levels)
    trimesh = pytest.importorskip("trimesh")
    for name, image in (("mesh.glb", mesh.color), ("albedo.glb", mesh.albedo)):
        (read,) = trimesh.load(tmp_path / name).geometry.values()
        texture_of = np.asarray(read.visual.material.baseColorTexture)[..., :3].astype(int)
        assert np.abs(texture_of - image).mean() < 3  # JPEG


def test_the_textured_mesh_is_the_same_in_any_unit(thin: OrientedPoints, tmp_path: Path) -> None:
    """In meters, most triangles were below a limit of area of the library that unfolds them, and had no place in the texture."""
    full = joined_mesh(pieces(thin, CELL), tmp_path, 1.0)
    gray: Any = SimpleNamespace(linear=lambda points, _: np.full((len(points), 3), 0.5))
    meshes = {
        meters: textured(replace(full, vertices=full.vertices / meters), 1000, gray, CELL / meters)
        for meters in (1, 1e3, 1e-3)
    }
    for meters, mesh in meshes.items():
        corners = mesh.uv[mesh.triangles]
        (a, b), (c, d) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
        assert (a * d != b * c).all()
        assert len(mesh.color) == pytest.approx(len(meshes[1].color), rel=0.05)
        assert meters * mesh.deviation == pytest.approx(meshes[1].deviation, rel=0.05)
        np.testing.assert_allclose(meters * np.ptp(mesh.vertices, axis=0), 2 * RADIUS, rtol=0.05)


def normals_of_texels(mesh: TexturedMesh) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """World normals that the normal map gives at the middle of triangles, and these places."""
    places, uv, normals = (values[mesh.triangles].mean(1) for values in (mesh.vertices, mesh.uv, mesh.normals))
    along = mesh.tangents[mesh.triangles, :3].mean(1)
    side = len(mesh.color)
    local = mesh.normal_map[(uv[:, 1] * side).astype(int), (uv[:, 0] * side).astype(int)] / 127.5 - 1
    n = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    t = along - n * (along * n).sum(1, keepdims=True)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    b = np.cross(n, t) * mesh.tangents[mesh.triangles[:, 0], 3:]
    return local[:, :1] * t + local[:, 1:2] * b + local[:, 2:] * n, places


def test_levels_of_detail_get_smaller_and_keep_the_full_normals(
    thin: OrientedPoints, views: list[View], tmp_path: Path
) -> None:
    full = joined_mesh(pieces(thin, CELL), tmp_path / "full", 1.0)
    paint = Paint.of(views, full.vertices, full.normals)
    levels = levels_of_detail(full, 4000, paint, CELL)
    assert [len(level.triangles) for level in levels] == pytest.approx([4000, 1000], rel=0.02)
    assert len(levels[1].color) < 0.75 * len(levels[0].color)
    assert levels[0].deviation < levels[1].deviation < 0.1
    simpler = joined_mesh(pieces(thin, 2 * CELL), tmp_path / "simpler", 1.0)
    (coarse,) = levels_of_detail(full, 1000, paint, CELL, simpler)
    assert len(coarse.triangles) == pytest.approx(1000, rel=0.02) and coarse.deviation < 0.3
    # A mesh with fewer triangles than are allowed has simpler levels, too.
    few = levels_of_detail(simpler, 8 * len(simpler.triangles), paint, CELL)
    assert [len(level.triangles) for level in few] == pytest.approx(
        [len(simpler.triangles), len(simpler.triangles) / 4], rel=0.02
    )
    for level in levels:
        normals, places = normals_of_texels(level)
        cosine = (normals * places).sum(1) / np.linalg.norm(places, axis=1) / np.linalg.norm(normals, axis=1)
        # The triangles of the last are 5 degrees off the sphere at their corners.
        assert np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))) < 2
    files, figures = write_levels(tmp_path, levels, "mm", "sphere")
    assert [path.name for path in files] == ["mesh.glb", "0.glb", "1.glb"]
    assert [row["triangles"] for row in figures] == [len(level.triangles) for level in levels]
    assert [row["bytes"] for row in figures] == [path.stat().st_size for path in files[1:]]
    for path in files:
        content = path.read_bytes()
        assert struct.unpack("<4sII", content[:12]) == (b"glTF", 2, len(content))
        document = json.loads(content[20 : 20 + struct.unpack("<I", content[12:16])[0]])
        assert document.get("extensionsRequired", []) == ([] if path.name == "mesh.glb" else ["EXT_texture_webp"])
        assert {image["mimeType"] for image in document["images"]} == (
            {"image/jpeg", "image/png"} if path.name == "mesh.glb" else {"image/webp"}
        )
    assert {row["texture_format"] for row in figures} == {"webp"}
    files_of_webp = [path.read_bytes() for path in files]
    # Readers without EXT_texture_webp, such as MeshLab, open levels with JPEG and PNG textures.
    write_levels(tmp_path / "jpeg", levels, "mm", "sphere", "jpeg")
    for k in range(len(levels)):
        content = (tmp_path / f"jpeg/levels/{k}.glb").read_bytes()
        document = json.loads(content[20 : 20 + struct.unpack("<I", content[12:16])[0]])
        assert "extensionsUsed" not in document and "extensionsRequired" not in document
        assert [document["images"][texture["source"]]["mimeType"] for texture in document["textures"]] == [
            "image/jpeg",
            "image/png",
        ]
    assert [path.read_bytes() for path in files] == files_of_webp
    trimesh = pytest.importorskip("trimesh")
    for path, level in zip(files, [levels[0], *levels], strict=True):
        scene = trimesh.load(path)
        (read,) = scene.geometry.values()
        assert scene.extents == pytest.approx([0.02, 0.02, 0.02], rel=0.05)
        assert len(read.faces) == len(level.triangles)
        assert np.asarray(read.visual.material.baseColorTexture).shape[:2] == level.color.shape[:2]
        fine = np.asarray(read.visual.material.normalTexture)[..., :3]
        assert (fine == level.normal_map).all()  # lossless


def test_large_meshes_are_searched_in_parts(sphere, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    places = 1.01 * sphere.vertices[::40]
    expected = NearestVertices(sphere)(places)
    monkeypatch.setattr(texture, "_MOST_IN_MEMORY", 10)
    find = NearestVertices(sphere)
    assert (np.concatenate([find(part) for part in np.array_split(places, 9)]) == expected).all()
    assert (find(places[:1]) == expected[:1]).all()


def test_tangents_are_unit_vectors_where_the_texture_has_no_area() -> None:
    """The second triangle is one point of the texture."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]])
    uv = np.array([[0.0, 0], [1, 0], [0, 1], [0.5, 0.5], [0.5, 0.5], [0.5, 0.5]])
    normals = np.tile([0.0, 0, 1], (6, 1))
    tangents = _tangents(points, normals, uv, np.array([[0, 1, 2], [3, 4, 5]]))
    np.testing.assert_allclose(tangents[:3, :3], np.tile([1.0, 0, 0], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(tangents[:, :3], axis=1), 1)
    np.testing.assert_allclose((tangents[:, :3] * normals).sum(1), 0, atol=1e-12)


def test_meshes_are_written_as_they_are_read(tmp_path: Path) -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    write_ply(
        tmp_path / "a.ply",
        {**{name: (vertices[:, k], "f8") for k, name in enumerate("xyz")}, "sigma": (np.ones(4), "f4")},
        triangles,
        "test",
    )
    points, faces = read_mesh(tmp_path / "a.ply")
    assert (points == vertices).all() and (faces == triangles).all() and is_closed(faces)
    assert not is_closed(faces[:3])
    assert not is_closed(faces[:, ::-1][:1].repeat(2, 0))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("[object]", "[objects]", "unknown key [objects]; did you mean object?"),
        ("name =", "nam =", "unknown key object.nam; did you mean name?"),
        ('"o0/station.toml"', '"o7/*.toml"', "object.stations: no file matches 'o7/*.toml'"),
        ("closed = false", "closed = 1", "object.closed = 1, expected true or false"),
        ("closed = false", "max_sigma_gsd = -1", "object.max_sigma_gsd = -1, expected more than 0"),
        ("faces = 3000", "faces = 3", "object.faces = 3, expected 100 to 1000000000"),
        ("faces = 3000", "faces = inf", "object.faces = 'Infinity', expected a number"),
        ("closed = false", 'texture_format = "png"', "object.texture_format = 'png', expected 'webp' or 'jpeg'"),
        ("closed = false", 'unit = "m"', "station.unit = 'mm', expected 'm'"),
        ('name = "pair"', 'name = ""', "object.name = '', expected a text"),
        ('"o0/station.toml"', '"*.toml"', "object.stations: no file matches '*.toml'"),
        ('"o0/station.toml"', '"object.toml"', "object.toml: is an object file, expected a station file"),
    ],
)
def test_object_files_that_are_wrong(pair: Path, old: str, new: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        Object.load(edit(pair, old, new))
    assert expected in str(caught.value)


@pytest.fixture(scope="module")
def made(tiny_station_source: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome, bytes]:
    """A pair, what the command line said as it made the pair's surface in out/, and the mesh that it wrote."""
    file = write_pair(tiny_station_source, tmp_path_factory.mktemp("pair"))
    outcome = run_malus("object", file, "-o", file.parent / "out", "--jobs", "2", "--threads", "1")
    assert outcome.code == 0, outcome.err
    return file, outcome, (file.parent / "out/object/mesh.ply").read_bytes()


def test_command_line_makes_one_surface_and_does_nothing_twice(
    made: tuple[Path, Outcome, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the first run to a station that is taken out: the page tells how far stations can be trusted, and forgets that one."""
    pair, first, _ = made
    output = pair.parent / "out"
    quality = json.loads((output / "object/quality.json").read_text())
    assert [row["station"] for row in quality["stations"]] == ["o0", "o1"]
    assert quality["agreement"]["rms_ratio"] < 0.05
    assert quality["mesh"]["triangles"] > 2500 and not quality["mesh"]["closed"]
    require_statements(output)
    require_limit(output / "stations/o0")
    assert {"mesh.ply", "mesh.glb", "levels/0.glb", "report/index.html"} <= set(quality["files"])
    assert first.out.startswith("pair: ") and "mm, 2 of 2 stations, " in first.out
    assert not half_written(output)
    written = (output / "object/mesh.ply").stat().st_mtime_ns
    quiet = malus_here("object", pair, "-o", output, "--quiet")
    assert quiet.code == 0 and not quiet.out
    assert (output / "object/mesh.ply").stat().st_mtime_ns == written
    require_told(pair, output, first, quiet)
    require_scale(output)
    edit(output / "object/quality.json", '"gsd": ', '"gsd": 1')
    monkeypatch.setattr(object_run, "write_record", recorded)
    assert malus_here("object", pair, "-o", output, "--quiet").code == 0
    # There are no times in it: it is made again to the bit.
    assert json.loads((output / "object/quality.json").read_text()) == quality
    # A cloud that is replaced while the surface is made, after the stations have been run.
    (output / "object/mesh.ply").write_bytes(b"spoiled")
    with monkeypatch.context() as patch:
        patch.setattr(object_run, "write_mesh", changing(pair.parent / "o1/dense/cloud.ply", object_run.write_mesh))
        outcome = malus_here("object", pair, "-o", output, "--quiet")
    assert outcome.code == 2 and "o1/station.toml: its files or results were changed" in outcome.err
    # What is left of an earlier surface, or made of this one, would look finished.
    assert {path.name for path in (output / "object").iterdir()} <= {"lock"}
    require_gone(pair, output)


def require_limit(station: Path) -> None:
    """By default a surface counts if it is as sure as four pixels or as four standard deviations of a point, whichever is more."""
    view, noise = load_view("o0", station), Workspace(station).manifest["steps"]["prior"]["notes"]["noise"]
    assert view.most_sigma == pytest.approx(4 * max(view.gsd, noise)) and noise > 0
    assert view.usable.any() and view.sigma[view.usable].max() < view.most_sigma
    strict = load_view("o0", station, float(np.median(view.sigma[view.usable])) / view.gsd)
    assert 0.3 < strict.unsure < 0.7 and strict.usable.sum() < 0.7 * view.usable.sum()


def recorded(path: Path, record: dict[str, Any]) -> None:
    """As write_record. A run killed at it must leave no temporary folder: the next run would find the surface made, and remove nothing."""
    assert not list(path.parent.glob(".mesh-*"))
    write_record(path, record)


def comments_of(output: Path) -> set[str]:
    header = (output / "object/mesh.ply").read_bytes().split(b"end_header", 1)[0].decode()
    return {line.removeprefix("comment ") for line in header.splitlines() if line.startswith("comment ")}


def require_statements(output: Path) -> None:
    """What the meshes state: the catalog entries of the stations, and how far each can be trusted."""
    comments = comments_of(output)
    confidence = json.loads((output / "stations/o0/quality.json").read_text())["confidence"]
    trusted = " ".join([confidence["level"], *confidence["reasons"]])
    assert {"title: Relief & label", "identifier: X 1907.4", "unit: mm", f"confidence of o0: {trusted}"} <= comments
    for name in ("mesh.glb", "levels/0.glb"):
        content = (output / "object" / name).read_bytes()
        document = json.loads(content[20 : 20 + struct.unpack("<I", content[12:16])[0]])
        assert {f"{key}: {words}" for key, words in document["asset"]["extras"].items()} == comments
        assert document["materials"][0]["doubleSided"]  # seen from behind, an open surface was not there


@pytest.mark.parametrize(
    ("place", "gsd", "double"),
    [
        (100.0, 0.05, False),  # millimeters about the origin
        (500_000.0, 5e-4, True),  # a local grid in meters
        (4_000.0, 0.05, True),  # a monument of 80 000 GSD, about the origin
    ],
)
def test_coordinates_are_double_where_single_precision_would_move_vertices(
    place: float, gsd: float, double: bool
) -> None:
    vertices = np.array([[0.0, 0, 0], [1, 1, 1]]) - [place, 0, 0]
    assert needs_double(vertices, gsd) == double
    moved = np.abs(vertices.astype(np.float32) - vertices).max()
    assert double or moved <= 1e-3 * gsd


def changing(file: Path, function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, which changes a file before."""

    def changed(*arguments: Any) -> Any:
        file.write_bytes(file.read_bytes() + b" ")
        return function(*arguments)

    return changed


def test_broken_station_is_told_until_it_is_taken_out_and_the_others_are_joined(pair: Path) -> None:
    (pair.parent / "o1/pol/pol_030.tif").write_bytes(b"no image")
    output = pair.parent / "out"
    outcome = malus_here("object", pair, "-o", output, "--threads", "1")
    assert outcome.code == 2
    assert "o1" in outcome.err and "pol_030.tif" in outcome.err and "Traceback" not in outcome.err
    quality = json.loads((output / "object/quality.json").read_text())
    assert quality["warnings"][-1].startswith("o1: is not in the surface: polarized image o1/pol/")
    assert f"warning 1: {quality['warnings'][-1]}" in comments_of(output)
    assert str(pair.parent) in outcome.err and str(pair.parent) not in json.dumps(quality["stations"])
    assert [row["status"] for row in quality["stations"]] == ["done", "failed"]
    assert (output / "object/mesh.ply").is_file()
    page = (output / "object/report/index.html").read_text()
    assert str(pair.parent) not in page
    assert (
        'id="station-o1"' in page
        and "One surface of 1 station " in page
        and "No surface of one station lies where another has its own." in page
    )
    require_gone(pair, output)


def test_an_error_of_the_surface_hides_no_station_that_failed(pair: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise DataError("stations agree on no surface")

    outcomes = [
        {"station": "o0", "status": "done", "reason": "", "manifest": "1"},
        {"station": "o1", "status": "failed", "reason": "pol_030.tif: is no image"},
    ]
    for name in ("run_campaign", "outcomes_of"):
        monkeypatch.setattr(object_run.batch, name, lambda *_, **__: outcomes)
    monkeypatch.setattr(object_run, "_fuse", fail)
    with pytest.raises(DataError) as caught:
        run_object(Object.load(pair), pair.parent / "out")
    assert caught.value.__notes__ == ["warning before it: o1: is not in the surface: pol_030.tif: is no image"]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/home/anna/bust/st1/station.toml: x", "st1/station.toml: x"),
        ("no '/home/anna/views/a b.jpg'", "no '../views/a b.jpg'"),
        ("/mnt/home/anna/bust/x and /home/ben/y", "/mnt/home/anna/bust/x and ../../ben/y"),
    ],
)
def test_reasons_name_files_as_the_object_file_would(text: str, shown: str) -> None:
    assert with_relative_paths(text, Path("/home/anna/bust")) == shown


def test_no_earlier_surface_stays_where_all_stations_fail(pair: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It looked like the result of the run that failed."""
    folder = pair.parent / "out/object"
    (folder / "report").mkdir(parents=True)
    for name in ("quality.json", "mesh.ply", "mesh.glb", "report/index.html"):
        (folder / name).write_text("earlier")
    outcomes = [{"station": "o0", "status": "failed", "reason": "pol_030.tif: is no image", "exit_code": 2}]
    for name in ("run_campaign", "outcomes_of"):
        monkeypatch.setattr(object_run.batch, name, lambda *_, **__: outcomes)
    with pytest.raises(InputError, match="1 of 1 stations failed"):
        run_object(Object.load(pair), pair.parent / "out")
    assert [path.name for path in folder.iterdir()] == ["lock"]


def done_by_hand(monkeypatch: pytest.MonkeyPatch, outcomes: list[Any], ran: Callable[..., None]) -> list[list[Any]]:
    """Lets `ran` stand for the run of the stations, and a record for the surface; returns the outcomes that surfaces were made of."""
    made: list[list[Any]] = []

    def campaign(*_: Any, **__: Any) -> list[Any]:
        ran()
        return list(outcomes)

    def fuse(_: Any, used: list[Any], frame: Any, folder: Path, key: str, *__: Any) -> None:
        made.append(list(used))
        (folder / "mesh.ply").write_text(key)
        write_record(folder / "quality.json", {"key": key, "files": {}})

    monkeypatch.setattr(object_run.batch, "run_campaign", campaign)
    monkeypatch.setattr(object_run.batch, "outcomes_of", lambda *_, **__: list(outcomes))
    monkeypatch.setattr(object_run, "_fuse", fuse)
    return made


def outcome_of(name: str, status: str = "done", **more: Any) -> dict[str, Any]:
    return {"station": name, "file": f"{name}/station.toml", "status": status, "reason": "", "exit_code": 0} | more


@pytest.mark.parametrize("change", ["option", "result", "nothing"])
def test_no_earlier_surface_stays_where_a_run_is_interrupted(
    pair: Path, monkeypatch: pytest.MonkeyPatch, change: str
) -> None:
    """After a change it looked like the result of the run that was interrupted."""
    outcomes = [outcome_of(name, manifest="1") for name in ("o0", "o1")]
    made = done_by_hand(monkeypatch, outcomes, lambda: None)
    run_object(Object.load(pair), pair.parent / "out")
    assert len(made) == 1
    if change == "option":
        outcomes[1] = outcome_of("o1", "pending")
    if change == "result":
        outcomes[1]["manifest"] = "2"

    def interrupted() -> None:
        raise KeyboardInterrupt

    done_by_hand(monkeypatch, outcomes, interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_object(Object.load(pair), pair.parent / "out")
    assert (pair.parent / "out/object/mesh.ply").exists() == (change == "nothing")


@pytest.mark.parametrize("removing", ["shutil.rmtree", "Path.unlink"])
def test_an_interrupted_removal_leaves_no_part_of_a_surface(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, removing: str
) -> None:
    """The page and the maps of agreement stayed, which looked finished, when the mesh was gone."""

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    for name in ("quality.json", "mesh.ply", "albedo.glb", "levels/0.glb", "agreement/o0.png", "report/index.html"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("earlier")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(f"malus.object.run.{removing}", interrupted)
        object_run._clear(tmp_path)
    assert all(path.name.startswith(".mesh-") for path in tmp_path.iterdir())
    object_run._clear(tmp_path)
    assert not list(tmp_path.iterdir())


def test_an_interrupted_search_for_cameras_leaves_no_surface_of_other_photos(
    with_surface: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(object_run, "find_frame", interrupted)
    for stays in (True, False):
        with pytest.raises(KeyboardInterrupt):
            run_object(Object.load(with_surface), with_surface.parent / "out")
        assert (with_surface.parent / "out/object/mesh.ply").exists() == stays
        Image.new("L", (96, 64), 90).save(with_surface.parent / "views/1.png")


def meanwhile(folder: Path, act: Callable[[], None]) -> threading.Thread:
    """Holds the object's folder as another shard does that makes the surface; `act` is what it does before it lets go."""
    held = threading.Event()

    def hold() -> None:
        with exclusive(folder):
            held.set()
            time.sleep(0.3)
            act()

    other = threading.Thread(target=hold)
    other.start()
    held.wait()
    return other


@pytest.mark.parametrize("by_other", ["made", "ran"])
def test_shards_that_end_together_wait_for_each_other(
    pair: Path, monkeypatch: pytest.MonkeyPatch, by_other: str
) -> None:
    """The second one failed. If it had run a failed station again, the first one's surface was removed, too."""
    thing, folder = Object.load(pair), pair.parent / "out/object"
    outcomes = [outcome_of("o0", manifest="1"), outcome_of("o1", "failed", reason="no light", exit_code=2)]
    others: list[threading.Thread] = []

    def act() -> None:
        if by_other == "ran":
            outcomes[1] = outcome_of("o1", manifest="1")
        else:
            key = object_run._key(thing, outcomes, None)
            object_run._fuse(thing, outcomes, None, folder, key, None, 1, lambda *_: None)

    made = done_by_hand(monkeypatch, outcomes, lambda: others.append(meanwhile(folder, act)))
    told = run_object(thing, pair.parent / "out")
    others[0].join()
    assert made == [outcomes] == [told]
    # Another one that begins while the surface is made does not take it for an earlier one.
    others.append(meanwhile(folder, lambda: None))
    monkeypatch.setattr(object_run.batch, "run_campaign", lambda *_, **__: list(outcomes))
    run_object(thing, pair.parent / "out")
    others[1].join()
    assert len(made) == 1


def test_a_station_that_fails_again_as_before_changes_no_surface(pair: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    thing = Object.load(pair)
    before = [outcome_of("o0", manifest="1", seconds=1.0), outcome_of("o1", "failed", reason="no light", seconds=2.0)]
    after = [*before[:1], {**before[1], "seconds": 3.0}]
    monkeypatch.setattr(object_run.batch, "outcomes_of", lambda *_: after)
    key = object_run._key(thing, before, None)
    object_run._require_unchanged(thing, before, None, pair.parent / "out/object", key)
    after[1] = {**after[1], "reason": "no lens"}
    with pytest.raises(InputError, match="o1/station.toml: its files or results were changed"):
        object_run._require_unchanged(thing, before, None, pair.parent / "out/object", key)


def require_gone(pair: Path, output: Path) -> None:
    """Takes o1 out of the object file, and runs it again: nothing of the object tells of it any more."""
    outcome = malus_here("object", edit(pair, ', "o1/station.toml"', ""), "-o", output, "--threads", "1")
    assert outcome.code == 0, outcome.err
    page = (output / "object/report/index.html").read_text()
    assert [row["station"] for row in json.loads((output / "object/quality.json").read_text())["stations"]] == ["o0"]
    assert "o1" not in re.sub(r"base64,[^\"]*", "", page).split("<script")[0]
    assert [path.name for path in (output / "object/agreement").iterdir()] == ["o0.png"]
    assert "o1" not in (output / "index.html").read_text() + (output / "campaign.csv").read_text()


def require_told(pair: Path, output: Path, outcome: Outcome, quiet: Outcome) -> None:
    """How far stations can be trusted, on the page and by the first run, a quiet one and two others that have nothing to do."""
    again = malus_here("object", pair, "-o", output)
    assert "stations      2 of 2 done" in again.err and "100 %  object " in again.err, "all kept"
    assert "  run now: none; run before or elsewhere: 2\n" in again.out and "run now" not in outcome.out
    events = [json.loads(line) for line in malus_here("object", pair, "-o", output, "--json").out.splitlines()]
    told = [event["message"] for event in events if event["event"] == "log" and event["level"] == "warning"]
    assert told == [line.removeprefix("warning: ") for line in quiet.err.splitlines()] and told
    text = html.unescape((output / "object/report/index.html").read_text())
    for name in ("o0", "o1"):
        confidence = json.loads((output / f"stations/{name}/quality.json").read_text())["confidence"]
        row = text.split(f'<tr id="station-{name}">')[1].split("</tr>")[0]
        assert f"confidence {confidence['level']}" in row
        assert all(text.count(reason) == 1 for reason in confidence["reasons"])  # once for all stations, first of all
        said = f"{name}: confidence {confidence['level']}: {confidence['reasons'][0]}"
        assert said in outcome.out and said in quiet.err
        assert any(line.startswith(said) for line in told)
        assert " 50 %  stations " in outcome.err and "100 %  object " in outcome.err
        size, mesh = outcome.out.splitlines()[0], outcome.out.splitlines()[2]
        assert re.fullmatch(r"pair: [\d.]+ × [\d.]+ × [\d.]+ mm, 2 of 2 stations, one pixel is [\d.]+ µm", size)
        assert "triangles, open; 100.0 % of the surface measured" in mesh
        assert f"  report: malus view {output / 'object'}" in outcome.out
        assert row.count('<td class="n">') == 8, "numbers stand right"
        assert f"Agreement of {name} with the other stations: 100.0 % of what they see together" in text


def require_scale(output: Path) -> None:
    """What the page's view shows is as large by its scale bar as the mesh is, however far one zooms."""
    page = output / "object/report/index.html"
    views = json.loads(page.read_text().split('id="object-data">')[1].split("</script>")[0])
    longest = max(views["extent"])
    assert views["seen_by"] == ["o0", "o1"]
    with turning_view(page, "object") as view:
        home = pixel_mm(view)
        view.locator("[name=paint]").select_option("seen-1")
        assert max(drawn_mm(view)) == pytest.approx(longest, rel=0.08)
        view.get_by_role("button", name="Zoom in").click()
        assert pixel_mm(view) == pytest.approx(home / 1.5, rel=2e-3)
        view.locator("canvas").focus()
        for key in "--":
            view.page.keyboard.press(key)
        assert pixel_mm(view) == pytest.approx(home / 1.5 / 0.8**2, rel=2e-3)
        assert max(drawn_mm(view)) == pytest.approx(longest, rel=0.08)
        view.page.keyboard.press("0")
        assert pixel_mm(view) == pytest.approx(home, rel=2e-3)


def test_reasons_are_given_once_for_all_their_stations() -> None:
    page = importlib.import_module("malus.object.page")
    same = "The light is a map, fitted at 2.5 mm."
    stations = [
        {"station": "a", "reasons": f"In 47 % of the object it is the prior's. {same}"},
        {"station": "b", "reasons": same},
        {"station": "c", "reasons": f"In 8 % of the object it is the prior's. {same}"},
    ]
    assert page.reasons_of(stations) == [
        ("In 8 to 47 % of the object it is the prior's.", ["a", "c"]),
        (same, ["a", "b", "c"]),
    ]
    assert page.reasons_of([]) == []
    unknown = {"a": "a: is bare metal", "b": "b: has no light", "c": "c: is bare metal"}
    assert page.reasons_without_albedo(unknown) == ["a, c: is bare metal", "b: has no light"]
    # Names of files: what is a number in them is no figure, and they may have any sign.
    named = [f"Images are linear according to their files ({file} and 5 more)." for file in ("#1.tif", "IMG_0012.JPG")]
    other = named[1].replace("0012", "0030")
    told = [{"station": name, "reasons": said} for name, said in zip("abc", [*named, other], strict=True)]
    assert page.reasons_of(told) == [(named[0], ["a"]), (named[1], ["b"]), (other, ["c"])]


def test_maps_on_the_page_are_cut_to_what_they_show_and_have_a_scale(tmp_path: Path) -> None:
    page = importlib.import_module("malus.object.page")
    colors = np.full((100, 200, 3), 128, np.uint8)
    colors[40:60, 50:150] = (10, 128, 128)
    Image.fromarray(colors).save(tmp_path / "a.png")
    quality = {"unit": "mm", "stations": [{"station": "a", "status": "done", "gsd": 0.5}]}
    shown = page._maps(tmp_path, quality)["a"]
    assert (shown.width, shown.height) == (108, 20)
    assert shown.bar_label == "10 mm" and shown.bar_percent == pytest.approx(100 * 10 / 54)


def test_shards_leave_the_surface_to_the_last(pair: Path) -> None:
    output = pair.parent / "out"
    words = ("object", pair, "-o", output, "--shard", "1/2", "--threads", "2")
    first = malus_here(*words)
    assert first.code == 0 and "1 of 2 stations are not run yet" in first.out
    quiet = malus_here(*words, "--quiet")
    assert quiet.code == 0 and not quiet.out
    assert not (output / "object").exists()


@needs_distributed
@pytest.mark.filterwarnings("ignore")  # Dask's own, while it loses a worker
def test_a_killed_worker_changes_nothing(pair: Path, tmp_path: Path, made: tuple[Path, Outcome, bytes]) -> None:
    import distributed

    thing = Object.load(pair)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        victim = next(iter(cluster.workers.values())).pid

        def kill() -> None:
            while len(list(tmp_path.glob("cluster/stations/*/manifest.json"))) < 2:  # both are at work
                time.sleep(0.02)
            os.kill(victim, signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        outcomes = run_object(thing, tmp_path / "cluster", threads=1, scheduler=cluster.scheduler_address)
        killer.join()
    assert [outcome["status"] for outcome in outcomes] == ["done", "done"]
    assert (tmp_path / "cluster/object/mesh.ply").read_bytes() == made[2]


def test_check_lists_every_station(pair: Path) -> None:
    outcome = malus_here("check", pair, "--threads", "1")
    assert outcome.code == 0, outcome.err
    assert "object pair: 2 stations" in outcome.out and "surface: one open mesh" in outcome.out
    times = r"(\d+) s one after another\n  surface: [^\n]*: (\d+) s\nexpected: about (\d+) s in all\n"
    stations, surface, total = map(int, re.search(times, outcome.out).groups())  # type: ignore[union-attr]
    assert abs(stations + surface - total) <= 1 <= total
    for name in ("o0", "o1"):
        assert f"station {name} (small): " in outcome.out
    told = json.loads(malus_here("check", pair, "--json", "--threads", "1").out)
    assert [plan["station"] for plan in told["stations"]] == ["o0", "o1"]
    seconds = [plan["seconds"] for plan in told["stations"]]
    assert (
        told["seconds"] == pytest.approx(sum(seconds) + told["surface"]["seconds"]) and told["surface"]["seconds"] > 0
    )


def test_check_of_an_object_has_no_picture(pair: Path) -> None:
    outcome = malus_here("check", pair, "--overlay", "x.png")
    assert outcome.code == 2 and "--overlay x.png: is a picture of one station" in outcome.err


def test_check_names_every_station_that_cannot_be_run(pair: Path) -> None:
    """It ended at the first of them."""
    for k in range(2):
        (pair.parent / f"o{k}/pol/pol_0{3 * (k + 1)}0.tif").write_bytes(b"no image")
    outcome = malus_here("check", pair, "--threads", "1")
    assert outcome.code == 2 and "2 of 2 stations cannot be run" in outcome.err
    assert all(re.search(rf"o{k}: .*pol_0{3 * (k + 1)}0.tif", outcome.err) for k in range(2))


def test_check_names_every_station_whose_file_cannot_be_read(pair: Path) -> None:
    for k in range(2):
        (pair.parent / f"o{k}/pol/pol_0{3 * (k + 1)}0.tif").unlink()
    outcome = malus_here("check", pair, "--threads", "1")
    assert outcome.code == 2 and "2 of 2 stations cannot be run" in outcome.err
    assert all(re.search(rf"o{k}: .*pol_0{3 * (k + 1)}0.tif", outcome.err) for k in range(2)), outcome.err


def test_station_files_beside_the_objects_own_match_a_glob(pair: Path) -> None:
    """The object's file was read as one of the stations."""
    for k in range(2):
        shutil.copytree(pair.parent / f"o{k}", pair.parent, dirs_exist_ok=True)
        (pair.parent / "station.toml").rename(pair.parent / f"o{k}.toml")
    edit(pair, '"o0/station.toml", "o1/station.toml"', '"*.toml"')
    assert [path.name for path in Object.load(pair).campaign.stations] == ["o0.toml", "o1.toml"]


def test_check_says_what_would_end_the_run_after_its_stations(pair: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: Any) -> None:
        raise ExternalError("COLMAP is missing")

    definition = importlib.import_module("malus.object.definition")
    monkeypatch.setattr(definition, "Colmap", none)
    Object.load(pair).require_ready()
    closed = Object.load(edit(pair, "closed = false", "closed = true"))
    with pytest.raises(ExternalError, match="COLMAP is missing"):
        closed.check()
    monkeypatch.setattr(definition, "require_packages", none)
    with pytest.raises(ExternalError):
        Object.load(edit(pair, "closed = true", "closed = false")).check()


def test_a_run_of_an_object_from_photos_begins_with_colmap(photographed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was looked for after the polarization of all stations had been computed."""

    def none(*_: Any) -> None:
        raise ExternalError("COLMAP is missing")

    monkeypatch.setattr(importlib.import_module("malus.object.definition"), "Colmap", none)
    with pytest.raises(ExternalError, match="COLMAP is missing"):
        run_object(Object.load(photographed), photographed.parent / "out")
    assert not (photographed.parent / "out").exists()


@pytest.mark.skipif(shutil.which("colmap") is None, reason="COLMAP is not installed")
def test_stations_are_found_in_the_photos_they_share(tmp_path: Path) -> None:
    """Two stations at one place, and one with a damaged image."""
    demo_with_photos(tmp_path / "a")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    shutil.copytree(tmp_path / "a", tmp_path / "lost")
    max((tmp_path / "lost/pol").iterdir()).write_bytes(b"no image")
    for name in ("b", "lost"):
        edit(tmp_path / name / "station.toml", 'folder = "views"', 'folder = "../a/views"')
    file = tmp_path / "object.toml"
    file.write_text(
        'object = { stations = ["*/station.toml"] }\n[options.photos]\nmax_features = 1500\n[options.sweep]\nagain = false\n'
    )
    thing = Object.load(file)
    frame = find_frame(thing, tmp_path / "out", 2, lambda *_: None)
    assert set(frame.figures["station"]) == {"a", "b"}
    first, second = (load_cameras(frame.cameras / f"{name}.json") for name in "ab")
    with pytest.raises(InputError, match=max((tmp_path / "lost/pol").iterdir()).name):
        load_cameras(frame.cameras / "lost.json")
    eyes = [-cameras.station.pose()[0].T @ cameras.station.pose()[1] for cameras in (first, second)]
    # Two copies of one image stand at one place, as far as features and windows locate it.
    assert np.linalg.norm(eyes[0] - eyes[1]) < 1e-3 * np.linalg.norm(eyes[0])
    assert len(first.photos) == 7  # six photos and the other station's image
    written = (tmp_path / "out/photogrammetry/done/mapping.json").stat().st_mtime_ns
    assert find_frame(thing, tmp_path / "out", 2, lambda *_: None) == frame
    assert (tmp_path / "out/photogrammetry/done/mapping.json").stat().st_mtime_ns == written
    # A station runs with them as it does with cameras of its own.
    events: list[Progress] = []
    result = reconstruct(
        Station.load(tmp_path / "a/station.toml"), thing.campaign.options, cameras=first, until="prior",
        workspace=tmp_path / "out/stations/a", replace=True, progress=events.append,
    )  # fmt: skip
    # It begins with the polarization that it was found with.
    assert {event.message for event in events if event.step == "polarization"} == {"kept from an earlier run"}
    assert result.prior_depth is not None and np.isfinite(result.prior_depth).mean() > 0.5


@pytest.fixture
def photographed(pair: Path, tmp_path: Path) -> Path:
    """The pair, its stations with photos in place of pose and prior."""
    (tmp_path / "views").mkdir()
    for number in range(3):
        Image.new("L", (96, 64), 100 + number).save(tmp_path / f"views/{number}.png")
    for k in range(2):
        station = tmp_path / f"o{k}/station.toml"
        edit(station, 'colmap_model = "sparse"\nimage = "station.jpg"',
             'model = "PINHOLE"\nwidth = 100\nheight = 80\nparams = [1937.0, 1937.0, 50.0, 40.0]')  # fmt: skip
        edit(station, '[prior]\ncloud = "dense/cloud.ply"', '[photos]\nfolder = "../views"')
    return pair


@pytest.fixture
def with_surface(photographed: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The photographed pair with a surface of its photos from an earlier run; no COLMAP is needed."""
    monkeypatch.setattr(Object, "require_ready", lambda _: None)
    monkeypatch.setattr(front_end, "Colmap", lambda *_: SimpleNamespace(title="", threads=1, peak_mb=0.0))
    folder = photographed.parent / "out/object"
    folder.mkdir(parents=True)
    key = object_run._key_of_files(Object.load(photographed), photographed.parent / "out")
    write_record(folder / "quality.json", {"photos_key": key})
    (folder / "mesh.ply").write_text("earlier")
    return photographed


@pytest.mark.parametrize("error", [DataError, InputError, ResourceError, ExternalError])
@pytest.mark.parametrize("change", ["nothing", "photo", "distance", "option", "station", "closed"])
def test_an_earlier_surface_stays_only_if_it_may_be_of_these_files(
    with_surface: Path, monkeypatch: pytest.MonkeyPatch, error: type[Exception], change: str
) -> None:
    """It looked like the result of the run that failed. A COLMAP that is not there or a full disk say nothing about it."""

    def fail(*_: object) -> None:
        raise error("no cameras")

    monkeypatch.setattr(object_run, "find_frame", fail)
    if change == "photo":
        Image.new("L", (96, 64), 90).save(with_surface.parent / "views/1.png")
    if change == "distance":
        ends = [f'[{{ image = "0.png", x = {x}, y = 4 }}, {{ image = "1.png", x = {x}, y = 4 }}]' for x in (3, 9)]
        in_stations(with_surface, f"\n[[scale]]\ndistance = 5\na = {ends[0]}\nb = {ends[1]}\n")
    if change == "option":
        edit(with_surface, "smoothing_px = 4", "smoothing_px = 5")
    if change == "station":
        edit(with_surface.parent / "o1/station.toml", "frames_averaged = 16", "frames_averaged = 17")
    if change == "closed":
        edit(with_surface, "closed = false", "closed = true")
    with pytest.raises(error, match="no cameras"):
        run_object(Object.load(with_surface), with_surface.parent / "out")
    stays = change == "nothing" and error is not DataError
    folder = with_surface.parent / "out/object"
    assert (folder / "mesh.ply").exists() == (folder / "quality.json").exists() == stays


@pytest.mark.parametrize("error", [ResourceError, InputError])
def test_a_copy_that_cannot_be_written_leaves_an_earlier_surface(
    with_surface: Path, monkeypatch: pytest.MonkeyPatch, error: type[Exception]
) -> None:
    """A full disk was taken for photos that cannot be used."""

    def fail(target: str, _: object) -> None:
        raise error(f"{target}: cannot be written")

    monkeypatch.setattr(_core, "write_png", fail)
    with pytest.raises(error, match=r"views/0.png: no copy could be written for COLMAP \(.*0.png: cannot be written"):
        run_object(Object.load(with_surface), with_surface.parent / "out", threads=1)
    assert (with_surface.parent / "out/object/mesh.ply").exists()
    # A damaged photo is no photo of that surface.
    (with_surface.parent / "views/0.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"views/0.png"):
        run_object(Object.load(with_surface), with_surface.parent / "out", threads=1)
    assert not (with_surface.parent / "out/object/mesh.ply").exists()


@pytest.fixture
def turning(photographed: Path) -> Path:
    """The photographed pair on a turntable, all photos and stations with masks."""
    edit(photographed, "closed = false", "closed = false\nturntable = true")
    (photographed.parent / "masks").mkdir()
    for number in range(3):
        Image.new("L", (96, 64), 255).save(photographed.parent / f"masks/{number}.png")
    for k in range(2):
        station = photographed.parent / f"o{k}/station.toml"
        edit(station, 'folder = "../views"', 'folder = "../views"\nmasks = "../masks"')
        edit(station, "[polarized]\n", '[polarized]\nmask = "mask.png"\n')
        Image.new("L", (100, 80), 255).save(photographed.parent / f"o{k}/mask.png")
    return photographed


def test_a_turntable_has_masks(turning: Path) -> None:
    thing = Object.load(turning)
    assert thing.turntable and thing.unmasked() == []
    (turning.parent / "masks/1.png").unlink()
    edit(turning.parent / "o1/station.toml", 'mask = "mask.png"\n', "")
    photos, stations = Object.load(turning).unmasked()
    assert photos.startswith("turntable: 1 of 3 photos have no mask (1.png): what stands still")
    assert stations.startswith("turntable: 1 of 2 stations have no mask (o1): what stands still")
    edit(turning.parent / "o0/station.toml", 'mask = "mask.png"\n', "")
    with pytest.raises(InputError, match=r"object.toml: object.turntable = true needs masks of the stations"):
        Object.load(turning)
    for k in range(2):
        edit(turning.parent / f"o{k}/station.toml", '\nmasks = "../masks"', "")
    with pytest.raises(InputError, match=r"object.toml: object.turntable = true needs masks of the photos"):
        Object.load(turning)
    assert Object.load(edit(turning, "turntable = true", "turntable = false")).unmasked() == []


def test_a_turntable_has_photos(pair: Path) -> None:
    with pytest.raises(InputError, match=r"object.toml: object.turntable = true needs \[photos\]"):
        Object.load(edit(pair, "closed = false", "turntable = true"))


@pytest.mark.skipif(shutil.which("colmap") is None, reason="COLMAP is not installed")
@pytest.mark.parametrize(("found", "said"), [(None, "no point is marked"), ({}, "2 of 2 stations failed\n")])
def test_an_error_of_the_search_for_cameras_has_the_warnings_before_it(
    turning: Path, monkeypatch: pytest.MonkeyPatch, found: dict[str, StationCameras] | None, said: str
) -> None:
    """That most photos had nothing in common was kept for a report that was never written."""

    def find(*_: Any, log: Callable[[str, str], None], **__: Any) -> dict[str, StationCameras]:
        log("warning", "2.png: nothing in common with the other photos")
        log("info", "matched")
        if found is None:
            raise DataError("no point is marked in two photos")
        return found

    monkeypatch.setattr(object_frame, "find_object_cameras", find)
    monkeypatch.setattr(object_frame, "unpolarized_scene", lambda *_: (np.ones((80, 100), np.float32), None))
    monkeypatch.setattr(object_frame, "_begin", lambda *_: None)
    outcome = malus_here("object", turning, "-o", turning.parent / "out", "--threads", "1", "--quiet")
    assert outcome.code == 3 and f"malus: {said}" in outcome.err
    assert "  warning before it: 2.png: nothing in common" in outcome.err and "matched" not in outcome.err


def test_check_says_which_masks_a_turntable_lacks(turning: Path) -> None:
    (turning.parent / "masks/1.png").unlink()
    outcome = malus_here("check", turning, "--threads", "1")
    assert outcome.code == 0, outcome.err
    said = " ".join(outcome.out.split())
    assert "warning: turntable: 1 of 3 photos have no mask (1.png)" in said
    assert "2 of 3 photos have a mask; a visual hull is made of at least 4" in said
    # With a third station, the outlines of two photos and of two other stations are enough.
    shutil.copytree(turning.parent / "o1", turning.parent / "o2")
    edit(turning, '"o1/station.toml"', '"o1/station.toml", "o2/station.toml"')
    assert "visual hull" not in malus_here("check", turning, "--threads", "1").out


@pytest.mark.parametrize("turntable", [True, False])
def test_masks_of_stations_on_a_turntable_reach_the_search_for_cameras(
    turning: Path, monkeypatch: pytest.MonkeyPatch, turntable: bool
) -> None:
    given: list[Any] = []

    def find(*_: Any, outlines: Any, **__: Any) -> dict[str, StationCameras]:
        given.append(outlines)
        return {}

    def scene(*_: Any) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        return np.ones((80, 100), np.float32), np.full((80, 100), 255, np.uint8)

    monkeypatch.setattr(object_frame, "find_object_cameras", find)
    monkeypatch.setattr(object_frame, "unpolarized_scene", scene)
    monkeypatch.setattr(object_frame, "_begin", lambda *_: None)
    edit(turning.parent / "o1/station.toml", 'mask = "mask.png"\n', "")
    if not turntable:
        edit(turning, "turntable = true", "turntable = false")
    frame = find_frame(Object.load(turning), turning.parent / "out", 1, lambda *_: None)
    if turntable:
        assert list(given[0]) == ["o0"] and given[0]["o0"].file == turning.parent / "o0/mask.png"
        assert given[0]["o0"].mask.shape == (80, 100)
    else:
        assert given == [None]
    assert len(frame.warnings) == turntable
    # No station was placed: each ends with that reason, and not the program.
    for name in ("o0", "o1"):
        with pytest.raises(DataError, match=f"{name} could not be placed among the photos"):
            load_cameras(frame.cameras / f"{name}.json")


@pytest.mark.parametrize("turntable", [True, False])
def test_outlines_of_the_other_stations_are_silhouettes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, turntable: bool
) -> None:
    """Of three stations the second has no mask; their lens has distortion, which the masks, as taken, have too."""
    lens = Camera("SIMPLE_RADIAL", 12, 8, [20.0, 5.5, 3.5, 0.1])
    masks = {name: tmp_path / f"{name}.png" for name in "ac"}
    outlines = {name: Outline(np.full((8, 12), 255, np.uint8), path) for name, path in masks.items()}
    seen: dict[str, StationView] = {}

    def place(bench: Bench, photos: Any, solved: Any, views: dict[str, StationView], said: Any) -> Any:
        seen.update(views)
        assert bench.inside_masks == turntable
        images = {
            image: RegisteredImage(Camera("PINHOLE", 12, 8, [20, 20, 5.5, 3.5], translation=[k, 0, 0]), (), 50)
            for k, image in enumerate(views)
        }
        model = SparseModel(images, np.zeros((0, 3)), np.zeros(0), np.zeros(0, int))
        placed = SimpleNamespace(has=lambda _: True, matches={image: {} for image in views}, model=model)
        return placed, model, {"photogrammetry": {}, "scale": None}

    monkeypatch.setattr(front_end, "_solved", lambda *_: ([], None))
    monkeypatch.setattr(front_end, "_placed_and_scaled", place)
    monkeypatch.setattr(front_end, "Colmap", lambda *_: SimpleNamespace(title="", threads=1, peak_mb=0.0))
    found = front_end.find_object_cameras(
        {}, {name: (lens, np.ones((8, 12), np.float32)) for name in "abc"}, tmp_path / "work",
        outlines=outlines if turntable else None,
    )  # fmt: skip
    assert [view.mask is not None for view in seen.values()] == [turntable, False, turntable]
    told = {name: [mask for _, mask, _ in cameras.silhouettes] for name, cameras in found.items()}
    assert told == ({"a": [masks["c"]], "b": [masks["a"], masks["c"]], "c": [masks["a"]]} if turntable else
                    {"a": [], "b": [], "c": []})  # fmt: skip
    if turntable:
        ((_, _, camera),) = found["a"].silhouettes
        assert (camera.model, list(camera.params)) == ("SIMPLE_RADIAL", list(lens.params))
        np.testing.assert_array_equal(camera.pose()[1], [2, 0, 0])


def test_silhouettes_are_kept_with_the_cameras_of_a_station(tmp_path: Path) -> None:
    model, mask = tmp_path / "model", tmp_path / "mask.png"
    shutil.copytree(EXAMPLE / "sparse", model)
    Image.new("L", (12, 8), 255).save(mask)
    camera = Camera("SIMPLE_RADIAL", 12, 8, [20.0, 5.5, 3.5, 0.1], translation=[1, 2, 3])
    kept = StationCameras(camera, [], SparseModel.read(model), {}, {}, silhouettes=[("other", mask, camera)])
    save_cameras(tmp_path / "a.json", kept, model)
    ((name, path, read),) = load_cameras(tmp_path / "a.json").silhouettes
    assert (name, path, read) == ("other", mask, camera)
    Image.new("L", (12, 8), 0).save(mask)
    with pytest.raises(InputError, match=r"mask.png was changed since its camera was found"):
        load_cameras(tmp_path / "a.json")


def in_stations(object_file: Path, text: str, number: int | None = None) -> None:
    """Put tables at the end of the stations' files, or of one's."""
    for k in range(2) if number is None else [number]:
        station = object_file.parent / f"o{k}/station.toml"
        station.write_text(station.read_text() + text)


def point(name: str = "T", xyz: str = "[1, 2, 3]", **marked: str) -> str:
    places = {"marks": '[{ image = "0.png", x = 4.0, y = 5.0 }]'} if not marked else marked
    return f'\n[[control]]\nname = "{name}"\nxyz = {xyz}\n' + "".join(
        f"{key} = {value}\n" for key, value in places.items()
    )


def test_photos_of_an_object_stand_in_its_file_or_in_its_stations(photographed: Path) -> None:
    shared = Object.load(photographed).shared
    assert shared is not None and Path(shared["photos"]["folder"]).name == "views" and shared["scale"] == []
    edit(photographed, "[options]", '[photos]\nfolder = "views"\n' + point() + "[options]")
    shared = Object.load(photographed).shared
    assert shared is not None and Path(shared["photos"]["folder"]).name == "views"
    assert [point["name"] for point in shared["control"]] == ["T"]


def test_stations_may_leave_out_the_photos_of_their_object(photographed: Path) -> None:
    """They had to repeat them; the same photos, named in one place, give the same stations."""
    before = Object.load(photographed)
    for k in range(2):
        edit(photographed.parent / f"o{k}/station.toml", '[photos]\nfolder = "../views"', "")
    with pytest.raises(InputError, match=r"o0/station.toml.* \[camera\].*qvec"):
        Object.load(photographed)
    thing = Object.load(edit(photographed, "[options]", '[photos]\nfolder = "views"\n[options]'))
    assert thing.shared is not None and before.shared is not None
    assert thing.shared["photos"] == before.shared["photos"]
    task = thing.campaign.tasks(photographed.parent / "out", 1, photographed.parent / "cameras")[1]
    assert task.load().describe()["photos"] == thing.shared["photos"]
    key = task.key()
    Image.new("L", (96, 64), 99).save(photographed.parent / "views/2.jpg")
    assert task.key() != key
    # A process that runs a station reads it again.
    again = pickle.loads(pickle.dumps(thing.campaign.station(task.station)))
    assert again.describe() == task.load().describe()
    edit(photographed.parent / "o1/station.toml", "40.0]", "40.0]\nqvec = [1, 0, 0, 0]\ntvec = [0, 0, 0]")
    with pytest.raises(InputError, match=r"o1/station.toml: \[camera\] has a pose"):
        Object.load(photographed)


def test_a_prior_beside_the_photos_of_an_object_is_named(photographed: Path) -> None:
    """The station's pose was said to be missing, which the photos give."""
    edit(photographed, "[options]", '[photos]\nfolder = "views"\n[options]')
    edit(photographed.parent / "o1/station.toml", '[photos]\nfolder = "../views"', '[prior]\ncloud = "dense/cloud.ply"')
    with pytest.raises(InputError, match=r"o1/station.toml: has a \[prior\], but .*object.toml has \[photos\]"):
        Object.load(photographed)


def test_control_points_of_stations_count_together(photographed: Path) -> None:
    in_stations(photographed, point("both"))
    in_stations(photographed, point("first") + point("seen", pixel="[7, 8]"), 0)
    in_stations(photographed, point("second") + point("seen"), 1)
    shared = Object.load(photographed).shared
    assert shared is not None
    assert [(point["name"], len(point["marks"])) for point in shared["control"]] == [
        ("both", 1), ("first", 1), ("seen", 1), ("second", 1)
    ]  # fmt: skip
    in_stations(photographed, point("third"), 0)
    in_stations(photographed, point("third", xyz="[1, 2, 4]"), 1)
    with pytest.raises(InputError, match=r"o1/station.toml: \[\[control\]\] third: xyz is not what .*o0/station.toml"):
        Object.load(photographed)


def known_distance(check: str = "false") -> str:
    return f"\n[[scale]]\ndistance = 3\ncheck = {check}\n" + "".join(
        f'{end} = [{{ image = "0.png", x = 4, y = 5 }}, {{ image = "1.png", x = 4, y = 5 }}]\n' for end in "ab"
    )


def test_the_size_of_an_object_is_stated_in_one_way(photographed: Path) -> None:
    """Distances in one station's file beside control points in another's did not count, without a word."""
    in_stations(photographed, known_distance())
    shared = Object.load(photographed).shared
    assert shared is not None and len(shared["scale"]) == 1
    edit(photographed.parent / "o1/station.toml", known_distance(), point())
    with pytest.raises(InputError, match=r"o0/station.toml: \[\[scale\]\] cannot be given together .*o1/station.toml"):
        Object.load(photographed)
    edit(photographed.parent / "o1/station.toml", point(), known_distance("true"))
    with pytest.raises(InputError, match=r"o1/station.toml: \[\[scale\]\] distance = 3: check is not what .*o0/st"):
        Object.load(photographed)


def test_points_of_a_station_need_the_objects_frame(photographed: Path) -> None:
    edit(photographed, "[options]", '[photos]\nfolder = "views"\n[options]')
    in_stations(photographed, point(pixel="[7, 8]"), 1)
    with pytest.raises(InputError, match=r"o1/station.toml: \[\[control\]\] T: the object is not in the frame"):
        Object.load(photographed)
    edit(photographed, "[options]", point("of the object") + "[options]")
    assert Object.load(photographed).shared is not None


@pytest.mark.skipif(shutil.which("colmap") is None, reason="COLMAP is not installed")
def test_check_counts_the_points_of_all_stations_together(photographed: Path) -> None:
    """It demanded of every station that its own points determine the frame."""
    marks = '[{ image = "0.png", x = 4.0, y = 5.0 }, { image = "1.png", x = 4.0, y = 5.0 }]'
    in_stations(photographed, point("a", marks=marks) + point("b", xyz="[4, 2, 3]", marks=marks), 0)
    in_stations(photographed, point("c", xyz="[1, 5, 3]", marks=marks), 1)
    first, second = Object.load(photographed).check()
    assert any("frame and size from 3 control points" in line for line in first["does"])
    assert not any("[[scale]]" in warning for plan in (first, second) for warning in plan["warnings"])


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (point(), "[[control]] T with marks does not count"),
        (
            '\n[[scale]]\ndistance = 3\n' + "".join(
                f'{end} = [{{ image = "0.png", x = 4, y = 5 }}, {{ image = "1.png", x = 4, y = 5 }}]\n' for end in "ab"
            ),
            "[[scale]] does not count",
        ),
    ],
)  # fmt: skip
def test_what_stations_say_of_an_objects_own_photos_is_not_lost(photographed: Path, said: str, expected: str) -> None:
    edit(photographed, "[options]", '[photos]\nfolder = "views"\n[options]')
    assert Object.load(photographed).shared is not None
    in_stations(photographed, said, 1)
    with pytest.raises(InputError) as caught:
        Object.load(photographed)
    assert "o1/station.toml: " in str(caught.value) and expected in str(caught.value)


@pytest.mark.skipif(shutil.which("colmap") is None, reason="COLMAP is not installed")
def test_check_counts_shared_photos_once(photographed: Path) -> None:
    plans = Object.load(photographed).check()
    said = [line.split(":")[0] for plan in plans for line in plan["does"]]
    assert [said.count(step) for step in ("photos", "scale", "sweep")] == [1, 1, 2]
    assert plans[0]["seconds"] > plans[1]["seconds"]
    # Every station sweeps, and what a station takes by itself it takes here, less the photos' cameras.
    alone = dict(expected_times(Station.load(photographed.parent / "o1/station.toml"), Options(fusion="grid")))
    times = expected_times(
        Station.load(photographed.parent / "o1/station.toml"), Options(fusion="grid"), cameras_known=True
    )
    assert dict(times) == {step: seconds for step, seconds in alone.items() if step != "photos"}
    assert dict(times)["sweep"] > dict(times)["fuse"] > 0


def test_where_cameras_lie_and_what_they_took_changes_no_task(pair: Path) -> None:
    folder = pair.parent / "cameras"
    task = Object.load(pair).campaign.tasks(pair.parent / "out", 1, folder)[0]
    said = {
        "model": "/a",
        "times": {"seconds": 1},
        "photos": [{"name": "1", "path": "/a/1", "sha256": "1"}],
        "station": [1],
    }
    write_record(Path(task.cameras), said)
    key = task.key()
    write_record(
        Path(task.cameras),
        {**said, "model": "/b", "times": {}, "photos": [{"name": "1", "path": "/b/1", "sha256": "1"}]},
    )
    assert task.key() == key
    for change in ({"station": [2]}, {"photos": [{"name": "1", "path": "/a/1", "sha256": "2"}]}, {"failure": "lost"}):
        write_record(Path(task.cameras), {**said, **change})
        assert task.key() != key


def test_warnings_of_finding_the_stations_come_once(
    pair: Path, views: list[View], sphere: ObjectMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Reported:
        """A station's workspace, whose report has the warnings of finding it, and its own."""

        def __init__(self, folder: Path) -> None:
            self.quality = {"warnings": ["photos: a lens is doubtful", f"fuse: {folder.name} is dark"]}

    monkeypatch.setattr(doubts, "Workspace", Reported)
    outcomes = [{"station": name, "status": "done"} for name in ("o0", "o1")]
    outcomes.append({"station": "o2", "status": "failed", "reason": "no light"})
    said = warnings_of(outcomes, ["a lens is doubtful"], pair.parent)
    assert said == [
        "photos: a lens is doubtful", "o0: fuse: o0 is dark", "o1: fuse: o1 is dark", "o2: is not in the surface: no light"
    ]  # fmt: skip


def test_stations_that_others_do_not_confirm_are_told() -> None:
    def row(name: str, off: float | None, seen: float = 0.5, contradicted: float | None = None) -> dict[str, Any]:
        return {
            "station": name, "status": "done", "seen_fraction": seen, "unsure_fraction": 0.3, "max_sigma_gsd": 4.0,
            "agreement": {"rms_ratio": off, "contradicted_fraction": contradicted},
        }  # fmt: skip

    told = doubts_of_stations(
        [
            row("good", 1.1, contradicted=0.01), row("off", 3.14, contradicted=0.0), row("apart", None), row("unsure", None, 0.0),
            {"station": "x", "status": "failed"},
        ]
    )  # fmt: skip
    assert [warning.split(": ")[1] for warning in told] == ["off", "apart", "unsure"]
    assert "3.1 standard deviations" in told[0] and "nothing checks its place" in told[1]
    assert "object.max_sigma_gsd" in told[2]
    assert doubts_of_stations([row("alone", None)]) == []
    (told_of_one,) = doubts_of_stations([row("alone", None) | {"unsure_fraction": 0.42}])
    assert (
        "alone: 42 % of its surface is left out" in told_of_one and "above 4 GSD (object.max_sigma_gsd)" in told_of_one
    )
    # Not told that nothing checks it: all others contradict it.
    (told_of_one,) = doubts_of_stations([row("good", 1.1, contradicted=0.01), row("wrong", None, contradicted=1.0)])
    assert told_of_one.startswith("object: wrong: 100 % of its comparisons with other stations are contradictions")


def warnings_with(views: list[View]) -> list[str]:
    """Warnings about stations of these views, all of whose surface is in the mesh."""
    outcomes = [{"station": view.name, "status": "done", "reason": "", "figures": {}} for view in views]
    coverage = Coverage(np.ones(len(views)), np.zeros(len(views)), np.ones(1, np.uint8))
    return doubts_of_stations(station_figures(outcomes, views, combine(views)[1], coverage, FAR / FOCAL))


@pytest.mark.parametrize("off", [0.5, 1.5, 3.0, 6.0])
def test_a_station_is_told_to_be_wrong_however_wrong_it_is(off: float) -> None:
    """What was farther off counted for nothing: the figures of agreement were best where the surface was worst."""
    views = [sphere_view("a", (1, 0, 0)), sphere_view("b", (1, 0.3, 0)), sphere_view("c", (1, 0, 0.3))]
    assert warnings_with(views) == []
    depth = views[2].depth.copy()
    depth[:, : SIDE // 2] -= off
    assert any(": c: " in warning for warning in warnings_with([*views[:2], replace(views[2], depth=depth)]))


def test_stations_that_agree_nowhere_contradict_each_other() -> None:
    views = [sphere_view("a", (1, 0, 0)), sphere_view("b", (1, 0.1, 0), offset=3.0)]
    agreements = combine(views)[1]
    figures = agreement_figures(agreements, FAR / FOCAL)
    assert figures["rms_ratio"] is None and figures["contradicted_fraction"] == 1.0
    # The maps have them in the last color, and not in gray.
    assert all(np.nanmin(one.ratio) > 4 and np.isfinite(one.ratio[64, 64]) for one in agreements)
    told = warnings_with(views)
    assert len(told) == 2 and all("100 % of its comparisons" in warning for warning in told)


def test_the_page_says_how_stations_agree_and_contradict() -> None:
    def shown(within: float | None, contradicted: float | None) -> str:
        met = {"within_two_sigma": within, "median_gsd": 0.25, "contradicted_fraction": contradicted}
        return template("object_agreement.html.j2").render(quality={"agreement": met})

    assert "97.0 % within two standard deviations" in shown(0.97, 0.0) and "of all comparisons" not in shown(0.97, 0.0)
    assert "Contradictions are not among these; they are 12.3 % of all comparisons" in shown(0.97, 0.123)
    assert "contradict each other at all of them" in shown(None, 1.0)
    assert "No surface of one station lies where another has its own" in shown(None, None)


def test_no_station_has_the_id_of_a_part_of_the_page() -> None:
    """One in a folder object-data had that of the surface's data, which the page then did not show."""
    text = (Path(object_run.__file__).parents[1] / "templates/object.html.j2").read_text(encoding="utf-8")
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert [name for name in ids if name.startswith("station-") or "{" in name] == ["station-{{ row.station }}"]


def test_stations_that_see_other_places_contradict_nothing(views: list[View]) -> None:
    """A place on the far side is hidden by the sphere."""
    assert warnings_with(views) == []
    assert [one.contradictions for one in combine(views)[1]] == [0] * len(views)
    assert agreement_figures(combine(views[:2])[1], FAR / FOCAL)["contradicted_fraction"] is None


def test_agreement_with_a_station_counts_pixels_of_the_object() -> None:
    views = [sphere_view("a", (1, 0, 0)), replace(sphere_view("b", (1, 0.1, 0), offset=0.1), gsd=0.25)]
    agreements = combine(views)[1]
    outcomes = [{"station": view.name, "status": "done", "reason": "", "figures": {}} for view in views]
    rows = station_figures(outcomes, views, agreements, Coverage(np.ones(2), np.zeros(2), np.ones(9, np.uint8)), 0.4)
    for row, met in zip(rows, agreements, strict=True):
        assert row["agreement"]["median_gsd"] == pytest.approx(np.median(np.abs(met.distances)) / 0.4)


def test_figures_of_the_photos_are_those_of_the_last_run(pair: Path) -> None:
    """A distance that was held out after the surface was made was not in quality.json: the stations' cameras are the same without it."""
    thing = Object.load(pair)
    outcomes = [{"station": name, "reason": "", "manifest": name} for name in ("o0", "o1")]
    frames = [
        None, Frame(pair.parent, {"scale": None}, []), Frame(pair.parent, {"scale": {"distances": []}}, []),
        Frame(pair.parent, {"scale": None}, ["a lens is doubtful"]),
    ]  # fmt: skip
    assert len({object_run._key(thing, outcomes, frame) for frame in frames}) == len(frames)
    same = Frame(pair.parent, {"scale": None}, [])
    assert object_run._key(thing, outcomes, same) == object_run._key(thing, outcomes, frames[1])


def test_the_page_says_how_photos_distances_and_points_fit() -> None:
    found = {
        "registered": 14, "photos": 16, "unregistered": ["<7>.jpg"], "reprojection_px": 0.3412, "station": {"a": {}}, "scale": None
    }  # fmt: skip

    def shown(**more: Any) -> str:
        quality = {"unit": "cm", "stations": [{}, {}], "photogrammetry": {**found, **more}}
        return template("object_photos.html.j2").render(quality=quality)

    text = shown()
    assert "14 of 16 photos and 1 of 2 stations" in text and "0.34 px" in text and "&lt;7&gt;.jpg" in text
    assert "the size is arbitrary" in text
    fit = {"name": "[[scale]] 1", "distance": 31.504, "adjusted": 31.5, "sigma": 0.01, "rms_px": 0.4}
    held_out = [{**fit, "check": False, "residual": 0.001}, {**fit, "check": True, "residual": -0.0213}]
    text = shown(scale={"distances": held_out, "status": "converged", "sigma": 0.001, "scale": 2.0})
    assert "Size from 1 known distance: known to 0.05 %" in text
    assert "<td>check</td>" in text and "−0.021" in text and "residual [cm]" in text
    points = [{"name": "P", "check": True, "offset": [0.1, -0.2, 0.3], "rms_px": 0.5}]
    text = shown(control={"datum": {"sigma": 0.1, "check_rms": 0.13, "doubtful": None, "points": points}})
    assert "the check points are off by 0.13 cm" in text and "−0.2" in text and "arbitrary" not in text


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        ("object.toml", "[options]", '[photos]\nfolder = "none"\n[options]', "object.toml, line 8: [photos].folder"),
        ("object.toml", "[options]", '[photos]\nfoldr = "views"\n[options]', "foldr"),
        ("object.toml", "[options]", "[[scale]]\ndistance = 3\n[options]", "[[scale]] needs [photos]"),
        ("object.toml", "[options]", "[[control]]\nxyz = [1, 2, 3]\n[options]", "[[control]] needs [photos]"),
        (
            "object.toml",
            "[options]",
            '[photos]\nfolder = "views"\n' + point(pixel="[1, 2]") + "[options]",
            "pixel is a place in one",
        ),
        (
            "object.toml",
            "[options]",
            '[photos]\nfolder = "views"\nexclude = ["2.png"]\n[options]',
            "o0/station.toml: [photos] are not those of",
        ),
        ("o1/station.toml", 'folder = "../views"', 'folder = "../views"\nexclude = ["0.png"]', "are not those of"),
        ("o1/station.toml", "40.0]", "40.0]\nqvec = [1, 0, 0, 0]\ntvec = [0, 0, 0]", "has a pose"),
    ],
)
def test_shared_photos_that_are_wrong(photographed: Path, file: str, old: str, new: str, expected: str) -> None:
    edit(photographed.parent / file, old, new)
    with pytest.raises(InputError) as caught:
        Object.load(photographed)
    assert expected in str(caught.value)


@pytest.mark.parametrize("number", [0, 1])
def test_a_station_with_photos_of_its_own_does_not_stand_in_the_frame_of_the_others(pair: Path, number: int) -> None:
    """Whether it is the first one or not: a first one was taken for one that names the photos of all."""
    (pair.parent / "views").mkdir()
    (pair.parent / "views/0.png").write_bytes(b"photo")
    station = pair.parent / f"o{number}/station.toml"
    edit(station, 'colmap_model = "sparse"\nimage = "station.jpg"',
         'model = "PINHOLE"\nwidth = 100\nheight = 80\nparams = [1937.0, 1937.0, 50.0, 40.0]')  # fmt: skip
    edit(station, '[prior]\ncloud = "dense/cloud.ply"', '[photos]\nfolder = "../views"')
    with pytest.raises(
        InputError, match=rf"o{number}/station.toml: has no \[prior\], so that its frame is that of its own photos"
    ):
        Object.load(pair)
    in_stations(pair, point(), number)
    assert Object.load(pair).shared is None


def test_a_station_without_a_surface_is_refused(pair: Path) -> None:
    """It failed as the last thing in a run, after hours for the others."""
    edit(pair.parent / "o1/station.toml", '[prior]\ncloud = "dense/cloud.ply"', "")
    with pytest.raises(InputError, match=r"o1/station.toml: has neither \[prior\] nor \[photos\]"):
        Object.load(pair)


def test_only_one_station_may_stand_in_its_cameras_frame(pair: Path) -> None:
    for k in range(2):
        station = pair.parent / f"o{k}/station.toml"
        (pair.parent / f"o{k}/depth.tif").write_bytes(b"depth")
        edit(station, 'colmap_model = "sparse"\nimage = "station.jpg"',
             'model = "PINHOLE"\nwidth = 100\nheight = 80\nparams = [1937.0, 1937.0, 50.0, 40.0]')  # fmt: skip
        edit(station, 'cloud = "dense/cloud.ply"', 'depth = "depth.tif"')
    with pytest.raises(InputError, match=r"o1/station.toml: \[camera\] has no pose, like that of .*o0/station.toml"):
        Object.load(pair)
    edit(pair.parent / "o1/station.toml", "40.0]", "40.0]\nqvec = [1, 0, 0, 0]\ntvec = [0, 0, 0]")
    assert Object.load(pair).shared is None


def scaled_by(distance: float) -> str:
    return f"\n[[scale]]\ndistance = {distance}\na_xyz = [0, 0, 0]\nb_xyz = [10, 0, 0]\n"


def test_clouds_are_as_large_as_known_distances_make_them(pair: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    edit(pair.parent / "o1/station.toml", "dense/cloud.ply", "../o0/dense/cloud.ply")
    manifest = {"steps": {"prior": {"notes": {"noise": 0.1}}}}
    monkeypatch.setattr(clouds, "Workspace", lambda _: SimpleNamespace(manifest=manifest))

    def cloud() -> OrientedPoints:
        thing = Object.load(pair)
        files = [{"station": path.parent.name, "file": str(path)} for path in thing.campaign.stations]
        (found,), warnings = clouds_of(thing, files, pair.parent, gsd, 1)
        assert warnings == []
        return found

    gsd = 1e9

    given = cloud()
    in_stations(pair, scaled_by(20))
    found = cloud()
    np.testing.assert_allclose(found.points, 2 * given.points, rtol=1e-12)
    np.testing.assert_array_equal(found.normals, given.normals)
    # Their points count as pixels of a size that joins them, whatever the pixels of the images are.
    assert given.scale is None and found.scale is None
    tree = pytest.importorskip("scipy.spatial").cKDTree(found.points)
    side = 0.3 * np.median(tree.query(found.points, 7)[0][:, -1])
    for times, expected in ((1.1, None), (2, 2), (4, 4), (1000, 12)):
        gsd = side / times
        scale = cloud().scale
        assert scale is None if expected is None else scale == pytest.approx(expected)


def test_stations_that_scale_one_cloud_differently_are_refused(pair: Path) -> None:
    edit(pair.parent / "o1/station.toml", "dense/cloud.ply", "../o0/dense/cloud.ply")
    in_stations(pair, scaled_by(20), 0)
    with pytest.raises(InputError, match=r"o1/station.toml: its \[\[scale\]\] make .*cloud.ply 1 times .* 2 times"):
        Object.load(pair)
    in_stations(pair, scaled_by(20), 1)
    Object.load(pair)


def test_a_cloud_may_be_a_workspace_of_colmaps_dense_stereo(tmp_path: Path) -> None:
    (tmp_path / "sparse").mkdir()
    (tmp_path / "sparse/cameras.txt").write_text("1 PINHOLE 6 4 10 10 3 2\n")
    (tmp_path / "sparse/images.txt").write_text("1 1 0 0 0 0 0 0 1 a.jpg\n\n")
    (tmp_path / "sparse/points3D.txt").write_text("")
    for kind, values in (("depth", np.full((4, 6), 5.0)), ("normal", np.tile([[[0.0]], [[0]], [[-2]]], (1, 4, 6)))):
        folder = tmp_path / f"stereo/{kind}_maps"
        folder.mkdir(parents=True)
        channels = 1 if values.ndim == 2 else 3
        (folder / "a.jpg.geometric.bin").write_bytes(f"6&4&{channels}&".encode() + values.astype("<f4").tobytes())
    read = read_cloud(tmp_path, "mm")
    assert read is not None
    points, normals = read
    assert points.shape == (24, 3)
    np.testing.assert_allclose(points[:, 2], 5)
    np.testing.assert_allclose(normals, np.tile([0, 0, -1], (24, 1)), atol=1e-6)


def test_clouds_without_normals_are_told(pair: Path) -> None:
    """Places that no station sees were left open without a word. What the object's surface lacks stands in its files, too."""
    for k in range(2):
        write_ply(pair.parent / f"o{k}/dense/cloud.ply", bare_cloud(pair.parent / f"o{k}/dense/cloud.ply"), None)
    plans = Object.load(pair).check(threads=1)
    for k, plan in enumerate(plans):
        assert any(f"cloud o{k}/dense/cloud.ply has no normals: " in warning for warning in plan["warnings"])
    outcome = malus_here("object", pair, "-o", "out", "--threads", "1", "--quiet")
    assert outcome.code == 0, outcome.err
    told = json.loads(Path("out/object/quality.json").read_text())["warnings"]
    own = [warning for warning in told if warning.startswith("object: cloud ")]
    assert len(own) == 2 and "o0/dense/cloud.ply has no normals" in own[0] and f"warning: {own[0]}" in outcome.err
    assert {f"warning {k}: {warning}" for k, warning in enumerate(own, start=1)} <= comments_of(Path("out"))
    # A cloud that stations share is named once.
    edit(pair.parent / "o1/station.toml", "dense/cloud.ply", "../o0/dense/cloud.ply")
    assert "has no normals" not in " ".join(Object.load(pair).check(threads=1)[1]["warnings"])


def bare_cloud(path: Path) -> dict[str, Any]:
    return columns("xyz", _core.read_oriented_points(str(path))[0], "f8")


def test_points_without_a_normal_do_not_count_against_those_beside_them(views: list[View], tmp_path: Path) -> None:
    """A normal that is not known is zero in the file. No station looks from below."""
    normals = np.random.default_rng(0).normal(size=(40000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    normals = normals[normals[:, 2] < -0.5]
    half = normals[::2]
    read = []
    for places, given in ((half, half), (normals, np.where((np.arange(len(normals)) % 2 == 0)[:, None], normals, 0))):
        axes = columns("xyz", RADIUS * places, "f8") | columns(("nx", "ny", "nz"), given, "f4")
        write_ply(tmp_path / "cloud.ply", axes, None)
        cloud = read_cloud(tmp_path / "cloud.ply", "mm")
        assert cloud is not None
        read.append(object_points(views[:5], [stereo(*cloud)]))
    assert (read[0].stations == 0).sum() > 500 and (read[1].points == read[0].points).all()
    write_ply(tmp_path / "cloud.ply", axes | columns(("nx", "ny", "nz"), 0 * normals, "f4"), None)
    assert read_cloud(tmp_path / "cloud.ply", "mm") is None


def test_stations_none_of_which_is_sure_enough_are_no_surface(views: list[View]) -> None:
    nothing, _ = combine([replace(view, usable=np.zeros_like(view.usable)) for view in views])
    with pytest.raises(DataError, match=r"no station has a surface that is sure enough.*object.max_sigma_gsd"):
        next(pieces(nothing, CELL))


def test_points_too_few_for_a_surface(tmp_path: Path) -> None:
    few = OrientedPoints(np.zeros((5, 3)), np.ones((5, 3)), np.ones(5), np.ones(5, np.int64))
    with pytest.raises(DataError, match="5 points"):
        poisson_mesh(few, 1.0, tmp_path, Colmap(1))
