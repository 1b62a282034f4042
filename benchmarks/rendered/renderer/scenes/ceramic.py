"""A glazed bowl lying foot up: painted glossy glaze and an unglazed, matte foot ring (and chips) on one object, in a room that is
lit by a window, with a bright wall and a dark floor."""

import lights
import numpy as np
from geometry import axes, board, fbm, grid_mesh, local, smin, sstep, subset
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter

GLAZE, BODY = 1, 2


def bands(X, Y, r, ph, R, rng):
    """Painted rings, petals around the foot and a scroll band: the amount of cobalt, 0..1."""
    line = lambda c, w: np.exp(-0.5 * ((r - c) / w) ** 4)
    ink = np.maximum.reduce([line(R * 0.93, 0.5), line(R * 0.9, 0.25), line(R * 0.55, 0.4)])
    petals = np.abs(r - R * (0.4 + 0.09 * np.abs(np.cos(5 * ph)))) < 0.6
    scroll = np.abs(r - R * (0.73 + 0.07 * np.sin(9 * ph))) < 0.8
    leaf = (np.abs(((ph * 9 / np.pi) % 2) - 1) < 0.3) & (np.abs(r - R * 0.73) < R * 0.05)
    return np.maximum(ink, gaussian_filter((petals | scroll | leaf).astype(float), 1.5))


