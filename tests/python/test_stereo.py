"""The surface sweep on arrays: a textured plane seen by pinhole cameras, truth by construction."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import malus
from malus import _core
from malus._files import sha256_of
from malus.photogrammetry import StationCameras, station_sweep
from malus.photogrammetry.model import SparseModel
from malus.photogrammetry.photos import Photo

WIDTH, HEIGHT, FOCAL, DISTANCE = 120, 100, 400.0, 300.0


def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    value = np.full_like(x, 0.5)
    for octave in range(4):
        k, turn = 0.25 * 1.9**octave, 1.1 * octave
        a, b = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        value += 0.1 * 0.6**octave * (np.sin(k * a + octave) + np.sin(1.17 * k * b))
    return np.clip(value, 0, 1)


def camera_at(center: tuple[float, float, float]) -> malus.Camera:
    c = np.array(center)
    forward = np.array([0, 0, DISTANCE]) - c
    forward /= np.linalg.norm(forward)
    right = np.cross([0, 1, 0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return malus.Camera("PINHOLE", WIDTH, HEIGHT, [FOCAL, FOCAL, 59.5, 49.5], rotation, -rotation @ c)


def seen(camera: malus.Camera) -> tuple[np.ndarray, np.ndarray]:
    """Image of the plane z = 300 + x / 4 and its depth."""
    rotation, translation = camera.pose()
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - 59.5) / FOCAL, (v - 49.5) / FOCAL, np.ones_like(u)], -1) @ rotation
    center = -rotation.T @ translation
    depth = (DISTANCE + center[0] / 4 - center[2]) / (rays[..., 2] - rays[..., 0] / 4)
    points = center + depth[..., None] * rays
    return texture(points[..., 0], points[..., 1]), depth


@pytest.fixture(scope="module")
def scene() -> dict[str, object]:
    station = camera_at((0, 0, 0))
    image, depth = seen(station)
    turns = 2 * np.pi * np.arange(5) / 5
    cameras = [camera_at((90 * np.cos(a), 90 * np.sin(a), 0)) for a in turns]
    v, u = np.mgrid[5:HEIGHT:12, 5:WIDTH:12]
    z = depth[v, u]
    points = np.stack([(u - 59.5) / FOCAL * z, (v - 49.5) / FOCAL * z, z], -1).reshape(-1, 3)
    return {
        "intensity": image,
        "camera": station,
        "views": [(0.8 * seen(c)[0] + 0.1, c) for c in cameras],
        "points": points,
        "options": malus.Options(sweep={"station_gamma": 1.0, "min_level_px": 40}),
        "depth": depth,
    }


def arguments(scene: dict[str, object], **changes: object) -> dict[str, object]:
    return {**{name: value for name, value in scene.items() if name != "depth"}, **changes}


def test_sweep_finds_the_plane(scene: dict[str, object]) -> None:
    steps: list[float] = []
    result = malus.stereo.sweep(**arguments(scene, progress=lambda _, fraction, __: steps.append(fraction)))
    error = np.abs(result.depth - scene["depth"])[6:-6, 6:-6] / (DISTANCE / FOCAL)
    assert np.isfinite(error).mean() > 0.99
    assert np.nanmedian(error) < 0.1
    assert result.depth.dtype == result.sigma.dtype == np.float32
    assert result.views_used == 5
    assert result.halves_compared
    assert steps == sorted(steps)
    again = malus.stereo.sweep(**arguments(scene, threads=2))
    np.testing.assert_array_equal(result.depth, again.depth)


def test_arguments_are_checked(scene: dict[str, object]) -> None:
    views = scene["views"]
    with pytest.raises(ValueError, match=r"intensity has shape \(3, 3\), expected \(100, 120\)"):
        malus.stereo.sweep(**arguments(scene, intensity=np.ones((3, 3))))
    with pytest.raises(ValueError, match=r"views\[1\] has shape \(4, 4\), expected \(100, 120\)"):
        malus.stereo.sweep(**arguments(scene, views=[views[0], (np.ones((4, 4)), views[1][1])]))
    dark = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    with pytest.raises(malus.InputError, match=r"^surface sweep: views\[1\]: intensities must be finite"):
        malus.stereo.sweep(**arguments(scene, views=[views[0], (dark, views[1][1])]))
    with pytest.raises(ValueError, match=r"points has shape \(3,\), expected \(N, 3\)"):
        malus.stereo.sweep(**arguments(scene, points=np.ones(3)))
    with pytest.raises(ValueError, match=r"mask has shape"):
        malus.stereo.sweep(**arguments(scene, mask=np.ones((2, 2))))
    with pytest.raises(malus.DataError, match="no photos"):
        malus.stereo.sweep(**arguments(scene, views=[]))
    with pytest.raises(malus.DataError, match="3 of 3 triangulated points"):
        malus.stereo.sweep(**arguments(scene, points=scene["points"][:3]))
    bent = malus.Camera("SIMPLE_RADIAL", WIDTH, HEIGHT, [FOCAL, 59.5, 49.5, 0.1])
    with pytest.raises(malus.InputError, match="must be undistorted"):
        malus.stereo.sweep(**arguments(scene, camera=bent))
    with pytest.raises(malus.InputError, match="MAGIC"):
        malus.stereo.sweep(**arguments(scene, camera=malus.Camera("MAGIC", WIDTH, HEIGHT, [1.0])))


@pytest.fixture
def placed(scene: dict[str, object], tmp_path: Path) -> StationCameras:
    photos = []
    for k, (image, camera) in enumerate(scene["views"]):
        path = tmp_path / f"photo_{k}.tif"
        _core.write_tiff16(str(path), np.uint16(65535 * image))
        photos.append((Photo(path.name, path, WIDTH, HEIGHT), camera))
    return StationCameras(
        scene["camera"], photos, SparseModel({}, scene["points"], np.zeros(0), np.zeros(0, int)), {}, {}
    )


def sweep_station(
    scene: dict[str, object], placed: StationCameras, folder: Path, options: malus.Options,
    fuse: Callable[[station_sweep.Swept], station_sweep.FusedOnce],
) -> station_sweep.Swept:  # fmt: skip
    return station_sweep.sweep_station(
        placed, scene["intensity"], np.full((HEIGHT, WIDTH), 255, np.uint8), folder, fuse=fuse, fused_of={},
        options=options, threads=1, progress=lambda *_: None, log=lambda *_: None,
    )  # fmt: skip


@pytest.mark.parametrize(("again", "completeness", "fusions"), [(True, 0.3, 1), (False, 0.3, 0)])
def test_station_is_swept_again_about_the_fused_surface_once(
    scene: dict[str, object], placed: StationCameras, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    again: bool, completeness: float, fusions: int,
) -> None:  # fmt: skip
    monkeypatch.setattr(station_sweep, "AGAIN_COMPLETENESS", completeness)
    options = malus.Options(sweep={"station_gamma": 1.0, "min_level_px": 40, "again": again})
    gsd = DISTANCE / FOCAL
    fused: list[station_sweep.Swept] = []

    def fuse(first: station_sweep.Swept) -> station_sweep.FusedOnce:
        fused.append(first)
        prior = np.float32(scene["depth"])
        surface = prior.copy()
        surface[50, 60] += 5 * gsd
        surface[0, 0] = np.nan
        return station_sweep.FusedOnce(surface, prior, np.full_like(prior, gsd))

    first, second = (sweep_station(scene, placed, tmp_path, options, fuse) for _ in range(2))
    assert len(fused) == fusions
    assert "seconds" in first.times and "seconds" not in str(first.figures), "quality.json contains no times"
    np.testing.assert_array_equal(first.depth, second.depth)
    assert (first.shape is None) == (fusions == 0)
    if first.shape is not None:
        assert first.shape[50, 60] == pytest.approx(scene["depth"][50, 60] + 2 * gsd, abs=1e-3)
        assert np.isfinite(first.shape).all()
        assert first.figures["first"]["completeness"] > 0.9


def test_incomplete_sweep_drops_depths_that_the_fused_surface_contradicts(
    scene: dict[str, object], placed: StationCameras, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(station_sweep, "AGAIN_COMPLETENESS", 1.1)
    options = malus.Options(sweep={"station_gamma": 1.0, "min_level_px": 40})
    gsd = DISTANCE / FOCAL
    mirror = np.zeros((HEIGHT, WIDTH), bool)
    mirror[40:60, 30:60] = True
    fused: list[station_sweep.Swept] = []

    def fuse(swept: station_sweep.Swept) -> station_sweep.FusedOnce:
        """A surface that differs from the sweep by 20 GSD in one place, and by a scale, which shape alone does not determine."""
        fused.append(swept)
        surface = np.float32(1.01 * scene["depth"])
        surface[mirror] -= 20 * gsd
        return station_sweep.FusedOnce(surface, surface + 5 * gsd, np.full_like(surface, gsd))

    first, second = (sweep_station(scene, placed, tmp_path, options, fuse) for _ in range(2))
    assert len(fused) == 2
    before, after = (np.isfinite(sweep.depth) for sweep in fused)
    assert not after[mirror].any()
    assert not (after & ~before).any()
    assert after[~mirror].sum() > 0.9 * before[~mirror].sum() > 0.8 * (~mirror).sum()
    np.testing.assert_array_equal(first.depth, fused[1].depth)
    np.testing.assert_array_equal(np.isfinite(first.sigma), after)
    np.testing.assert_allclose(first.shape, fuse(first).prior_depth - 2 * gsd, rtol=1e-6)
    assert first.figures["completeness"] == pytest.approx(after.mean())
    assert first.figures["first"]["completeness"] == pytest.approx(before.mean())
    np.testing.assert_array_equal(first.depth, second.depth)
    np.testing.assert_array_equal(first.shape, second.shape)


def test_messages_of_the_sweep_name_the_file_of_a_photo(
    scene: dict[str, object], placed: StationCameras, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They had its index from 0 only."""
    options = malus.Options(sweep={"station_gamma": 1.0, "min_level_px": 40, "again": False})
    told: list[str] = []

    def sweep(*arguments: Any) -> malus.stereo.SweepResult:
        arguments[8]("warning", "surface sweep: views[1] and 1 more: the lens is approximated to 2 px only")
        return real(*arguments)

    real = malus.stereo.sweep
    monkeypatch.setattr(malus.stereo, "sweep", sweep)
    _core.write_tiff16(str(placed.photos[2][0].path), np.zeros((HEIGHT, WIDTH - 1), np.uint16))
    with pytest.raises(malus.InputError, match=r"surface sweep: photo photo_2\.tif is 119 x 100 pixels"):
        station_sweep.sweep_station(
            placed, scene["intensity"], np.full((HEIGHT, WIDTH), 255, np.uint8), tmp_path / "work",  # type: ignore[arg-type]
            options=options, threads=1, progress=lambda *_: None, log=lambda level, message: told.append(message),
        )  # fmt: skip
    assert told == ["surface sweep: photo photo_1.tif and 1 more: the lens is approximated to 2 px only"]


