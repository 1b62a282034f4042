"""Synthetic stations of any size with exact ground truth, to measure time, memory and accuracy.

    import malus.synthetic
    malus.synthetic.write_station("big", 5196, 3464)       # 18 megapixels: big/station.toml, big/gt, big/meta.json

A surface (depth and albedo) under one lamp and an even sky is rendered pixel by pixel as docs/method.md models reflection:
light from inside the body is polarized along the azimuth of the normal (Eq 6), the mirrored sky across it (Eq 8), and the
rough highlight of the lamp about the half vector of light and view. Cast shadows and light reflected between parts of the
surface, which a path tracer would add, are left out. Frames, angles and units: docs/conventions.md.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from malus import _core
from malus._files import replacing, write_text
from malus.camera import Camera

Floats = NDArray[np.float64]
_BAND_ROWS = 256
_WHITE_DN = 16383


@dataclass(frozen=True)
class Scene:
    """A surface in front of a pinhole camera.

    depth: H×W z in the unit of the station; albedo: H×W; patches: name → box (u0, v0, u1, v1, inclusive) of a flat area.
    """

    depth: Floats
    albedo: NDArray[np.float32]
    camera: Camera
    patches: dict[str, tuple[int, int, int, int]] = field(default_factory=dict)

    @property
    def gsd(self) -> float:
        """Ground sampling distance at the image's center."""
        return float(self.depth[self.depth.shape[0] // 2, self.depth.shape[1] // 2] / self.camera.params[0])


@dataclass(frozen=True)
class Reflectance:
    """Material and light.

    light: direction to the lamp, camera frame (any length); lamp, sky: radiance that a white matte surface facing the lamp
    reflects from lamp and sky, respectively; roughness: Beckmann's alpha of the lamp's highlight.
    """

    refractive_index: float = 1.5
    roughness: float = 0.25
    light: tuple[float, float, float] = (-0.35, -0.54, -0.77)
    lamp: float = 1.0
    sky: float = 0.07


@dataclass(frozen=True)
class Sensor:
    """Noise and full well of the sensor, and the angles of the polarizer, counter-clockwise from image +x."""

    angles_deg: Sequence[float] = (0, 30, 60, 90, 120, 150)
    full_well_e: float = 20000
    read_noise_e: float = 8
    frames_averaged: int = 16


def _smooth_noise(random: np.random.Generator, height: int, width: int, wavelength: float) -> Floats:
    """Noise of one wavelength (px) and variance about 1: random knots joined by cubic B-splines."""

    def taps(count: int) -> tuple[NDArray[np.int64], Floats]:
        at = np.arange(count) / (0.5 * wavelength)
        knot = np.floor(at).astype(np.int64)
        t = at - knot
        weights = np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, 3 * (t + t**2 - t**3) + 1, t**3]) / 6
        return knot, weights

    (rows, row_weights), (columns, column_weights) = taps(height), taps(width)
    # A B-spline of white knots keeps 0.479 of their variance along each axis, in the mean over a knot's interval.
    knots = random.standard_normal((rows[-1] + 4, columns[-1] + 4)) / 0.479
    along = sum(column_weights[k] * knots[:, columns + k] for k in range(4))
    full: Floats = sum((row_weights[k][:, None] * along[rows + k] for k in range(4)), np.zeros((height, width)))
    return full


