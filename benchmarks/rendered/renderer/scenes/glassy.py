"""Black glass with facets and engraved rings under an overcast sky: no texture, so that stereo fails."""

import lights
import numpy as np
from geometry import axes, board, flat_square, grid_mesh, object_mesh, smin, sstep
from scipy.ndimage import gaussian_filter


def rings(X, Y):
    return -0.14 * np.exp(-0.5 * (((np.hypot(X - 5, Y + 3) % 7.0) - 3.5) / 0.5) ** 2)


def scene(style, rng, quality):
    step = 0.06 / quality
    x, y, X, Y = axes(54, 48, step)
    H, a, b, power = style["dome"]
    dome = H * (1 - ((X / a) ** 2 + (Y / b) ** 2) ** power)
    az0, z, flat, flats = rng.uniform(0, 360), dome.copy(), np.zeros_like(X), []
    facets = [("flat", az0, rng.uniform(20, 26), 4.6)]
    facets += [
        ("curved", az0 + 72 * k + rng.uniform(-8, 8), rng.uniform(18, 38), rng.uniform(2.5, 4)) for k in range(1, 5)
    ]
    if style["second_flat"]:
        facets[2] = ("flat2", facets[2][1], *style["second_flat"])
    planes = []
    for kind, az, zenith, cut in facets:
        t = np.tan(np.radians(zenith))
        gx, gy = t * np.cos(np.radians(az)), t * np.sin(np.radians(az))
        g = dome + gx * X + gy * Y
        i, j = np.unravel_index(np.argmax(g), g.shape)
        plane = g[i, j] - cut - gx * X - gy * Y
        if kind == "curved":
            plane = plane - ((X - X[i, j]) ** 2 * 0.6 + (Y - Y[i, j]) ** 2) / (2 * rng.uniform(110, 220))
        else:
            planes.append((kind, plane))
            flat = np.maximum(flat, sstep(dome - plane, -2.5, -0.8))
        z = smin(z, plane, 1.6)
    flats = [flat_square(z, plane, X, Y, step, kind) for kind, plane in planes]
    z = z + gaussian_filter(style["engraving"](X, Y), 0.15 / step) * (1 - flat) * sstep(z, 4, 8)
    V, N, F, _ = grid_mesh(x, y, z, step, z > -0.4)
    points = {"P1": (-64.0, -44.0), "P2": (66.0, -45.0), "P3": (63.0, 44.0)}
    return dict(
        meshes=[
            object_mesh(
                V, N, F, dict(type="pplastic", int_ior=1.5, specular_reflectance=1.0, alpha=0.015), albedo=0.012
            ),
            board((220, 160), 0.0, rng, 1.3, points.values(), 1.3, gain=0.25),
        ],
        lights=[lights.constant(1.0), lights.directional([0, 0, 1.0], 1e-9)],
        light_meta=dict(
            kind="unpolarized constant environment only (cloudy sky)", dir_to_light_world=[], env_radiance=1.0
        ),
        stations=[dict(target=[0, 0, 12.0], dist=430, tilt=style["tilt"], roll=0.8, focal_mm=60)],
        views=dict(n=12, angle=25, dist=470, focal_mm=50),
        size=(720, 480),
        view_size=(960, 640),
        spp=180,
        flat=flats,
        points={k: [*p, 0.0] for k, p in points.items()},
        mvs=dict(keep=0.04, noise=6.0),
        material=dict(
            bsdf="pplastic", refractive_index=1.5, roughness_alpha=0.015, diffuse_albedo="0.012 (black glass)"
        ),
    )


STYLES = dict(dev=dict(seed=1020, dome=(30.0, 50.0, 44.0, 1.0), second_flat=None, engraving=rings, tilt=(3.0, 2.0)))