def test_few_masks_make_no_hull_and_leave_the_sweep(
    scene: dict[str, object], placed: StationCameras, tmp_path: Path
) -> None:
    """On a turntable photos need masks for their cameras' sake; with three photos the sweep ended for want of a fourth mask."""
    mask = tmp_path / "mask.png"
    _core.write_png(str(mask), np.full((HEIGHT, WIDTH), 255, np.uint8))
    photos = [(replace(photo, mask=mask), camera) for photo, camera in placed.photos[:3]]
    told: list[str] = []
    swept = station_sweep.sweep_station(
        replace(placed, photos=photos), scene["intensity"], np.full((HEIGHT, WIDTH), 255, np.uint8), tmp_path / "work",
        options=malus.Options(sweep={"station_gamma": 1.0, "min_level_px": 40}), threads=1, progress=lambda *_: None,
        log=lambda level, message: told.append(message),
    )  # fmt: skip
    assert swept.hull is None and np.isfinite(swept.depth).mean() > 0.5
    assert any("a visual hull is made of at least 4" in message for message in told)


def test_depths_before_the_hull_are_dropped_and_do_not_count_as_found(
    scene: dict[str, object], placed: StationCameras, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gsd = DISTANCE / FOCAL
    hull = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    hull[:, :70] = scene["depth"][:, :70] + 20 * gsd  # type: ignore[index]
    found = station_sweep.Hull(hull, np.full_like(hull, 0.1 * gsd), {"masks": 4}, {})
    monkeypatch.setattr(station_sweep._Sweep, "hull", lambda _: found)
    options = malus.Options(sweep={"station_gamma": 1.0, "min_level_px": 40, "again": False})
    swept = sweep_station(scene, placed, tmp_path, options, lambda _: pytest.fail("one sweep"))
    seen = np.isfinite(swept.depth)
    assert seen[:, :70].mean() < 0.05 and seen[:, 70:].mean() > 0.8
    assert swept.figures["completeness"] == pytest.approx(seen.mean())


def test_the_second_sweep_keeps_no_depths_before_the_hull_either(
    scene: dict[str, object], placed: StationCameras, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the hull replaces mirror images, the prior's sigma is large, so that a search about it may find others."""
    gsd = DISTANCE / FOCAL
    depth = np.float32(scene["depth"])  # type: ignore[arg-type]
    hull = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    hull[:, :70] = depth[:, :70] + 10 * gsd
    found = station_sweep.Hull(hull, np.full_like(hull, gsd), {"masks": 4, "mask_files": {"a": "0"}}, {})
    monkeypatch.setattr(station_sweep._Sweep, "hull", lambda _: found)
    options = malus.Options(sweep={"station_gamma": 1.0, "min_level_px": 40})
    surface = np.where(np.isfinite(hull), hull, depth)
    sigma = np.where(np.isfinite(hull), np.float32(5 * gsd), np.float32(gsd))
    swept = sweep_station(scene, placed, tmp_path, options, lambda _: station_sweep.FusedOnce(surface, surface, sigma))
    seen = np.isfinite(swept.depth)
    assert seen[:, :70].mean() < 0.05 and seen[:, 70:].mean() > 0.8
    np.testing.assert_array_equal(np.isfinite(swept.sigma), seen)
    assert swept.shape is not None and swept.figures["completeness"] == pytest.approx(seen.mean())
    assert swept.figures["masks"] == swept.figures["first"]["masks"] == 4 and swept.figures["mask_files"] == {"a": "0"}


RADIUS = 25.0


def ball_seen(camera: malus.Camera) -> np.ndarray:
    """Depth of a ball about (0, 0, DISTANCE); NaN beside it."""
    rotation, translation = camera.pose()
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - 59.5) / FOCAL, (v - 49.5) / FOCAL, np.ones((HEIGHT, WIDTH))], -1)
    middle = rotation @ np.array([0, 0, DISTANCE]) + translation
    a, b, c = (rays**2).sum(-1), rays @ middle, middle @ middle - RADIUS**2
    with np.errstate(invalid="ignore"):
        return np.asarray((b - np.sqrt(b**2 - a * c)) / a)