def relief(width: int, height: int, *, seed: int = 0) -> Scene:
    """Carved, textured stone with a flat label, in mm, seen by a camera of 60 mm on a 22.3 mm sensor.

    It has bumps of wavelengths from 6 px to the width of the image, each randomly up to a fifth steeper or flatter, and grooves
    10 px wide. A larger image shows a larger stone at the same sampling distance (0.06 mm), with the same slopes and the same
    detail per pixel.
    """
    random = np.random.default_rng(seed)
    focal, gsd = width * 60 / 22.3, 0.06
    camera = Camera("PINHOLE", width, height, [focal, focal, 0.5 * width + 1.3, 0.5 * height - 2.6])
    bumps = np.zeros((height, width))
    texture = np.zeros((height, width), np.float32)
    wavelength = 6.0
    while wavelength < width:
        steepness = 0.08 * random.uniform(0.8, 1.2)
        bumps += steepness * wavelength / (2 * np.pi) * _smooth_noise(random, height, width, wavelength)
        texture += 0.3 * _smooth_noise(random, height, width, 0.7 * wavelength).astype(np.float32)
        wavelength *= 2
    # Grooves follow the zero lines of a coarse field: value over slope of the field is the distance from these lines.
    scale = 160.0
    field_of_grooves = _smooth_noise(random, height, width, scale)
    distance = np.abs(field_of_grooves) * scale / (2 * np.pi)
    bumps -= 3 * np.clip(1 - distance / 5, 0, 1)
    box = (int(0.58 * width), int(0.59 * height), int(0.75 * width), int(0.74 * height))
    u0, v0, u1, v1 = box
    bumps[v0 - 6 : v1 + 7, u0 - 6 : u1 + 7] = bumps[v0:v1, u0:u1].min() - 4
    bumps[v0 : v1 + 1, u0 : u1 + 1] += 4
    columns, rows = np.arange(width) - 0.5 * width, np.arange(height) - 0.5 * height
    tilted = 0.2 * columns[None, :] - 0.08 * rows[:, None]
    depth = gsd * (focal + tilted - bumps)
    albedo = np.clip(0.35 * np.exp(texture), 0.05, 0.85).astype(np.float32)
    return Scene(depth, albedo, camera, {"label": (u0 + 4, v0 + 4, u1 - 4, v1 - 4)})


def _rays(camera: Camera, first: int, last: int) -> Floats:
    """Rays with z = 1 of rows [first, last), H×W×3."""
    fx, fy, cx, cy = camera.params
    x, y = (np.arange(camera.width) - cx) / fx, (np.arange(first, last) - cy) / fy
    shape = (last - first, camera.width)
    return np.stack([np.broadcast_to(x, shape), np.broadcast_to(y[:, None], shape), np.ones(shape)], -1)


def _normals(scene: Scene, first: int, last: int) -> Floats:
    """Unit normals towards the camera of rows [first, last), from differences of the surface's points."""
    begin, end = max(first - 1, 0), min(last + 1, scene.camera.height)
    points = scene.depth[begin:end, :, None] * _rays(scene.camera, begin, end)
    normals: Floats = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return normals[first - begin : last - begin]


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = np.einsum("...i,...i->...", a, b)
    return product


def _fresnel(cosine: Floats, eta: float) -> tuple[Floats, Floats]:
    """(Rs + Rp) / 2 and (Rs − Rp) / 2 at this cosine of the zenith."""
    refracted = np.sqrt(eta * eta - 1 + cosine**2)
    s = ((cosine - refracted) / (cosine + refracted)) ** 2
    p = ((eta * eta * cosine - refracted) / (eta * eta * cosine + refracted)) ** 2
    return 0.5 * (s + p), 0.5 * (s - p)


def _diffuse_degree(cosine: Floats, eta: float) -> Floats:
    """Eq 6."""
    sin2 = 1 - cosine**2
    bottom = 2 + 2 * eta**2 - (eta + 1 / eta) ** 2 * sin2 + 4 * cosine * np.sqrt(eta * eta - sin2)
    return (eta - 1 / eta) ** 2 * sin2 / bottom


def stokes(scene: Scene, reflectance: Reflectance | None = None) -> Iterator[tuple[int, Floats, Floats, Floats]]:
    """Stokes vectors, band by band from the top: first row, s0, s1, s2 (each rows × W)."""
    how = reflectance or Reflectance()
    light = np.asarray(how.light) / np.linalg.norm(how.light)
    eta = how.refractive_index
    for first in range(0, scene.camera.height, _BAND_ROWS):
        last = min(first + _BAND_ROWS, scene.camera.height)
        rays = _rays(scene.camera, first, last)
        view = -rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        right = np.stack([rays[..., 2], np.zeros_like(rays[..., 0]), -rays[..., 0]], -1)
        right /= np.linalg.norm(right, axis=-1, keepdims=True)
        up = np.cross(view, right)
        normal = _normals(scene, first, last)
        cosine = np.clip(_dot(normal, view), 0.02, 1.0)
        lit = np.maximum(normal @ light, 0.0)
        albedo = scene.albedo[first:last]

        body = albedo * (how.lamp * lit + how.sky)
        mirrored, mirror_difference = _fresnel(cosine, eta)
        radial = body * _diffuse_degree(cosine, eta) - how.sky * mirror_difference
        across, along = _dot(normal, right), _dot(normal, up)
        flat = np.maximum(across**2 + along**2, 1e-30)
        cos2, sin2 = (across**2 - along**2) / flat, 2 * across * along / flat

        half = light + view
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        facing = np.clip(_dot(normal, half), 0.02, 1.0)
        facets = np.exp((1 - facing**-2) / how.roughness**2) / (how.roughness**2 * facing**4)
        # `lamp` is the radiance that a white matte surface reflects, its irradiance over π: this π cancels that of the microfacets' density.
        strength = np.where(lit > 0, how.lamp * facets / (4 * cosine), 0.0)
        glint, glint_difference = _fresnel(_dot(half, view), eta)
        half_across, half_along = _dot(half, right), _dot(half, up)
        half_flat = np.maximum(half_across**2 + half_along**2, 1e-30)
        polarized = strength * glint_difference
        yield (
            first,
            body + how.sky * mirrored + strength * glint,
            radial * cos2 - polarized * (half_across**2 - half_along**2) / half_flat,
            radial * sin2 - polarized * 2 * half_across * half_along / half_flat,
        )


