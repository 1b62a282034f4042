"""Scale from coded targets: the photos of a rendered scene with printed targets laid on the object, through the front end.

    python benchmarks/coded_targets.py SCENE -o WORK [--dictionary aruco_4x4_50] [--side-mm 22]

SCENE: a folder written by rendered/renderer/render.py, with views/, gt_sparse/ and station_photos.toml, which has the marks of three points.
In every photo a square target is drawn at each of these points, in the plane of the three. The distances of the targets' centers replace
the marked distances: two in the adjustment, the third as a check. Prints where the targets were found, the adjustment's residuals, and the
scale's error against the true poses. Needs `pip install opencv-python-headless scipy`.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from real_photos import similarity
from sweep import read_cameras

import malus
from malus.camera import Camera
from malus.photogrammetry import SparseModel

Array = NDArray[np.floating]
SUPERSAMPLING = 4
PAPER, INK = 215.0, 25.0


def triangulated(marks: list[dict[str, Any]], cameras: dict[str, Camera]) -> Array:
    """Point nearest to the rays of its marks."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for mark in marks:
        camera = cameras[mark["image"]]
        fx, fy, cx, cy = camera.params
        ray = camera.rotation.T @ np.array([(mark["x"] - cx) / fx, (mark["y"] - cy) / fy, 1])
        across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        normal += across
        right += across @ (-camera.rotation.T @ camera.translation)
    return np.linalg.solve(normal, right)


def draw_target(photo: Array, camera: Camera, pattern: Array, corners: Array) -> None:
    """Draw a square pattern into a photo; its corners lie at these points (4×3, clockwise from the upper left)."""
    seen = (corners @ camera.rotation.T + camera.translation).T
    fx, fy, cx, cy = camera.params
    pixels = np.stack([fx * seen[0] / seen[2] + cx, fy * seen[1] / seen[2] + cy], axis=1)
    height, width = photo.shape[:2]
    side = pattern.shape[0]
    source = np.float32([[0, 0], [side, 0], [side, side], [0, side]]) - 0.5
    target = np.float32((pixels + 0.5) * SUPERSAMPLING - 0.5)
    to_photo = cv2.getPerspectiveTransform(source, target)
    large = (width * SUPERSAMPLING, height * SUPERSAMPLING)
    paper = cv2.warpPerspective(pattern, to_photo, large, flags=cv2.INTER_LINEAR)
    cover = cv2.warpPerspective(np.ones_like(pattern), to_photo, large, flags=cv2.INTER_LINEAR)
    paper, cover = (cv2.resize(x, (width, height), interpolation=cv2.INTER_AREA)[..., None] for x in (paper, cover))
    photo *= 1 - cover
    photo += INK * cover + (PAPER - INK) * paper


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--work", type=Path, required=True)
    parser.add_argument("--dictionary", default="aruco_4x4_50")
    parser.add_argument("--side-mm", type=float, default=22)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    scene, folder = arguments.scene, arguments.work / "station"
    description = tomllib.loads((scene / "station_photos.toml").read_text())
    cameras = read_cameras(scene / "gt_sparse")
    bars = description["scale"]
    points = np.array([triangulated(marks, cameras) for marks in (bars[0]["a"], bars[0]["b"], bars[1]["a"])])

    # Axes of the targets in the plane of the points; the normal `up` points to the side of the cameras.
    up = np.cross(points[1] - points[0], points[2] - points[0])
    center = np.mean([-c.rotation.T @ c.translation for c in cameras.values()], axis=0)
    up *= np.sign(up @ (center - points[0])) / np.linalg.norm(up)
    across = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
    down = np.cross(across, up)
    name, family = arguments.dictionary, "DICT_" + arguments.dictionary.removeprefix("aruco_").upper()
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, family))
    quiet = 1.35  # paper around the ink
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "views").mkdir(parents=True)
    for path in sorted((scene / "views").glob("view_*.jpg")):
        photo = np.float32(cv2.imread(str(path)))
        for number, point in enumerate(points):
            ink = cv2.aruco.generateImageMarker(dictionary, number, 300)
            border = round(300 * (quiet - 1) / 2)
            pattern = np.float32(np.pad(ink, border, constant_values=255)) / 255
            half = quiet * arguments.side_mm / 2
            corners = np.array(
                [point + half * (a * across + b * down) for a, b in [(-1, -1), (1, -1), (1, 1), (-1, 1)]]
            )
            draw_target(photo, cameras[path.name], pattern, corners)
        cv2.imwrite(str(folder / "views" / path.name), photo, [cv2.IMWRITE_JPEG_QUALITY, 95])

    text = (scene / "station_photos.toml").read_text()
    head = text[: text.index("[[scale]]")].replace('"pol/', f'"{scene.resolve()}/pol/')
    head = "\n".join(line for line in head.splitlines() if not line.startswith("exclude")) + "\n"
    scales = [
        f'[[scale]]\ndistance = {np.linalg.norm(points[a] - points[b]):.4f}\ntargets = [{a}, {b}]\n'
        f'targets_dictionary = "{name}"\ncheck = {"true" if (a, b) == (1, 2) else "false"}\n'
        for a, b in [(0, 1), (0, 2), (1, 2)]
    ]  # fmt: skip
    (folder / "station.toml").write_text(head + "\n".join(scales))

    options = malus.Options("grid", sweep={"again": False})
    workspace = arguments.work / "workspace"
    station = malus.Station.load(folder / "station.toml")
    result = malus.reconstruct(station, options, workspace=workspace, threads=arguments.threads)
    assert result.quality is not None
    print(json.dumps(result.quality["scale"], indent=1))
    images = SparseModel.read(workspace / "prior" / "colmap" / "model").images
    found = {name: image.camera for name, image in images.items()}
    names = sorted(name for name in found if name.startswith("view_"))
    centers = [np.array([-c[n].rotation.T @ c[n].translation for n in names]) for c in (found, cameras)]
    scale, _, _ = similarity(*centers)
    print(f"{len(names)} photos, scale error {100 * (scale - 1):+.4f} %")


if __name__ == "__main__":
    main()