@pytest.mark.parametrize("masked", ["photos", "silhouettes", ""])
def test_photos_that_agree_nowhere_leave_the_visual_hull_of_their_masks(tmp_path: Path, masked: str) -> None:
    """A ball of one gray, which no window finds again. Its outlines are those of the photos, or of stations that turned with them."""
    station, photos, silhouettes = camera_at((0, 0, 0)), [], []
    for k in range(24):
        turn, up = 2 * np.pi * k / 8 + 0.2, (0, 120, -120)[k % 3]
        camera = camera_at((280 * np.cos(turn), up, DISTANCE + 280 * np.sin(turn)))
        image, mask = tmp_path / f"photo_{k}.tif", tmp_path / f"photo_{k}.png"
        _core.write_tiff16(str(image), np.full((HEIGHT, WIDTH), 30000, np.uint16))
        _core.write_png(str(mask), np.where(np.isfinite(ball_seen(camera)), np.uint8(255), np.uint8(0)))
        photos.append((Photo(image.name, image, WIDTH, HEIGHT, mask=mask if masked == "photos" else None), camera))
        if masked == "silhouettes":
            silhouettes.append((image.name, mask, camera))
    truth = ball_seen(station)
    nothing = SparseModel({}, np.zeros((0, 3)), np.zeros(0), np.zeros(0, int))
    cameras = StationCameras(station, photos, nothing, {}, {}, silhouettes=silhouettes)
    told: list[str] = []

    def swept() -> station_sweep.Swept:
        return station_sweep.sweep_station(
            cameras, np.full((HEIGHT, WIDTH), 0.5, np.float32), np.where(np.isfinite(truth), np.uint8(255), np.uint8(0)),
            tmp_path / "work", options=malus.Options(), threads=1, progress=lambda *_: None,
            log=lambda level, message: told.append(message), fuse=lambda _: pytest.fail("nothing to sweep about"),
        )  # fmt: skip

    if not masked:
        with pytest.raises(malus.DataError):
            swept()
        return
    first, again = swept(), swept()
    assert not np.isfinite(first.depth).any()
    assert any("visual hull" in message for message in told)
    assert first.hull is not None and again.hull is not None
    assert first.hull.figures["masks"] == 24 and "photo_3.tif" in first.hull.figures["mask_files"]
    assert first.hull.masks[tmp_path / "photo_3.png"] == sha256_of(tmp_path / "photo_3.png")
    assert len(again.hull.masks) == 24
    np.testing.assert_array_equal(first.hull.depth, again.hull.depth)
    off = np.abs(first.hull.depth - truth)[np.isfinite(truth)]
    assert np.isfinite(off).mean() > 0.95
    assert np.nanmedian(off) < 0.05 * RADIUS
    assert (off < 2 * first.hull.sigma[np.isfinite(truth)])[np.isfinite(off)].mean() > 0.9
    assert set(first.rasters()) == {"depth", "sigma", "hull", "hull_sigma"}


