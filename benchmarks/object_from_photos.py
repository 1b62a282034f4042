"""A whole object from its photographs alone: stations found among them, their surfaces joined and scored.

    python benchmarks/object_from_photos.py SCENE -o OUT [--masks | --turntable] [--points 8] [--mark-px 0.3] [--seed 0]

SCENE: a scene in the round written by rendered/renderer/render.py, with views/, gt_sparse/, gt/mesh.ply and st*/. The stations keep
their polarized images, masks and lenses; cloud and poses are left out. Control points are vertices of the true mesh. They are marked in
the photos that show them, with errors of --mark-px, and bring the object into the frame of the truth, in which the mesh is
scored (rendered/mesh_score.py). Half of the control points are held out: their residuals show the error of the frame.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import trimesh

from malus.camera import Camera
from malus.photogrammetry.model import SparseModel

PHOTO = "view_"
#: Exit code of `malus object` if some stations failed and the others were joined.
SOME_STATIONS_FAILED = 3
#: Side of the cells in which the nearest vertex hides those behind it, in pixels of the photo.
CELL_PX = 3


def project(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N×2, center of the first pixel at 0, 0) and depths of points, in a pinhole camera."""
    rotation, translation = camera.pose()
    places = points @ np.asarray(rotation).T + np.asarray(translation)
    fx, fy, cx, cy = camera.params
    return np.stack([fx * places[:, 0] / places[:, 2] + cx, fy * places[:, 1] / places[:, 2] + cy], -1), places[:, 2]


def is_seen(camera: Camera, mesh: trimesh.Trimesh, chosen: np.ndarray) -> np.ndarray:
    """Which of the chosen vertices are in the image, are seen at less than 60° from their normals, and are nearest in their cell."""
    pixels, depths = project(camera, mesh.vertices)
    cells = np.floor(pixels / CELL_PX).astype(int)
    inside = ((pixels > 5) & (pixels < np.array([camera.width, camera.height]) - 6)).all(1)
    order = {}
    for cell, depth in zip(map(tuple, cells[inside]), depths[inside], strict=True):
        order[cell] = min(depth, order.get(cell, np.inf))
    rotation, translation = (np.asarray(part) for part in camera.pose())
    rays = mesh.vertices[chosen] + rotation.T @ translation
    cosine = -(mesh.vertex_normals[chosen] * rays).sum(1) / np.linalg.norm(rays, axis=1)
    size = np.ptp(mesh.vertices, axis=0).max()
    return np.array([
        inside[i] and c > 0.5 and depths[i] < order[tuple(cells[i])] + 0.01 * size
        for i, c in zip(chosen, cosine, strict=True)
    ])  # fmt: skip


def control_tables(scene: Path, count: int, mark_px: float, random: np.random.Generator) -> str:
    mesh = trimesh.load(scene / "gt/mesh.ply", process=False, force="mesh")
    cameras = {name: image.camera for name, image in SparseModel.read(scene / "gt_sparse").images.items()}
    photos = {name: camera for name, camera in cameras.items() if name.startswith(PHOTO)}
    chosen = random.choice(len(mesh.vertices), 20 * count, replace=False)
    seen = {name: is_seen(camera, mesh, chosen) for name, camera in photos.items()}
    often = np.flatnonzero(sum(marks.astype(int) for marks in seen.values()) >= 4)[:count]
    if len(often) < count:
        sys.exit(f"{scene}: only {len(often)} places are seen by four photos, expected {count}")
    tables = []
    for number, k in enumerate(often):
        place = mesh.vertices[chosen[k]]
        marks = []
        for name, camera in photos.items():
            if seen[name][k]:
                ((u, v),) = project(camera, place[None])[0] + random.normal(0, mark_px, 2)
                marks.append(f'{{ image = "{name}", x = {u:.2f}, y = {v:.2f} }}')
        tables.append(
            f'[[control]]\nname = "P{number}"\nxyz = {[round(float(x), 5) for x in place]}\nmarks = [{", ".join(marks)}]\n'
            + ("check = true\n" if number % 2 else "")
        )
    return "\n".join(tables)


def lens_keys(camera: Camera) -> str:
    """A pinhole lens in the syntax and convention of station files: the center of the first pixel at 0.5, 0.5."""
    fx, fy, cx, cy = camera.params
    return (
        f'model = "PINHOLE", width = {camera.width}, height = {camera.height}, params = {[fx, fy, cx + 0.5, cy + 0.5]}'
    )


def write_masks(scene: Path, folder: Path) -> None:
    """Write the true outline of the mesh in every photo."""
    folder.mkdir(parents=True, exist_ok=True)
    mesh = trimesh.load(scene / "gt/mesh.ply", process=False, force="mesh")
    for name, image in SparseModel.read(scene / "gt_sparse").images.items():
        if name.startswith(PHOTO):
            mask = np.zeros((image.camera.height, image.camera.width), np.uint8)
            pixels = project(image.camera, mesh.vertices)[0]
            for corners in np.rint(16 * pixels[mesh.faces]).astype(np.int32):
                cv2.fillConvexPoly(mask, corners, 255, shift=4)
            cv2.imwrite(str(folder / f"{name}.png"), mask)


def write_object(scene: Path, folder: Path, tables: str, masks: Path | None, *, turntable: bool) -> Path:
    """Write the object file beside its station files, which keep only images, mask and lens."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras = {name: image.camera for name, image in SparseModel.read(scene / "gt_sparse").images.items()}
    stations = sorted(scene.glob("st*/station.toml"))
    exclude = [f"{station.parent.name}.jpg" for station in stations]
    photos = (
        f'[photos]\nfolder = "{scene.resolve() / "views"}"\nexclude = {exclude}\n'
        f"camera = {{ {lens_keys(cameras[f'{PHOTO}00.jpg'])} }}\n" + (f'masks = "{masks.resolve()}"\n' if masks else "")
    )
    names = []
    for station, own in zip(stations, exclude, strict=True):
        images = station.parent.resolve()
        text = station.read_text().split("[camera]")[0].replace('"pol/', f'"{images}/pol/')
        text = text.replace('"mask.png"', f'"{images}/mask.png"')
        lens = "\n".join(lens_keys(cameras[own]).split(", ", 3))
        names.append(f"{station.parent.name}.toml")
        (folder / names[-1]).write_text(f"{text}[camera]\n{lens}\n\n{photos}")
    (folder / "object.toml").write_text(
        f'[object]\nname = "{scene.name} from photos"\nunit = "mm"\nstations = {names}\nturntable = {str(turntable).lower()}\n\n{photos}\n{tables}'
    )
    return folder / "object.toml"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--masks", action="store_true", help="give the photos the object's true outlines")
    parser.add_argument("--turntable", action="store_true", help="as --masks, and nothing counts outside of them")
    parser.add_argument("--points", type=int, default=8)
    parser.add_argument("--mark-px", type=float, default=0.3)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    tables = control_tables(args.scene, args.points, args.mark_px, np.random.default_rng(args.seed))
    masks = args.output / "masks" if args.masks or args.turntable else None
    if masks is not None:
        write_masks(args.scene, masks)
    file = write_object(args.scene, args.output / "files", tables, masks, turntable=args.turntable)
    command = [Path(sys.executable).with_name("malus"), "object", file, "-o", args.output / "work", "--jobs", "2"]
    if subprocess.run(command, check=False).returncode not in (0, SOME_STATIONS_FAILED):
        sys.exit(1)
    score = Path(__file__).parent / "rendered/mesh_score.py"
    subprocess.run([sys.executable, score, args.scene, args.output / "work/object/mesh.ply"], check=True)


if __name__ == "__main__":
    main()
