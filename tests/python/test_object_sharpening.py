"""Detail that comes back by the phases of stations: a sphere whose surface was roughened, and its true phases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from malus.object import View
from malus.object.sharpening import Phases, sharpened, telling
from test_object import FAR, RADIUS, SIDE, points_of, sphere_view


def phases_of(view: View, turned: float = 0.0) -> Phases:
    """Phases of the body's own light at the view's normals, all turned by so many degrees."""
    ray = (points_of(view) - view.eye) @ view.rotation.T
    normals = view.normals @ view.rotation.T
    along = normals - ray * (normals[..., 2:] / ray[..., 2:])
    angle = np.arctan2(-along[..., 1], along[..., 0]) + np.radians(turned)
    degree = np.where(view.usable, 0.1 * (1 - view.cosine**2), 0)
    return Phases(np.nan_to_num(np.stack([degree * np.cos(2 * angle), degree * np.sin(2 * angle)])))


def rough(view: View) -> View:
    """The view with ripples of a fifth of a GSD and nine pixels, which turn its normals by up to 8 degrees."""
    rows, columns = np.indices((SIDE, SIDE))
    wave = 0.2 * view.gsd * np.sin(2 * np.pi * columns / 9) * np.sin(2 * np.pi * rows / 9)
    factor = 1 + wave / FAR
    moved = replace(view, depth=view.depth * factor)
    slopes = [np.gradient(points_of(moved), axis=axis) for axis in (0, 1)]
    normals = np.cross(slopes[0], slopes[1])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return replace(moved, normals=np.where(np.isfinite(normals), normals, 0.0))


def turned_by(view: View) -> float:
    """How far the normals are off the sphere's (degrees, median)."""
    inner = view.usable & (view.cosine > 0.5)
    true = points_of(view)[inner] / np.linalg.norm(points_of(view)[inner], axis=1, keepdims=True)
    return float(np.degrees(np.median(np.arccos(np.clip((true * view.normals[inner]).sum(1), -1, 1)))))


STATIONS = [sphere_view(f"s{k}", axis) for k, axis in enumerate([(1, 0, 0), (0.8, 0.6, 0), (0.8, 0, 0.6)])]


def test_phases_of_several_stations_bring_the_normals_back() -> None:
    roughened, phases = [rough(view) for view in STATIONS], [phases_of(view) for view in STATIONS]
    sharp = list(sharpened(roughened, telling(roughened, phases)))
    assert turned_by(roughened[0]) > 3
    assert turned_by(sharp[0]) < 0.6 * turned_by(roughened[0])
    off = [np.abs(np.linalg.norm(points_of(view), axis=-1) - RADIUS)[view.usable] for view in (roughened[0], sharp[0])]
    assert np.median(off[1]) < np.median(off[0])


def test_what_is_right_stays() -> None:
    after = next(sharpened(STATIONS, telling(STATIONS, [phases_of(view) for view in STATIONS])))
    moved = np.abs(after.depth - STATIONS[0].depth)[STATIONS[0].usable]
    assert np.percentile(moved, 95) < 0.02 * STATIONS[0].gsd


def test_phases_that_have_nothing_to_do_with_the_surface_move_nothing() -> None:
    roughened = [rough(view) for view in STATIONS]
    told = telling(roughened, [phases_of(view, turned=45.0) for view in STATIONS])
    assert not told
    after = sharpened(roughened, told)
    for view, other in zip(roughened, after, strict=True):
        assert np.array_equal(other.depth, view.depth.astype(np.float32), equal_nan=True)
        assert np.array_equal(other.normals, view.normals.astype(np.float32), equal_nan=True)