def test_two_masks_that_contradict_each_other_are_both_named(tmp_path: Path) -> None:
    """Without either one there is a hull, so that one was named, and the run with it corrected took the other one for right."""
    station, silhouettes = camera_at((0, 0, 0)), []
    for k in range(12):
        turn = 2 * np.pi * k / 12 + 0.2
        camera, file = camera_at((280 * np.cos(turn), 0, DISTANCE + 280 * np.sin(turn))), tmp_path / f"{k}.png"
        mask = np.where(np.isfinite(ball_seen(camera)), np.uint8(255), np.uint8(0))
        rows = np.flatnonzero(mask.any(1))
        middle, quarter = int(rows.mean()), len(rows) // 4
        if k == 3:
            mask[middle - quarter :] = 0
        if k == 8:
            mask[: middle + quarter] = 0
        _core.write_png(str(file), mask)
        silhouettes.append((f"photo {k}", file, camera))
    nothing = SparseModel({}, np.zeros((0, 3)), np.zeros(0), np.zeros(0, int))
    cameras = StationCameras(station, [], nothing, {}, {}, silhouettes=silhouettes)
    with pytest.raises(malus.DataError, match=r"/[38]\.png and [^ ]*/[38]\.png contradict each other"):
        station_sweep.sweep_station(
            cameras, np.full((HEIGHT, WIDTH), 0.5, np.float32), np.full((HEIGHT, WIDTH), 255, np.uint8), tmp_path / "work",
            options=malus.Options(), threads=1, progress=lambda *_: None, log=lambda *_: None,
        )  # fmt: skip


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ((5,), "without .*/5.png there is"),
        ((4, 5), "without [^,]*/4.png, [^,]*/5.png there is"),
        ((0, 1, 2, 3, 4, 5), "masks: .*0.png, "),
    ],
)
def test_masks_that_do_not_meet_are_named(tmp_path: Path, wrong: tuple[int, ...], said: str) -> None:
    """The error named no file."""
    station, silhouettes = camera_at((0, 0, 0)), []
    for k in range(12):
        turn = 2 * np.pi * k / 12 + 0.2
        camera, file = camera_at((280 * np.cos(turn), 0, DISTANCE + 280 * np.sin(turn))), tmp_path / f"{k}.png"
        mask = np.where(np.isfinite(ball_seen(camera)), np.uint8(255), np.uint8(0))
        if k in wrong:
            mask[:] = 0
            corner = 85 * (k % 2)
            mask[corner : corner + 10, corner : corner + 10] = 255
        _core.write_png(str(file), mask)
        silhouettes.append((f"photo {k}", file, camera))
    nothing = SparseModel({}, np.zeros((0, 3)), np.zeros(0), np.zeros(0, int))
    cameras = StationCameras(station, [], nothing, {}, {}, silhouettes=silhouettes)
    with pytest.raises(malus.DataError, match=said):
        station_sweep.sweep_station(
            cameras, np.full((HEIGHT, WIDTH), 0.5, np.float32), np.full((HEIGHT, WIDTH), 255, np.uint8), tmp_path / "work",
            options=malus.Options(), threads=1, progress=lambda *_: None, log=lambda *_: None,
        )  # fmt: skip


