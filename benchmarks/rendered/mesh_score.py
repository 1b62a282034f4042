#!/usr/bin/env python3
"""Scores a mesh of a whole object against the true mesh of a scene with several stations.

    mesh_score.py SCENE MESH [--json]        SCENE has gt/mesh.ply, gt_sparse/, st*/station.toml, st*/gt/; MESH in the same frame and unit

Figures for the parts that a station sees (its true depth map contains the point), in units of the scene's median GSD: precision, recall and
F-score at 1 and 0.5 GSD, median and RMS distance of the mesh from the truth, Chamfer distance (mean of both directions), median angle between
normals; for the whole object: recall_all at 1 GSD. Distances are from densely sampled points to the plane of the nearest sample of the other mesh.
Needs numpy, scipy, trimesh.
"""

import argparse
import json
import tomllib
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation


def samples(mesh, spacing):
    """Sample points about `spacing` apart, and the normals of their faces."""
    count = int(np.clip(mesh.area / spacing**2 * 2, 1e4, 3e6))
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=0)
    return np.asarray(points), mesh.face_normals[faces]


def stations(scene):
    """Rotation, translation, K values, true depth and mask of every station."""
    images = {
        r[9]: r
        for r in (line.split() for line in open(scene / "gt_sparse/images.txt"))
        if len(r) == 10 and not r[0].startswith("#")
    }
    cameras = {
        r[0]: r
        for r in (line.split() for line in open(scene / "gt_sparse/cameras.txt"))
        if r and not r[0].startswith("#")
    }
    for folder in sorted(scene.glob("st*/station.toml")):
        row = images[tomllib.loads(folder.read_text())["camera"]["image"]]
        w, x, y, z = map(float, row[1:5])
        truth = np.load(folder.parent / "gt/depth_normal_mask.npz")
        yield (
            Rotation.from_quat([x, y, z, w]).as_matrix(),
            np.array(row[5:8], float),
            np.array(cameras[row[8]][4:], float),
            truth["depth"],
            truth["mask"],
        )


def seen(points, views, tolerance):
    found = np.zeros(len(points), bool)
    for R, t, (fx, fy, cx, cy), depth, mask in views:
        p = points @ R.T + t
        u, v = np.floor(p[:, 0] / p[:, 2] * fx + cx).astype(int), np.floor(p[:, 1] / p[:, 2] * fy + cy).astype(int)
        inside = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0]) & (p[:, 2] > 0)
        u, v = np.where(inside, u, 0), np.where(inside, v, 0)
        found |= inside & mask[v, u] & (np.abs(depth[v, u] - p[:, 2]) < tolerance)
    return found


def distances(points, other, normals, spacing):
    """Distance of each point to the plane of the nearest sample of the other mesh; to the sample itself if it is far. Also its index."""
    away, nearest = cKDTree(other).query(points, workers=-1)
    plane = np.abs(((points - other[nearest]) * normals[nearest]).sum(1))
    return np.where(away < 3 * spacing, plane, away), nearest


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("scene", type=Path)
    arguments.add_argument("mesh", type=Path)
    arguments.add_argument("--json", action="store_true")
    known = arguments.parse_args()
    views = list(stations(known.scene))
    gsd = float(np.median([np.median(depth[mask]) / fx for _, _, (fx, _, _, _), depth, mask in views]))
    spacing = gsd / 2
    truth, truth_normals = samples(trimesh.load(known.scene / "gt/mesh.ply", process=False, force="mesh"), spacing)
    mesh = trimesh.load(known.mesh, process=False, force="mesh")
    made, made_normals = samples(mesh, spacing)
    visible = seen(truth, views, 4 * gsd)
    to_truth, nearest = distances(made, truth, truth_normals, spacing)
    counted = visible[nearest]
    to_made, _ = distances(truth, made, made_normals, spacing)
    angle = np.degrees(np.arccos(np.clip(np.abs((made_normals * truth_normals[nearest]).sum(1)), 0, 1)))
    figures = {
        "gsd": gsd,
        "watertight": bool(mesh.is_watertight),
        "faces": len(mesh.faces),
        "visible_share": float(visible.mean()),
    }
    for limit in (1, 0.5):
        precision, recall = (
            float((to_truth[counted] < limit * gsd).mean()),
            float((to_made[visible] < limit * gsd).mean()),
        )
        figures |= {
            f"precision_{limit:g}": precision,
            f"recall_{limit:g}": recall,
            f"f_score_{limit:g}": 2 * precision * recall / max(precision + recall, 1e-9),
        }
    figures |= {
        "median_gsd": float(np.median(to_truth[counted]) / gsd),
        "rms_gsd": float(np.sqrt((to_truth[counted] ** 2).mean()) / gsd),
        "chamfer_gsd": float((to_truth[counted].mean() + to_made[visible].mean()) / 2 / gsd),
        "normal_median_deg": float(np.median(angle[counted])),
        "recall_all_1": float((to_made < gsd).mean()),
    }
    print(json.dumps(figures) if known.json else "\n".join(f"{k:18s} {v}" for k, v in figures.items()))


if __name__ == "__main__":
    main()
