"""Whole objects: a sphere that stations see in part, object files, and the command line on copies of a station."""

from __future__ import annotations

import json
import os
import shutil
import signal
import struct
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from conftest import demo_with_photos, edit, half_written, needs_distributed
from conftest import malus as run_malus
from malus import InputError, Station, reconstruct
from malus.object import (
    Object,
    OrientedPoints,
    View,
    agreement_figures,
    combine,
    poisson_mesh,
    run_object,
    textured,
    trimmed,
    unseen_stereo,
)
from malus.object.ply import read_mesh, write_ply
from malus.object.run import find_frame, is_closed
from malus.object.texture import _tangents, write_glb
from malus.object.views import LEAST_COSINE
from malus.photogrammetry.program import Colmap
from malus.photogrammetry.shared_frame import load_cameras

RADIUS, FAR, FOCAL, SIDE = 10.0, 60.0, 300.0, 128
SIGMA = 0.05


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
    depth = np.where(inside, (-b - np.sqrt(np.maximum(b**2 - a * c, 0))) / a, np.nan)
    points = (rays * depth[..., None] - translation) @ rotation
    normals = points / (RADIUS + offset)
    eye = -rotation.T @ translation
    to_eye = eye - points
    cosine = (normals * to_eye).sum(-1) / np.linalg.norm(to_eye, axis=-1)
    color = light * np.where(points[..., 2:] > 0, 0.6, 0.2)
    return View(
        name=name, gsd=FAR / FOCAL, focal=(FOCAL, FOCAL), center=(63.5, 63.5), rotation=rotation, translation=translation,
        depth=depth, points=points, normals=normals, sigma=np.full(depth.shape, SIGMA), cosine=cosine,
        usable=inside & (cosine > LEAST_COSINE), object=inside, color=np.nan_to_num(color),
    )  # fmt: skip


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


def test_stations_that_disagree_meet_in_the_middle_by_their_variances() -> None:
    first, second = sphere_view("a", (1, 0, 0)), sphere_view("b", (1, 0.1, 0), offset=0.1)
    points, agreements = combine([first, second])
    both = points.stations == 2
    # Seen alike and stated alike: the mean; and the stated standard deviation does not shrink.
    assert np.median(np.linalg.norm(points.points[both], axis=1)) == pytest.approx(RADIUS + 0.05, abs=0.005)
    assert points.sigma[both] == pytest.approx(SIGMA)
    figures = agreement_figures(agreements, first.gsd)
    assert figures["rms_ratio"] == pytest.approx(0.1 / (np.sqrt(2) * SIGMA), rel=0.02)


def test_stereo_counts_where_no_station_looks_and_not_off_the_object(views: list[View]) -> None:
    direction = np.array([0.0, 0.0, 1.0])
    cloud = np.array([RADIUS * direction, -RADIUS * direction, 1.3 * RADIUS * direction, [30.0, 0, 0]])
    normals = np.array([direction, -direction, direction, direction])
    points, _ = combine(views[:5])  # nobody sees the sphere from below
    kept = unseen_stereo(cloud, normals, 0.1, views[:5], points)
    assert kept.points == pytest.approx(cloud[1:2])
    assert kept.stations.tolist() == [0]


def test_stereo_beside_what_stations_see_is_left_out(views: list[View]) -> None:
    # A crease that no station's surface enters: what the cloud has there is off the surface beside it.
    angles = np.radians([100.0, 175.0])
    cloud = (RADIUS - 0.3) * np.stack([np.sin(angles), 0 * angles, np.cos(angles)], 1)
    normals = np.tile([0.0, 1.0, 0.0], (2, 1))
    points, _ = combine(views[:5])
    unbounded = unseen_stereo(cloud, normals, 0.1, views[:5], points.select(np.zeros(len(points.points), bool)))
    assert unbounded.points == pytest.approx(cloud)
    assert unseen_stereo(cloud, normals, 0.1, views[:5], points).points == pytest.approx(cloud[1:])


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


def test_closed_mesh_is_manifold_as_others_see_it(sphere) -> None:  # type: ignore[no-untyped-def]
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(sphere.vertices, sphere.triangles, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.01)
    assert np.unique(np.sort(sphere.triangles, 1), axis=0).shape == sphere.triangles.shape


def test_what_nobody_sees_is_marked_and_trimmed(views: list[View], tmp_path: Path) -> None:
    points, _ = combine(views[:5])
    closed = poisson_mesh(points, views[0].gsd, tmp_path, Colmap(1))
    assert is_closed(closed.triangles)
    below = closed.vertices[:, 2] < -0.99 * RADIUS
    assert not closed.measured[below].any()
    assert (closed.sigma[below] > 5 * SIGMA).all()
    open_one = trimmed(closed, 1.0)
    assert not is_closed(open_one.triangles)
    assert open_one.measured.all()
    assert len(open_one.triangles) < len(closed.triangles)