@pytest.mark.parametrize(
    ("wrong", "count", "most", "found"),
    [
        ("a", 1, 1, "a"),
        ("g", 7, 3, "g"),
        ("e", 5, 1, "e"),
        ("a", 4, 0, ""),
        ("bd", 8, 4, "bd"),
        ("ab", 8, 4, "ab"),
        ("ad", 8, 4, "abcd"),
        ("ab", 5, 2, "ab"),
        ("ah", 8, 4, ""),
    ],
)
def test_wrong_names_are_found_by_halving(wrong: str, count: int, most: int, found: str) -> None:
    names = list("abcdefgh"[:count])
    asked: list[Sequence[str]] = []

    def is_right(left_out: Sequence[str]) -> bool:
        asked.append(left_out)
        return set(wrong) <= set(left_out)

    assert station_sweep._without_which(names, most, is_right) == list(found)
    assert len(asked) <= 9 and all(len(left_out) <= most for left_out in asked)


@pytest.mark.parametrize("contradict", [False, True])
def test_few_hulls_are_tried_to_find_wrong_masks(contradict: bool) -> None:
    """For two wrong ones of 40 there were up to 26, and more for two of which one must be left out."""
    for pair in itertools.combinations(map(str, range(64)), 2):
        tried = []

        def hull_of(
            silhouettes: list[tuple[str, None]], pair: tuple[str, str] = pair, tried: list[int] = tried
        ) -> None:
            tried.append(len(silhouettes))
            if sum(mask in pair for mask, _ in silhouettes) > contradict:
                raise malus.DataError("no place in common")

        sweep: Any = SimpleNamespace(_hull_of=hull_of)
        words = station_sweep._Sweep._blamed(sweep, [(str(mask), None) for mask in range(64)])
        assert len(tried) <= station_sweep.MOST_HULLS
        if contradict:
            assert words.startswith((f"{pair[0]} and {pair[1]} contradict", f"{pair[1]} and {pair[0]} contradict"))
        else:
            assert words.startswith(("without ", "masks: "))
