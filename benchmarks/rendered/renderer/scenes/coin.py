"""A black-lacquered coin under a sky and a softbox."""

import lights
import numpy as np
from geometry import axes, board, fbm, grid_mesh, local, object_mesh, sample_raster, sstep, text_ring
from scipy.ndimage import gaussian_filter

LACQUER = dict(type="pplastic", int_ior=1.5, specular_reflectance=1.0, alpha=0.05)


def bull(h, X, Y):
    """A bull-ish body: union of domes (x, y, half axes, height, angle)."""
    for cx, cy, a, b, A, t in (
        (-1, -2.2, 3.6, 1.7, 0.24, 0.2),
        (-4.6, -0.6, 1.3, 1.0, 0.2, -0.5),
        (-2.8, -4.6, 0.5, 1.6, 0.13, 0),
        (1.2, -4.5, 0.5, 1.6, 0.13, 0.1),
        (2.6, -1.0, 0.4, 1.8, 0.11, -0.7),
        (-5.2, 0.9, 0.28, 0.9, 0.12, 0.5),
    ):
        u, v = local(X, Y, cx, cy, t)
        e = np.clip(1 - (u / a) ** 2 - (v / b) ** 2, 0, None)
        h = np.maximum(h, A * np.sqrt(e + 0.02) * (e > 0) - 0.02)
    return h


def scene(style, rng, quality, material=LACQUER):
    step, R = 0.015 / quality, style["radius"]
    x, _, X, Y = axes(R + 0.3, R + 0.3, step)
    r, ph = np.hypot(X, Y), np.arctan2(Y, X)
    h = 0.28 * sstep(r, R - 1.5, R - 1.25)  # rim
    n = style["beads"]
    along = (((ph + np.pi) / (2 * np.pi) * n) % 1 - 0.5) * 2 * np.pi * (R - 2.05) / n
    h += 0.16 * np.sqrt(np.clip(1 - (along**2 + (r - (R - 2.05)) ** 2) / 0.3**2, 0, None))
    h += 0.17 * sample_raster(text_ring(style["word"], R - 3.5), X, Y)
    h = style["emblem"](h, X, Y)
    fx, fy = style["field"]
    flat = np.maximum(np.abs(X - fx) - 1.9, np.abs(Y - fy) - 0.95)
    wear = 0.006 * fbm(X.shape, step, 0.5, 3, rng, 1.0)
    h = gaussian_filter(h, 0.05 / step) + wear * sstep(flat, 0.1, 0.8) * (r < R - 0.2)
    h = h * sstep(flat, -0.02, 0.15)  # the field is exactly flat
    T = 1.8
    h = T + h - (T + 0.5) * sstep(r, R - 0.22, R)
    V, N, F, UV = grid_mesh(x, x, h, step, r < R + 0.02)
    lacquer = material["type"] == "pplastic"
    albedo = np.clip(0.03 * (1 + 0.15 * fbm(X.shape, step, 0.3, 4, rng, 1.0)), 0.005, 0.2).astype(np.float32)
    points = {"P1": (-15.5, -11.0), "P2": (16.0, -11.5), "P3": (15.5, 11.0)}
    support = board((56, 40), 0.0, rng, 0.35, points.values(), 0.35, gain=0.25)
    s = lights.direction(*style["light"])
    return dict(
        meshes=[
            object_mesh(V, N, F, material, uv=UV, tex=albedo if lacquer else None),
            support,
        ],
        lights=[lights.constant(0.6), lights.softbox(s * 260, (130, 130), 1.6)],
        light_meta=dict(
            kind="constant environment + one softbox (130x130 mm area light facing the origin)",
            softbox_centre_world=(s * 260).tolist(),
            dir_to_light_world=[s.tolist()],
            softbox_radiance=1.6,
            env_radiance=0.6,
        ),
        stations=[dict(target=[0, 0, T], dist=300, tilt=style["tilt"], roll=-2, focal_mm=153.0)],
        views=dict(n=12, angle=25, dist=330, focal_mm=130.0),
        size=(720, 480),
        view_size=(960, 640),
        spp=180,
        flat=[dict(name="field", c=[fx, fy], half=[1.6, 0.7])],
        points={k: [*p, 0.0] for k, p in points.items()},
        mvs=dict(keep=0.3, noise=2.0),
        material=dict(
            bsdf=material["type"],
            refractive_index=material.get("int_ior"),
            roughness_alpha=material["alpha"],
            eta=material.get("eta"),
            k=material.get("k"),
            diffuse_albedo="~0.03 (black lacquer)" if lacquer else "0 (conductor)",
        ),
    )


STYLES = dict(
    dev=dict(
        seed=1010,
        radius=13.0,
        beads=64,
        word="DARIVS * REX * PERSARVM * ",
        emblem=bull,
        field=(2.6, 4.6),
        light=(60, 48),
        tilt=(11.0, 6.0),
    )
)
