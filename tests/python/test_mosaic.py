"""A polarization camera's station from its one file to the fused surface."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import tifffile

import malus
from conftest import QUICK, edit

CELL_DEG = (90, 45, 135, 0)
SIX_DEG = (0, 30, 60, 90, 120, 150)
OPTIONS = malus.Options(refine=QUICK, assess={"polarization_height": False})
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


@pytest.fixture(scope="module")
def mosaic_station(small_station_source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small station as a mosaic; read it, do not change it."""
    folder = shutil.copytree(small_station_source, tmp_path_factory.mktemp("mosaic") / "station")
    channels = polarizer_images(folder)
    write(folder / "mosaic.tif", np.take_along_axis(channels, place(channels.shape[1:])[None], 0)[0])
    copy = shutil.copy(folder / "station.toml", folder / "mosaic.toml")
    return edit(copy, IMAGES, 'images = ["mosaic.tif"]\nmosaic = [[90, 45], [135, 0]]')


@pytest.fixture(scope="module")
def mosaic(mosaic_station: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[malus.Result, Path, list[str]]:
    """The mosaic's surface, its workspace and the log of its run."""
    work, said = tmp_path_factory.mktemp("surface") / "w", []
    result = malus.reconstruct(
        malus.Station.load(mosaic_station), OPTIONS, workspace=work, threads=2, log=lambda _, text: said.append(text)
    )
    return result, work, said


def test_mosaic_becomes_a_surface(
    small_station_source: Path, mosaic_station: Path, mosaic: tuple[malus.Result, Path, list[str]]
) -> None:
    six = malus.reconstruct(malus.Station.load(small_station_source / "station.toml"), OPTIONS, threads=2)
    surface, work, said = mosaic
    assert surface.depth is not None and surface.depth.shape == (160, 200) and surface.quality is not None
    assert surface.quality["coverage"]["fraction"] > 0.99
    # Measured: 5.3°.
    assert normals_off_deg(surface, six) < 7
    # Carved, painted stone: hardly polarized, and its texture is finer than the cells.
    assert any("texture finer than the mosaic's cells" in text for text in said)
    # The interpolation's estimated errors survive on disk.
    (work / "fused/depth.tif").unlink()
    again = malus.reconstruct(malus.Station.load(mosaic_station), OPTIONS, workspace=work, threads=2)
    np.testing.assert_array_equal(again.depth, surface.depth)


def test_strong_texture_is_not_taken_for_a_missing_filter(mosaic_station: Path, tmp_path: Path) -> None:
    """A polarization camera always has its filters. Before a real one, the peel of an orange was called unpolarized."""
    folder = shutil.copytree(mosaic_station.parent, tmp_path / "station")
    image = tifffile.imread(folder / "mosaic.tif").astype(float)
    write(folder / "mosaic.tif", image * np.random.default_rng(0).uniform(0.85, 1.15, image.shape))
    said: list[str] = []
    malus.reconstruct(
        malus.Station.load(folder / "mosaic.toml"), OPTIONS, until="evidence", threads=2,
        log=lambda _, text: said.append(text),
    )  # fmt: skip
    assert any("texture finer than the mosaic's cells" in text for text in said)
    assert not any("polarized" in text for text in said)


def test_color_mosaic_becomes_a_surface(
    mosaic_station: Path, mosaic: tuple[malus.Result, Path, list[str]], tmp_path: Path
) -> None:
    station = shutil.copytree(mosaic_station.parent, tmp_path / "station") / mosaic_station.name
    path = station.parent / "mosaic.tif"
    gray = tifffile.imread(path).astype(float)
    v, u = np.indices(gray.shape)
    tint = np.array([[0.9, 1.0], [1.0, 0.7]])[v // 2 % 2, u // 2 % 2]
    write(path, gray * tint)
    edit(station, "mosaic = [[", 'mosaic_colors = "RGGB"\nmosaic = [[')
    color = malus.reconstruct(malus.Station.load(station), OPTIONS, threads=2)
    assert normals_off_deg(color, mosaic[0]) < 1
