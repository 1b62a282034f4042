#!/usr/bin/env python3
"""Scores a finished workspace against a scene with exact ground truth.

    python score.py SCENE WORK [--align none|similarity] [--json]

SCENE   a folder with meta.json and gt/depth_normal_mask.npz, as renderer/render.py writes it; or a folder with
        truth/depth.tif in the camera of the workspace, as in the examples
WORK    a workspace (fused/depth.tif, fused/camera.txt, prior/depth.tif, ...)

Everything is measured on the pixels of the object, 6 px away from its border, where the fused depth is finite:
  coverage          share of those object pixels that have a depth
  rmse_gsd          RMSE of the depth error in units of the ground sampling distance, after removing its median
  bias_gsd          that median
  detail_rmse_gsd   RMSE of the depth error without its low frequencies (Gaussian, sigma 8 px, inside the mask)
  detail_mad_gsd    the same with a robust spread: 1.4826 x median of the absolute value
  normal_mae_deg    mean angle between true normals and the normals of the fused depth (perspective differences)
  normal_median_deg its median
  gain_*            the same figure of prior/depth.tif divided by that of fused/depth.tif
  patch_<name>      RMSE to the fitted plane on a flat patch, in GSD (the paper's Table 2)
  sigma_2           share of pixels whose depth error (median removed) is below 2 x fused/sigma.tif
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image
from scipy import ndimage

from malus._robust import robust_spread

BORDER_PX, DETAIL_SIGMA_PX = 6, 8.0


def lowpass(values, mask, sigma):
    weight = ndimage.gaussian_filter(mask.astype(float), sigma)
    return ndimage.gaussian_filter(np.where(mask, values, 0.0), sigma) / np.maximum(weight, 1e-6)


def pinhole_of(camera_txt):
    """fx, fy, cx, cy of the one PINHOLE camera of a COLMAP text file, in OpenCV pixel coordinates."""
    for line in Path(camera_txt).read_text().splitlines():
        if line.strip() and not line.startswith("#"):
            words = line.split()
            if words[1] != "PINHOLE":
                raise SystemExit(f"{camera_txt}: expected a PINHOLE camera, found {words[1]}")
            fx, fy, cx, cy = map(float, words[4:8])
            return np.array([fx, fy, cx - 0.5, cy - 0.5])
    raise SystemExit(f"{camera_txt}: no camera")


def points_in_cam(depth, pinhole):
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    fx, fy, cx, cy = pinhole
    return np.stack([(u - cx) / fx * depth, (v - cy) / fy * depth, depth], -1)


def normals_of(depth, pinhole):
    """Camera-frame unit normals towards the camera, from central differences of the 3-D points."""
    points = points_in_cam(depth, pinhole)
    normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def similarity(source, target):
    """Scale s, rotation R, translation t that take source to target in the least-squares sense (Umeyama 1991)."""
    ms, mt = source.mean(0), target.mean(0)
    u, d, vt = np.linalg.svd((target - mt).T @ (source - ms) / len(source))
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ sign @ vt
    scale = np.trace(np.diag(d) @ sign) / ((source - ms) ** 2).sum(1).mean()
    return scale, rotation, mt - scale * rotation @ ms


def figures(depth, pinhole, truth, truth_pinhole, gsd, mask, align):
    ok = mask & np.isfinite(depth) & (depth > 0)
    points = points_in_cam(np.where(ok, depth, np.nan), pinhole)
    if align == "similarity":
        target = points_in_cam(truth, truth_pinhole)
        pick = np.flatnonzero(ok)[:: max(1, ok.sum() // 50000)]
        scale, rotation, shift = similarity(points.reshape(-1, 3)[pick], target.reshape(-1, 3)[pick])
        points = scale * points @ rotation.T + shift
    depth = points[..., 2]
    error = np.where(ok, (depth - truth) / gsd, 0.0)
    bias = np.median(error[ok])
    error = np.where(ok, error - bias, 0.0)
    detail = (error - lowpass(error, ok, DETAIL_SIGMA_PX))[ok]
    filled = np.where(ok, depth, truth)
    cosine = (normals_of(filled, pinhole if align == "none" else truth_pinhole) * normals_of(truth, truth_pinhole)).sum(
        -1
    )
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))[ndimage.binary_erosion(ok)]
    return error, dict(
        coverage=ok.sum() / mask.sum(),
        bias_gsd=bias,
        rmse_gsd=np.sqrt((error[ok] ** 2).mean()),
        detail_rmse_gsd=np.sqrt((detail**2).mean()),
        detail_mad_gsd=robust_spread(detail),
        normal_mae_deg=np.nanmean(angle),
        normal_median_deg=np.nanmedian(angle),
    )


def truth_of(scene, work, pinhole):
    """True depth, the object's pixels, GSD, flat patches by name, and pinhole of a scene."""
    if not (scene / "meta.json").exists():
        truth = np.array(Image.open(scene / "truth" / "depth.tif"), float)
        quality = json.loads((work / "quality.json").read_text())
        patches = {patch["name"]: patch["box"] for patch in quality["patches"]}
        return truth, np.isfinite(truth), quality["gsd"], patches, pinhole
    meta = json.loads((scene / "meta.json").read_text())
    gt = np.load(scene / "gt" / "depth_normal_mask.npz")
    mask = gt["mask"] & (gt["label"] == 1) if (gt["label"] == 1).any() else gt["mask"]
    patches = {patch["name"]: patch["box_xyxy"] for patch in meta.get("flat_patches", [])}
    K = np.array(meta["station"]["K"])
    return gt["depth"].astype(float), mask, meta["gsd_mm"], patches, np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--align", choices=["none", "similarity"], default="none")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()

    pinhole = pinhole_of(args.work / "fused" / "camera.txt")
    truth, mask, gsd, patches, truth_pinhole = truth_of(args.scene, args.work, pinhole)
    inner = np.zeros_like(mask)
    inner[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    mask = ndimage.binary_erosion(mask, np.ones((3, 3)), iterations=BORDER_PX, border_value=1) & inner

    depth = tifffile.imread(args.work / "fused" / "depth.tif").astype(float)
    if depth.shape != truth.shape:
        raise SystemExit(f"fused/depth.tif is {depth.shape}, the scene is {truth.shape}")
    error, out = figures(depth, pinhole, truth, truth_pinhole, gsd, mask, args.align)
    prior_file = args.work / "prior" / "depth.tif"
    if prior_file.exists():
        prior = tifffile.imread(prior_file).astype(float)
        _, before = figures(prior, pinhole, truth, truth_pinhole, gsd, mask, args.align)
        for name in ("rmse_gsd", "detail_rmse_gsd", "detail_mad_gsd", "normal_mae_deg", "normal_median_deg"):
            out["prior_" + name] = before[name]
            out["gain_" + name] = before[name] / max(out[name], 1e-12)
    for name, (x0, y0, x1, y1) in patches.items():
        points = points_in_cam(depth, pinhole)[y0 : y1 + 1, x0 : x1 + 1].reshape(-1, 3)
        points = points[np.isfinite(points).all(1)]
        if len(points) > 10:
            centered = points - points.mean(0)
            out["patch_" + name] = np.linalg.svd(centered, full_matrices=False)[1][-1] / np.sqrt(len(points)) / gsd
    sigma_file = args.work / "fused" / "sigma.tif"
    if sigma_file.exists():
        sigma = tifffile.imread(sigma_file).astype(float) / gsd
        ok = mask & np.isfinite(sigma) & np.isfinite(depth)
        out["sigma_2"] = (np.abs(error[ok]) < 2 * sigma[ok]).mean()
    out = {name: round(float(value), 4) for name, value in out.items()}
    print(json.dumps(out) if args.json else "\n".join(f"{name:24s} {value}" for name, value in out.items()))


if __name__ == "__main__":
    sys.exit(main())
