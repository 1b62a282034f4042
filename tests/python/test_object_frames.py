"""Stations in different frames: two models of the same photos, and priors that no other station sees. A sphere about the origin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from conftest import edit, malus_here
from malus import Camera, _core
from malus.object import Object, one_frame
from malus.object.one_frame import doubts_of_frames
from malus.object.ply import columns, write_ply

Floats = NDArray[np.float64]

RADIUS, FAR, FOCAL, SIDE = 10.0, 60.0, 300.0, 128
#: The other frame of a model that was made separately: x becomes SCALE · TURN · x + MOVE.
SCALE, MOVE = 1.7, np.array([5.0, -80.0, 30.0])
TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])


def camera(direction: tuple[float, ...], focal: float = FOCAL, aim: tuple[float, ...] = (0, 0, 0)) -> Camera:
    """In this direction from the sphere, looking at a place on it."""
    eye = FAR * np.array(direction) / np.linalg.norm(direction)
    forward = (np.array(aim) - eye) / np.linalg.norm(np.array(aim) - eye)
    right = np.cross(forward, [0.1, 0.2, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Camera("PINHOLE", SIDE, SIDE, [focal, focal, 63.5, 63.5], rotation, -rotation @ eye)


def elsewhere(of: Camera, scale: float = SCALE, turn: Floats = TURN, move: Floats = MOVE) -> Camera:
    """The camera in another frame."""
    rotation, translation = of.pose()
    turned = rotation @ turn.T
    return Camera(of.model, of.width, of.height, of.params, turned, scale * translation - turned @ move)


def ring(count: int = 8) -> dict[str, Camera]:
    angles = 2 * np.pi * np.arange(count) / count
    return {f"view_{k}.jpg": camera((np.cos(a), np.sin(a), 0.3)) for k, a in enumerate(angles)}


def write_model(folder: Path, cameras: dict[str, Camera]) -> None:
    folder.mkdir(parents=True)
    lines = []
    for number, (name, one) in enumerate(cameras.items(), start=1):
        rotation, translation = one.pose()
        pose = " ".join(f"{value:.17g}" for value in (*_core.quaternion_of(rotation), *translation))
        lines.append(f"{number} {pose} 1 {name}\n\n")
    (folder / "cameras.txt").write_text(f"1 PINHOLE {SIDE} {SIDE} {FOCAL} {FOCAL} 64 64\n")
    (folder / "images.txt").write_text("".join(lines))


def station(
    folder: Path, name: str, one: Camera, prior: str, source: Path | None, scale: float = 1.0
) -> dict[str, Any]:
    """What is known of a station, which names the model in its folder if there is one."""
    file = folder / name / "station.toml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text('[camera]\ncolmap_model = "sparse"\n' if (file.parent / "sparse").exists() else "[camera]\n")
    said = {"path": str(file), "unit": "mm", "camera": one.description(), "prior": prior, "prior_scale": scale}
    return said | ({} if source is None else {f"prior_{prior}": str(source)})


def cloud(path: Path, points: Floats) -> Path:
    write_ply(path, columns("xyz", points, "f8"), None)
    return path


def on_sphere(*toward: tuple[float, ...], count: int = 5000) -> Floats:
    """Points of the sphere on the sides that face these directions; without one, all around."""
    points = np.random.default_rng(3).normal(size=(count, 3))
    points *= RADIUS / np.linalg.norm(points, axis=1)[:, None]
    return points[np.any([points @ np.array(side) > 3 for side in toward], axis=0)] if toward else points


def models_differ(folder: Path, first: dict[str, Camera], second: dict[str, Camera], scale: float = 1.0) -> list[str]:
    """Warnings about two stations, each with a model of its own, and a cloud that both share."""
    file, stations = cloud(folder / "cloud.ply", on_sphere()), {}
    for name, cameras, times in (("front", first, 1.0), ("back", second, scale)):
        write_model(folder / name / "sparse", cameras)
        stations[name] = station(folder, name, next(iter(cameras.values())), "cloud", file, times)
    doubts = doubts_of_frames(stations, folder)
    assert doubts["front"] == []
    return doubts["back"]


def test_models_of_the_same_photos_in_two_frames_are_named(tmp_path: Path) -> None:
    photos = ring()
    moved = {name: elsewhere(one) for name, one in photos.items()}
    (said,) = models_differ(tmp_path, photos | {"front.tif": camera((1, 0, 0))}, moved)
    assert said.startswith("back/sparse and front/sparse, the model of front, are in different frames: of 8 photos")
    photo = next(name for name in photos if name in said)
    distance = np.linalg.norm(eye(moved[photo]) - eye(photos[photo]))
    assert f"{photo} is turned by 36.9° and moved by {distance:.3g} mm" in said


def eye(one: Camera) -> Floats:
    rotation, translation = one.pose()
    return -rotation.T @ translation


@pytest.mark.parametrize("other", [{"scale": 1.02}, {"turn": TURN}, {"move": MOVE}])
def test_a_frame_differs_by_size_place_or_turn_alone(tmp_path: Path, other: dict[str, Any]) -> None:
    frame = {"scale": 1.0, "turn": np.eye(3), "move": np.zeros(3)} | other
    assert len(models_differ(tmp_path, ring(), {name: elsewhere(one, **frame) for name, one in ring().items()})) == 1


def test_a_frame_may_be_turned_about_the_line_on_which_all_photos_stand(tmp_path: Path) -> None:
    rotation = camera((1, 0, 0)).pose()[0]
    photos = {
        f"{z}.jpg": Camera("PINHOLE", SIDE, SIDE, [FOCAL, FOCAL, 63.5, 63.5], rotation, -rotation @ [0, 0, z])
        for z in (0.0, 20.0, 50.0)
    }
    turned = {name: elsewhere(one, 1.0, TURN, np.zeros(3)) for name, one in photos.items()}
    (said,) = models_differ(tmp_path, photos, turned)
    assert "is turned by 36.9° and moved by " in said


def test_known_distances_move_the_cameras_of_one_of_two_copies(tmp_path: Path) -> None:
    (said,) = models_differ(tmp_path, ring(), ring(), scale=1.5)
    assert "turned by 0° and moved by 30 mm" in said


@pytest.mark.parametrize("case", ["copy", "adjusted again", "others of the same names", "two in common", "one is lost"])
def test_models_in_one_frame_are_not_doubted(tmp_path: Path, case: str) -> None:
    photos, random = ring(), np.random.default_rng(0)
    second = dict(photos)
    if case == "adjusted again":  # with other photos, which turns and moves each of them by a little
        for name, one in photos.items():
            rotation, translation = one.pose()
            small = 0.003 * random.normal(size=3)
            turn = np.linalg.qr(np.eye(3) + np.cross(np.eye(3), small))[0]
            turn *= np.sign(np.diag(turn))
            second[name] = Camera(one.model, SIDE, SIDE, one.params, turn @ rotation, translation + 0.1 * small)
    if case == "others of the same names":  # of two memory cards
        second = {name: camera(tuple(random.normal(size=3))) for name in photos}
    if case == "two in common":
        second = {name: elsewhere(photos[name]) for name in list(photos)[:2]}
    if case == "one is lost":
        second["view_3.jpg"] = elsewhere(photos["view_3.jpg"])
    assert models_differ(tmp_path, photos, second) == []


def test_points_of_a_model_that_no_station_reads_may_be_damaged(tmp_path: Path) -> None:
    assert len(models_differ(tmp_path / "sound", ring(), {name: elsewhere(one) for name, one in ring().items()})) == 1
    stations = {}
    for name, one in (("front", camera((1, 0, 0))), ("back", elsewhere(camera((-1, 0, 0))))):
        write_model(tmp_path / name / "sparse", ring())
        (tmp_path / name / "sparse/points3D.txt").write_text("")
        stations[name] = station(tmp_path, name, one, "cloud", tmp_path / "sound/cloud.ply")
    assert doubts_of_frames(stations, tmp_path) == {"front": [], "back": []}


def test_a_workspace_of_dense_stereo_is_the_model_of_a_station_with_a_stated_pose(tmp_path: Path) -> None:
    photos, stations = ring(), {}
    for name, cameras in (("front", photos), ("back", {name: elsewhere(one) for name, one in photos.items()})):
        write_model(tmp_path / name / "dense/sparse", cameras)
        for photo, one in cameras.items():
            folder = tmp_path / name / "dense/stereo/depth_maps"
            folder.mkdir(parents=True, exist_ok=True)
            z = np.full((SIDE, SIDE), FAR if one is photos[photo] else SCALE * FAR, "<f4")
            (folder / f"{photo}.geometric.bin").write_bytes(f"{SIDE}&{SIDE}&1&".encode() + z.tobytes())
        stations[name] = station(tmp_path, name, next(iter(cameras.values())), "cloud", tmp_path / name / "dense")
    (said,) = doubts_of_frames(stations, tmp_path)["back"]
    assert said.startswith("back/dense/sparse and front/dense/sparse")


def depth_map(path: Path, one: Camera) -> Path:
    """The sphere as the camera sees it."""
    lens = one.undistorted()
    _, translation = lens.pose()
    rows, cols = np.indices((SIDE, SIDE))
    rays = np.stack([(cols - lens.cx) / lens.fx, (rows - lens.cy) / lens.fy, np.ones((SIDE, SIDE))], -1)
    a, b, c = (rays**2).sum(-1), -rays @ translation, translation @ translation - RADIUS**2
    with np.errstate(invalid="ignore"):
        depth = (-b - np.sqrt(b**2 - a * c)) / a
    tifffile.imwrite(path, depth.astype(np.float32))
    return path


def seen(folder: Path, cameras: dict[str, Camera], kind: str) -> dict[str, dict[str, Any]]:
    """Stations with a prior each, which has what the station sees of the sphere."""
    stations = {}
    for name, one in cameras.items():
        prior = (
            depth_map(folder / f"{name}.tif", one)
            if kind == "depth"
            else cloud(folder / f"{name}.ply", on_sphere(tuple(eye(one) / FAR)))
        )
        stations[name] = station(folder, name, one, kind, prior)
    return stations


@pytest.mark.parametrize("kind", ["cloud", "depth"])
def test_stations_all_around_and_near_ones_have_something_in_common(tmp_path: Path, kind: str) -> None:
    cameras = {
        "front": camera((1, 0, 0)),
        "back": camera((-1, 0, 0)),
        "detail": camera((0.1, 1, 0), 20 * FOCAL, (0, RADIUS, 1)),
    }
    doubts = doubts_of_frames(seen(tmp_path, cameras, kind), tmp_path)
    assert doubts == {"front": [], "back": [], "detail": []}


def test_a_large_depth_map_is_looked_up_at_some_of_its_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(one_frame, "_MOST_POINTS", 1000)
    one = camera((1, 2, 3))
    points = one_frame._of_depth(tifffile.imread(depth_map(tmp_path / "depth.tif", one)), one.description())
    assert 300 < len(points) < 1000
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), RADIUS, atol=1e-4)


@pytest.mark.parametrize("kind", ["cloud", "depth"])
def test_stations_that_have_nothing_in_common_are_named(tmp_path: Path, kind: str) -> None:
    """Two in local coordinates, and two on the globe."""
    cameras = {"front": camera((1, 0, 0)), "back": camera((-1, 0, 0))}
    stations = seen(tmp_path, cameras, kind)
    far = np.array([4e6, 1e6, 4.8e6])
    for name, direction in (("left", (0, 1, 0)), ("above", (0.1, 0, 1))):
        one = camera(direction)
        prior = depth_map(tmp_path / f"{name}.tif", one)
        if kind == "cloud":
            prior = cloud(tmp_path / f"{name}.ply", on_sphere(direction) + far)
        stations[name] = station(tmp_path, name, elsewhere(one, 1.0, np.eye(3), far), kind, prior)
    doubts = doubts_of_frames(stations, tmp_path)
    (said,) = doubts.pop("left")
    assert said.startswith("left, above and front, back have nothing in common: no prior of the ones has a point in")
    assert doubts == {"front": [], "back": [], "above": []}


def test_near_stations_of_different_places_are_in_one_frame_if_something_says_so(tmp_path: Path) -> None:
    """Their model, its copy or a cloud that both name; and who knows what a plane has in common with others."""
    places = {name: camera((1, 0, 0), 20 * FOCAL, (RADIUS, 0, z)) for name, z in (("top", 3), ("low", -3))}
    own = seen(tmp_path, places, "depth")
    assert [len(said) for said in doubts_of_frames(own, tmp_path).values()] == [0, 1]
    low = station(tmp_path, "low", places["low"], "plane", None)
    assert not any(doubts_of_frames(own | {"low": low}, tmp_path).values())
    whole = cloud(tmp_path / "cloud.ply", on_sphere())
    shared = {name: station(tmp_path, name, one, "cloud", whole) for name, one in places.items()}
    assert not any(doubts_of_frames(shared, tmp_path).values())
    write_model(tmp_path / "low/sparse", ring())
    write_model(tmp_path / "top/sparse", ring())
    own = seen(tmp_path, places, "depth")
    assert not any(doubts_of_frames(own, tmp_path).values())
    (tmp_path / "low/station.toml").write_text('[camera]\ncolmap_model = "../top/sparse"\n')
    (tmp_path / "top/sparse/points3D.txt").write_text("")
    assert not any(doubts_of_frames(own, tmp_path).values())


def test_a_mesh_of_few_triangles_is_seen_between_its_corners(tmp_path: Path) -> None:
    wall = np.array([[RADIUS, -500.0, -500], [RADIUS, 500, -500], [RADIUS, 0, 700]])
    write_ply(tmp_path / "wall.ply", columns("xyz", wall, "f8"), np.array([[0, 1, 2]], np.uint32))
    stations = seen(tmp_path, {"detail": camera((1, 0, 0), 4 * FOCAL, (RADIUS, 0, 3))}, "depth")
    far = camera((1, 0, 0), FOCAL, (RADIUS, 300, 0))
    stations["wall"] = station(tmp_path, "wall", far, "mesh", tmp_path / "wall.ply")
    assert not any(doubts_of_frames(stations, tmp_path).values())
    write_ply(tmp_path / "wall.ply", columns("xyz", wall + [0, 2000, 0], "f8"), np.array([[0, 1, 2]], np.uint32))
    assert any(doubts_of_frames(stations, tmp_path).values())


def test_check_tells_of_two_models_of_one_object(pair: Path) -> None:
    assert "frames" not in malus_here("check", pair, "--threads", "1").out
    folder = pair.parent / "o1"
    model = _core.ColmapModel.read(str(folder / "sparse"))
    model.transform(SCALE, TURN, MOVE)
    for old in (folder / "sparse").iterdir():
        old.unlink()
    model.write(str(folder / "sparse"))
    points, normals = _core.read_oriented_points(str(folder / "dense/cloud.ply"))
    moved = columns("xyz", SCALE * points @ TURN.T + MOVE, "f8")
    write_ply(folder / "dense/cloud.ply", moved | columns(("nx", "ny", "nz"), normals @ TURN.T, "f4"), None)
    outcome = malus_here("check", pair, "--quiet", "--threads", "1")
    assert outcome.code == 0
    assert "warning: o1 (small): o1/sparse and o0/sparse, the model of o0, are in different frames: " in outcome.err
    # Photos give all stations one frame.
    assert Object.load(edit(pair, ', "o1/station.toml"', "")).check(threads=1)[0]["warnings"] == []
