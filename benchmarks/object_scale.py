"""Whole objects at the size of cameras and of monuments: minutes and memory of every part.

    .venv/bin/python benchmarks/object_scale.py SCENE -o OUT [--megapixels 0.2 1 4] [--copies 0] [--threads 2]

SCENE: a scene in the round as rendered/renderer/render.py leaves it. Its stations are enlarged to each of these sizes (cubic
interpolation, and noise of the sensor anew), and `malus object` is run on them. Memory is what the processes hold and cannot give back
(anonymous pages), at its peak. With --copies the largest object is then repeated side by side so many times, in memory, and its surface
is made as `malus object` makes it: a monument of six times as many stations.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from measuring import ROOT, table
from PIL import Image

from malus.object import Object, run, texture
from malus.object.agreement import object_points
from malus.object.color import Paint
from malus.object.implicit import pieces
from malus.object.joining import joined_mesh
from malus.object.mesh_file import write_mesh
from malus.object.sharpening import Phases, sharpened, telling
from malus.object.views import View, load_view, stored
from malus.workspace import Workspace

_FULL_WELL_E, _READ_NOISE_E, _FRAMES, _WHITE = 20000.0, 8.0, 16, 16383
_SAMPLE_S = 0.5


def held_gb(process: int) -> float:
    """Anonymous memory of a process and all that it started."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rpartition(")")[2].split()
        except OSError:  # It ended meanwhile.
            continue
        children.setdefault(int(fields[1]), []).append(int(entry.parent.name))
    total, waiting = 0, [process]
    while waiting:
        one = waiting.pop()
        waiting += children.get(one, [])
        try:
            status = Path(f"/proc/{one}/status").read_text()
        except OSError:
            continue
        total += sum(int(line.split()[1]) for line in status.splitlines() if line.startswith("RssAnon"))
    return total * 1024 / 1e9


@contextmanager
def peak_of(process: int) -> Iterator[list[float]]:
    """The highest `held_gb` until the end of the block, as the only element of a list."""
    peak, done = [0.0], threading.Event()

    def look() -> None:
        while not done.wait(_SAMPLE_S):
            peak[0] = max(peak[0], held_gb(process))

    watch = threading.Thread(target=look, daemon=True)
    watch.start()
    try:
        yield peak
    finally:
        done.set()
        watch.join()


def enlarged(scene: Path, folder: Path, factor: float) -> Path:
    """A copy of the scene whose stations have `factor` times as many pixels a side; returns its object file."""
    shutil.copytree(scene / "dense", folder / "dense")
    shutil.copytree(scene / "gt_sparse", folder / "gt_sparse")
    shutil.copy(scene / "object.toml", folder)
    random = np.random.default_rng(0)
    sizes = {}
    for station in sorted(scene.glob("st?")):
        other = folder / station.name
        (other / "pol/lownoise").mkdir(parents=True)
        shutil.copy(station / "station.toml", other)
        mask = cv2.imread(str(station / "mask.png"), cv2.IMREAD_GRAYSCALE)
        size = (round(mask.shape[1] * factor), round(mask.shape[0] * factor))
        sizes[f"{station.name}.jpg"] = size
        Image.fromarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST)).save(other / "mask.png")
        for path in sorted((station / "pol/lownoise").glob("*.png")):
            image = cv2.resize(
                cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float32), size, interpolation=cv2.INTER_CUBIC
            )
            electrons = np.clip(image, 0, None) * (_FULL_WELL_E / _WHITE)
            noise = np.sqrt((electrons + _READ_NOISE_E**2) / _FRAMES) * random.standard_normal(image.shape, np.float32)
            image = np.clip(np.rint((electrons + noise) * (_WHITE / _FULL_WELL_E)), 0, _WHITE).astype(np.uint16)
            Image.fromarray(image).save(other / "pol/lownoise" / path.name, compress_level=1)
    enlarge_cameras(folder / "gt_sparse", sizes)
    return folder / "object.toml"


def enlarge_cameras(model: Path, sizes: dict[str, tuple[int, int]]) -> None:
    """Rewrite the pinhole cameras of these images for their new sizes."""
    of_camera = {}
    for line in (model / "images.txt").read_text().splitlines():
        fields = line.split()
        if len(fields) == 10 and fields[9] in sizes:
            of_camera[fields[8]] = sizes[fields[9]]
    lines = []
    for line in (model / "cameras.txt").read_text().splitlines():
        fields = line.split()
        if fields and fields[0] in of_camera:
            width, height = of_camera[fields[0]]
            # COLMAP's pixels begin at their corner, so that all parameters grow alike.
            across, down = width / int(fields[2]), height / int(fields[3])
            scaled = [float(value) * by for value, by in zip(fields[4:], (across, down, across, down), strict=True)]
            line = f"{fields[0]} {fields[1]} {width} {height} {' '.join(map(str, scaled))}"
        lines.append(line)
    (model / "cameras.txt").write_text("\n".join(lines) + "\n")


