"""Files of a rendered scene."""

import json
import zipfile
from io import BytesIO

import cv2
import noise
import numpy as np
from scipy.ndimage import binary_dilation


def quantized(a, step):
    """Rounded to multiples of `step`, a power of two, so that the file compresses well."""
    return (np.round(np.asarray(a, np.float64) / step) * step).astype(np.float32)


def npz(path, **arrays):
    """Writes an npz file that np.load reads as usual; with LZMA it is a third smaller than from np.savez_compressed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as f:
        for name, a in arrays.items():
            b = BytesIO()
            np.lib.format.write_array(b, np.ascontiguousarray(a))
            f.writestr(name + ".npy", b.getvalue())


def png(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    paeth = [cv2.IMWRITE_PNG_FILTER, 128] if hasattr(cv2, "IMWRITE_PNG_FILTER") else []  # best on noisy 16-bit images
    cv2.imwrite(
        str(path),
        image,
        [cv2.IMWRITE_PNG_COMPRESSION, 9, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_FILTERED, *paeth],
    )


def jpg(path, image, quality=84):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, quality])


def cloud_ply(path, P, N, gray):
    names = ("x", "y", "z", "nx", "ny", "nz")
    a = np.empty(len(P), [(n, "<f4") for n in names] + [(c, "u1") for c in ("red", "green", "blue")])
    for k, n in enumerate(names):
        a[n] = (P if k < 3 else N)[:, k % 3]
    a["red"] = a["green"] = a["blue"] = gray
    head = (
        ["ply", "format binary_little_endian 1.0", "comment units mm, world frame", f"element vertex {len(a)}"]
        + [f"property float {n}" for n in names]
        + [f"property uchar {c}" for c in ("red", "green", "blue")]
        + ["end_header", ""]
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("\n".join(head).encode() + a.tobytes())


def mesh_ply(path, V, F):
    head = [
        "ply",
        "format binary_little_endian 1.0",
        "comment units mm, world frame",
        f"element vertex {len(V)}",
        "property float x",
        "property float y",
        "property float z",
        f"element face {len(F)}",
        "property list uchar int vertex_indices",
        "end_header",
        "",
    ]
    f = np.empty(len(F), [("n", "u1"), ("v", "<i4", 3)])
    f["n"], f["v"] = 3, F
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("\n".join(head).encode() + np.ascontiguousarray(V, "<f4").tobytes() + f.tobytes())


def truth(folder, t, S):
    """Writes gt/depth_normal_mask.npz, and gt/stokes.npz on the object and 8 px around it (0 elsewhere)."""
    label = t["label"]
    near = binary_dilation(label == 1, iterations=8)
    npz(
        folder / "gt/depth_normal_mask.npz",
        depth=quantized(np.where(label > 0, t["z"], 0), 2.0**-13),
        normal=quantized(t["normal"], 2.0**-13),
        mask=label == 1,
        label=label,
        material=t["material"],
    )
    npz(folder / "gt/stokes.npz", **{f"s{k}": quantized(np.where(near, S[..., k], 0), 2.0**-14) for k in range(3)})


def components(folder, S, specular, diffuse, label):
    """Writes gt/components.npz: the shares of specular and diffuse reflection in the light and in the polarization."""
    ps, pd = (np.hypot(c[..., 1], c[..., 2]) for c in (specular, diffuse))
    share = specular[..., 0] / np.maximum(specular[..., 0] + diffuse[..., 0], 1e-9)
    obj = label == 1
    dolp = lambda p: quantized(np.where(obj, p / np.maximum(S[..., 0], 1e-6), 0), 2.0**-10)
    npz(
        folder / "gt/components.npz",
        spec_fraction_s0=np.where(obj, np.round(np.clip(share, 0, 1) * 255), 0).astype(np.uint8),
        spec_dominant=(ps > pd) & obj,
        dolp_diffuse_part=dolp(pd),
        dolp_specular_part=dolp(ps),
    )


def polarized_set(folder, name, S, frames, rng, M=None, jpeg=False):
    """Writes pol/NAME/pol_AAA.png (or .jpg); returns the description of these images for meta.json."""
    for k, angle in enumerate(noise.ANGLES):
        I = noise.polarized(S, angle)
        dn = noise.sensor_dn(I if M is None else noise.moved(I, M[k]), rng, frames)
        if jpeg:
            jpg(folder / f"pol/{name}/pol_{angle:03d}.jpg", noise.srgb8(dn / noise.WHITE_DN), 95)
        else:
            png(folder / f"pol/{name}/pol_{angle:03d}.png", dn)
    return dict(
        frames_averaged=frames,
        misregistered=M is not None,
        M_ref_to_image=None if M is None else [m.tolist() for m in M],
        format="8-bit sRGB-gamma JPEG q95" if jpeg else "16-bit linear PNG, white level 16383",
    )


def flat_patches(flats, t):
    """Pixel boxes (corners included) inside the flat areas, with the plane fitted to the truth there."""
    cam, z, obj, out = t["cam"], t["z"], t["label"] == 1, []
    Xc = cam.rays().reshape(*z.shape, 3) * z[..., None]
    Xw = (Xc - cam.t) @ cam.R
    for f in flats:
        m = obj & (np.abs(Xw[..., 0] - f["c"][0]) < f["half"][0]) & (np.abs(Xw[..., 1] - f["c"][1]) < f["half"][1])
        ys, xs = np.nonzero(m)
        if len(ys) < 30:
            continue
        cy, cx, hw, hh = ys.mean(), xs.mean(), np.ptp(xs) / 2.0, np.ptp(ys) / 2.0
        while True:
            x0, y0, x1, y1 = (
                int(np.ceil(cx - hw)),
                int(np.ceil(cy - hh)),
                int(np.floor(cx + hw)),
                int(np.floor(cy + hh)),
            )
            if m[y0 : y1 + 1, x0 : x1 + 1].all() or min(hw, hh) < 3:
                break
            hw, hh = hw * 0.97, hh * 0.97
        p = Xc[y0 : y1 + 1, x0 : x1 + 1].reshape(-1, 3)
        c = p.mean(0)
        n = np.linalg.svd(p - c, full_matrices=False)[2][2]
        n *= -np.sign(n[2])
        out.append(
            dict(
                name=f["name"],
                box_xyxy=[x0, y0, x1, y1],
                plane_normal_cam=n.tolist(),
                plane_point_cam=c.tolist(),
                gt_plane_rmse_mm=float(((p - c) @ n).std()),
                zenith_deg=float(np.degrees(np.arccos(-n @ c / np.linalg.norm(c)))),
                world_centre_xy=list(map(float, f["c"])),
                world_half_size_xy=list(map(float, f["half"])),
            )
        )
    return out


def text(path, value):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(value if isinstance(value, str) else json.dumps(value, indent=1) + "\n")
