"""Meshes of one object's points by several libraries, for mesh_score.py: the evidence for decision 68.

    .venv/bin/python benchmarks/object_meshers.py OBJECT.toml WORK -o OUT [--threads 2]

WORK: the finished folder of `malus object OBJECT.toml -o WORK`. Its points are made again, and each mesher makes OUT/NAME.ply of them:

    tangent_planes  as `malus object` does
    colmap          COLMAP's screened Poisson reconstruction
    open3d          the same by Open3D
    tsdf            Open3D's sparse volume of truncated signed distances, from the moved depth maps: it takes no normals

The meshes of the last three are cut as the first one is: no triangle reaches farther than `REACH_GSD` from a point, and small separate
parts are dropped. Prints seconds and triangles. Needs the package open3d (0.19).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from measuring import table
from scipy.spatial import cKDTree

from malus.batch import outcomes_of
from malus.object import Object
from malus.object.agreement import OrientedPoints, object_points
from malus.object.clouds import clouds_of
from malus.object.implicit import MOST_REACH_CELLS, pieces
from malus.object.joining import joined_mesh
from malus.object.meshing import LEAST_PART, poisson_mesh
from malus.object.sharpening import Phases, sharpened, telling
from malus.object.views import View, load_view
from malus.photogrammetry.program import Colmap
from malus.workspace import Workspace

#: Where the tangent planes' mesh ends at the latest.
REACH_GSD = MOST_REACH_CELLS
#: Where a truncated distance is truncated, as Curless and Levoy (1996) advise: a few times the noise of the depths.
_TRUNCATION_GSD = 4.0


def parts_of(work: Path, thing: Object, scratch: Path, threads: int) -> tuple[list[View], OrientedPoints, float]:
    """The stations' moved surfaces, the object's points and its GSD, as `malus object` makes them."""
    done = [outcome for outcome in outcomes_of(thing.campaign, work) if outcome["status"] == "done"]
    folders = {outcome["station"]: work / "stations" / outcome["station"] for outcome in done}
    views = [load_view(name, folder, thing.max_sigma_gsd, threads) for name, folder in folders.items()]
    gsd = float(np.median([view.gsd for view in views]))
    phases = [Phases.of(Workspace(folder), scratch / name) for name, folder in folders.items()]
    moved = list(sharpened(views, telling(views, phases, threads=threads), threads=threads))
    clouds, _ = clouds_of(thing, done, work, gsd, threads)
    return moved, object_points(moved, clouds, threads=threads), gsd


def cut(mesh: trimesh.Trimesh, points: OrientedPoints, reach: float) -> trimesh.Trimesh:
    """Without triangles that reach too far from the points, and without small separate parts."""
    near = cKDTree(points.points).query(mesh.vertices, workers=-1)[0] <= reach
    mesh.update_faces(near[mesh.faces].all(1))
    parts = trimesh.graph.connected_components(mesh.face_adjacency, min_len=1, nodes=np.arange(len(mesh.faces)))
    kept = np.zeros(len(mesh.faces), bool)
    for part in parts:
        kept[part] = len(part) >= LEAST_PART * len(mesh.faces)
    mesh.update_faces(kept)
    mesh.remove_unreferenced_vertices()
    return mesh


def by_open3d(points: OrientedPoints, gsd: float, threads: int) -> trimesh.Trimesh:
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points.points))
    cloud.normals = open3d.utility.Vector3dVector(points.normals.astype(float))
    made, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, width=gsd, n_threads=threads)
    return trimesh.Trimesh(np.asarray(made.vertices), np.asarray(made.triangles), process=False)


def by_tsdf(views: list[View], gsd: float) -> trimesh.Trimesh:
    import open3d

    integration = open3d.pipelines.integration
    volume = integration.ScalableTSDFVolume(
        voxel_length=gsd, sdf_trunc=_TRUNCATION_GSD * gsd, color_type=integration.TSDFVolumeColorType.NoColor
    )
    for view in views:
        depth = np.where(view.usable, view.depth, 0).astype(np.float32)
        height, width = depth.shape
        pinhole = open3d.camera.PinholeCameraIntrinsic(width, height, *view.focal, *view.center)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = view.rotation, view.translation
        image = open3d.geometry.RGBDImage.create_from_color_and_depth(
            open3d.geometry.Image(np.zeros((height, width, 3), np.uint8)), open3d.geometry.Image(depth),
            depth_scale=1.0, depth_trunc=1e9,
        )  # fmt: skip
        volume.integrate(image, pinhole, pose)
    made = volume.extract_triangle_mesh()
    return trimesh.Trimesh(np.asarray(made.vertices), np.asarray(made.triangles), process=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("definition", type=Path, metavar="OBJECT.toml")
    parser.add_argument("work", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    thing, threads = Object.load(arguments.definition), arguments.threads
    rows = []
    with tempfile.TemporaryDirectory(dir=arguments.output) as temporary:
        scratch = Path(temporary)
        views, points, gsd = parts_of(arguments.work, thing, scratch / "phases", threads)
        most_sigma = max(view.most_sigma for view in views)

        def planes() -> trimesh.Trimesh:
            mesh = joined_mesh(pieces(points, gsd, threads), scratch / "planes", most_sigma)
            return trimesh.Trimesh(np.array(mesh.vertices), np.array(mesh.triangles), process=False)

        def colmap() -> trimesh.Trimesh:
            mesh = poisson_mesh(points, gsd, scratch / "colmap", Colmap(threads, "colmap"))
            return trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)

        meshers: dict[str, Callable[[], trimesh.Trimesh]] = {
            "tangent_planes": planes,
            "colmap": lambda: cut(colmap(), points, REACH_GSD * gsd),
            "open3d": lambda: cut(by_open3d(points, gsd, threads), points, REACH_GSD * gsd),
            "tsdf": lambda: cut(by_tsdf(views, gsd), points, REACH_GSD * gsd),
        }
        for name, mesher in meshers.items():
            start = time.perf_counter()
            mesh = mesher()
            mesh.export(arguments.output / f"{name}.ply")
            rows.append([name, f"{time.perf_counter() - start:.1f}", str(len(mesh.faces))])
    print(table(["mesher", "seconds", "triangles"], rows))


if __name__ == "__main__":
    main()
