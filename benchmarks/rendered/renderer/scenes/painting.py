"""A varnished panel painting on a copy stand: a slight warp, impasto 0.05-0.4 mm, craquelure, two softboxes at 45 degrees."""

import lights
import numpy as np
from geometry import axes, board, dot_target, fbm, grid_mesh, local, object_mesh, sstep, window
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree


def ground(X, Y, rng):
    """Underpainting of the dev panel: sky, hill, field."""
    t = sstep(Y - 6 * np.sin(X / 17), -6, 4)
    return 0.18 + 0.4 * t + 0.04 * np.sin(X / 9)


def paint(style, rng, h, alb, x, y, X, Y):
    """Overlapping brush strokes; each has bristle furrows, raised edges and a paint color."""
    for _ in range(style["strokes"]):
        L, w, A = (
            rng.uniform(*style["lengths"]),
            rng.uniform(*style["widths"]),
            rng.uniform(0.05, 0.4) * rng.uniform(0.5, 1),
        )
        cx, cy = rng.uniform(x[0], x[-1]), rng.uniform(y[0], y[-1])
        angle = style["flow"](cx, cy) + rng.normal(0, 0.25)
        win = window(x, y, cx, cy, L / 2 + w)
        if win is None:
            continue
        u, v = local(X[win], Y[win], cx, cy, angle)
        v = v - rng.uniform(-0.012, 0.012) * u**2
        line = gaussian_filter(rng.standard_normal(256), 1.4)
        bristles = np.interp(v, np.linspace(-w, w, 256), line / line.std()) * 0.22
        inside = sstep(w / 2 * (1 - 0.3 * (2 * u / L) ** 4) - np.abs(v), 0, 0.35) * sstep(
            L / 2 - np.abs(u) + 6 * bristles - 0.8, 0, 1.4
        )  # ragged ends
        edge = 0.55 * np.exp(-0.5 * ((np.abs(v) - w / 2 + 0.5) / 0.3) ** 2) + 0.8 * np.exp(
            -0.5 * ((u - L / 2 + 1.0) / 0.7) ** 2
        )
        body = A * np.clip(0.45 + bristles * (1 - 0.4 * sstep(u, -L / 2, L / 2)) + edge, 0.05, 1.6)
        h[win] = h[win] * (1 - 0.75 * inside) + inside * body
        color = np.clip(style["palette"](cx, cy, rng), 0.03, 0.8)
        alb[win] = alb[win] * (1 - 0.92 * inside) + 0.92 * inside * color * (1 + 0.12 * bristles)