def render(
    scene: Scene, reflectance: Reflectance | None = None, sensor: Sensor | None = None, *, seed: int = 0
) -> list[NDArray[np.uint16]]:
    """16-bit images through the polarizer, one per angle; linear, white level 16383, 0.3 % of the pixels clipped."""
    how = sensor or Sensor()
    random = np.random.default_rng(seed)
    size = scene.depth.shape
    images = [np.zeros(size, np.uint16) for _ in how.angles_deg]
    s0, s1, s2 = (np.empty(size, np.float32) for _ in range(3))
    for first, *band in stokes(scene, reflectance):
        for raster, rows in zip((s0, s1, s2), band, strict=True):
            raster[first : first + len(rows)] = rows
    exposure = 0.97 / (0.5 * np.quantile((s0 + np.hypot(s1, s2))[::7, ::7], 0.997))
    for image, degrees in zip(images, how.angles_deg, strict=True):
        angle = np.deg2rad(degrees)
        for first in range(0, size[0], _BAND_ROWS):
            part = slice(first, first + _BAND_ROWS)
            signal = 0.5 * exposure * (s0[part] + np.cos(2 * angle) * s1[part] + np.sin(2 * angle) * s2[part])
            variance = (signal * how.full_well_e + how.read_noise_e**2) / how.full_well_e**2 / how.frames_averaged
            signal += np.sqrt(variance) * random.standard_normal(signal.shape, dtype=np.float32)
            image[part] = np.round(np.clip(signal, 0, 1) * _WHITE_DN)
    return images


def _blurred(values: Floats, radius: int) -> Floats:
    """Three box filters of this radius, borders repeated: nearly a Gaussian of sigma = radius + ½."""
    for axis in (0, 1) * 3:
        extent, padding = values.shape[axis], [(0, 0), (0, 0)]
        padding[axis] = (radius, radius)
        padded = np.moveaxis(np.pad(values, padding, mode="edge"), axis, 0)
        total = np.zeros_like(padded[:extent])
        for shift in range(2 * radius + 1):
            total += padded[shift : shift + extent]
        values = np.moveaxis(total / (2 * radius + 1), 0, axis)
    return values


def stereo_depth(scene: Scene, *, seed: int = 0) -> Floats:
    """Depth as stereo would measure it: without detail below 3 px, with errors of 0.4 GSD that are correlated over 40 px."""
    random = np.random.default_rng(seed + 1)
    height, width = scene.depth.shape
    errors: Floats = 0.4 * scene.gsd * _smooth_noise(random, height, width, 40)
    return _blurred(scene.depth, 2) + errors


def stereo_cloud(
    scene: Scene, *, pixels_per_point: float = 6, noise_gsd: float = 0.7, outliers: float = 0.03, seed: int = 0
) -> tuple[Floats, NDArray[np.float32]]:
    """Points (N×3, world) and normals (N×3) as dense stereo measures them: blurred, with noise and outliers."""
    random = np.random.default_rng(seed + 2)
    smooth = Scene(_blurred(scene.depth, 2), scene.albedo, scene.camera)
    points, normals = [], []
    for first in range(0, scene.camera.height, _BAND_ROWS):
        last = min(first + _BAND_ROWS, scene.camera.height)
        chosen = random.random((last - first, scene.camera.width)) < 1 / pixels_per_point
        points.append((smooth.depth[first:last, :, None] * _rays(scene.camera, first, last))[chosen])
        normals.append(_normals(smooth, first, last)[chosen])
    cloud, facing = np.concatenate(points), np.concatenate(normals)
    cloud += noise_gsd * scene.gsd * random.standard_normal(cloud.shape)
    facing += 0.08 * random.standard_normal(facing.shape)
    facing /= np.linalg.norm(facing, axis=-1, keepdims=True)
    wrong = random.random(len(cloud)) < outliers
    cloud[wrong] += 15 * scene.gsd * random.standard_normal((int(wrong.sum()), 3))
    rotation, translation = scene.camera.pose()
    return (cloud - translation) @ rotation, (facing @ rotation).astype(np.float32)


