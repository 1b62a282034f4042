"""Round objects on a board, of kinds that no other scene contains: ball, orange, hedgehog, vase with black and white paint, metal
kettle, shell. Each has a file with its name in this folder. The seed determines shape and color.
"""

import lights
import numpy as np
from geometry import board, object_mesh, star_shaped


def waves(rng, count, k):
    """Sum of waves in random directions, with variance 1; k: approximate wave number per radius (rad)."""
    v = rng.normal(size=(count, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    k = k * np.exp(rng.uniform(-0.4, 0.4, count))
    p = rng.uniform(0, 6.3, count)
    return lambda d: sum(np.sin((d @ (v[i] * k[i])) + p[i]) for i in range(count)) / np.sqrt(count / 2)


def shape_of(kind, rng):
    """Functions of the direction for radius [mm] and albedo; for a kettle also its metal, else None."""
    R = 45.0
    big, fine = waves(rng, 8, 3.0), waves(rng, 24, 28.0)
    metal, albedo = None, lambda d: np.full(len(d), float(rng.uniform(0.25, 0.8)))
    if kind == "ball":
        radius = lambda d: R + 0 * d[..., 0]
    elif kind == "orange":
        dimples = waves(rng, 40, 40.0)
        radius = lambda d: (
            R / np.sqrt(d[..., 0] ** 2 + d[..., 1] ** 2 + 1.15 * d[..., 2] ** 2)
            + 0.5 * big(d)
            + 0.12 * np.minimum(dimples(d), 0.6)
        )
        a = rng.uniform(0.3, 0.6)
        albedo = lambda d: np.clip(a + 0.03 * fine(d), 0.1, 0.9)
    elif kind == "hedgehog":
        bumps = waves(rng, 30, 16.0)
        radius = lambda d: R * 0.9 + 2.0 * big(d) + 2.2 * np.clip(bumps(d), -0.3, 2) ** 2 * 0.5
    elif kind == "vase":
        n = int(rng.integers(9, 20))
        depth = rng.uniform(0.2, 1.0)
        radius = lambda d: (
            R * (1 + 0.12 * np.cos(5 * np.arcsin(np.clip(d[..., 1], -1, 1))))
            + depth * np.cos(n * np.arctan2(d[..., 0], d[..., 2])) * np.sqrt(np.clip(1 - d[..., 1] ** 2, 0, 1))
        )
        paint = waves(rng, 12, 9.0)
        albedo = lambda d: np.where(paint(d) > 0.15, 0.04, 0.6)
    elif kind == "kettle":
        m = [(0.25, 3.4), (2.9, 3.1), (1.3, 7.5)][int(rng.integers(3))]
        metal = dict(type="roughconductor", eta=m[0], k=m[1], alpha=float(rng.uniform(0.06, 0.25)))
        radius = lambda d: R / np.sqrt(d[..., 0] ** 2 + 1.3 * d[..., 1] ** 2 + d[..., 2] ** 2) + 0.8 * big(d)
    elif kind == "shell":
        n = int(rng.integers(14, 30))
        spot = waves(rng, 16, 14.0)
        radius = lambda d: (
            R * 0.95
            + 1.5 * big(d)
            + 0.7 * np.abs(np.sin(n / 2 * np.arctan2(d[..., 1] + 0.3 * d[..., 0], d[..., 2] + 0.4))) ** 0.7
        )
        albedo = lambda d: np.clip(0.55 + 0.2 * np.tanh(3 * spot(d)), 0.05, 0.9)
    return radius, albedo, metal


def scene_of(kind):
    def scene(style, rng, quality):
        radius, albedo, metal = shape_of(kind, rng)
        V, N, F, D = star_shaped(radius, int(640 * quality))
        points = {"P1": (-62.0, -44.0), "P2": (63.0, -43.0), "P3": (61.0, 44.0)}
        ramp = np.tile((np.arange(128) + 0.5) / 128, (4, 1)).astype(np.float32)
        a = np.clip(albedo(D), 0.01, 0.95)
        bsdf = metal or dict(type="pplastic", int_ior=1.5, specular_reflectance=1.0, alpha=0.15)
        mesh = object_mesh(V, N, F, bsdf, uv=np.stack([a, np.full_like(a, 0.5)], 1), tex=None if metal else ramp)
        s = lights.direction(60, 50)
        return dict(
            meshes=[mesh, board((230, 165), -40.0, rng, 1.5, points.values(), 1.5)],
            lights=[lights.directional(s, np.pi), lights.constant(0.04)],
            light_meta=dict(kind="sun", dir_to_light_world=[s.tolist()]),
            stations=[dict(target=[0, 0, 5.0], dist=465, tilt=(2.0, -3.0), roll=0.5, focal_mm=465 * 22.3 / 150)],
            views=dict(n=8, angle=25, dist=500, focal_mm=500 * 22.3 / 165),
            size=(600, 400),
            view_size=(600, 400),
            spp=144,
            flat=[],
            points={k: [*p, -40.0] for k, p in points.items()},
            mvs=dict(keep=0.55, noise=1.4),
            material=dict(
                bsdf=bsdf["type"],
                refractive_index=None if metal else 1.5,
                roughness_alpha=bsdf["alpha"],
                diffuse_albedo="see scene",
            ),
        )

    return scene


STYLES = dict(dev=dict(seed=2000))
