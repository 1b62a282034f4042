"""One station with images and photos of camera size: minutes and memory of every stage of `malus run`, beside those that `malus check` expects.

    .venv/bin/python benchmarks/camera_scale.py [--photos 12] [--megapixels 4] [--polarized-megapixels 4] [--threads 2] [--folder F]

The object is the textured relief of `malus.synthetic`; its size grows with the number of pixels. The photos are taken from rings around
the station through the same lens, and are noisy color JPEGs of 8 bits. Their files give the focal length in EXIF; everything else is
found. The station is made once in the folder; its run starts anew each time. Printed at the end: the distance of the surface from the
truth, apart from scale and position, which come from the photos.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

from malus import _core, synthetic
from malus.camera import Camera

Floats = NDArray[np.float64]
_ROWS = 512
#: Angles of the photos from the station's axis, taken in turn all around the axis.
_TILTS_DEG = (14.0, 20.0, 26.0)
#: Diagonal of a full frame, to which 35-mm-equivalent focal lengths in EXIF refer.
_FULL_FRAME_MM = 43.27
_WHITE = np.array([1.0, 0.95, 0.85])


def size_of(megapixels: float) -> tuple[int, int]:
    """Width and height, 3:2, even numbers of pixels."""
    height = 2 * round((megapixels * 1e6 / 1.5) ** 0.5 / 2)
    return 2 * round(0.75 * height), height


def photo_camera(station: Camera, distance: float, size: tuple[int, int], number: int, count: int) -> Camera:
    """A camera that looks at the middle of the object, at the station's distance and scale."""
    turn, tilt = 2 * np.pi * number / count, np.radians(_TILTS_DEG[number % len(_TILTS_DEG)])
    middle = np.array([0.0, 0.0, distance])
    forward = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    focal = station.params[0] * size[0] / station.width
    params = [focal, focal, 0.5 * size[0] - 0.5, 0.5 * size[1] - 0.5]
    return Camera("PINHOLE", *size, params, rotation, -rotation @ (middle - distance * forward))


