"""Cameras and depth from real photographs with known projection matrices, through the same front end as a station's photos.

    .venv/bin/python benchmarks/real_photos.py FOLDER [--station 00031.png] [--work WORK]

FOLDER holds photographs of one pinhole camera and beside each `NAME_P.txt`, its 3 × 4 projection matrix. One photograph serves as the
station's image. Prints the errors of the cameras' centers and directions after a similarity, and the figures and sigma of the sweep;
writes the station's view, its depth and its confidence as WORK/depth.png.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import tifffile
from numpy.typing import NDArray

from malus.camera import Camera
from malus.options import Options
from malus.photogrammetry import find_cameras, sweep_station
from malus.photogrammetry.photos import read_gray


@dataclass(frozen=True)
class GivenCamera:
    """Pose and calibration from a projection matrix."""

    center: NDArray[np.float64]
    rotation: NDArray[np.float64]
    """Camera from world."""
    calibration: NDArray[np.float64]


def read_camera(path: Path) -> GivenCamera:
    """Camera of a 3 × 4 projection matrix."""
    matrix = np.loadtxt(path, max_rows=3, dtype=float)
    left = matrix[:, :3] * np.sign(np.linalg.det(matrix[:, :3]))
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ left).T)
    signs = np.diag(np.sign(np.diag(flip @ r.T @ flip)))
    calibration = flip @ r.T @ flip @ signs
    center = -np.linalg.solve(matrix[:, :3], matrix[:, 3])
    return GivenCamera(center, signs @ flip @ q.T, calibration / calibration[2, 2])


def similarity(
    source: NDArray[np.float64], target: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Scale, rotation and shift that take source to target in the least-squares sense (Umeyama 1991)."""
    a, b = source - source.mean(0), target - target.mean(0)
    u, d, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ sign @ vt
    scale = float(np.trace(np.diag(d) @ sign) / (a**2).sum())
    return scale, rotation, target.mean(0) - scale * rotation @ source.mean(0)


def main() -> None:
    """Run the front end and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--station", default="00031.png")
    parser.add_argument("--work", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="section.key=value")
    arguments = parser.parse_args()
    work = arguments.work or Path(tempfile.mkdtemp())
    coded = read_gray(arguments.folder / arguments.station)
    height, width = coded.shape
    given = {path.name: read_camera(path.with_name(f"{path.stem}_P.txt")) for path in arguments.folder.glob("*.png")}
    k = given[arguments.station].calibration
    lens = {"model": "PINHOLE", "width": width, "height": height, "params": [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]}
    description = {
        "photos": {"folder": str(arguments.folder), "exclude": [arguments.station], "masks": None, "camera": lens},
        "camera": lens,
        "scale": [],
        "control": [],
    }
    options = Options()
    for assignment in arguments.set:
        options.set(assignment)
    linear = np.power(coded, 2.2, dtype=np.float32)
    common = {"options": options, "threads": 2, "log": lambda level, message: print(f"{level}: {message}")}
    cameras = find_cameras(description, linear, work, **common)
    figures = cameras.figures["photogrammetry"]
    print(f"{figures['registered']} of {figures['photos']} photos and the station registered; windows: "
          f"{json.dumps(figures['windows'])}")  # fmt: skip

    found: dict[str, Camera] = {photo.name: camera for photo, camera in cameras.photos}
    found[arguments.station] = cameras.station
    names = sorted(found)
    centers = np.array([-found[name].rotation.T @ found[name].translation for name in names])
    truth = np.array([given[name].center for name in names])
    scale, turn, shift = similarity(centers, truth)
    errors = np.linalg.norm(scale * centers @ turn.T + shift - truth, axis=1)
    angles = [
        np.degrees(np.arccos(np.clip((np.trace(found[n].rotation @ turn.T @ given[n].rotation.T) - 1) / 2, -1, 1)))
        for n in names
    ]
    extent = np.linalg.norm(truth - truth.mean(0), axis=1).max()
    print(f"centers: {np.median(errors) / extent:.2e} of the cameras' extent (median), {errors.max() / extent:.2e} (largest); "
          f"directions: {np.median(angles):.4f}° (median), {max(angles):.4f}° (largest)")  # fmt: skip

    mask = np.full(coded.shape, 255, np.uint8)
    swept = sweep_station(cameras, linear, mask, work, **common)
    depth = swept.depth
    confidence = tifffile.imread(work / "sweep_confidence.tif")
    gsd = depth / k[0, 0]
    print(
        f"sweep: {json.dumps(swept.figures)}; sigma over GSD, quartiles {np.nanpercentile(swept.sigma / gsd, [25, 50, 75]).round(2)}"
    )
    figure, axes = plt.subplots(1, 3, figsize=(15, 4), constrained_layout=True)
    axes[0].imshow(coded, cmap="gray")
    low, high = np.nanpercentile(depth, [1, 99])
    axes[1].imshow(depth, cmap="turbo", vmin=low, vmax=high)
    axes[2].imshow(confidence, cmap="viridis", vmin=0, vmax=1)
    for axis, title in zip(axes, ("station's view", "depth", "confidence"), strict=True):
        axis.set_title(title)
        axis.set_axis_off()
    figure.savefig(work / "depth.png", dpi=90)
    print(work / "depth.png")


if __name__ == "__main__":
    main()
