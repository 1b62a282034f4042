"""How much of each pixel's light was mirrored at the surface, from the reflection model that the refinement fitted.

The model (docs/method.md, section 4) says what a surface of the fused slopes mirrors of lamp and surroundings, and how that is polarized.
Where parts of the object shade each other less is mirrored than it says, so its strength is fitted anew to the measured polarization about
every pixel.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malus.camera import Camera
from malus.raster import sample
from malus.workspace import Workspace

Floats = NDArray[np.float64]
#: Pixels on either side that share one strength of the mirrored light.
_RADIUS = 3
#: Standard deviations: of that strength about 1, and of the degree of polarization about what the model explains.
_STRENGTH_SIGMA, _MISFIT = 0.5, 0.01
#: Value of mirroring pixels in fused/label.png.
_SPECULAR = 2
#: As in cpp/malus/fusion/surroundings.cpp: edge and step of the tabulated slopes, cells along the disc, rays of the camera.
_TABLE_SIDE, _TABLE_EDGE, _CELLS, _RAYS = 65, 0.985, 20, (3, 2)


def mirrored_share(workspace: Workspace) -> NDArray[np.float32] | None:
    """Share of the unpolarized intensity that was mirrored at the surface, H×W in [0, 1]; NaN where there is no surface.

    None for a surface without a reflection model (`--fusion grid`).
    """
    if not workspace.has("fused/refinement.json"):
        return None
    model = json.loads(workspace.path("fused/refinement.json").read_text(encoding="utf-8"))
    s0 = 2 * workspace.raster("polarization/unpolarized.tif").astype(float)
    degree, phase = (workspace.raster(f"polarization/{name}.tif").astype(float) for name in ("degree", "phase"))
    measured = s0[..., None] * degree[..., None] * np.stack([np.cos(2 * phase), np.sin(2 * phase)], -1)
    frame = RayFrames(workspace.camera)
    p, q = frame.slopes(workspace.raster("fused/normals.tif").astype(float))
    eta = float(model["refractive_index"]["value"])
    with np.errstate(invalid="ignore", over="ignore"):
        if model["surroundings"] is None:
            mirrored = _lamp_and_environment(p, q, frame, model, eta)
        else:
            mirrored = _surroundings(p, q, workspace.camera, model["surroundings"], eta)
        amount = _strength(s0, measured, p, q, mirrored, eta) * mirrored[..., 0]
        share = np.clip(amount / s0, 0, 1)
        if model["mirror"] is not None and workspace.has("fused/label.png"):
            mirrors = workspace.raster("fused/label.png") == _SPECULAR
            share[mirrors] = np.clip(1 - model["mirror"]["body"] / s0[mirrors], 0, 1)
    return np.asarray(share, dtype=np.float32)


class RayFrames:
    """Directions of every pixel's ray in the camera frame, H×W×3: to the right, upwards, and to the viewer."""

    def __init__(self, camera: Camera) -> None:
        v, u = np.indices((camera.height, camera.width))
        self.set_rays(np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], -1))

    def set_rays(self, rays: Floats) -> None:
        """Take these rays (…×3, camera frame, any length) instead."""
        direction = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        right = np.stack([direction[..., 2], np.zeros(direction.shape[:-1]), -direction[..., 0]], -1)
        self.right = right / np.linalg.norm(right, axis=-1, keepdims=True)
        self.up = -np.cross(direction, self.right)
        self.view = -direction

    def slopes(self, normals: Floats) -> tuple[Floats, Floats]:
        """P and Q of normals (…×3): their tangents to the right and upwards, seen along the ray."""
        facing = (normals * self.view).sum(-1)
        facing = np.where(facing > 0.02, facing, np.nan)
        return (normals * self.right).sum(-1) / facing, (normals * self.up).sum(-1) / facing