def sampled(raster: NDArray[np.float32], u: Floats, v: Floats) -> NDArray[np.float32]:
    """Bilinear values of the raster; beyond its border, the border's values."""
    return np.asarray(
        cv2.remap(raster, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    )


def photograph(
    depth: NDArray[np.float32], radiance: NDArray[np.float32], station: Camera, camera: Camera
) -> NDArray[np.uint8]:
    """8-bit RGB of the surface that the station sees at `depth`, black outside the station's image."""
    rotation, translation = camera.pose()
    center = -rotation.T @ translation
    fx, fy, cx, cy = station.params
    focal, _, x0, y0 = camera.params
    random = np.random.default_rng(int(1e6 * abs(center[0])))
    picture = np.zeros((camera.height, camera.width, 3), np.uint8)
    for first in range(0, camera.height, _ROWS):
        v, u = np.mgrid[first : min(first + _ROWS, camera.height), : camera.width].astype(float)
        rays = np.stack([(u - x0) / focal, (v - y0) / focal, np.ones_like(u)], -1) @ rotation
        z = np.full(u.shape, float(np.mean(depth[::97, ::97])))
        for _ in range(6):  # the surface is flat enough that each step reduces the error five times
            along = (z - center[2]) / rays[..., 2]
            on_u = fx * (center[0] + along * rays[..., 0]) / z + cx
            on_v = fy * (center[1] + along * rays[..., 1]) / z + cy
            z = sampled(depth, on_u, on_v).astype(float)
        light = sampled(radiance, on_u, on_v)
        light[(on_u < 0) | (on_v < 0) | (on_u > station.width - 1) | (on_v > station.height - 1)] = 0
        coded = 255 * np.clip(light[..., None] * _WHITE, 0, 1) ** (1 / 2.2) + random.standard_normal(u.shape)[..., None]
        picture[first : first + len(u)] = np.clip(np.rint(coded), 0, 255)
    return picture


def marks_of(point: Floats, cameras: dict[str, Camera]) -> str:
    """Marks of a point in the photos, in the syntax of a station file."""
    marks = []
    for name, camera in cameras.items():
        rotation, translation = camera.pose()
        x, y, z = rotation @ point + translation
        focal, _, cx, cy = camera.params
        marks.append(f'{{ image = "{name}", x = {focal * x / z + cx:.3f}, y = {focal * y / z + cy:.3f} }}')
    return f"[{', '.join(marks)}]"


def write_station(folder: Path, polarized_mpx: float, photos: int, photo_mpx: float) -> Path:
    """Write the station, its photos and its truth (truth.npz); returns the station file, which is written last."""
    scene, how = synthetic.relief(*size_of(polarized_mpx)), synthetic.Sensor()
    camera, names = scene.camera, []
    (folder / "pol").mkdir(parents=True, exist_ok=True)
    for angle, image in zip(how.angles_deg, synthetic.render(scene), strict=True):
        names.append(f"pol/pol_{angle:03g}.tif")
        Image.fromarray(image).save(folder / names[-1])
    radiance = np.concatenate([s0 for _, s0, _, _ in synthetic.stokes(scene)]).astype(np.float32)
    radiance *= 0.9 / np.quantile(radiance[::7, ::7], 0.99)
    depth, size = scene.depth.astype(np.float32), size_of(photo_mpx)
    np.savez(folder / "truth.npz", depth=depth, gsd=scene.gsd)
    exif = Image.Exif()
    focal_px = camera.params[0] * size[0] / camera.width
    exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = "Malus", "synthetic"
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = round(
        focal_px / np.hypot(*size) * _FULL_FRAME_MM
    )
    (folder / "photos").mkdir(exist_ok=True)
    cameras = {}
    distance = float(np.median(depth[::97, ::97]))
    for number in range(photos):
        name = f"photo_{number:03d}.jpg"
        cameras[name] = photo_camera(camera, distance, size, number, photos)
        picture = photograph(depth, radiance, camera, cameras[name])
        Image.fromarray(picture).save(folder / "photos" / name, quality=95, exif=exif)
        print(f"photo {number + 1} of {photos}", file=sys.stderr, flush=True)
    fx, fy, cx, cy = camera.params
    ends = []
    for part in (0.3, 0.7):
        u, v = int(part * camera.width), int(part * camera.height)
        ends.append(float(depth[v, u]) * np.array([(u - cx) / fx, (v - cy) / fy, 1.0]))
    marked = dict(list(cameras.items())[:: max(1, photos // 6)])
    station = folder / "station.toml"
    station.write_text(f"""[station]
name = "relief, {photos} photos of {photo_mpx:g} megapixels"
unit = "mm"

[polarized]
images = {json.dumps(names)}
angles_deg = {list(how.angles_deg)}
frames_averaged = {how.frames_averaged}
full_well_e = {how.full_well_e}
read_noise_e = {how.read_noise_e}
white_level = 16383

[optics]
refractive_index = 1.5

[camera]
model = "PINHOLE"
width = {camera.width}
height = {camera.height}
params = {[float(fx), float(fy), float(cx) + 0.5, float(cy) + 0.5]}

[photos]
folder = "photos"

[[scale]]
distance = {float(np.linalg.norm(ends[1] - ends[0]))}
a = {marks_of(ends[0], marked)}
b = {marks_of(ends[1], marked)}
""")
    return station


def stages(times: dict[str, Any]) -> list[tuple[str, dict[str, float]]]:
    """Time and memory of each step; of each stage if a step has stages."""
    rows = []
    for step, taken in times.items():
        if "stages" in taken:
            rows += [(f"{step}: {stage}", row) for stage, row in taken["stages"].items()]
        else:
            rows.append((step, taken))
    return rows


def printed(name: str, seconds: float, cpu_seconds: float, peak_mb: float) -> None:
    print(f"| {name} | {seconds / 60:.2f} | {cpu_seconds / 60:.2f} | {peak_mb / 1000:.2f} |")


def print_error(work: Path, truth: Path) -> None:
    """Print the error of the fused depth in GSD, after removal of one scale factor and one offset."""
    with np.load(truth) as known:
        right, gsd = known["depth"][::5, ::5], float(known["gsd"])
    depth = _core.read_raster(str(work / "fused/depth.tif"))[::5, ::5]
    factor = np.nanmedian(depth / right)
    off = (depth / factor - right) / gsd
    off -= np.nanmedian(off)
    print(f"\ndepth is {np.nanmedian(np.abs(off)):.2f} GSD off the truth (median), its scale {factor:.5f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=int, default=12)
    parser.add_argument("--megapixels", type=float, default=4, help="of a photo")
    parser.add_argument("--polarized-megapixels", type=float, help="of a polarized image; default: as a photo")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--set", action="append", default=[], metavar="section.key=value")
    parser.add_argument("--folder", type=Path, help="for the station; default: a temporary one")
    arguments = parser.parse_args()
    polarized = arguments.polarized_megapixels or arguments.megapixels
    options = ["--threads", str(arguments.threads), *(word for said in arguments.set for word in ("--set", said))]
    with tempfile.TemporaryDirectory() as temporary:
        folder = (
            arguments.folder or Path(temporary)
        ).resolve() / f"{arguments.photos}x{arguments.megapixels:g}-{polarized:g}"
        station = folder / "station.toml"
        if not station.exists():
            write_station(folder, polarized, arguments.photos, arguments.megapixels)
        malus = [sys.executable, "-m", "malus"]
        answer = subprocess.run(
            [*malus, "check", station, "--json", *options], check=True, capture_output=True, cwd=folder
        )
        expected = json.loads(answer.stdout)
        work = folder / "work"
        shutil.rmtree(work, ignore_errors=True)
        start = time.monotonic()
        subprocess.run([*malus, "run", station, "-o", work, "--quiet", *options], check=True)
        wall = time.monotonic() - start
        rows = stages(json.loads((work / "manifest.json").read_text())["times"])
        print("| step | minutes | processor minutes | peak GB |\n|---|---|---|---|")
        for name, taken in rows:
            printed(name, taken["seconds"], taken["cpu_seconds"], taken["peak_mb"])
        peak = max(taken["peak_mb"] for _, taken in rows)
        printed("all", wall, sum(taken["cpu_seconds"] for _, taken in rows), peak)
        print(f"| expected | {expected['seconds'] / 60:.2f} | | {expected['memory_mb'] / 1000:.2f} |")
        print_error(work, folder / "truth.npz")
        print(f"load of the machine at the end: {os.getloadavg()[0]:.1f} processes")


if __name__ == "__main__":
    main()
