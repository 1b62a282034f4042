"""A head of uniform albedo under a sun and a weak sky: large slopes, silhouettes, interreflections."""

import lights
import numpy as np
from geometry import board, object_mesh, star_shaped


def bump(d, az, el, sa, se, amplitude):
    """Gaussian in azimuth (from +z towards +x) and elevation, in degrees."""
    a, e = np.degrees(np.arctan2(d[..., 0], d[..., 2])), np.degrees(np.arcsin(np.clip(d[..., 1], -1, 1)))
    return amplitude * np.exp(-0.5 * (((a - az) / sa) ** 2 + ((e - el) / se) ** 2))


def head(d, g, waves, style):
    """Radius in direction d; g = random numbers in -1..1."""
    r = 1 / np.sqrt(((d / np.array([68.0 + 3 * g[0], 92.0 + 4 * g[1], 80.0 + 3 * g[2]])) ** 2).sum(-1))
    e, a = np.degrees(np.arcsin(np.clip(d[..., 1], -1, 1))), np.degrees(np.arctan2(d[..., 0], d[..., 2]))
    r = r + bump(d, 0, -4, 7 + g[3], 13, 19 + 2 * g[4]) + bump(d, 0, -11, 10, 5, 7)  # nose
    for s in (-1, 1):
        r = (
            r
            + bump(d, s * (24 + g[5]), 8, 11, 7, -7)
            + bump(d, s * (24 + g[5]), 7, 6.5, 4.2, 5.2)
            + bump(d, s * 24, 10.6, 7, 1.2, 1.2)
        )  # eye
        r = (
            r
            + bump(d, s * 22, 19, 14, 4, 4 + g[6])
            + bump(d, s * 34, -10, 14, 10, 4 + g[7])
            + bump(d, s * 88, 2, 8, 14, 9)
        )  # brow, cheek, ear
        r = r + bump(d, s * 7, -13, 2.2, 2.2, -2.0)
    r = (
        r
        + bump(d, 0, -23, 13, 2.0, 3.4)
        + bump(d, 0, -28.5, 11, 2.4, 3.6)
        + bump(d, 0, -25.7, 12, 0.9, -2.2)
        + bump(d, 0, -41, 14, 7, 8 + 2 * g[8])
    )  # lips, chin
    hair, k = 1 / (1 + np.exp(-(e - (34 + 4 * g[9]) - 8 * np.cos(np.radians(a))) / 2.0)), style["locks"]
    r = r + hair * (
        5
        + 1.6 * np.sin(k * np.radians(a) + 3 * np.sin(np.radians(e * 6)))
        + 0.5 * np.sin(2.3 * k * np.radians(a) + e * 0.35)
    )
    r = r + style["beard"](a, e) + 60 * np.exp(-0.5 * ((90 + e) / 26.0) ** 2)  # neck
    return (
        r
        + sum(np.sin((d @ v) * 9 + p) for v, p in waves[:8]) * 0.25
        + sum(np.sin((d @ v) * 34 + p) for v, p in waves[8:]) * 0.035
    )


def scene(style, rng, quality):
    g, waves = rng.uniform(-1, 1, 40), [(rng.normal(size=3), rng.uniform(0, 6)) for _ in range(24)]
    V, N, F, _ = star_shaped(lambda d: head(d, g, waves, style), int(640 * quality))
    points = {"P1": (-125.0, -85.0), "P2": (128.0, -84.0), "P3": (124.0, 86.0)}
    s, sky = lights.direction(*style["light"]), 0.04
    return dict(
        meshes=[
            object_mesh(V, N, F, dict(type="pplastic", int_ior=1.5, specular_reflectance=1.0, alpha=0.15), albedo=0.6),
            board((460, 330), -82.0, rng, 3.0, points.values(), 3.0),
        ],
        lights=[lights.directional(s, np.pi), lights.constant(sky)],
        light_meta=dict(
            kind="distant directional + weak constant environment",
            dir_to_light_world=[s.tolist()],
            directional_irradiance=np.pi,
            env_radiance=sky,
        ),
        stations=[dict(target=[0, -4, 10.0], dist=930, tilt=(2.0, -3.0), roll=0.5, focal_mm=60)],
        views=dict(n=12, angle=25, dist=1000, focal_mm=50),
        size=(720, 480),
        view_size=(960, 640),
        spp=144,
        flat=[],
        points={k: [*p, -82.0] for k, p in points.items()},
        mvs=dict(keep=0.55, noise=1.4),
        material=dict(bsdf="pplastic", refractive_index=1.5, roughness_alpha=0.15, diffuse_albedo="0.6 uniform"),
    )


STYLES = dict(dev=dict(seed=1030, locks=13, beard=lambda a, e: 0.0, light=(70, 58)))
