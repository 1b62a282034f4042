"""A small glazed statuette in the round: six stations about the vertical axis (+y) in one world frame, with one closed mesh as truth."""

import lights
import numpy as np
from cameras import around
from geometry import board, close_holes, object_mesh, smin, sstep, surface_nets
from scipy.ndimage import gaussian_filter, map_coordinates


def ellipsoid(p, center, radii, turn=0.0):
    """Approximate signed distance of an ellipsoid; turn = degrees about z."""
    a = np.radians(turn)
    x, y, z = (p[i] - center[i] for i in range(3))
    q = [x * np.cos(a) + y * np.sin(a), -x * np.sin(a) + y * np.cos(a), z]
    k0 = np.sqrt(sum((c / r) ** 2 for c, r in zip(q, radii)))
    k1 = np.sqrt(sum((c / r**2) ** 2 for c, r in zip(q, radii)))
    return k0 * (k0 - 1) / np.maximum(k1, 1e-6)


def limb(p, a, b, ra, rb):
    """Approximate signed distance of a limb from a to b with radii ra to rb."""
    ab = np.subtract(b, a)
    h = np.clip(sum((p[i] - a[i]) * ab[i] for i in range(3)) / (ab @ ab), 0, 1)
    return np.sqrt(sum((p[i] - a[i] - h * ab[i]) ** 2 for i in range(3))) - (ra + h * (rb - ra))


def drum(p, y0, y1, radius, edge, lobes=0, depth=0.0):
    """Approximate signed distance of a round base with a rounded edge, scalloped in lobes."""
    r, ph = np.hypot(p[0], p[2]), np.arctan2(p[0], p[2])
    d = np.maximum(
        r - radius + edge + depth * (1 - np.abs(np.cos(lobes / 2 * ph))),
        np.abs(p[1] - (y0 + y1) / 2) - (y1 - y0) / 2 + edge,
    )
    return np.maximum(d, 0) - edge + np.minimum(d, 0)


def torus(p, center, R, r):
    return np.hypot(np.hypot(p[0] - center[0], p[2] - center[2]) - R, p[1] - center[1]) - r


SHAPES = dict(ellipsoid=ellipsoid, limb=limb, drum=drum, torus=torus)


def noise_3d(shape, step, shortest, longest, rng, beta):
    k = (
        np.sqrt(
            sum(
                np.meshgrid(
                    *[np.fft.fftfreq(n, step) ** 2 for n in shape[:2]],
                    np.fft.rfftfreq(shape[2], step) ** 2,
                    indexing="ij",
                )
            )
        )
        + 1e-9
    )
    f = np.fft.irfftn(
        np.fft.rfftn(rng.standard_normal(shape).astype(np.float32))
        * (k**-beta / (1 + (k * shortest) ** 8) / (1 + (1 / (k * longest)) ** 8)),
        s=shape,
    )
    return (f / f.std()).astype(np.float32)


def scene(style, rng, quality):
    step, (wx, wy, wz) = style["voxel"] / quality, style["half_size"]
    n = [int(2 * w / step) + 1 for w in (wx, wy, wz)]
    origin = np.array([-wx, -wy, -wz])
    p = np.meshgrid(
        *[(o + np.arange(m) * step).astype(np.float32) for o, m in zip(origin, n)], indexing="ij", sparse=True
    )
    p = [np.broadcast_to(c, n) for c in p]
    f = np.full(n, 1e3, np.float32)
    for kind, blend, *args in style["shapes"]:  # blend > 0: joined softly, < 0: cut out
        d = SHAPES[kind](p, *args).astype(np.float32)
        f = smin(f, d, blend) if blend > 0 else -smin(-f, d, -blend)
    ph, r = np.arctan2(p[0], p[2]), np.hypot(p[0], p[2])
    for y0, y1, count, depth, sway in style["folds"]:  # drapery
        m = sstep(p[1], y0, y0 + 6) * (1 - sstep(p[1], y1 - 12, y1)) * sstep(r, 5, 9)
        f = f + depth * m * (
            np.sin(count * ph + sway * np.sin(p[1] / 9) + 0.8 * np.sin(3 * ph))
            + 0.35 * np.sin(2.3 * count * ph + p[1] / 3)
        )
    for y0, width, depth in style["lines"]:  # engraved hems
        f = f + depth * np.exp(-0.5 * ((p[1] - y0 - 0.8 * np.sin(3 * ph)) / width) ** 2)
    for y0, y1, pitch, depth in style["diaper"]:  # engraved pattern on a band
        m = sstep(p[1], y0, y0 + 1) * (1 - sstep(p[1], y1 - 1, y1))
        u, v = ph * 12 / pitch, p[1] / pitch
        f = f + depth * m * np.exp(
            -0.5 * (np.minimum(np.abs(np.sin(np.pi * (u + v))), np.abs(np.sin(np.pi * (u - v)))) / 0.16) ** 2
        )
    f = f + style["grain"] * noise_3d(n, step, 1.5, 8, rng, 1.2)
    f = gaussian_filter(f.astype(np.float32), 0.5)
    V, N, F = close_holes(*surface_nets(f, origin, step))
    at = (V - origin) / step
    recess = map_coordinates(f - gaussian_filter(f, 1.6 / step), at.T, order=1)  # > 0 in hollows: darker glaze, dirt
    stain = map_coordinates(noise_3d(n, step, 4, 40, rng, 1.4), at.T, order=1)
    lo, hi = style["albedo"]
    a = np.clip(hi - 0.35 * np.clip(recess, 0, 0.6) + 0.04 * stain, lo, 0.9)
    for y0, y1, factor in style["painted"]:
        a = np.where((V[:, 1] > y0) & (V[:, 1] < y1), a * factor, a)
    ramp = np.tile((np.arange(128) + 0.5) / 128, (4, 1)).astype(np.float32)  # albedo by u
    yb = -wy + style["foot"]
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    marks = {"P1": (-40.0, -38.0), "P2": (41.0, -39.0), "P3": (39.0, 40.0)}
    support = board((112, 112), yb, rng, 1.1, marks.values(), 1.1, px=1400, gain=0.6, turn=turn)
    boxes = [(around(az, el) * distance, size, power) for az, el, distance, size, power in style["softboxes"]]
    return dict(
        meshes=[
            object_mesh(
                V,
                N,
                F,
                dict(type="pplastic", int_ior=style["index"], alpha=style["alpha"], specular_reflectance=1.0),
                uv=np.stack([a, np.full_like(a, 0.5)], 1),
                tex=ramp,
            ),
            support,
        ],
        lights=[lights.room(style["room"])]
        + [lights.softbox(c, (size, size), power, up=(0, 1, 0.01)) for c, size, power in boxes],
        light_meta=dict(
            kind="room as environment map, its windows in it (not seen directly: black backdrop), and softboxes if any",
            softbox_centres_world=[c.tolist() for c, *_ in boxes],
            softbox_sizes_mm=[s for _, s, _ in boxes],
            softbox_radiances=[q for *_, q in boxes],
            dir_to_light_world=[(c / np.linalg.norm(c)).tolist() for c, *_ in boxes],
        ),
        stations=[
            dict(
                target=[0, style["aim"], 0.0],
                dist=560,
                direction=around(az, el).tolist(),
                roll=roll,
                focal_mm=560 * 22.3 / style["field"],
            )
            for az, el, roll in style["stations"]
        ],
        views=dict(n=16, elevations=(14.0, 32.0), dist=600, focal_mm=600 * 22.3 / (style["field"] * 1.12)),
        flat=[],
        points={k: [x, yb, -y] for k, (x, y) in marks.items()},
        mvs=dict(keep=0.72, noise=1.4, share=1 / 14),
        size=(400, 500),
        view_size=(512, 640),
        spp=108,
        hide_lights=True,
        truth_mesh=(V, F),
        material=dict(
            bsdf="pplastic",
            refractive_index=style["index"],
            roughness_alpha=style["alpha"],
            diffuse_albedo=f"{lo}-{hi}, darker in hollows",
        ),
    )


