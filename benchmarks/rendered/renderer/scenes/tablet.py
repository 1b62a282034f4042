"""A cuneiform clay tablet: convex, matte, one raking softbox and a weak reflector card; interreflections matter."""

import lights
import numpy as np
from geometry import axes, board, cut_wedge, fbm, flat_square, grid_mesh, object_mesh, smin, sstep
from scipy.ndimage import gaussian_filter


def write_lines(style, rng, det, x, y, X, Y, half):
    """Presses ruled lines of signs into the clay; every sign consists of a few wedges in the style's directions."""
    hx, hy = half
    top, bottom, pitch = style["lines"]
    for line in np.arange(bottom, top, pitch):
        width = hx * np.sqrt(max(0, 1 - abs(line / hy) ** 4)) - style["margin"]
        px = -width
        if style["ruled"]:
            det[:] = np.minimum(
                det, -0.25 * np.exp(-0.5 * ((Y - line - pitch * 0.62) / 0.16) ** 2) * (np.abs(X) < width + 1.5)
            )
        while px < width - 3:
            for _ in range(rng.integers(2, 6)):  # one sign
                a = rng.choice(style["directions"]) + rng.normal(0, 0.08)
                L = rng.uniform(2.4, 4.6)
                cut_wedge(
                    det,
                    x,
                    y,
                    X,
                    Y,
                    px + rng.uniform(-0.4, 2.6),
                    line + rng.uniform(-1, 1) * pitch * 0.26,
                    a,
                    L,
                    rng.uniform(1.1, 2.2),
                    rng.uniform(*style["depths"]),
                )
            px += rng.uniform(3.4, 5.4)