def _save(path: Path, image: NDArray[Any]) -> None:
    with replacing(path) as temporary:
        Image.fromarray(image).save(temporary)


def _names_of_images(angles_deg: Sequence[float]) -> list[str]:
    """A file name for each image, by its angle; repeated exposures of one angle are numbered."""
    names: list[str] = []
    for angle in angles_deg:
        name = f"pol/pol_{angle:03g}"
        names.append(f"{name}.tif" if f"{name}.tif" not in names else f"{name}_{len(names)}.tif")
    return names


def write_station(
    folder: str | Path,
    width: int,
    height: int,
    *,
    prior: str = "cloud",
    sensor: Sensor | None = None,
    reflectance: Reflectance | None = None,
    seed: int = 0,
) -> Path:
    """Write a relief of any size as a station and return its station file.

    prior: "cloud" (PLY) or "depth" (TIFF). The ground truth for scoring results is written beside the station's own files:
    gt/depth_normal_mask.npz (depth, mask, label) and meta.json (camera, sampling distance, flat patches).
    """
    if prior not in ("cloud", "depth"):
        raise ValueError(f"prior is {prior!r}, expected 'cloud' or 'depth'")
    if min(width, height) < 120:
        raise ValueError(f"{width} x {height} pixels, expected at least 120 each way")
    folder, how = Path(folder), sensor or Sensor()
    scene = relief(width, height, seed=seed)
    names = _names_of_images(how.angles_deg)
    for name, image in zip(names, render(scene, reflectance, how, seed=seed), strict=True):
        _save(folder / name, image)
    if prior == "cloud":
        prior_line = 'cloud = "cloud.ply"'
        points, normals = stereo_cloud(scene, seed=seed)
        none = np.zeros((0, 3), np.uint8), np.zeros((0, 3), np.uint32)
        _core.write_ply(str(folder / "cloud.ply"), points, normals, *none, [], 1)
    else:
        prior_line = 'depth = "depth.tif"'
        _save(folder / "depth.tif", stereo_depth(scene, seed=seed).astype(np.float32))
    rotation, translation = scene.camera.pose()
    fx, fy, cx, cy = (float(value) for value in scene.camera.params)
    patches = "".join(f'\n[[patch]]\nname = "{name}"\nbox = {list(box)}\n' for name, box in scene.patches.items())
    write_text(
        folder / "station.toml",
        f"""[station]
name = "relief {width} x {height}"
unit = "mm"

[polarized]
images = {json.dumps(names)}
angles_deg = {[float(angle) for angle in how.angles_deg]}
frames_averaged = {how.frames_averaged}
full_well_e = {how.full_well_e}
read_noise_e = {how.read_noise_e}
white_level = {_WHITE_DN}

[optics]
refractive_index = 1.5

[camera]
model = "PINHOLE"
width = {width}
height = {height}
params = {[fx, fy, cx + 0.5, cy + 0.5]}
qvec = [1, 0, 0, 0]
tvec = {translation.tolist()}

[prior]
{prior_line}
{patches}""",
    )
    everywhere = np.ones(scene.depth.shape, bool)
    (folder / "gt").mkdir(exist_ok=True)
    np.savez(
        folder / "gt" / "depth_normal_mask.npz",
        depth=scene.depth.astype(np.float32),
        mask=everywhere,
        label=everywhere.astype(np.uint8),
    )
    truth = {
        "gsd_mm": scene.gsd,
        "station": {"K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], "R_world_to_cam": rotation.tolist()},
        "flat_patches": [{"name": name, "box_xyxy": list(box)} for name, box in scene.patches.items()],
    }
    write_text(folder / "meta.json", json.dumps(truth, indent=1))
    return folder / "station.toml"