def fresnel(tan2: ArrayLike, eta: float) -> tuple[Floats, Floats, Floats]:
    """Reflectance, and by tan² of the zenith: diffuse degree (Eq 6) and (Rs − Rp) / 2 of a smooth dielectric."""
    c2 = 1 / (1 + np.minimum(np.asarray(tan2, dtype=np.float64), 1458.0))
    s = 1 - c2
    c, q = np.sqrt(c2), np.sqrt(eta**2 - s)
    sum_s, sum_p = c + q, eta**2 * c + q
    reflectance = 0.5 * (((c - q) / sum_s) ** 2 + ((eta**2 * c - q) / sum_p) ** 2)
    diffuse = (eta - 1 / eta) ** 2 * c2 / (2 + 2 * eta**2 - (eta + 1 / eta) ** 2 * s + 4 * c * q)
    specular = 2 * (eta**2 - 1) ** 2 * c * c2 * q / (sum_s * sum_p) ** 2
    return reflectance, diffuse, specular


def _lamp_and_environment(p: Floats, q: Floats, frame: RayFrames, model: Mapping[str, Any], eta: float) -> Floats:
    """(s0, s1, s2) mirrored of an environment that depends on the zenith alone, and of a lamp in rough facets."""
    tan2 = p**2 + q**2
    reflectance, _, specular = fresnel(tan2, eta)
    nodes = [node["zenith_rad"] for node in model["environment"]]
    radiance = np.interp(np.arctan(np.sqrt(tan2)), nodes, [node["radiance"] for node in model["environment"]])
    polarized = radiance * specular
    total = np.stack([radiance * reflectance, -polarized * (p**2 - q**2), -polarized * 2 * p * q], -1)
    strength = float(model["lobe"]["strength"]) if model["lobe"] else 0.0
    if not strength > 0:
        return np.asarray(total)
    half = np.asarray(model["light"]["direction"], dtype=np.float64) + frame.view
    along = (half * frame.view).sum(-1)
    hp, hq = (half * frame.right).sum(-1) / along, (half * frame.up).sum(-1) / along
    at_half, _, specular_at_half = fresnel(hp**2 + hq**2, eta)
    slant2 = 1 + tan2
    together = 1 + p * hp + q * hq
    cos2 = together**2 / (slant2 * (1 + hp**2 + hq**2))
    alpha2 = float(model["lobe"]["roughness"]) ** 2
    facets = np.exp(-(1 - cos2) / cos2 / alpha2) / (alpha2 * cos2**2) * np.sqrt(slant2)
    facets = strength * np.where((together > 0) & (cos2 > 0.0025) & (along > 1e-3), facets, 0)
    about = [at_half, -specular_at_half * (hp**2 - hq**2), -specular_at_half * 2 * hp * hq]
    return np.asarray(total + facets[..., None] * np.stack(about, -1))


def _surroundings(p: Floats, q: Floats, camera: Camera, told: Mapping[str, Any], eta: float) -> Floats:
    """(s0, s1, s2) mirrored of a map of radiance over half vectors, tabulated over the slopes for some rays of the camera."""
    # Stereographic: all zeniths are on a disc.
    length = 1 + np.sqrt(1 + p**2 + q**2)
    at = np.stack([p / length, q / length], -1) / _TABLE_EDGE
    at = (np.nan_to_num(at) + 1) / 2 * (_TABLE_SIDE - 1)
    x, y = np.arange(camera.width), np.arange(camera.height)
    total = np.zeros((*p.shape, 3))
    for i in range(_RAYS[0]):
        for j in range(_RAYS[1]):
            across = np.interp(x, [camera.width * (k + 0.5) / _RAYS[0] for k in range(_RAYS[0])], np.eye(_RAYS[0])[i])
            along = np.interp(y, [camera.height * (k + 0.5) / _RAYS[1] for k in range(_RAYS[1])], np.eye(_RAYS[1])[j])
            u, v = camera.width * (i + 0.5) / _RAYS[0], camera.height * (j + 0.5) / _RAYS[1]
            ray = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
            table = _table(ray, camera, told["radiance"], float(told["roughness"]), eta)
            total += (along[:, None] * across)[..., None] * sample(table, at)
    total[~np.isfinite(p)] = np.nan
    return total


