"""A struck medal of metal in a light tent with one dark side and a softbox. The formulas for dielectrics do not hold for metal."""

import lights
import numpy as np
from geometry import axes, board, fbm, grid_mesh, local, object_mesh, sample_raster, smin, sstep, text_ring
from scipy.ndimage import gaussian_filter


def head(h, X, Y, style):
    """A profile head of overlapping domes (x, y, half axes, height, angle), struck in relief."""
    for cx, cy, a, b, A, t in style["domes"]:
        u, v = local(X, Y, cx, cy, t)
        e = 1 - (u / a) ** 2 - (v / b) ** 2
        h = -smin(-h, -(A * np.sqrt(np.clip(e, 0, None) + 0.01) * (e > 0) - 0.02), 0.08)
    return h


def scene(style, rng, quality):
    step, R = 0.03 / quality, style["radius"]
    x, y, X, Y = axes(R + 0.3, R + 0.3, step)
    r, ph = np.hypot(X, Y), np.arctan2(Y, X)
    h = np.zeros_like(X)
    h = np.maximum(h, 0.55 * sstep(r, R - 1.6, R - 1.1))  # rim
    n, rb = style["beads"], R - 2.3
    f = (((ph + np.pi) / (2 * np.pi) * n) % 1 - 0.5) * 2 * np.pi * rb / n
    h += 0.3 * np.sqrt(np.clip(1 - (f**2 + (r - rb) ** 2) / 0.45**2, 0, None))
    h += 0.28 * sample_raster(text_ring(style["word"], R - 4.4, px_mm=14.0, scale=1.3), X, Y, px_mm=14.0, blur=1.4)
    h = head(h, X, Y, style)
    if style["hair"]:  # engraved locks
        hx, hy, radius, k = style["hair"]
        u = np.hypot(X - hx, Y - hy)
        h -= (
            0.07
            * (1 + np.cos(k * np.arctan2(Y - hy, X - hx) + 1.4 * u))
            * sstep(u, 1.2, 2.2)
            * (1 - sstep(u, radius - 1, radius))
            * (h > 0.4)
        )
    for cx, cy, t in style["leaves"]:
        u, v = local(X, Y, cx, cy, t)
        leaf = np.sqrt(np.clip(1 - (u / 1.7) ** 2 - (v / 0.6) ** 2, 0, None))
        h = np.maximum(h, 0.3 * leaf * (1 - 0.5 * np.exp(-0.5 * (v / 0.08) ** 2)))
    fx, fy, fw, fh = style["field"]
    flat = np.maximum(np.abs(X - fx) - fw - 0.3, np.abs(Y - fy) - fh - 0.3)
    h = gaussian_filter(h, 0.06 / step)
    wear = 0.008 * fbm(X.shape, step, 0.6, 5, rng, 1.1) - 0.05 * np.clip(
        fbm(X.shape, step, 2, 30, rng, 1.3) - 1.3, 0, 1
    )
    scratches = np.zeros_like(h)
    for _ in range(style["scratches"]):
        u, v = local(X, Y, rng.uniform(-R, R), rng.uniform(-R, R), rng.uniform(0, np.pi))
        scratches -= (
            rng.uniform(0.008, 0.02) * np.exp(-0.5 * (v / 0.05) ** 2) * sstep(rng.uniform(2, 6) - np.abs(u), 0, 1)
        )
    h = (h + (wear + scratches) * sstep(flat, 0.1, 0.6)) * sstep(flat, -0.02, 0.25)  # the field stays exactly flat
    T = 2.6
    h = T + h - (T + 0.7) * sstep(r, R - 0.3, R)
    V, N, F, UV = grid_mesh(x, y, h, step, r < R + 0.02)
    lo, hi = style["alpha"]
    alpha = np.clip(
        (lo + hi) / 2 + (hi - lo) / 2 * fbm(X.shape, step, 0.5, 12, rng, 1.2), lo, hi
    )  # worn and patinated areas
    metal = dict(
        type="roughconductor", eta=style["eta"], k=style["k"], alpha=alpha, specular_reflectance=style["reflectance"]
    )
    points = {"P1": (-R - 3.6, -R + 3), "P2": (R + 3.8, -R + 2.4), "P3": (R + 3.5, R - 3)}
    support = board((R * 3.6, R * 2.5), 0.0, rng, 0.5, points.values(), 0.5, gain=0.3)
    dark_az, dark_width, dark = style["dark_side"]

    def tent(d):
        """Uniform tent, open (dark) on one side; the opening has a soft edge; above 65 degrees it is closed."""
        az, el = np.degrees(np.arctan2(d[..., 1], d[..., 0])), np.degrees(np.arcsin(np.clip(d[..., 2], -1, 1)))
        side = 1 - sstep(np.abs((az - dark_az + 180) % 360 - 180), dark_width / 2 - 8, dark_width / 2 + 8)
        return 0.7 * (1 - (1 - dark) * side * (1 - sstep(el, 55, 70)))

    s = lights.direction(*style["softbox"])
    return dict(
        meshes=[
            object_mesh(V, N, F, metal, uv=UV),
            support,
        ],
        lights=[lights.room(tent), lights.softbox(s * 240, (90, 90), 2.5)],
        light_meta=dict(
            kind="light tent (uniform, one dark side) and one softbox 90 x 90 mm",
            tent_radiance=0.7,
            dark_side_azimuth_width_factor=style["dark_side"],
            softbox_centre_world=(s * 240).tolist(),
            softbox_radiance=2.5,
            dir_to_light_world=[s.tolist()],
        ),
        stations=[
            dict(target=[0, 0, T], dist=360, tilt=style["tilt"], roll=style["roll"], focal_mm=360 * 22.3 / (R * 3.15))
        ],
        views=dict(n=8, angle=25, dist=400, focal_mm=400 * 22.3 / (R * 3.5)),
        flat=[dict(name="field", c=[fx, fy], half=[fw, fh])],
        points={k: [*p, 0.0] for k, p in points.items()},
        mvs=dict(keep=0.45, noise=2.2),
        spp=144,
        material=dict(
            bsdf="roughconductor",
            eta=style["eta"],
            k=style["k"],
            roughness_alpha=[lo, hi],
            refractive_index=None,
            metal=style["metal"],
        ),
    )


STYLES = dict(
    dev=dict(
        seed=1100,
        radius=17.0,
        beads=72,
        word="LVDOVICVS * PICTOR * MDXLII * ",
        scratches=14,
        hair=(-0.6, 3.2, 5.0, 9),
        leaves=[],
        domes=[
            (-0.2, 2.0, 4.6, 5.4, 1.15, 0.1),
            (3.6, 0.4, 1.9, 1.0, 0.75, -0.6),
            (3.0, -2.2, 1.5, 1.1, 0.6, 0.3),
            (-1.0, -4.4, 2.6, 2.6, 0.7, 0.9),
            (-2.5, -6.6, 4.6, 1.9, 0.8, 0.15),
        ],
        field=(6.6, 5.2, 1.2, 1.2),
        alpha=(0.1, 0.2),
        eta=0.63,
        k=3.19,
        reflectance=1.0,
        metal="brass at 550 nm",
        dark_side=(200.0, 80.0, 0.06),
        softbox=(55.0, 50.0),
        tilt=(9.0, 7.0),
        roll=1.5,
    )
)
