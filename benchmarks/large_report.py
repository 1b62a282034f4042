"""Time, memory and size of the report of a large station: a workspace enlarged from a smaller one.

    python benchmarks/large_report.py WORK -o LARGE [--megapixels 18] [--noise 0.01]

Rasters are enlarged (linearly; labels and masks by the nearest pixel), and the camera is scaled accordingly. Enlarged
rasters are smoother than real ones and would compress too well, so they get noise. `--noise` is the standard deviation:
for normals of their components, for depths as a share of a GSD, for all other rasters as a share of the value. Printed:
CPU and wall-clock seconds, peak memory and the size of the page.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import shutil
import time
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

import malus.report


def enlarged(raster: NDArray[np.floating], shape: tuple[int, int], order: int) -> NDArray[np.floating]:
    rows = (np.arange(shape[0]) + 0.5) * raster.shape[0] / shape[0] - 0.5
    columns = (np.arange(shape[1]) + 0.5) * raster.shape[1] / shape[1] - 0.5
    grid = np.meshgrid(rows, columns, indexing="ij")
    planes = raster[..., None] if raster.ndim == 2 else raster
    result = [ndimage.map_coordinates(plane, grid, order=order, mode="nearest") for plane in np.moveaxis(planes, -1, 0)]
    return np.squeeze(np.stack(result, -1)) if raster.ndim == 2 else np.stack(result, -1)


def enlarge(work: Path, large: Path, megapixels: float, noise: float) -> None:
    random = np.random.default_rng(0)
    depth = tifffile.imread(work / "fused/depth.tif")
    factor = float(np.sqrt(megapixels * 1e6 / depth.size))
    shape = (round(depth.shape[0] * factor), round(depth.shape[1] * factor))
    quality = json.loads((work / "quality.json").read_text())
    quality["gsd"] /= factor
    quality["width"], quality["height"] = shape[1], shape[0]
    for path in sorted(work.rglob("*")):
        name = path.relative_to(work)
        target = large / name
        if path.is_dir() or name.parts[0] == "report" or name.name in ("surface.ply", "surface.glb", "dem.tif"):
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".tif":
            raster = enlarged(tifffile.imread(path).astype(np.float32), shape, 1)
            if name.name == "normals.tif":
                raster += noise * random.standard_normal(raster.shape)
                raster /= np.linalg.norm(raster, axis=-1, keepdims=True)
            elif name.name == "depth.tif":
                raster += noise * quality["gsd"] * random.standard_normal(raster.shape)
            else:
                raster *= 1 + noise * random.standard_normal(raster.shape)
            tifffile.imwrite(target, raster.astype(np.float32), photometric="rgb" if raster.ndim == 3 else "minisblack")
        elif path.suffix == ".png":
            Image.fromarray(enlarged(np.asarray(Image.open(path)), shape, 0)).save(target)
        else:
            shutil.copy(path, target)
    (large / "quality.json").write_text(json.dumps(quality))
    manifest = json.loads((work / "manifest.json").read_text())
    for step in manifest["steps"].values():
        camera = step.get("notes", {}).get("camera")
        if camera:
            camera["width"], camera["height"] = shape[1], shape[0]
            for key in ("fx", "fy"):
                camera[key] *= factor
            for key in ("cx", "cy"):
                camera[key] = factor * (camera[key] + 0.5) - 0.5
    (large / "manifest.json").write_text(json.dumps(manifest))


def write_report(large: Path) -> None:
    """Write the report without the workspace's checks, which would refuse files that differ from the manifest."""
    malus.Workspace.path = lambda self, name: self.folder / name
    malus.Workspace.has = lambda self, name: (self.folder / name).is_file()
    malus.Workspace.manifest = json.loads((large / "manifest.json").read_text())
    malus.report.write_report(large)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--megapixels", type=float, default=18)
    parser.add_argument("--noise", type=float, default=0.01)
    args = parser.parse_args()
    if not args.output.exists():
        enlarge(args.work, args.output, args.megapixels, args.noise)
    # A process of its own, so that its peak memory is that of the report alone.
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    process = multiprocessing.get_context("spawn").Process(target=write_report, args=(args.output,))
    process.start()
    process.join()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    page = malus.Workspace(args.output).folder / "report/index.html"
    cpu = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    print(f"{cpu:.1f} CPU s, {time.perf_counter() - start:.1f} s, {used.ru_maxrss / 2**20:.2f} GB, "
          f"{page.stat().st_size / 1e6:.1f} MB")  # fmt: skip


if __name__ == "__main__":
    main()
