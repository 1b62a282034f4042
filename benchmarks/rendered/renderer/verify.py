#!/usr/bin/env python3
"""Checks Mitsuba's polarization against theory, and the consistency of rendered folders.

python verify.py sphere             AoLP and DoLP of spheres (diffuse, glossy, metal) under a uniform sky; tilted metal plane
python verify.py room               directions of the environment map
python verify.py folder DIR [...]   agreement of phase and degree of the true Stokes images with the true normals
"""

import json
import sys
from pathlib import Path

import numpy as np


def dolp_diffuse(t, n):
    s = np.sin(t) ** 2
    return (n - 1 / n) ** 2 * s / (2 + 2 * n * n - (n + 1 / n) ** 2 * s + 4 * np.cos(t) * np.sqrt(n * n - s))


def dolp_specular(t, n):
    """(Rs - Rp) / (Rs + Rp); n real or complex (conductor)."""
    c, root = np.cos(t), np.sqrt(np.asarray(n, complex) ** 2 - np.sin(t) ** 2)
    rs, rp = np.abs((c - root) / (c + root)) ** 2, np.abs((n**2 * c - root) / (n**2 * c + root)) ** 2
    return (rs - rp) / (rs + rp)


def frame(rays, normal):
    """Zenith and azimuth (0 = image right, positive = up) of camera-frame normals about each pixel's ray."""
    d = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    right = np.cross(np.array([0, 1.0, 0]), d)
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    up = -np.cross(d, right)
    return np.arccos(np.clip(-(normal * d).sum(-1), -1, 1)), np.arctan2((normal * up).sum(-1), (normal * right).sum(-1))


def apart(a, b):
    """Angle (degrees) between directions that are known modulo 180 degrees."""
    return np.degrees(np.abs((a - b + np.pi / 2) % np.pi - np.pi / 2))


def sphere():
    import tracer
    from cameras import Camera

    mi, W, R, D = tracer.mi, 128, 0.8, 10.0
    cam = Camera(W, W, 5.45 * 22.3, (0, 0), np.diag([1.0, -1.0, -1.0]), np.array([0, 0, D]))
    copper = 1.02 - 2.58j
    kinds = dict(
        diffuse=dict(type="pplastic", diffuse_reflectance=0.5, int_ior=1.5, alpha=0.1, specular_reflectance=0.0),
        glossy=dict(type="pplastic", diffuse_reflectance=0.0, int_ior=1.5, alpha=0.01, specular_reflectance=1.0),
        metal=dict(type="roughconductor", eta=1.02, k=2.58, alpha=0.02),
        rough_metal=dict(type="roughconductor", eta=1.02, k=2.58, alpha=0.2),
    )
    d = cam.rays()
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    b = d[:, 2] * D
    disc = b * b - (D * D - R * R)
    normal = ((b - np.sqrt(np.maximum(disc, 0)))[:, None] * d - [0, 0, D]) / R
    t, az = frame(cam.rays(), normal)
    ok = (disc > 0) & (t > np.radians(5)) & (t < np.radians(75))
    for name, bsdf in kinds.items():
        scene = mi.load_dict(
            dict(type="scene", s=dict(type="sphere", radius=R, b=bsdf), e=dict(type="constant", radiance=1.0))
        )
        S = tracer.render_stokes(scene, cam, 144, depth=2)[0].reshape(-1, 3)
        phase, rho = 0.5 * np.arctan2(S[:, 2], S[:, 1]), np.hypot(S[:, 1], S[:, 2]) / np.maximum(S[:, 0], 1e-9)
        model = dolp_diffuse(t, 1.5) if name == "diffuse" else dolp_specular(t, copper if "metal" in name else 1.5)
        print(
            f"{name:12s} phase from {'azimuth' if name == 'diffuse' else 'azimuth + 90'}: median "
            f"{np.median(apart(phase, az + (0 if name == 'diffuse' else np.pi / 2))[ok]):.3f} deg; degree - theory: median |.| {np.median(np.abs(rho - model)[ok]):.5f}, "
            f"95 % {np.quantile(np.abs(rho - model)[ok], 0.95):.5f}, largest degree {model[ok].max():.3f}"
        )
    for angle in (30.0, 60.0):  # plane tilted to the right: normal (sin, 0, cos)
        a = np.radians(angle)
        T = mi.ScalarTransform4f().rotate([0, 1, 0], angle)
        scene = mi.load_dict(
            dict(
                type="scene",
                p=dict(type="rectangle", to_world=T, b=kinds["metal"]),
                e=dict(type="constant", radiance=1.0),
            )
        )
        S = tracer.render_stokes(scene, cam, 72, depth=2)[0][60:68, 60:68].mean((0, 1))
        print(
            f"metal plane {angle:.0f} deg to the right: s1/s0 {S[1] / S[0]:+.4f} (theory {-dolp_specular(a, copper):+.4f}), s2/s0 {S[2] / S[0]:+.4f}"
        )


