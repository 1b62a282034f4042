"""A ColorChecker seen through a camera of known colors, and what its correction does to exports."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms

import malus
from conftest import malus_here
from malus import chart, synthetic
from test_raw import write_dng

with np.printoptions():  # its import changes how numpy prints numbers for all tests that follow
    colour = pytest.importorskip("colour")
cv2 = pytest.importorskip("cv2")
# colour-science warns about its optional parts.
pytestmark = pytest.mark.filterwarnings("ignore")

#: Matrix from linear sRGB to the camera's linear RGB.
CAMERA = np.array([[0.55, 0.25, 0.10], [0.18, 0.62, 0.12], [0.05, 0.20, 0.60]])


@pytest.fixture(scope="module")
def photograph(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """A noisy 16-bit photograph of a chart in perspective, and the centers of its corner patches."""
    side, reference = 60, chart._reference(colour)
    flat = np.full((4 * side + 60, 6 * side + 60, 3), 0.02)
    for k, color in enumerate(reference):
        row, column = divmod(k, 6)
        top, left = 36 + row * side, 36 + column * side
        flat[top : top + side - 12, left : left + side - 12] = color
    corners = np.array([[120, 90], [560, 120], [540, 440], [100, 410]], np.float32)
    size = np.array([[0, 0], [420, 0], [420, 300], [0, 300]], np.float32)
    view = cv2.getPerspectiveTransform(size, corners)
    seen = cv2.warpPerspective(flat @ CAMERA.T, view, (680, 520), borderValue=(0.3, 0.3, 0.3))
    seen = 0.8 * seen + np.random.default_rng(0).normal(0, 0.003, seen.shape)
    path = tmp_path_factory.mktemp("chart") / "chart.tif"
    tifffile.imwrite(path, np.clip(seen * 65535, 0, 65535).astype(np.uint16))
    inner = np.array([[[60, 60]], [[360, 60]], [[360, 240]], [[60, 240]]], np.float32)
    return path, cv2.perspectiveTransform(inner, view).reshape(-1, 2)


@pytest.mark.parametrize("given", [False, True])
def test_the_cameras_colors_are_found(photograph: tuple[Path, np.ndarray], tmp_path: Path, given: bool) -> None:
    path, corners = photograph
    extra = ["--corners", ",".join(f"{x:.1f}" for x in corners.ravel())] if given else []
    told = malus_here("chart", path, "-o", tmp_path / "chart.json", *extra)
    assert told.code == 0, told.err
    assert "CIEDE2000" in told.out
    found = chart.ColorCorrection.load(tmp_path / "chart.json")
    np.testing.assert_allclose(found.matrix @ CAMERA * 0.8, np.eye(3), atol=0.02)
    # Pixel noise of 0.3 % of white, averaged over each patch.
    assert found.delta_e.mean() < 0.5 and found.delta_e_left_out.max() < 2
    np.testing.assert_allclose(found.corners, corners, atol=6)


def test_levels_are_those_of_the_station(photograph: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    """Of 14 bits in a file of 16 the chart was taken four times too dark, and exports were four times too bright."""
    levels = tifffile.imread(photograph[0]) / 65535
    path = tmp_path / "chart.tif"
    tifffile.imwrite(path, np.rint(512 + levels * (16383 - 512)).astype(np.uint16))
    told = malus_here("chart", path, "-o", tmp_path / "c.json", "--white-level", "16383", "--black-level", "512")
    assert told.code == 0, told.err
    found = chart.ColorCorrection.load(tmp_path / "c.json")
    np.testing.assert_allclose(found.matrix @ CAMERA * 0.8, np.eye(3), atol=0.02)
    with pytest.raises(malus.InputError, match="white_level = 100 must be above black_level = 512"):
        chart.measure_chart(path, white_level=100, black_level=512)


def test_a_raw_file_of_the_chart_has_its_own_levels(photograph: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    linear, corners = tifffile.imread(photograph[0]) / 65535, photograph[1]
    mosaic = linear[..., 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = linear[::2, ::2, 0], linear[1::2, 1::2, 2]
    write_dng(tmp_path / "chart.dng", mosaic)
    given = corners.ravel().tolist()
    found = chart.measure_chart(tmp_path / "chart.dng", corners=given)
    np.testing.assert_allclose(found.matrix, chart.measure_chart(photograph[0], corners=given).matrix, atol=0.02)
    with pytest.raises(malus.InputError, match="level are not for RAW files"):
        chart.measure_chart(tmp_path / "chart.dng", corners=given, white_level=16383)


def test_unusable_charts_are_refused(photograph: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    path, corners = photograph
    with pytest.raises(malus.DataError, match="the right way up"):
        chart.measure_chart(path, corners=np.roll(corners, 2, axis=0).ravel().tolist())
    for beside in (400, -400):
        with pytest.raises(malus.InputError, match="lies beside the image"):
            chart.measure_chart(path, corners=(corners + beside).ravel().tolist())
    tifffile.imwrite(tmp_path / "plain.tif", np.full((200, 300, 3), 30000, np.uint16))
    told = malus_here("chart", tmp_path / "plain.tif", "-o", tmp_path / "c.json")
    assert told.code == 3 and "no ColorChecker was found" in told.err and not (tmp_path / "c.json").exists()
    tifffile.imwrite(tmp_path / "gray.tif", np.full((200, 300), 30000, np.uint16))
    with pytest.raises(malus.InputError, match="taken in gray"):
        chart.measure_chart(tmp_path / "gray.tif")
    (tmp_path / "c.json").write_text(json.dumps({"linear_srgb_from_camera": np.eye(3).tolist()}))
    with pytest.raises(malus.InputError, match="is no color correction"):
        chart.ColorCorrection.load(tmp_path / "c.json")


def test_textures_are_corrected_by_the_chart(tmp_path: Path) -> None:
    station = synthetic.write_station(tmp_path / "station", 200, 140, prior="depth")
    paint = np.array([0.9, 0.5, 0.3])
    for path in (tmp_path / "station/pol").iterdir():
        gray = np.asarray(Image.open(path)).astype(float)
        tifffile.imwrite(path, np.rint(gray[..., None] * (CAMERA @ paint)).astype(np.uint16), photometric="rgb")
    work = tmp_path / "work"
    assert malus_here("assess", station, "-o", work, "--fusion", "grid", "--quiet").code == 0
    correction = chart.ColorCorrection(np.linalg.inv(CAMERA), np.zeros(24), np.zeros(24), np.zeros((4, 2)), "here")
    file = correction.save(tmp_path / "chart.json")
    told = malus_here("export", work, "--format", "obj", "--chart", file, "-o", tmp_path / "a.obj")
    assert told.code == 0, told.err
    path = tmp_path / "a.png"
    with Image.open(path) as image:
        profile = ImageCms.ImageCmsProfile(io.BytesIO(image.info["icc_profile"]))
        assert "sRGB" in ImageCms.getProfileDescription(profile)
        texture = np.asarray(image).reshape(-1, 3) / 255
    linear = np.where(texture <= 0.04045, texture / 12.92, ((texture + 0.055) / 1.055) ** 2.4)
    bright = linear[linear.mean(-1) > 0.1]
    np.testing.assert_allclose(
        bright / bright.sum(-1, keepdims=True), np.tile(paint / paint.sum(), (len(bright), 1)), atol=0.02
    )
    ply = malus.export(work, "ply", tmp_path / "a.ply", chart=file)
    assert ply.stat().st_size > 1000


def test_gray_stations_and_missing_packages_are_reported(
    finished_grid: Path, photograph: tuple[Path, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    correction = chart.ColorCorrection(np.eye(3), np.zeros(24), np.zeros(24), np.zeros((4, 2)), "here")
    with pytest.raises(malus.InputError, match="was taken in gray"):
        malus.export(finished_grid, "obj", tmp_path / "a.obj", chart=correction.save(tmp_path / "chart.json"))
    monkeypatch.setitem(sys.modules, "colour", None)
    with pytest.raises(malus.ExternalError, match=r"colour-science.*malus\[color\]"):
        chart.measure_chart(photograph[0])