def scene(style, rng, quality):
    step, (hx, hy) = 0.08 / quality, style["half_size"]
    x, y, X, Y = axes(hx, hy, step)
    warp = (
        style["warp"] * (X / hx) ** 2
        + style["twist"] * (X / hx) * (Y / hy)
        + 0.12 * fbm(X.shape, step, 40, 200, rng, 1.6)
    )
    h, alb = np.zeros_like(X), style["ground"](X, Y, rng)
    h += 0.03 * fbm(X.shape, step, 0.5, 1.2, rng, 0.6)  # canvas and ground
    paint(style, rng, h, alb, x, y, X, Y)
    n = int(4 * hx * hy / style["crack_cell"] ** 2)  # craquelure: cell borders
    seeds = np.stack([rng.uniform(-hx, hx, n), rng.uniform(-hy, hy, n)], 1)
    qx, qy = X + 0.5 * fbm(X.shape, step, 1.5, 12, rng, 1.4), Y + 0.5 * fbm(X.shape, step, 1.5, 12, rng, 1.4)
    d = cKDTree(seeds).query(np.stack([qx.ravel(), qy.ravel()], 1).astype(np.float32), k=2)[0]
    border = (d[:, 1] - d[:, 0]).reshape(X.shape)
    cracked = sstep(fbm(X.shape, step, 20, 120, rng, 1.4), -0.9, 0.1)
    crack = np.exp(-0.5 * (border / 0.16) ** 2) * cracked
    h = (
        h - 0.06 * crack + style["cupping"] * np.clip(border / style["crack_cell"] - 0.25, None, 0) * -cracked
    )  # islands cup upwards at their rims
    alb *= 1 - 0.55 * crack
    losses = sstep(
        fbm(X.shape, step, 3, 40, rng, 1.5), style["losses"], style["losses"] + 0.1
    )  # lost paint: bare ground
    h, alb = h * (1 - losses) - 0.12 * losses, alb * (1 - losses) + 0.55 * losses
    z = gaussian_filter(h, 0.06 / step) + warp
    cx, cy, cw, ch = style["card"]  # a pasted label, exactly flat
    D = np.maximum(np.abs(X - cx) - cw, np.abs(Y - cy) - ch)
    i, j = np.searchsorted(y, cy), np.searchsorted(x, cx)
    plane = (
        warp[i, j]
        + 0.55
        + (warp[i, j + 20] - warp[i, j - 20]) / (40 * step) * (X - cx)
        + (warp[i + 20, j] - warp[i - 20, j]) / (40 * step) * (Y - cy)
    )
    z = np.where(D < 0, plane, z + (plane - z) * (1 - sstep(D, 0, 0.4)))
    alb = np.where(D < 0.2, 0.5 + 0.01 * fbm(X.shape, step, 0.3, 2, rng, 0.5), alb)
    points = {"P1": (-hx + 4, -hy + 4), "P2": (hx - 4, -hy + 4.5), "P3": (hx - 4, hy - 4)}
    for p in points.values():
        dot_target(alb, X, Y, p, 1.0)
    alb = np.clip(gaussian_filter(alb, 0.06 / step), 0.025, 0.85)
    V, N, F, UV = grid_mesh(x, y, z, step)
    support = board((hx * 3, hy * 3), -4.0, rng, 1.2, [], 1.0, gain=0.5)
    boxes, (size, distance) = [], style["softboxes"]
    for az, power in style["sides"]:
        c = lights.direction(az, 45.0) * distance
        boxes.append((c, power))
    at = lambda p: [*p, float(z[np.searchsorted(y, p[1]), np.searchsorted(x, p[0])])]
    return dict(
        meshes=[
            object_mesh(
                V,
                N,
                F,
                dict(type="pplastic", int_ior=1.5, alpha=style["alpha"], specular_reflectance=1.0),
                uv=UV,
                tex=alb.astype(np.float32),
            ),
            support,
        ],
        lights=[lights.softbox(c, (size, size), power) for c, power in boxes] + [lights.constant(style["ambient"])],
        light_meta=dict(
            kind=f"two softboxes {size} x {size} mm left and right at 45 degrees, dim room",
            softbox_centres_world=[c.tolist() for c, _ in boxes],
            softbox_radiances=[p for _, p in boxes],
            env_radiance=style["ambient"],
            dir_to_light_world=[(c / np.linalg.norm(c)).tolist() for c, _ in boxes],
        ),
        stations=[
            dict(target=[0, 0, 0.0], dist=650, tilt=style["tilt"], roll=style["roll"], focal_mm=650 * 22.3 / (hx * 2.2))
        ],
        views=dict(n=8, angle=24, dist=700, focal_mm=700 * 22.3 / (hx * 2.6)),
        flat=[dict(name="label", c=[cx, cy], half=[cw - 0.4, ch - 0.4])],
        points={k: at(p) for k, p in points.items()},
        mvs=dict(keep=0.95, noise=0.8),
        spp=144,
        material=dict(
            bsdf="pplastic",
            refractive_index=1.5,
            roughness_alpha=style["alpha"],
            diffuse_albedo="paint 0.03-0.8 under varnish",
        ),
    )


STYLES = dict(
    dev=dict(
        seed=1140,
        half_size=(60.0, 41.0),
        warp=0.8,
        twist=0.3,
        strokes=420,
        lengths=(9.0, 26.0),
        widths=(2.5, 6.0),
        crack_cell=5.0,
        cupping=0.05,
        losses=2.2,
        flow=lambda x, y: 0.25 * np.sin(x / 20) + (1.1 if y < -8 else 0),
        palette=lambda x, y, rng: (0.5 if y > 0 else 0.16) * np.exp(rng.normal(0, 0.5)),
        ground=ground,
        card=(38.0, -27.0, 7.0, 4.5),
        alpha=0.08,
        softboxes=(260.0, 520.0),
        sides=[(180.0, 7.0), (0.0, 6.0)],
        ambient=0.04,
        tilt=(3.0, 2.0),
        roll=0.5,
    )
)
