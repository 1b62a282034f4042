"""The object's own color, against the albedo that the images were rendered with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import malus
from conftest import malus_here
from malus import albedo, rti, synthetic


def spread(estimate: np.ndarray, truth: np.ndarray) -> float:
    """Robust standard deviation of log(estimate / truth) over the pixels with an estimate."""
    known = np.isfinite(estimate) & (estimate > 0)
    assert known.mean() > 0.9
    ratio = np.log(estimate[known] / truth[known])
    return float(1.4826 * np.median(np.abs(ratio - np.median(ratio))))


@pytest.fixture(scope="module")
def truth() -> synthetic.Scene:
    return synthetic.relief(240, 180, seed=3)


def test_albedo_matches_the_scene(dates: tuple[Path, Path], truth: synthetic.Scene) -> None:
    workspace = malus.Workspace(dates[0])
    found = albedo.albedo_of(workspace)
    assert found.shape == truth.albedo.shape
    # Spread of the color as photographed: .094; with only the shading removed: .036.
    assert spread(workspace.color(), truth.albedo) > 0.08
    assert spread(found, truth.albedo) < 0.03


def test_albedo_does_not_contain_shading() -> None:
    rng = np.random.default_rng(3)
    slopes = rng.normal(0, 0.4, (60, 80, 2))
    normals = np.concatenate([-slopes, np.ones((60, 80, 1))], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    paint = rng.choice([0.2, 0.5], (60, 80))
    light = np.array([0.3, 0.4, 0.85])
    picture = (paint * (normals @ light + 0.1))[..., None] * np.ones(3)
    removed = albedo.diffuse_albedo(picture, normals * (1, -1, -1))[..., 0]
    assert np.std(removed[paint == 0.5]) < 0.02 * np.mean(removed[paint == 0.5]) + 0.02
    assert np.mean(removed[paint == 0.5]) / np.mean(removed[paint == 0.2]) == pytest.approx(2.5, rel=0.05)


def test_planes_and_surfaces_of_few_pixels_keep_their_color() -> None:
    paint = np.random.default_rng(1).uniform(0.2, 0.6, (40, 50, 1)).astype(np.float32)
    normals = np.broadcast_to(np.array([0.1, -0.2, -0.97], np.float32), (40, 50, 3)).copy()
    np.testing.assert_allclose(albedo.diffuse_albedo(paint, normals), paint, rtol=1e-5)
    normals[5:] = np.nan
    few = albedo.diffuse_albedo(paint, normals)
    np.testing.assert_allclose(few[:5], paint[:5], rtol=1e-5)
    assert np.isnan(few[5:]).all()


def test_mirrored_share_matches_the_rendering(dates: tuple[Path, Path], truth: synthetic.Scene) -> None:
    share = malus.Workspace(dates[0]).mirrored_share()
    assert share is not None
    every = synthetic.Reflectance()
    total = np.concatenate([s0 for _, s0, *_ in synthetic.stokes(truth, every)])
    # Doubling the albedo doubles the body light and changes nothing else.
    doubled = replace(truth, albedo=2 * truth.albedo)
    mirrored = 2 * total - np.concatenate([s0 for _, s0, *_ in synthetic.stokes(doubled, every)])
    expected = mirrored / total
    error = share - expected
    assert np.sqrt(np.mean(expected**2)) > 0.05
    assert np.sqrt(np.nanmean(error**2)) < 0.5 * np.sqrt(np.mean(expected**2))


def test_textures_can_have_the_albedo(dates: tuple[Path, Path], tmp_path: Path, finished_grid: Path) -> None:
    told = malus_here("export", dates[0], "--format", "obj", "--albedo", "-o", tmp_path / "a.obj")
    assert told.code == 0, told.err
    malus.export(dates[0], "obj", tmp_path / "b.obj")
    own, photograph = (np.asarray(Image.open(tmp_path / f"{name}.png")).astype(int) for name in "ab")
    assert own.shape == photograph.shape and np.abs(own - photograph).mean() > 3
    told = malus_here("export", finished_grid, "--format", "obj", "--albedo")
    assert told.code == 3 and "--fusion refined" in told.err
    told = malus_here("export", dates[0], "--format", "stl", "--albedo")
    assert told.code == 2 and "--albedo is for obj" in told.err
    # A IIIF folder has both the photograph and the albedo, each under its own name.
    told = malus_here("export", dates[0], "--format", "iiif", "--albedo")
    assert told.code == 2 and "not for iiif" in told.err


def test_relighting_names_its_texture_albedo_or_unshaded(
    dates: tuple[Path, Path], tmp_path: Path, finished_grid: Path
) -> None:
    for work, name, other in ((dates[0], "albedo", "unshaded"), (finished_grid, "unshaded", "albedo")):
        folder = malus.export(work, "relight", tmp_path / name)
        assert (folder / f"{name}.png").exists() and not (folder / f"{other}.png").exists()


def test_bare_metal_has_no_albedo(dates: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    raster = malus.Workspace.raster
    # For a metal, the refinement leaves NaN here.
    monkeypatch.setattr(
        malus.Workspace,
        "raster",
        lambda work, name: raster(work, name) * (np.nan if name == "fused/mirrored.tif" else 1),
    )
    work = malus.Workspace(dates[0])
    assert work.mirrored_share() is None
    with pytest.raises(malus.DataError, match="not bare metal"):
        albedo.albedo_of(work)
    assert not rti.relightable(work).without_highlights