def scene(style, rng, quality):
    step, (hx, hy), T = 0.05 / quality, style["half_size"], style["thickness"]
    x, y, X, Y = axes(hx + 0.5, hy + 0.5, step)
    p = style["corner"]
    e = (np.abs(X / hx) ** p + np.abs(Y / hy) ** p) ** (1 / p)  # rounded outline: 1 on the edge
    keep = e < 0.998
    pillow = T * np.clip(1 - np.clip(e, 0, 1) ** style["steepness"], 0, None) ** 0.55
    z = (
        pillow
        + style["bulge"] * (1 - (X / hx) ** 2 * 0.6 - (Y / hy) ** 2 * 0.6)
        + 0.35 * fbm(X.shape, step, 12, 80, rng, 1.6) * sstep(1 - e, 0, 0.2)
    )
    det = np.zeros_like(z)
    write_lines(style, rng, det, x, y, X, Y, (hx, hy))
    det = gaussian_filter(det, 0.09 / step)
    rims = 0.12 * np.clip(det - gaussian_filter(det, 0.45 / step), 0, None)  # clay pushed up beside the wedges
    worn = sstep(fbm(X.shape, step, 8, 60, rng, 1.4), style["wear"], style["wear"] + 0.8)
    z = z + (det + rims) * (1 - 0.8 * worn) * sstep(1 - e, 0.02, 0.1)
    z += (
        0.025 * fbm(X.shape, step, 0.25, 2.5, rng, 1.0)
        + 0.02 * np.minimum(0, fbm(X.shape, step, 0.6, 3, rng, 0.8) + 1.2) * 3
    )
    for k in range(style["cracks"]):
        u = (
            X * np.cos(k * 1.9 + style["seed"])
            + Y * np.sin(k * 1.9 + style["seed"])
            + 1.8 * fbm(X.shape, step, 2, 40, rng, 1.5)
            - rng.uniform(-0.5, 0.5) * hx
        )
        z -= 0.5 * np.exp(-0.5 * (u / 0.12) ** 2) * sstep(fbm(X.shape, step, 15, 80, rng), -0.2, 0.4)
    flats = []
    for cx, cy, gx, gy, cut in style["facets"]:  # planar breaks
        i, j = np.searchsorted(y, cy), np.searchsorted(x, cx)
        plane = (
            gaussian_filter(z[max(i - 40, 0) : i + 40, max(j - 40, 0) : j + 40], 15)[
                40 if i >= 40 else i, 40 if j >= 40 else j
            ]
            - cut
            + gx * (X - cx)
            + gy * (Y - cy)
        )
        z = smin(z, plane, 0.25)
        flats.append(flat_square(z, plane, X, Y, step, "break"))
    z = np.where(keep, z, z - 1.0)
    alb = np.clip(
        0.36 + 0.05 * fbm(X.shape, step, 1, 25, rng, 1.0) + 0.02 * fbm(X.shape, step, 0.3, 1.5, rng, 0.5), 0.08, 0.7
    )
    alb *= 1 - 0.35 * sstep(fbm(X.shape, step, 10, 80, rng, 1.4), 0.8, 1.8)  # burnt patch
    V, N, F, UV = grid_mesh(x, y, z, step, keep)
    points = {"P1": (-hx - 7, -hy * 0.8), "P2": (hx + 7.5, -hy * 0.82), "P3": (hx + 7, hy * 0.8)}
    support = board((max(hx, hy) * 3.4,) * 2, 0.0, rng, 0.9, points.values(), 0.9, gain=0.5)
    az, el = style["softbox"]
    s = lights.direction(az, el)
    c = lights.direction(az + 180 + style["card_turn"], 16.0) * 150
    return dict(
        meshes=[
            object_mesh(
                V,
                N,
                F,
                dict(type="pplastic", int_ior=1.5, alpha=style["alpha"], specular_reflectance=style["gloss"]),
                uv=UV,
                tex=alb.astype(np.float32),
            ),
            support,
        ],
        lights=[
            lights.softbox(s * 380, (130, 130), 12.0, target=(0, 0, T / 2), up=(0, 0, 1)),
            lights.card(c, (170, 90), 0.75, target=(0, 0, 5)),
            lights.constant(style["ambient"]),
        ],
        light_meta=dict(
            kind="one raking softbox 130 x 130 mm, a white reflector card 170 x 90 mm, dim room",
            softbox_centre_world=(s * 380).tolist(),
            softbox_radiance=12.0,
            card_centre_world=c.tolist(),
            card_albedo=0.75,
            env_radiance=style["ambient"],
            dir_to_light_world=[s.tolist()],
        ),
        stations=[
            dict(
                target=[0, 0, T * 0.8],
                dist=480,
                tilt=style["tilt"],
                roll=style["roll"],
                focal_mm=480 * 22.3 / style["field"],
            )
        ],
        views=dict(n=8, angle=25, dist=520, focal_mm=520 * 22.3 / (style["field"] * 1.15)),
        flat=flats,
        points={k: [*q, 0.0] for k, q in points.items()},
        mvs=dict(keep=0.93, noise=0.9),
        depth=6,
        view_depth=4,
        spp=144,
        material=dict(
            bsdf="pplastic",
            refractive_index=1.5,
            roughness_alpha=style["alpha"],
            specular_reflectance=style["gloss"],
            diffuse_albedo="clay 0.36, burnt patches",
        ),
    )


STYLES = dict(
    dev=dict(
        seed=1130,
        half_size=(34.0, 26.0),
        field=88.0,
        thickness=14.0,
        bulge=3.0,
        corner=4.0,
        steepness=4.0,
        lines=(22.0, -20.0, 6.2),
        margin=3.5,
        ruled=True,
        directions=[0.0, -np.pi / 2, -np.pi / 4],
        depths=(0.5, 1.6),
        wear=0.9,
        cracks=1,
        facets=[(24.0, 17.0, -0.35, -0.25, 1.0)],
        alpha=0.5,
        gloss=0.5,
        softbox=(120.0, 24.0),
        card_turn=10.0,
        ambient=0.03,
        tilt=(4.0, -6.0),
        roll=0.7,
    )
)