def scene(style, rng, quality):
    step, R = 0.1 / quality, style["radius"]
    x, y, X, Y = axes(R + 0.5, R + 0.5, step)
    ph, r = np.arctan2(Y, X), np.hypot(X, Y)
    n, depth = style["flutes"]
    wall = sstep(r, R * 0.42, R * 0.6) * (1 - sstep(r, R * 0.93, R))
    rho = r * (1 + depth * wall * np.abs(np.cos(n / 2 * ph)))  # flutes: scalloped wall
    rk, zk = np.array(style["profile"]).T
    z = PchipInterpolator(rk * R, zk)(np.clip(rho, 0, R * 1.001))
    foot_in, foot_out, foot = style["foot"]
    ring = sstep(r, foot_in - 0.9, foot_in + 0.7) * (1 - sstep(r, foot_out - 0.7, foot_out + 1.2))
    base = float(PchipInterpolator(rk * R, zk)(0))
    inside = r < (foot_in + foot_out) / 2
    z = np.where(inside, base, z)  # the base inside the ring is flat
    z = z + ring * (base + foot - z)
    z += style["turning"] * np.sin(2 * np.pi * r / 2.3 + 0.6 * np.sin(3 * ph)) * wall
    chips = np.zeros(r.shape, bool)
    for az, cr, cut, slope in style["chips"]:  # bits broken off: flat, rough
        a = np.radians(az)
        u, _ = local(X, Y, cr * np.cos(a), cr * np.sin(a), a)
        i, j = int((cr * np.sin(a) - y[0]) / step), int((cr * np.cos(a) - x[0]) / step)
        plane = z[i, j] - cut - slope * u + 0.06 * fbm(r.shape, step, 0.6, 4, rng, 1.0)
        near = np.hypot(X - cr * np.cos(a), Y - cr * np.sin(a)) < 9
        chips |= near & (plane < z - 0.02)
        z = np.where(near, smin(z, plane, 0.15), z)
    body = (
        chips
        | (
            (r > foot_in - 0.2)
            & (r < foot_out + style["bare"] * (1 + 0.25 * fbm(r.shape, step, 8, 60, rng, 1.2)) + 0.4)
        )
        | (r > R * 0.985)
    )
    matte = fbm(r.shape, step, 0.35, 2.5, rng, 0.8)
    glaze = fbm(r.shape, step, 1.5, 14, rng, 1.4)
    flat = r < foot_in - 1.6
    z = z + np.where(body, 0.012 * matte, 0.012 * glaze * ~flat)
    z = np.where(flat, base, gaussian_filter(z, 0.08 / step))
    ink = style["painting"](X, Y, r, ph, R, rng)
    alb = np.clip((0.62 + 0.02 * glaze) * (1 - ink) + 0.06 * ink, 0.04, 0.75)
    alb = np.where(
        body, np.clip(0.38 + 0.05 * matte + 0.03 * fbm(r.shape, step, 2, 30, rng, 1.0), 0.15, 0.6), alb
    ).astype(np.float32)
    V, N, F, UV = grid_mesh(x, y, z, step, r < R)
    keep = r < R  # divides the faces by material
    b = (
        body[keep]
        if len(V) == keep.sum()
        else body.ravel()[
            np.rint((V[:, 1] - y[0]) / step).astype(int) * len(x) + np.rint((V[:, 0] - x[0]) / step).astype(int)
        ]
    )
    faces_of_body = b[F].sum(1) >= 2
    meshes = []
    for name, number, sel, bsdf in (
        (
            "object_glaze",
            GLAZE,
            ~faces_of_body,
            dict(int_ior=1.5, alpha=style["glaze_alpha"], specular_reflectance=1.0),
        ),
        ("object_body", BODY, faces_of_body, dict(int_ior=1.5, alpha=0.45, specular_reflectance=0.6)),
    ):
        v, nn, uv, f = subset(V, N, UV, F[sel])
        meshes.append(
            dict(
                name=name,
                V=v,
                N=nn,
                F=f,
                uv=uv,
                tex=alb,
                albedo=None,
                bsdf=dict(type="pplastic", **bsdf),
                label=1,
                material=number,
            )
        )
    points = {"P1": (-R * 1.32, -R * 0.78), "P2": (R * 1.34, -R * 0.76), "P3": (R * 1.3, R * 0.78)}
    support = board((R * 4.2, R * 3), 0.0, rng, 1.5, points.values(), 1.5, gain=0.6)
    waz, wel, ww, wh = style["window"]

    def surroundings(d):
        """Radiance of the room, +z up: ceiling .35, wall opposite the window 0.8, dark towards the floor, a dark door, a lamp."""
        az = np.degrees(np.arctan2(d[..., 1], d[..., 0]))
        L = (
            0.25
            + 0.1 * d[..., 2]
            + 0.55 * (1 - sstep(np.abs((az - waz - 180 + 180) % 360 - 180), 30, 75)) * (1 - sstep(d[..., 2], 0.5, 0.9))
        )
        L = L * (0.25 + 0.75 * sstep(d[..., 2], -0.05, 0.25))
        return L * (1 - 0.85 * lights.rectangle_in_room(d, waz + 95, 25, 40, 50, 3)) + 0.9 * lights.rectangle_in_room(
            d, waz + 140, 60, 50, 12, 2
        )

    s = lights.direction(waz, wel)
    return dict(
        meshes=meshes + [support],
        lights=[lights.room(surroundings), lights.softbox(s * 1500, (ww, wh), style["window_radiance"], up=(0, 0, 1))],
        light_meta=dict(
            kind="room as environment map (bright wall, dark door, ceiling lamp, dark floor) and a window (area light)",
            window_centre_world=(s * 1500).tolist(),
            window_size_mm=[ww, wh],
            window_radiance=style["window_radiance"],
            dir_to_light_world=[s.tolist()],
        ),
        stations=[
            dict(
                target=[0, 0, base * 0.5],
                dist=900,
                tilt=style["tilt"],
                roll=style["roll"],
                focal_mm=900 * 22.3 / (R * 3.3),
            )
        ],
        views=dict(n=8, angle=27, dist=950, focal_mm=950 * 22.3 / (R * 3.7)),
        flat=[dict(name="base", c=[0.0, 0.0], half=[(foot_in - 2) / 1.45] * 2)],
        points={k: [*p, 0.0] for k, p in points.items()},
        mvs=dict(keep=0.5, noise=2.0),
        spp=144,
        material=dict(
            bsdf="pplastic",
            refractive_index=1.5,
            roughness_alpha=dict(glaze=style["glaze_alpha"], body=0.45),
            diffuse_albedo="glaze 0.06-0.64 painted, body 0.38",
        ),
        materials={str(GLAZE): "glossy glaze", str(BODY): "unglazed body"},
    )


STYLES = dict(
    dev=dict(
        seed=1120,
        radius=58.0,
        flutes=(0, 0.0),
        turning=0.05,
        profile=[(0, 38.0), (0.2, 37.6), (0.45, 34.0), (0.7, 25.0), (0.88, 13.0), (1.002, 0.0)],
        foot=(14.0, 18.5, 5.0),
        bare=2.2,
        chips=[(40, 50.0, 1.2, 0.9)],
        painting=bands,
        glaze_alpha=0.04,
        window=(35.0, 42.0, 900, 1300),
        window_radiance=6.0,
        tilt=(12.0, -9.0),
        roll=1.0,
    )
)
