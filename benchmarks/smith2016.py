"""Height from polarization alone, compared with the linear system of Smith, Ramamoorthi and Tozza 2016.

    python benchmarks/smith2016.py [DATA.npz …]

Without files: a sphere (zenith to 60°) and a bumpy surface (to 40°), 256², six angles, refractive index 1.5, albedo 1, Gaussian
noise of 0 and 0.5 %, light 15.9° off axis; and the sphere with noise and the light 30° off axis. A file has images (H, W, K), angles [rad],
mask, light (x right, y up, z to the viewer), normal (same axes). Printed: mean normal error in degrees by central differences. `likelihood`
is the default, `linear` and `literal` are the linear system, `literal` as printed in the paper; `no light` is the default with the light
estimated from the polarization, for a convex object.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import malus

SIZE, ETA = 256, 1.5
#: Columns of the table.
COLUMNS = ("likelihood", "linear", "literal", "no light")
Data = dict[str, Any]


def sphere() -> tuple[np.ndarray, np.ndarray]:
    radius = SIZE / 2 - 2
    v, u = np.mgrid[:SIZE, :SIZE]
    x, y = u - (SIZE - 1) / 2, (SIZE - 1) / 2 - v
    z = np.sqrt(np.maximum(radius**2 - x**2 - y**2, 0))
    return z, z > radius / 2


def bumps() -> tuple[np.ndarray, np.ndarray]:
    v, u = np.mgrid[:SIZE, :SIZE]
    k = 4 * np.pi / SIZE
    z = 0.35 / k * (np.sin(k * u) + np.cos(0.8 * k * v) + 0.6 * np.sin(0.7 * k * (u + v)))
    mask = np.zeros((SIZE, SIZE), bool)
    mask[4:-4, 4:-4] = True
    return z, mask


def imaged(surface: tuple[np.ndarray, np.ndarray], noise: float, off_axis_deg: float = 15.9) -> Data:
    """Images of the surface through a polarizer, with the light `off_axis_deg` to the right; axes x right, y up, z to the viewer."""
    z, mask = surface
    down, right = np.gradient(z)
    normal = np.stack([-right, down, np.ones_like(z)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    if mask.sum() < 0.9 * mask.size:  # the sphere's own normals, exact to its border
        radius = SIZE / 2 - 2
        v, u = np.mgrid[:SIZE, :SIZE]
        normal = np.stack([u - (SIZE - 1) / 2, (SIZE - 1) / 2 - v, z], -1) / radius
    light = np.array([np.sin(np.radians(off_axis_deg)), 0.0, np.cos(np.radians(off_axis_deg))])
    shading = np.maximum(normal @ light, 0.02)
    zenith = np.arccos(np.clip(normal[..., 2], -1, 1))
    degree = malus.polarization.diffuse_degree(zenith, ETA)
    azimuth = np.arctan2(normal[..., 1], normal[..., 0])
    angles = np.radians(np.arange(0, 180, 30))
    images = shading[..., None] * (1 + degree[..., None] * np.cos(2 * (angles - azimuth[..., None])))
    images += np.random.default_rng(5).normal(0, noise, images.shape)
    return {"images": images, "angles": angles, "mask": mask, "light": light, "normal": normal}


def normal_error_deg(height: np.ndarray, normal: np.ndarray, mask: np.ndarray) -> float:
    """Mean normal error over the pixels whose four neighbors are on the object."""
    inner = mask.copy()
    inner[1:-1, 1:-1] &= mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    down, right = np.gradient(height)
    found = np.stack([-right, down, np.ones_like(height)], -1)
    found /= np.linalg.norm(found, axis=-1, keepdims=True)
    return float(np.degrees(np.arccos(np.clip((found * normal).sum(-1), -1, 1)))[inner].mean())


def errors(data: Data, columns: Sequence[str] = COLUMNS) -> dict[str, float]:
    """Mean normal error for each of these columns of the table."""
    mask = data["mask"].astype(bool)
    images = [data["images"][..., k] for k in range(data["images"].shape[-1])]
    state = malus.polarization.decompose(images, list(data["angles"]), mask=mask)
    reflection = malus.polarization.map_reflection(state, reflection="diffuse")
    x, y, z = data["light"]
    result = {}
    for name in columns:
        method, light = ("likelihood", None) if name == "no light" else (name, [x, -y, -z, 0.0])
        options = malus.Options(height={"perspective": False, "method": method}, light={"without_prior": "convex"})
        height = malus.height.solve(state, reflection, light=light, options=options, threads=2).height
        result[name] = normal_error_deg(height.astype(float), data["normal"], mask)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, metavar="DATA.npz")
    args = parser.parse_args()
    cases: dict[str, Data] = {path.stem: dict(np.load(path)) for path in args.files}
    if not cases:
        for name, surface in (("sphere", sphere()), ("bumpy", bumps())):
            cases |= {f"{name}, {100 * noise:g} % noise": imaged(surface, noise) for noise in (0.0, 0.005)}
        cases["sphere, light 30° off axis, 0.5 % noise"] = imaged(sphere(), 0.005, 30)
    print("| surface | " + " | ".join(COLUMNS) + " |" + "\n|---|---|---|---|---|")
    for name, data in cases.items():
        print(f"| {name} | " + " | ".join(f"{error:.2f}°" for error in errors(data).values()) + " |", flush=True)


if __name__ == "__main__":
    main()