def test_texture_has_the_color_of_the_place_in_any_light(sphere, views: list[View], tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    lit = [sphere_view(f"s{k}", axis, light=1.0 if k % 2 else 0.5) for k, axis in enumerate(AXES)]
    mesh = textured(sphere, 2000, lit, lit[0].gsd)
    assert len(mesh.triangles) <= 2100
    corner = np.minimum((mesh.uv * mesh.color.shape[0]).astype(int), mesh.color.shape[0] - 1)
    paint = mesh.color[corner[:, 1], corner[:, 0]].mean(1)
    above, below = mesh.vertices[:, 2] > 2, mesh.vertices[:, 2] < -2
    assert np.ptp(np.percentile(paint[above], [5, 95])) < 12 and np.ptp(np.percentile(paint[below], [5, 95])) < 12
    assert paint[above].mean() > paint[below].mean() + 60
    # A fine normal is a third component near 1: the decimated sphere is smooth.
    assert np.median(mesh.normal_map[corner[:, 1], corner[:, 0], 2]) > 250
    write_glb(tmp_path / "mesh.glb", mesh, "mm", "sphere")
    content = (tmp_path / "mesh.glb").read_bytes()
    assert struct.unpack("<4sII", content[:12]) == (b"glTF", 2, len(content))
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.load(tmp_path / "mesh.glb")
    assert scene.extents == pytest.approx([0.02, 0.02, 0.02], rel=0.05)


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
        {**dict(zip("xyz", vertices.T, strict=True)), "sigma": np.ones(4, np.float32)},
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
        ("faces = 3000", "faces = 3", "object.faces = 3, expected at least 100"),
        ("closed = false", 'unit = "m"', "station.unit = 'mm', expected 'm'"),
    ],
)
def test_object_files_that_are_wrong(pair: Path, old: str, new: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        Object.load(edit(pair, old, new))
    assert expected in str(caught.value)


@pytest.fixture
def pair(small_station_source: Path, tmp_path: Path) -> Path:
    """An object of two copies of a station: they agree wherever they look."""
    for k in range(2):
        shutil.copytree(small_station_source, tmp_path / f"o{k}")
    file = tmp_path / "object.toml"
    file.write_text(
        '[object]\nname = "pair"\nstations = ["o0/station.toml", "o1/station.toml"]\nclosed = false\nreport = false\nfaces = 3000\n'
        '[options]\nfusion = "grid"\n[options.height]\niterations = 2\n'
    )
    return file


def test_command_line_makes_one_surface_and_does_nothing_twice(pair: Path) -> None:
    output = pair.parent / "out"
    first = run_malus("object", pair, "-o", output, "--jobs", "2", "--threads", "1")
    assert first.code == 0, first.err
    quality = json.loads((output / "object/quality.json").read_text())
    assert [row["station"] for row in quality["stations"]] == ["o0", "o1"]
    assert quality["agreement"]["rms_ratio"] < 0.05
    assert quality["mesh"]["triangles"] > 10000 and not quality["mesh"]["closed"]
    assert {"mesh.ply", "mesh.glb", "report/index.html"} <= set(quality["files"])
    assert "pair: 2 of 2 stations" in first.out
    assert not half_written(output)
    written = (output / "object/mesh.ply").stat().st_mtime_ns
    again = run_malus("object", pair, "-o", output, "--quiet")
    assert again.code == 0 and not again.out
    assert (output / "object/mesh.ply").stat().st_mtime_ns == written
    (output / "object/mesh.ply").write_bytes(b"spoiled")
    assert run_malus("object", pair, "-o", output, "--quiet").code == 0
    assert (output / "object/mesh.ply").read_bytes().startswith(b"ply")
    edit(output / "object/quality.json", '"gsd": ', '"gsd": 1')
    assert run_malus("object", pair, "-o", output, "--quiet").code == 0
    assert json.loads((output / "object/quality.json").read_text())["gsd"] == quality["gsd"]


def test_broken_station_is_told_and_the_others_are_joined(pair: Path) -> None:
    (pair.parent / "o1/pol/pol_030.tif").write_bytes(b"no image")
    output = pair.parent / "out"
    outcome = run_malus("object", pair, "-o", output, "--threads", "1")
    assert outcome.code == 2
    assert "o1" in outcome.err and "pol_030.tif" in outcome.err and "Traceback" not in outcome.err
    quality = json.loads((output / "object/quality.json").read_text())
    assert quality["warnings"][-1].startswith("o1: is not in the surface: ")
    assert [row["status"] for row in quality["stations"]] == ["done", "failed"]
    assert (output / "object/mesh.ply").is_file()


def test_shards_leave_the_surface_to_the_last(pair: Path) -> None:
    output = pair.parent / "out"
    first = run_malus("object", pair, "-o", output, "--shard", "1/2", "--threads", "2")
    assert first.code == 0 and "1 of 2 stations are not run yet" in first.out
    assert not (output / "object").exists()


@needs_distributed
@pytest.mark.filterwarnings("ignore")  # Dask's own, while it loses a worker
def test_a_killed_worker_changes_nothing(pair: Path, tmp_path: Path) -> None:
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
    run_object(thing, tmp_path / "serial", threads=1)
    meshes = [(tmp_path / f"{way}/object/mesh.ply").read_bytes() for way in ("cluster", "serial")]
    assert meshes[0] == meshes[1]


def test_check_lists_every_station(pair: Path) -> None:
    outcome = run_malus("check", pair, "--threads", "1")
    assert outcome.code == 0, outcome.err
    assert "object pair: 2 stations" in outcome.out and outcome.out.count("station small") == 2


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
    result = reconstruct(
        Station.load(tmp_path / "a/station.toml"), thing.campaign.options, cameras=first, until="prior"
    )
    assert result.prior_depth is not None and np.isfinite(result.prior_depth).mean() > 0.5


@pytest.fixture
def photographed(pair: Path, tmp_path: Path) -> Path:
    """The pair, its stations with photos in place of pose and prior."""
    (tmp_path / "views").mkdir()
    for number in range(3):
        Image.new("L", (96, 64), 100).save(tmp_path / f"views/{number}.png")
    for k in range(2):
        station = tmp_path / f"o{k}/station.toml"
        edit(station, 'colmap_model = "sparse"\nimage = "station.jpg"',
             'model = "PINHOLE"\nwidth = 200\nheight = 160\nparams = [1937.0, 1937.0, 100.0, 80.0]')  # fmt: skip
        edit(station, '[prior]\ncloud = "dense/cloud.ply"', '[photos]\nfolder = "../views"')
    return pair


def test_photos_of_an_object_stand_in_its_file_or_in_its_stations(photographed: Path) -> None:
    shared = Object.load(photographed).shared
    assert shared is not None and Path(shared["photos"]["folder"]).name == "views" and shared["scale"] == []
    edit(photographed, "[options]", '[photos]\nfolder = "views"\nexclude = ["2.png"]\n[options]')
    shared = Object.load(photographed).shared
    assert shared is not None and shared["photos"]["exclude"] == ["2.png"]
    point = '[[control]]\nname = "T"\nxyz = [1, 2, 3]\nmarks = [{ image = "0.png", x = 4.0, y = 5.0 }]\n'
    edit(photographed, "[options]", point + "[options]")
    shared = Object.load(photographed).shared
    assert shared is not None and [point["name"] for point in shared["control"]] == ["T"]


@pytest.mark.skipif(shutil.which("colmap") is None, reason="COLMAP is not installed")
def test_check_counts_shared_photos_once(photographed: Path) -> None:
    plans = Object.load(photographed).check()
    said = [line.split(":")[0] for plan in plans for line in plan["does"]]
    assert [said.count(step) for step in ("photos", "scale", "sweep")] == [1, 1, 2]
    assert plans[0]["seconds"] > plans[1]["seconds"]


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        ("object.toml", "[options]", '[photos]\nfolder = "none"\n[options]', "object.toml, line 8: [photos].folder"),
        ("object.toml", "[options]", '[photos]\nfoldr = "views"\n[options]', "foldr"),
        ("object.toml", "[options]", "[[scale]]\ndistance = 3\n[options]", "[[scale]] needs [photos]"),
        ("object.toml", "[options]", "[[control]]\nxyz = [1, 2, 3]\n[options]", "[[control]] needs [photos]"),
        ("o1/station.toml", 'folder = "../views"', 'folder = "../views"\nexclude = ["0.png"]', "are not those of"),
        ("o1/station.toml", "80.0]", "80.0]\nqvec = [1, 0, 0, 0]\ntvec = [0, 0, 0]", "has a pose"),
    ],
)
def test_shared_photos_that_are_wrong(photographed: Path, file: str, old: str, new: str, expected: str) -> None:
    edit(photographed.parent / file, old, new)
    with pytest.raises(InputError) as caught:
        Object.load(photographed)
    assert expected in str(caught.value)


def test_points_too_few_for_a_surface(tmp_path: Path) -> None:
    from malus import DataError

    few = OrientedPoints(np.zeros((5, 3)), np.ones((5, 3)), np.ones(5), np.ones(5, np.int64))
    with pytest.raises(DataError, match="5 points"):
        poisson_mesh(few, 1.0, tmp_path, Colmap(1))
