"""All code that needs Mitsuba: builds a scene, renders Stokes images and photographs, computes exact depth and normals at the pixel centers."""

import glob
import os
from pathlib import Path

for place in (Path(__file__).resolve().parent, Path.cwd()):  # see README: libllvm19 unpacked into a folder "deb/x"
    found = glob.glob(str(place / "deb/x/usr/lib/*/libLLVM.so.19.1"))
    if found:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", found[0])

import mitsuba as mi
import numpy as np
from scipy.stats import chi2

mi.set_variant("llvm_ad_mono_polarized")


def build(scene):
    """Mitsuba scene and its mesh objects by name, from the description that a scene function returns."""
    d, objects = dict(type="scene"), {}
    for m in scene["meshes"]:
        bsdf, uv, tex = dict(m["bsdf"]), m["uv"], m.get("tex")
        if m["label"] == 1 and bsdf["type"] == "pplastic":
            # pplastic chooses the lobe with probability specular mean / (specular mean + texture mean), regardless of the Fresnel term.
            # This is noisy on dark glossy objects. An unused half of the bitmap shifts the texture mean so that the probability
            # follows the energies of the lobes. The result stays unbiased.
            T = tex if tex is not None else np.full((4, 4), m["albedo"], np.float32)
            share = 0.045 / (0.045 + 0.85 * float(T.mean()))
            tex = np.hstack([T, np.full_like(T, 2 * (1 / share - 1) - T.mean())])
            uv = uv * [0.5, 1] if uv is not None else np.full((len(m["V"]), 2), 0.25)
        bitmap = lambda a, **k: dict(
            type="bitmap",
            data=mi.TensorXf(np.ascontiguousarray(a[..., None], np.float32)),
            raw=True,
            filter_type="bilinear",
            wrap_mode="clamp",
            **k,
        )
        if tex is not None:
            bsdf["diffuse_reflectance"] = bitmap(tex)
        elif m["albedo"] is not None:
            bsdf["diffuse_reflectance"] = float(m["albedo"])
        if isinstance(bsdf.get("alpha"), np.ndarray):
            bsdf["alpha"] = bitmap(bsdf["alpha"])
        p = mi.Properties()
        p["mesh_bsdf"] = mi.load_dict(bsdf)
        mesh = mi.Mesh(
            m["name"], len(m["V"]), len(m["F"]), has_vertex_normals=True, has_vertex_texcoords=uv is not None, props=p
        )
        p = mi.traverse(mesh)
        p["vertex_positions"], p["vertex_normals"] = (
            m["V"].astype(np.float32).ravel(),
            m["N"].astype(np.float32).ravel(),
        )
        p["faces"] = m["F"].astype(np.uint32).ravel()
        if uv is not None:
            p["vertex_texcoords"] = uv.astype(np.float32).ravel()
        p.update()
        d[m["name"]] = objects[m["name"]] = mesh
    for k, light in enumerate(scene["lights"]):
        d[f"light{k}"] = light
    return mi.load_dict(d), objects


def sensor(cam, sampler="multijitter"):
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = cam.R.T, cam.center
    M = M @ np.diag([-1.0, -1.0, 1.0, 1.0])  # Mitsuba's camera: x left, y up, z forward
    return mi.load_dict(
        dict(
            type="perspective",
            fov=float(np.degrees(2 * np.arctan(cam.W / 2 / cam.K[0, 0]))),
            fov_axis="x",
            near_clip=1.0,
            far_clip=1e5,
            principal_point_offset_x=-float((cam.K[0, 2] + 0.5 - cam.W / 2) / cam.W),
            principal_point_offset_y=-float((cam.K[1, 2] + 0.5 - cam.H / 2) / cam.H),
            to_world=mi.ScalarTransform4f(M),
            film=dict(
                type="hdrfilm",
                width=cam.W,
                height=cam.H,
                rfilter=dict(type="box"),
                pixel_format="luminance",
                component_format="float32",
            ),
            sampler=dict(type=sampler, sample_count=36),
        )
    )


