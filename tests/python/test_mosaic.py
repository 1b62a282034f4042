"""A polarization camera's station from its one file to the fused surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

import malus
from conftest import QUICK, edit

CELL_DEG = (90, 45, 135, 0)
SIX_DEG = (0, 30, 60, 90, 120, 150)
IMAGES = (
    "images = [" + ", ".join(f'"pol/pol_{a:03d}.tif"' for a in SIX_DEG) + "]\nangles_deg = [0, 30, 60, 90, 120, 150]"
)


def rows(angles_deg: tuple[int, ...]) -> np.ndarray:
    twice = np.radians(2.0 * np.array(angles_deg))
    return 0.5 * np.stack([np.ones_like(twice), np.cos(twice), np.sin(twice)], -1)


def polarizer_images(folder: Path) -> np.ndarray:
    """DN behind the cell's polarizers, from the Stokes vectors of the six images."""
    six = np.stack([tifffile.imread(folder / f"pol/pol_{a:03d}.tif").astype(float) for a in SIX_DEG])
    return np.tensordot(rows(CELL_DEG) @ np.linalg.pinv(rows(SIX_DEG)), six, 1)


def place(shape: tuple[int, int]) -> np.ndarray:
    v, u = np.indices(shape)
    return 2 * (v % 2) + u % 2


def write(path: Path, image: np.ndarray) -> None:
    tifffile.imwrite(path, np.clip(np.rint(image), 0, 16383).astype(np.uint16))


def normals_off_deg(result: malus.Result, other: malus.Result) -> float:
    """Median angle between two results' normals."""
    assert result.normals is not None and other.normals is not None
    return float(np.degrees(np.nanmedian(np.arccos(np.clip((result.normals * other.normals).sum(-1), -1, 1)))))


@pytest.fixture
def mosaic_station(small_station: Path) -> Path:
    folder = small_station.parent
    channels = polarizer_images(folder)
    write(folder / "mosaic.tif", np.take_along_axis(channels, place(channels.shape[1:])[None], 0)[0])
    copy = folder / "mosaic.toml"
    copy.write_text(small_station.read_text())
    return edit(copy, IMAGES, 'images = ["mosaic.tif"]\nmosaic = [[90, 45], [135, 0]]')


def test_mosaic_becomes_a_surface(small_station: Path, mosaic_station: Path, tmp_path: Path) -> None:
    options = malus.Options(refine=QUICK)
    six = malus.reconstruct(malus.Station.load(small_station), options, threads=2)
    warnings: list[str] = []
    station = malus.Station.load(mosaic_station)
    mosaic = malus.reconstruct(
        station, options, workspace=tmp_path / "w", threads=2, log=lambda _, text: warnings.append(text)
    )
    assert mosaic.depth is not None and mosaic.depth.shape == (160, 200) and mosaic.quality is not None
    assert mosaic.quality["coverage"]["fraction"] > 0.99
    # Measured: 5.3°.
    assert normals_off_deg(mosaic, six) < 7
    # Carved, painted stone: hardly polarized, and its texture is finer than the cells.
    assert any("texture finer than the mosaic's cells" in text for text in warnings)
    # The interpolation's estimated errors survive on disk.
    (tmp_path / "w/fused/depth.tif").unlink()
    again = malus.reconstruct(station, options, workspace=tmp_path / "w", threads=2)
    np.testing.assert_array_equal(again.depth, mosaic.depth)


def test_color_mosaic_becomes_a_surface(small_station: Path, mosaic_station: Path) -> None:
    options = malus.Options(refine=QUICK)
    gray = malus.reconstruct(malus.Station.load(mosaic_station), options, threads=2)
    path = mosaic_station.parent / "mosaic.tif"
    mosaic = tifffile.imread(path).astype(float)
    v, u = np.indices(mosaic.shape)
    tint = np.array([[0.9, 1.0], [1.0, 0.7]])[v // 2 % 2, u // 2 % 2]
    write(path, mosaic * tint)
    edit(mosaic_station, "mosaic = [[", 'mosaic_colors = "RGGB"\nmosaic = [[')
    color = malus.reconstruct(malus.Station.load(mosaic_station), options, threads=2)
    assert normals_off_deg(color, gray) < 1
