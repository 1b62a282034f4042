"""Light and height of rendered stations without their prior, compared with the truth.

    python benchmarks/light.py SCENE [SCENE …]

SCENE: a folder written by rendered/renderer/render.py. Its station runs without [prior] up to the height, once for each
value of light.without_prior. The reference light is the one that follows from the true normals. Printed: the angle
between the reference light and the view; the angle of the found light to the reference light, with "opposite" if the
found light is nearer to the reference light turned by 180° about the view; and the median angle between the height's
normals and the true ones.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import malus

sys.path.insert(0, str(Path(__file__).resolve().parent / "rendered"))
from score import normals_of

ASSUMPTIONS = ("contour", "convex")


def angle_deg(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


def without_prior(scene: Path, folder: Path) -> Path:
    """The station file without [prior], among links to the scene's files and to the files beside the scene's folder."""
    copy = folder / scene.name
    copy.mkdir()
    for entry in (*scene.parent.iterdir(), *scene.iterdir()):
        if entry.resolve() != scene.resolve():
            (folder / entry.relative_to(scene.parent)).symlink_to(entry.resolve())
    path = copy / "station_without_prior.toml"
    path.unlink(missing_ok=True)
    path.write_text(re.sub(r"(?m)^\[prior\][^\[]*", "", (scene / "station.toml").read_text()))
    return path


def row(scene: Path) -> str:
    with tempfile.TemporaryDirectory(prefix="malus-") as folder:
        station = malus.Station.load(without_prior(scene, Path(folder)))
        return row_of(station, scene)


def row_of(station: malus.Station, scene: Path) -> str:
    truth = np.load(scene / "gt/depth_normal_mask.npz")
    cells = [scene.name]
    for assumption in ASSUMPTIONS:
        options = malus.Options(light={"without_prior": assumption})
        with tempfile.TemporaryDirectory(prefix="malus-") as folder:
            result = malus.reconstruct(station, options, workspace=folder, until="height", threads=2)
            found = np.array(malus.Workspace(folder).manifest["steps"]["height"]["notes"]["light"][:3])
        assert result.unpolarized is not None and result.zenith_rad is not None and result.camera is not None
        assert result.polarization_height is not None
        seen = truth["mask"] & np.isfinite(result.zenith_rad)
        light = malus.height.light(result.unpolarized, truth["normal"], mask=seen, camera=result.camera)["light"][:3]
        if len(cells) == 1:
            cells.append(f"{angle_deg(light, np.array([0, 0, -1.0])):.0f}°")
        error, opposite = angle_deg(found, light), angle_deg(found * [-1, -1, 1], light)
        cells.append(f"{error:.1f}°" + (" opposite" if opposite < error else ""))
        fx, fy, cx, cy = result.camera.params
        normals = normals_of(np.exp(-result.polarization_height.astype(float) / fx), (fx, fy, cx, cy))
        cosine = np.clip((normals * truth["normal"]).sum(-1), -1, 1)[seen]
        cells.append(f"{np.nanmedian(np.degrees(np.arccos(cosine))):.1f}°")
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path, metavar="SCENE")
    args = parser.parse_args()
    header = ["station", "light", *(f"{name}, {what}" for name in ASSUMPTIONS for what in ("light", "normals"))]
    print("| " + " | ".join(header) + " |\n" + "|---" * len(header) + "|")
    for scene in args.scenes:
        print(row(scene), flush=True)


if __name__ == "__main__":
    main()