def daylight(d):
    """Radiance of the gallery: bright above, dark below, one brighter wall."""
    return 0.3 + 0.25 * d[..., 1] + 0.25 * np.clip(d[..., 0], 0, 1) ** 2


STYLES = dict(
    dev=dict(  # a seated, stout figure with a sack
        seed=1150,
        voxel=0.4,
        half_size=(31.0, 45.0, 31.0),
        foot=1.0,
        index=1.54,
        alpha=0.14,
        albedo=(0.2, 0.62),
        grain=0.05,
        aim=-2.0,
        field=112.0,
        shapes=[
            ("drum", 1.0, -44.0, -36.0, 28.0, 1.5, 20, 1.2),
            ("ellipsoid", 3.0, (0, -22, 0), (22, 19, 18)),
            ("ellipsoid", 4.0, (0, -2, -1), (16, 16, 13)),
            ("limb", 3.0, (-15, 2, 0), (-20, -16, 8), 6.5, 5.0),
            ("limb", 2.0, (-20, -16, 8), (-6, -14, 18), 5.0, 3.5),
            ("limb", 3.0, (15, 2, 0), (21, -14, 6), 6.5, 5.0),
            ("limb", 2.0, (21, -14, 6), (10, -2, 17), 4.6, 3.2),
            ("ellipsoid", 2.5, (18, -22, -12), (10, 13, 10), 15.0),
            ("ellipsoid", 3.0, (0, 18, 2), (10.5, 11.5, 10.5)),
            ("ellipsoid", 1.5, (0, 15, 12.0), (2.2, 2.6, 2.4)),
            ("ellipsoid", 1.0, (-10.5, 16, 2), (2, 4.5, 3)),
            ("ellipsoid", 1.0, (10.5, 16, 2), (2, 4.5, 3)),
            ("ellipsoid", -1.2, (-4.0, 19, 12.4), (2.2, 1.2, 2.0)),
            ("ellipsoid", -1.2, (4.0, 19, 12.4), (2.2, 1.2, 2.0)),
            ("ellipsoid", -1.0, (0, 9.8, 12), (3.4, 0.9, 2.0)),
            ("ellipsoid", 2.0, (0, 30, 0), (5, 4, 5)),
            ("limb", 2.5, (-12, -36, 10), (-2, -34, 19), 6.0, 4.0),
        ],
        folds=[(-40.0, 6.0, 11, 0.5, 2.0)],
        lines=[(-33.0, 0.5, 0.35)],
        diaper=[],
        painted=[(-60.0, -36.5, 0.45)],
        softboxes=[(35.0, 40.0, 420.0, 180.0, 7.0), (-120.0, 25.0, 420.0, 160.0, 4.0)],
        room=daylight,
        stations=[(0, 12, 0.5), (60, 18, -1.0), (118, 10, 1.0), (181, 20, 0.3), (242, 14, -0.6), (299, 22, 1.4)],
    )
)
