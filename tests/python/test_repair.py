"""Trimming and filling of exported meshes, on a plane whose holes are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import malus
from malus import repair
from malus._core import FusedSurface
from malus.camera import Camera


@pytest.fixture
def plane() -> tuple[FusedSurface, np.ndarray]:
    """An inclined plane with a hole inside and a hole at the image's border, and its depth without the holes."""
    camera = Camera("PINHOLE", 60, 40, [500, 500, 29.5, 19.5])
    v, u = np.indices((40, 60))
    truth = 1 / (0.002 + 1e-6 * (u - 30) - 2e-6 * (v - 20))
    depth = truth.astype(np.float32)
    depth[10:18, 20:30] = np.nan
    depth[30:, 50:] = np.nan
    normals = malus.surface.normals_from_depth(depth, camera)
    sigma = np.where(u < 10, 3.0, 0.5).astype(np.float32)
    sigma[~np.isfinite(depth)] = np.nan
    return FusedSurface(depth, normals, sigma, camera), truth


def test_filled_holes_continue_their_surroundings(plane: tuple[FusedSurface, np.ndarray]) -> None:
    pytest.importorskip("scipy")
    surface, truth = plane
    closed, holes = repair.filled(surface)
    assert holes.sum() == 80 and holes[10:18, 20:30].all()
    # Inverse depth is linear on a plane, and so harmonic.
    np.testing.assert_allclose(closed.depth[holes], truth[holes], rtol=1e-6)
    assert np.isfinite(closed.normals[holes]).all() and np.isnan(closed.sigma[holes]).all()
    assert np.isnan(closed.depth[30:, 50:]).all()
    again, none = repair.filled(closed)
    assert again is closed and not none.any()


def test_uncertain_parts_are_left_out(plane: tuple[FusedSurface, np.ndarray]) -> None:
    surface, _ = plane
    kept = repair.trimmed(surface, 1.0)
    assert np.isnan(kept.depth[:, :10]).all() and np.isfinite(kept.depth[:8, 10:]).all()
    with pytest.raises(malus.DataError, match=r"--trim.*the smallest is 0\.5"):
        repair.trimmed(surface, 0.1)


def test_meshes_are_trimmed_and_marked(finished_grid: Path, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    workspace = malus.Workspace(finished_grid)
    sigma = workspace.raster("fused/sigma.tif") / workspace.quality["gsd"]
    limit = float(np.nanpercentile(sigma, 60))
    path = malus.export(finished_grid, "ply", tmp_path / "a.ply", trim=limit, fill=True)
    mesh = trimesh.load(path)
    measured = int((sigma <= limit).sum())
    magenta = (np.asarray(mesh.visual.vertex_colors)[:, :3] == repair.FILLED_COLOR).all(-1)
    assert 0.9 * measured < (~magenta).sum() <= measured and magenta.any()
    with pytest.raises(malus.InputError, match="--trim is for obj"):
        malus.export(finished_grid, "las", tmp_path / "a.las", trim=limit)
    with pytest.raises(malus.InputError, match="expected a positive"):
        malus.export(finished_grid, "ply", tmp_path / "b.ply", trim=-1.0)