def room():
    import lights
    import tracer
    from cameras import Camera, look_at

    f = lambda d: 1 + 0.5 * d[..., 0] + 0.3 * d[..., 1] - 0.2 * d[..., 2]
    scene = tracer.mi.load_dict(dict(type="scene", e=lights.room(f)))
    for d in ([1, 0, 0], [0, 0, 1], [-0.6, 0.3, 0.5], [0.2, -0.8, -0.4]):
        d = np.array(d, float) / np.linalg.norm(d)
        R, t = look_at(np.zeros(3), d, np.array([0.1, 1, 0.05]), 0)
        print(
            np.round(d, 2),
            f"seen {tracer.render_photo(scene, Camera(16, 16, 800.0, (0, 0), R, t), 16).mean():.4f}, meant {f(d):.4f}",
        )


def folder(path):
    path = Path(path)
    m, g, s = (
        json.loads((path / "meta.json").read_text()),
        np.load(path / "gt/depth_normal_mask.npz"),
        np.load(path / "gt/stokes.npz"),
    )
    S, N, K = [s[f"s{k}"].astype(float) for k in range(3)], g["normal"].astype(float), np.array(m["station"]["K"])
    H, W = S[0].shape
    v, u = np.mgrid[:H, :W]
    t, az = frame(np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones((H, W))], -1), N)
    phase, rho = 0.5 * np.arctan2(S[2], S[1]), np.hypot(S[1], S[2]) / np.maximum(S[0], 1e-9)
    ok = g["mask"] & (t > np.radians(3)) & (t < np.radians(85)) & (S[0] > 1e-3)
    z = g["depth"].astype(float)  # consistency of the truth: normals computed from its depth
    P = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], -1)
    n = np.cross(np.gradient(P, axis=0), np.gradient(P, axis=1))
    n /= np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
    same = np.degrees(np.arccos(np.clip(np.abs((n * N).sum(-1)), 0, 1)))[ok]
    d, sp = apart(phase, az), apart(phase, az + np.pi / 2)
    out = dict(
        folder=str(path),
        pixels=int(ok.sum()),
        zenith=np.degrees(np.median(t[ok])),
        degree=np.median(rho[ok]),
        depth_vs_normals_deg=np.median(same),
        phase_vs_diffuse_deg=np.median(d[ok]),
        phase_vs_specular_deg=np.median(sp[ok]),
        phase_vs_nearer_deg=np.median(np.minimum(d, sp)[ok]),
        share_nearer_specular=(sp < d)[ok].mean(),
        strong_nearer_deg=np.median(np.minimum(d, sp)[ok & (rho > 0.05)]) if (ok & (rho > 0.05)).any() else None,
    )
    metal = m["material"]
    if metal.get("eta"):
        out["degree_over_conductor_theory"] = np.median(
            (rho / np.maximum(dolp_specular(t, metal["eta"] - 1j * metal["k"]), 1e-6))[ok & (t > np.radians(20))]
        )
    print(json.dumps({k: round(float(v), 4) if isinstance(v, (float, np.floating)) else v for k, v in out.items()}))


if __name__ == "__main__":
    what = sys.argv[1] if len(sys.argv) > 1 else "sphere"
    dict(sphere=sphere, room=room, folder=lambda: [folder(p) for p in sys.argv[2:]])[what]()
