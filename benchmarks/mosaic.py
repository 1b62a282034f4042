"""Mosaics of a polarization camera: made from rendered stations, then demosaiced and compared with the truth.

    python benchmarks/mosaic.py SCENE… [--seed 0]

SCENE: a folder written by rendered/renderer/render.py. Stokes vectors are fitted to the six images of low noise. Each pixel of the
mosaic gets the intensity behind its polarizer of the cell [[90, 45], [135, 0]], with the shot noise of four frames of
20000 electrons. Printed for bilinear channels, for `malus.capture.demosaic`, and for the latter on the layout of a color
camera (RGGB, a gray scene, luminance of the colors): RMS of s0 relative to the truth, and RMS, median and 95th
percentile of the error of (s1, s2) / s0, over pixels above 2 % of the white level.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

import malus

Array = NDArray[np.floating]
ANGLES_DEG = np.arange(0, 180, 30)
CELL_DEG = np.array([90, 45, 135, 0])
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
WHITE, FULL_WELL_E, FRAMES, BORDER_PX, DARK = 16383, 20000, 4, 8, 0.02


def rows_of(angles_deg: Array) -> Array:
    twice = np.radians(2 * angles_deg)
    return 0.5 * np.stack([np.ones_like(twice), np.cos(twice), np.sin(twice)], -1)


def scene_stokes(scene: Path) -> Array:
    images = [np.asarray(Image.open(scene / f"pol/lownoise/pol_{a:03d}.png"), dtype=float) / WHITE for a in ANGLES_DEG]
    stokes = np.tensordot(np.linalg.pinv(rows_of(ANGLES_DEG.astype(float))), np.stack(images), 1)
    height, width = (side // 4 * 4 for side in stokes.shape[1:])
    return stokes[:, :height, :width]


def bilinear(mosaic: Array) -> Array:
    kernel = np.array([0.5, 1, 0.5])
    channels = []
    for place in range(4):
        samples = np.zeros_like(mosaic)
        samples[place // 2 :: 2, place % 2 :: 2] = mosaic[place // 2 :: 2, place % 2 :: 2]
        rows = ndimage.convolve1d(samples, kernel, 0, mode="mirror")
        channels.append(ndimage.convolve1d(rows, kernel, 1, mode="mirror"))
    return np.stack(channels)


def errors(channels: Array, truth: Array) -> str:
    stokes = np.tensordot(np.linalg.pinv(rows_of(CELL_DEG.astype(float))), channels, 1)
    inside = (slice(None), slice(BORDER_PX, -BORDER_PX), slice(BORDER_PX, -BORDER_PX))
    stokes, truth = stokes[inside], truth[inside]
    bright = truth[0] > DARK
    s0 = np.sqrt(np.mean((stokes[0] / truth[0] - 1)[bright] ** 2))
    error = np.hypot(*(stokes[1:] / stokes[0] - truth[1:] / truth[0]))[bright]
    rms, median, high = np.sqrt(np.mean(error**2)), np.median(error), np.percentile(error, 95)
    return f"s0 {s0:.4f}; (s1, s2)/s0: RMS {rms:.4f}, median {median:.4f}, 95 % {high:.4f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    for scene in args.scenes:
        random = np.random.default_rng(args.seed)
        truth = scene_stokes(scene)
        channels = np.tensordot(rows_of(CELL_DEG.astype(float)), truth, 1)
        mosaic = np.zeros_like(truth[0])
        for place in range(4):
            cell = (slice(place // 2, None, 2), slice(place % 2, None, 2))
            mosaic[cell] = channels[place][cell]
        mosaic += np.sqrt(np.maximum(mosaic, 0) / FULL_WELL_E / FRAMES) * random.standard_normal(mosaic.shape)
        color = np.stack(malus.capture.demosaic(mosaic, colors="RGGB", threads=2)) @ LUMINANCE
        print(f"{scene.name}: bilinear {errors(bilinear(mosaic), truth)}")
        print(f"{scene.name}: malus    {errors(np.stack(malus.capture.demosaic(mosaic, threads=2)), truth)}")
        print(f"{scene.name}: color   {errors(color, truth)}")


if __name__ == "__main__":
    main()
