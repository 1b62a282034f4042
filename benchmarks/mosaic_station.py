"""Rendered stations as a polarization camera would have taken them, run through the whole pipeline and scored.

    python benchmarks/mosaic_station.py SCENE… -o WORK [--frames 16] [--seed 0]

SCENE: a folder written by rendered/renderer/render.py. The variants below are made from its noise-free Stokes vectors. Noise,
saturation and 14 bits are as in the scene's station file; camera and prior are those of this file:

    six       the six images of the station file, each pixel at every polarizer angle (not made here, only run)
    four      four images at 0°, 45°, 90°, 135°: a mosaic without missing samples
    mosaic    one image of the cell [[90, 45], [135, 0]]
    bilinear  the four channels of the mosaic interpolated bilinearly, given as four images: what most software does
    color    one image of a color camera (RGGB, cells of 4 × 4) of an object of one color, red, green, blue as COLOR
    color_bilinear  like color, with each of the twelve channels interpolated bilinearly

All variants average the same number of frames: a mosaic has a quarter of the photons of "four". Printed: the scores, one line each.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

import malus

Array = NDArray[np.floating]
WHITE, FULL_WELL_E, READ_NOISE_E = 16383, 20000, 8
CELL_DEG = (90, 45, 135, 0)
BAYER = ((0, 1), (1, 2))
COLOR = np.array([0.9, 1.0, 0.7])
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
VARIANTS = ("six", "four", "mosaic", "bilinear", "color", "color_bilinear")


def captured(signal: Array, frames: int, random: np.random.Generator) -> NDArray[np.uint16]:
    """DN of a mean over frames; each frame saturates."""
    variance = (np.maximum(signal, 0) * FULL_WELL_E + READ_NOISE_E**2) / FULL_WELL_E**2 / frames
    noisy = np.clip(signal, 0, 1) + np.sqrt(variance) * random.standard_normal(signal.shape)
    return np.clip(np.round(noisy * WHITE), 0, WHITE).astype(np.uint16)


def polarizer_images(scene: Path) -> Array:
    """Linear intensities behind the cell's four polarizers, 4×H×W."""
    truth = np.load(scene / "gt/stokes.npz")
    twice = np.radians(2 * np.array(CELL_DEG, dtype=float))
    rows = 0.5 * np.stack([np.ones(4), np.cos(twice), np.sin(twice)], -1)
    stokes = np.stack([truth[name] for name in ("s0", "s1", "s2")]).astype(float)
    return np.asarray(np.tensordot(rows, stokes, 1))


def cell_index(shape: tuple[int, ...]) -> NDArray[np.intp]:
    v, u = np.indices(shape)
    return np.asarray(2 * (v % 2) + u % 2)


def interpolated(mosaic: Array, known: NDArray[np.bool_], reach: int) -> Array:
    """Bilinear values between samples on a regular grid of `reach` pixels."""
    kernel = 1 - np.abs(np.arange(-reach + 1, reach)) / reach
    sums = [np.where(known, mosaic, 0).astype(float), known.astype(float)]
    for axis in (0, 1):
        sums = [ndimage.convolve1d(part, kernel, axis, mode="mirror") for part in sums]
    return np.asarray(sums[0] / sums[1])


def capture(variant: str, scene: Path, folder: Path, args: argparse.Namespace) -> str:
    """Write the images of a variant; returns the lines of [polarized] that name them."""
    random = np.random.default_rng(args.seed)
    images = polarizer_images(scene)
    cell = cell_index(images.shape[1:])
    if variant == "four":
        channels = [captured(image, args.frames, random) for image in images]
        return write_images(channels, folder)
    color = variant.startswith("color")
    v, u = np.indices(cell.shape)
    # In a color camera, each color filter covers a 2 × 2 cell of polarizers.
    band = np.array(BAYER)[v // 2 % 2, u // 2 % 2] if color else np.ones_like(cell)
    factor = COLOR[band] if color else 1.0
    mosaic = captured(np.take_along_axis(images, cell[None], 0)[0] * factor, args.frames, random)
    if variant in ("mosaic", "color"):
        Image.fromarray(mosaic).save(folder / "mosaic.png")
        colors = 'mosaic_colors = "RGGB"\n' if color else ""
        return f'images = ["mosaic.png"]\nmosaic = [[90, 45], [135, 0]]\n{colors}'
    split = []
    for place in range(4):
        if color:
            planes = [interpolated(mosaic, (cell == place) & (band == c), 4) for c in range(3)]
            # Green has two samples in a cell of 4 × 4, on a diagonal: they are closer than the grid that is assumed here.
            split.append(np.tensordot(LUMINANCE, np.stack(planes), 1))
        else:
            split.append(interpolated(mosaic, cell == place, 2))
    return write_images([np.clip(np.round(channel), 0, WHITE).astype(np.uint16) for channel in split], folder)


def write_images(channels: list[NDArray[np.uint16]], folder: Path) -> str:
    names = [f"pol_{angle:03d}.png" for angle in CELL_DEG]
    for name, channel in zip(names, channels, strict=True):
        Image.fromarray(channel).save(folder / name)
    return f"images = {json.dumps(names)}\nangles_deg = {list(CELL_DEG)}\n"


def station_file(variant: str, scene: Path, folder: Path, args: argparse.Namespace) -> Path:
    if variant == "six":
        return scene / "station.toml"
    folder.mkdir(parents=True, exist_ok=True)
    text = (scene / "station.toml").read_text()
    text = re.sub(r"images = .*\nangles_deg = .*\n", capture(variant, scene, folder, args), text)
    text = re.sub(r"frames_averaged = .*", f"frames_averaged = {args.frames}", text)
    if "mosaic =" in text:
        text = re.sub(r"angle_direction = .*\n", "", text)
    for name in ("gt_sparse", "dense/mvs_cloud.ply", "mask.png"):
        text = text.replace(f'"{name}"', f'"{scene.resolve() / name}"')
    path = folder / "station.toml"
    path.write_text(text)
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--score", type=Path, default=Path(__file__).parent / "rendered" / "score.py")
    parser.add_argument("--variants", nargs="+", default=VARIANTS, choices=VARIANTS)
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    for scene in args.scenes:
        for variant in args.variants:
            work = args.output / scene.name / variant / "work"
            station = station_file(variant, scene, work.parent, args)
            messages: list[str] = []
            malus.reconstruct(
                malus.Station.load(station), workspace=work, threads=args.threads,
                log=lambda _, text, messages=messages: messages.append(text),
            )  # fmt: skip
            command = [sys.executable, str(args.score), str(scene), str(work), "--json"]
            score = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            figures = ("rmse_gsd", "detail_rmse_gsd", "detail_mad_gsd", "normal_median_deg", "sigma_2", "coverage")
            patches = [name for name in score if name.startswith("patch_")]
            shown = ", ".join(f"{name} {score[name]:.3f}" for name in (*figures, *patches))
            print(f"{scene.name} {variant}: {shown}", flush=True)
            for text in messages:
                print("   ", text, flush=True)


if __name__ == "__main__":
    main()
