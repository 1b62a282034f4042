"""A carved, textured stone relief with a flat label, under a sun and a weak sky."""

import lights
import numpy as np
from geometry import axes, cut_wedge, dot_target, fbm, grid_mesh, object_mesh, sstep
from scipy.ndimage import gaussian_filter


def rosette(det, X, Y):
    r, ph = np.hypot(X + 60, Y - 42), np.arctan2(Y - 42, X + 60)
    det = np.minimum(det, -0.6 * np.exp(-0.5 * ((r - (17 + 4 * np.cos(8 * ph))) / 0.45) ** 2))
    det = np.minimum(det, -0.45 * np.exp(-0.5 * ((r - 7) / 0.4) ** 2))
    return det + np.where(r < 17, 0.5 * np.cos(8 * ph) * sstep(r, 8, 11) * (1 - sstep(r, 13, 16)), 0)


def scene(style, rng, quality):
    step = 0.1 / quality
    x, y, X, Y = axes(118, 82, step)
    shape, z = X.shape, np.zeros_like(X)
    for A, sx, sy in ((30, 62, 48), (9, 28, 24), (-6, 30, 26)):  # bulges of about 3 cm and folds
        cx, cy = rng.uniform(-45, 45), rng.uniform(-25, 25)
        z += A * np.exp(-0.5 * (((X - cx) / sx) ** 2 + ((Y - cy) / sy) ** 2))
    th = rng.uniform(*style["fold_angle"])
    u, period = X * np.cos(th) + Y * np.sin(th) + 6 * np.sin(Y / rng.uniform(18, 26) + X / 40), rng.uniform(28, 38)
    fold = 2.2 * (np.sin(2 * np.pi * u / period) + 0.35 * np.sin(4 * np.pi * u / period + 1))
    z += fold * sstep(fbm(shape, step, 60, 400, rng), -0.6, 0.6)
    lx, ly, lw, lh = (
        rng.uniform(*style["label_x"]),
        rng.uniform(*style["label_y"]),
        44,
        26,
    )  # the ground is flattened about the label
    D = np.maximum(np.abs(X - lx) - lw / 2, np.abs(Y - ly) - lh / 2)
    i, j = int((ly - y[0]) / step), int((lx - x[0]) / step)
    gy, gx = np.gradient(gaussian_filter(z, 6 / step)[i - 2 : i + 3, j - 2 : j + 3], step)
    plane = z[i, j] + (gx[2, 2] * 0.6 + 0.06) * (X - lx) + (gy[2, 2] * 0.6 - 0.04) * (Y - ly)
    z = z + (plane - z) * (1 - sstep(D, 0, 16))
    det = np.zeros_like(z)
    x0, x1, y0, y1 = style["text"]  # rows of wedges
    for row in np.arange(y0, y1, 11.5):
        px = x0
        while px < x1:
            a = rng.choice([0, -np.pi / 2, -np.pi / 4, np.pi + np.pi / 4]) + rng.normal(0, 0.07)
            cut_wedge(
                det,
                x,
                y,
                X,
                Y,
                px,
                row + rng.uniform(-2, 2),
                a,
                rng.uniform(5, 9),
                rng.uniform(2.4, 4),
                rng.uniform(0.4, 1.0),
            )
            if rng.random() < 0.6:
                cut_wedge(
                    det,
                    x,
                    y,
                    X,
                    Y,
                    px + rng.uniform(-1, 2),
                    row + rng.uniform(1.5, 4),
                    a,
                    rng.uniform(4, 6),
                    rng.uniform(2, 3),
                    rng.uniform(0.3, 0.7),
                )
            px += rng.uniform(4.5, 8)
        if style["ruled"]:
            det = np.minimum(
                det, -0.35 * np.exp(-0.5 * ((Y - (row + 8.6)) / 0.28) ** 2) * ((X > x0 - 3) & (X < x1 + 3))
            )
    det = style["ornament"](det, X, Y)
    for _ in range(4):  # engraved lines
        yy, s = (
            rng.uniform(-60, 60) + rng.uniform(3, 9) * np.sin(X / rng.uniform(9, 22) + rng.uniform(0, 6)),
            rng.uniform(0.25, 0.5),
        )
        det = np.minimum(
            det,
            -rng.uniform(0.2, 0.5)
            * np.exp(-0.5 * ((Y - yy) / s) ** 2)
            * sstep(fbm(shape, step, 50, 300, rng), -0.2, 0.1),
        )
    for depth, shortest, longest, stretch, lo, hi in style["chisel"]:
        det += (
            depth
            * fbm(shape, step, shortest, longest, rng, 1.2, (rng.uniform(0, 3), stretch))
            * sstep(fbm(shape, step, 40, 300, rng), lo, hi)
        )
    det += 0.012 * fbm(shape, step, 0.6, 3, rng, 1.0)  # grain
    z = z + gaussian_filter(det, 0.12 / step) * sstep(D, 0.3, 2.5) + 0.9 * (1 - sstep(D, 0, 0.5))
    alb = 0.45 + 0.07 * fbm(shape, step, 1.2, 40, rng, 1.0) + 0.05 * fbm(shape, step, 0.5, 2, rng, 0.5)
    grain = fbm(shape, step, 0.5, 2.5, rng, 0.4)
    alb = np.where(grain > 1.7, alb * 0.55, alb)
    alb = np.where(grain < -2, np.minimum(alb * 1.5, 0.8), alb)
    alb = style["veins"](alb, step, rng)
    alb = np.where(D < 0.3, 0.32 + 0.01 * grain, alb)
    for p in style["points"].values():
        dot_target(alb, X, Y, p, 1.3)
    alb = np.clip(gaussian_filter(alb, 0.08 / step), 0.05, 0.85)
    points = {
        k: [*p, float(z[round((p[1] - y[0]) / step), round((p[0] - x[0]) / step)])] for k, p in style["points"].items()
    }
    V, N, F, UV = grid_mesh(x, y, z, step)
    s, sky = lights.direction(rng.uniform(*style["light_azimuth"]), style["light_elevation"]), 0.07
    return dict(
        meshes=[
            object_mesh(
                V,
                N,
                F,
                dict(type="pplastic", int_ior=1.5, specular_reflectance=1.0, alpha=0.25),
                uv=UV,
                tex=alb.astype(np.float32),
            )
        ],
        lights=[lights.directional(s, np.pi), lights.constant(sky)],
        light_meta=dict(
            kind="distant directional + weak constant environment",
            dir_to_light_world=[s.tolist()],
            directional_irradiance=np.pi,
            env_radiance=sky,
        ),
        stations=[dict(target=[0, 0, float(z.mean())], dist=590, tilt=style["tilt"], roll=1.2, focal_mm=60)],
        views=dict(n=12, angle=25, dist=640, focal_mm=50),
        size=(720, 480),
        view_size=(960, 640),
        spp=144,
        flat=[dict(name="label", c=[lx, ly], half=[lw / 2 - 2, lh / 2 - 2])],
        points=points,
        mvs=dict(keep=0.97, noise=0.7),
        jpeg=style["jpeg"],
        distortion=style["distortion"],
        photos_self_calibrate=True,
        material=dict(bsdf="pplastic", refractive_index=1.5, roughness_alpha=0.25, diffuse_albedo="textured 0.05-0.85"),
    )


STYLES = dict(
    dev=dict(
        seed=1000,
        fold_angle=(0.3, 1.2),
        label_x=(30, 52),
        label_y=(-38, -20),
        text=(-95, 10, -62, 5),
        ruled=True,
        ornament=rosette,
        chisel=[(0.07, 1.4, 6, 7.0, 0, 0.8)],
        veins=lambda alb, step, rng: alb,
        points={"P1": (-88.0, -66.0), "P2": (90.0, -64.0), "P3": (86.0, 64.0)},
        light_azimuth=(110.0, 150.0),
        light_elevation=50,
        tilt=(4.0, -5.0),
        jpeg=True,
        distortion=dict(station=[0.22, -0.9, 6e-4, -4e-4], views=[0.12, -0.35, 4e-4, 3e-4]),
    )
)