def render_stokes(scene, cam, spp, depth=4, seed=0, hide=False, chunk=36):
    """S0, S1, S2 (H, W, 3) and their standard errors from the spread between the chunks (only the median over pixels is unbiased)."""
    path = dict(type="path", max_depth=depth, rr_depth=99, hide_emitters=hide)
    it, view = mi.load_dict(dict(type="stokes", nested=path)), sensor(cam)
    n = max(2, round(spp / chunk))
    total = square = 0
    for k in range(n):
        a = np.array(mi.render(scene, sensor=view, integrator=it, spp=chunk, seed=seed * 1000 + k)).astype(np.float64)[
            ..., [1, 4, 7]
        ]
        total, square = total + a, square + a * a  # channels: 0 luminance, 1..3 S0 rgb, 4..6 S1, 7..9 S2, 10..12 S3
    mean = total / n
    return mean, np.sqrt(np.maximum(square / n - mean**2, 0) / chi2.median(n - 1))


def render_photo(scene, cam, spp, depth=3, seed=0, hide=False):
    it = mi.load_dict(dict(type="path", max_depth=depth, rr_depth=99, hide_emitters=hide))
    return np.array(mi.render(scene, sensor=sensor(cam, "independent"), integrator=it, spp=spp, seed=seed))[
        ..., 0
    ].astype(np.float64)


def set_object(scene, what, value=None):
    """Sets every diffuse or specular reflectance of the object to zero or to `value`; returns the earlier values, to restore them."""
    p, old = mi.traverse(scene), {}
    for key in p.keys():
        if key.startswith("object") and what in key and key.endswith(("value", "data")):
            old[key] = p[key] * 1
            p[key] = p[key] * 0 if value is None else value[key]
    p.update()
    return old


def raycast(scene, objects, description, cam):
    """Depth along the optical axis (float64), shading normal in the camera frame, label and material at the pixel centers.
    In Embree's fast mode ~1e-4 of the rays slip between tiny triangles. So four rays within 0.002 px are cast, and the nearest hit counts."""
    meshes, dc = description["meshes"], cam.rays()
    dw, C, n = dc @ cam.R, cam.center, len(dc)
    face, nearest, which = np.zeros(n, np.int64), np.full(n, np.inf), np.full(n, -1)
    for jx, jy in ((0, 0), (1, 0.7), (-0.8, 1), (0.3, -1)):
        dj = (dc + np.array([jx / cam.K[0, 0], jy / cam.K[1, 1], 0]) * 2e-3) @ cam.R
        dj /= np.linalg.norm(dj, axis=1, keepdims=True)
        ray = mi.Ray3f(
            mi.Point3f(*[float(c) for c in C]),
            mi.Vector3f(*[np.ascontiguousarray(dj[:, k].astype(np.float32)) for k in range(3)]),
        )
        hit = scene.ray_intersect_preliminary(ray, coherent=True)
        t, w = np.where(np.array(hit.is_valid()), np.array(hit.t), np.inf), np.full(n, -1)
        for i, m in enumerate(meshes):
            w[np.array(hit.shape == mi.ShapePtr(objects[m["name"]]))] = i
        new = (t < nearest * 0.9995) & (w >= 0)
        nearest[new], face[new], which[new] = t[new], np.array(hit.prim_index)[new], w[new]
    z, normal, label, material = np.zeros(n), np.zeros((n, 3)), np.zeros(n, np.uint8), np.zeros(n, np.uint8)
    for i, m in enumerate(meshes):
        s = which == i
        f = m["F"][face[s]]
        a, b, c = (m["V"][f[:, k]] for k in range(3))
        e1, e2, d = b - a, c - a, dw[s]
        h = np.cross(d, e2)
        det, o = (e1 * h).sum(1), C - a
        u, q = (o * h).sum(1) / det, np.cross(o, e1)
        v = (d * q).sum(1) / det
        N = m["N"][f[:, 0]] * (1 - u - v)[:, None] + m["N"][f[:, 1]] * u[:, None] + m["N"][f[:, 2]] * v[:, None]
        z[s], normal[s] = (e2 * q).sum(1) / det, N / np.linalg.norm(N, axis=1, keepdims=True) @ cam.R.T
        label[s], material[s] = m["label"], m.get("material", m["label"] == 1)
    shape = (cam.H, cam.W)
    return dict(
        z=z.reshape(shape),
        normal=normal.reshape(shape + (3,)),
        label=label.reshape(shape),
        material=material.reshape(shape),
        cam=cam,
    )