def _table(ray: Floats, camera: Camera, radiance: Sequence[Sequence[float]], roughness: float, eta: float) -> Floats:
    """What one ray sees mirrored over stereographic slopes, SIDE×SIDE×3 (rows: q)."""
    frame = RayFrames(camera)
    frame.set_rays(ray)
    line = _TABLE_EDGE * np.linspace(-1, 1, _TABLE_SIDE)
    b, a = np.meshgrid(line, line, indexing="ij")
    inside = np.minimum(a**2 + b**2, 0.97)
    p, q = 2 * a / (1 - inside), 2 * b / (1 - inside)
    cos_normal = 1 / np.sqrt(1 + p**2 + q**2)
    normal = (p[..., None] * frame.right + q[..., None] * frame.up + frame.view) * cos_normal[..., None]
    side = 2 / _CELLS
    out = np.zeros((*p.shape, 3))
    for (row, column), value in np.ndenumerate(np.asarray(radiance, dtype=np.float64)):
        hx, hy = (column + 0.5) * side - 1, (row + 0.5) * side - 1
        if value <= 0 or np.hypot(hx, hy) >= 0.985:
            continue
        hz = np.sqrt(max(1 - hx**2 - hy**2, 1e-6))
        alpha2 = roughness**2 + 2 * (0.45 * side) ** 2 / np.sqrt(max(hz, 0.2))
        axis, about = np.array([0, 0, -1.0]), np.array([hx, -hy, -hz])
        light = 2 * about.dot(axis) * about - axis
        half = light + frame.view
        half = half / max(float(np.linalg.norm(half)), 1e-9)
        cos_facet, cos_light, cos_half = normal @ half, normal @ light, float(half @ frame.view)
        seen = (cos_facet > 0.02) & (cos_light > 0) & (cos_half >= 0.01)
        cos2 = np.where(seen, cos_facet, 1) ** 2
        facets = np.exp(-(1 - cos2) / cos2 / alpha2) / (np.pi * alpha2 * cos2**2)
        masking = np.minimum(1, 2 * cos_facet * np.minimum(cos_normal, cos_light) / cos_half)
        weight = np.where(seen, value * 4 * side**2 * facets * masking / (4 * cos_normal), 0)
        hp, hq = float(half @ frame.right) / cos_half, float(half @ frame.up) / cos_half
        reflectance, _, specular = fresnel(hp**2 + hq**2, eta)
        out += weight[..., None] * np.array([reflectance, -specular * (hp**2 - hq**2), -specular * 2 * hp * hq])
    return out


def _box_sum(values: Floats, radius: int) -> Floats:
    """Sums over squares of 2 · radius + 1 pixels."""
    padded = np.pad(values, ((radius + 1, radius), (radius + 1, radius)))
    sums = padded.cumsum(0).cumsum(1)
    size = 2 * radius + 1
    return np.asarray(sums[size:, size:] - sums[:-size, size:] - sums[size:, :-size] + sums[:-size, :-size])


def _strength(s0: Floats, measured: Floats, p: Floats, q: Floats, mirrored: Floats, eta: float) -> Floats:
    """By what the mirrored light is to be multiplied about each pixel, so that the polarization is as measured.

    With d = s0 − c m0 the polarization is linear in c: least squares over a square of pixels, with c near 1 to begin with.
    """
    degree = fresnel(p**2 + q**2, eta)[1][..., None] * np.stack([p**2 - q**2, 2 * p * q], -1)
    # As shares of the intensity, to which the model's misfits are proportional.
    change = (mirrored[..., 1:] - mirrored[..., :1] * degree) / s0[..., None]
    left = measured / s0[..., None] - degree
    usable: NDArray[np.bool_] = np.asarray(np.isfinite(left + change).all(-1))
    both = np.where(usable[..., None], left * change, 0).sum(-1)
    own = np.where(usable[..., None], change**2, 0).sum(-1)
    # Neighbors err together: the square counts as one pixel of its mean.
    count = np.maximum(_box_sum(usable.astype(float), _RADIUS), 1)
    prior = (_MISFIT / _STRENGTH_SIGMA) ** 2
    strength = (_box_sum(both, _RADIUS) / count + prior) / (_box_sum(own, _RADIUS) / count + prior)
    return np.clip(strength, 0, 2)