def measure_object(definition: Path, output: Path, threads: int) -> list[str]:
    """Run `malus object`; megapixels, minutes of stations and of the surface, peak memory, triangles."""
    start = time.perf_counter()
    process = subprocess.Popen(
        [ROOT / ".venv/bin/malus", "object", definition, "-o", output, "--threads", str(threads)]
    )
    with peak_of(process.pid) as peak:
        if process.wait() != 0:
            raise SystemExit(f"malus object ended with {process.returncode}")
    minutes = (time.perf_counter() - start) / 60
    manifests = [json.loads(path.read_text()) for path in (output / "stations").glob("*/manifest.json")]
    stations = sum(step["seconds"] for manifest in manifests for step in manifest["times"].values()) / 60
    quality = json.loads((output / "object/quality.json").read_text())
    depths = [
        Workspace(path.parent).raster("fused/depth.tif") for path in (output / "stations").glob("*/manifest.json")
    ]
    pixels = sum(depth.size for depth in depths) / 1e6
    return [
        f"{pixels / len(depths):.2g}", f"{minutes:.1f}", f"{stations:.1f}", f"{minutes - stations:.1f}",
        f"{60 * minutes / pixels:.0f}", f"{peak[0]:.2f}", f"{quality['mesh']['triangles'] / 1e6:.2f}",
    ]  # fmt: skip


def repeated(view: View, count: int, side: float) -> Iterator[View]:
    """The view and its copies, each a side farther along the world's x."""
    for k in range(count):
        shift = view.rotation @ np.array([k * side, 0.0, 0.0])
        yield replace(view, name=f"{view.name}-{k}", translation=view.translation - shift)


def measure_monument(definition: Path, output: Path, copies: int, threads: int) -> list[list[str]]:
    """The surface of the object's copies: seconds of every part, the peak until then, and how many of what there are."""
    thing = Object.load(definition)
    rows: list[list[str]] = []
    start = time.perf_counter()
    with tempfile.TemporaryDirectory(dir=output) as temporary, peak_of(os.getpid()) as peak:
        scratch = Path(temporary)

        def done(part: str, count: str) -> None:
            rows.append([part, f"{(time.perf_counter() - start) / 60:.1f}", f"{peak[0]:.2f}", count])
            print(" | ".join(rows[-1]), flush=True)

        workspaces = sorted((output / "stations").iterdir())
        read = [stored(load_view(path.name, path, thing.max_sigma_gsd), scratch / path.name) for path in workspaces]
        phases = [Phases.of(Workspace(path), scratch / f"{path.name}-phases") for path in workspaces]
        done("stations read", f"{len(read)} of {sum(view.depth.size for view in read) / 1e6:.0f} megapixels")
        told = telling(read, phases, threads=threads)
        # Copies do not see each other, so that what they become is the same for all.
        moved = [stored(view, scratch / f"{view.name}-moved") for view in sharpened(read, told, threads=threads)]
        done("moved to the phases", f"{len(moved)} stations")
        side = 1.05 * max(np.ptp(view.points_at(*np.nonzero(view.usable))[:, 0]) for view in moved)
        views = [copy for view in moved for copy in repeated(view, copies, side)]
        gsd = float(np.median([view.gsd for view in views]))
        points = object_points(views, [], threads=threads)
        done("points", f"{len(points.points) / 1e6:.1f} million of {len(views)} stations")
        most_sigma = max(view.most_sigma for view in views)
        mesh = joined_mesh(pieces(points, gsd, threads), scratch / "open", most_sigma)
        done("mesh", f"{len(mesh.triangles) / 1e6:.1f} million triangles")
        paint = Paint.of(views, mesh.vertices, mesh.normals)
        simpler = run._simpler(thing, mesh, points, gsd, most_sigma, scratch, threads)
        done("coarser mesh", f"{0 if simpler is None else len(simpler.triangles) / 1e6:.1f} million triangles")
        baked = texture.levels_of_detail(mesh, thing.faces, paint, gsd, simpler)
        done("textures", f"{len(baked)} levels, {len(baked[0].color)} texels a side")
        seeing = np.zeros(len(mesh.vertices), np.uint8)  # not counted here
        write_mesh(output / "monument.ply", mesh, paint, seeing, {}, scratch)
        done("written", f"{(output / 'monument.ply').stat().st_size / 1e9:.1f} GB")
    (output / "monument.ply").unlink()
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--megapixels", type=float, nargs="+", default=[0.2, 1, 4], help="of a station")
    parser.add_argument("--copies", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    with Image.open(next(iter(sorted(arguments.scene.glob("st?/mask.png"))))) as mask:
        own = mask.width * mask.height / 1e6
    rows = []
    for megapixels in arguments.megapixels:
        folder = arguments.output / f"{megapixels:g}"
        if not (folder / "object.toml").exists():
            folder.mkdir(parents=True, exist_ok=True)
            enlarged(arguments.scene, folder, (megapixels / own) ** 0.5)
        if not (folder / "out/object/quality.json").exists():
            rows.append(measure_object(folder / "object.toml", folder / "out", arguments.threads))
    head = [
        "megapixels a station",
        "minutes",
        "stations",
        "surface",
        "seconds a megapixel",
        "peak GB",
        "million triangles",
    ]
    print(table(head, rows))
    if arguments.copies:
        rows = measure_monument(folder / "object.toml", folder / "out", arguments.copies, arguments.threads)
        print(table(["part", "minutes until then", "peak GB until then", "what"], rows))


if __name__ == "__main__":
    main()
