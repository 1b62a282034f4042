"""Rendered stations with the errors of a hand-turned polarizer and a drifting exposure, calibrated and scored.

    python benchmarks/polarizer.py SCENE… -o WORK [--auto] [--seed 1] [--angle-deg 3] [--gain 0.03] [--until STEP]

SCENE: a folder written by rendered/renderer/render.py. Stokes vectors are fitted to the six images of low noise. Images are made from
them at angles that are off by up to ±angle-deg and with exposures that are off by up to ±gain (uniform); the noise of the
station file is added, and values are rounded to its 14 bits. The noise of the rendered images thus becomes part of the
scene: it follows the sinusoid and does not help the calibration. `--auto` leaves the angles out of the station file. The
unchanged station is also run.

Prints per image the errors of angle and exposure with their standard deviations, the largest errors, and for both runs
the MAD of the fused detail from the truth (as rendered/score.py, in GSD; with --until polarizer the angles only).
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image
from rendered_files import BORDER_PX, lowpass
from scipy import ndimage

import malus
from malus._robust import robust_spread

WHITE, FULL_WELL_E, READ_NOISE_E, FRAMES = 16383, 20000, 8, 16
ANGLES_DEG = np.arange(0, 180, 30)


def perturbed_station(scene: Path, folder: Path, args: argparse.Namespace) -> tuple[Path, np.ndarray, np.ndarray]:
    """Station file whose images have wrong angles and exposures; the true angles [deg] and exposures."""
    random = np.random.default_rng(args.seed)
    images = [np.asarray(Image.open(scene / f"pol/lownoise/pol_{a:03d}.png"), dtype=float) / WHITE for a in ANGLES_DEG]
    rows = rows_of(np.radians(ANGLES_DEG))
    stokes = np.tensordot(np.linalg.pinv(rows), np.stack(images), 1)
    angles = ANGLES_DEG + random.uniform(-args.angle_deg, args.angle_deg, 6)
    gains = 1 + random.uniform(-args.gain, args.gain, 6)
    (folder / "pol").mkdir(parents=True, exist_ok=True)
    for nominal, angle, gain in zip(ANGLES_DEG, angles, gains, strict=True):
        signal = np.maximum(gain * np.tensordot(rows_of(np.radians([angle])), stokes, 1)[0], 0)
        variance = (signal * FULL_WELL_E + READ_NOISE_E**2) / FULL_WELL_E**2 / FRAMES
        noisy = signal + np.sqrt(variance) * random.standard_normal(signal.shape)
        dn = np.clip(np.round(noisy * WHITE), 0, WHITE).astype(np.uint16)
        Image.fromarray(dn).save(folder / f"pol/pol_{nominal:03d}.png")
    text = (scene / "station.toml").read_text()
    text = text.replace("pol/lownoise/", "pol/")
    for name in ("gt_sparse", "dense/mvs_cloud.ply", "mask.png"):
        text = text.replace(f'"{name}"', f'"{scene.resolve() / name}"')
    if args.auto:
        text = re.sub(r"angles_deg = .*", 'angles_deg = "auto"', text)
    path = folder / "station.toml"
    path.write_text(text)
    return path, angles, gains / np.exp(np.mean(np.log(gains)))


def rows_of(angles_rad: np.ndarray) -> np.ndarray:
    return 0.5 * np.stack([np.ones_like(angles_rad), np.cos(2 * angles_rad), np.sin(2 * angles_rad)], -1)


def detail_mad(scene: Path, work: Path) -> float:
    truth = np.load(scene / "gt/depth_normal_mask.npz")
    depth = tifffile.imread(work / "fused/depth.tif").astype(float)
    mask = ndimage.binary_erosion(truth["mask"] > 0, iterations=BORDER_PX) & np.isfinite(depth)
    gsd = json.loads((work / "quality.json").read_text())["gsd"]
    error = np.where(mask, depth - truth["depth"], 0)
    detail = (error - lowpass(error, mask))[mask]
    return robust_spread(detail) / gsd


def run(station: Path, work: Path, args: argparse.Namespace) -> dict[str, object]:
    options = malus.Options()
    for assignment in args.set:
        options.set(assignment)
    malus.reconstruct(
        malus.Station.load(station),
        options,
        workspace=work,
        until=args.until,
        threads=2,
        log=lambda _, text: print(text),
    )
    manifest = json.loads((work / "manifest.json").read_text())
    return manifest["steps"]["polarizer"]["notes"]["calibration"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--auto", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--angle-deg", type=float, default=3)
    parser.add_argument("--gain", type=float, default=0.03)
    parser.add_argument("--until")
    parser.add_argument("--set", action="append", default=[])
    args = parser.parse_args()
    for scene in args.scenes:
        folder = args.output / f"{scene.name}_{args.seed}{'_auto' if args.auto else ''}"
        station, angles, gains = perturbed_station(scene, folder, args)
        found = run(station, folder / "work", args)
        angle_errors = (np.array(found["angles_deg"]) - angles + 90) % 180 - 90
        gain_errors = np.array(found["gains"]) - gains
        print(f"{scene.name}: from images {found['from_images']}, from surface {found['from_surface']}")
        print("  angles, error     ", np.round(angle_errors, 3), "deg")
        print("  angles, sigma     ", np.round(found["angles_sigma_deg"], 3))
        print("  exposures, error  ", np.round(100 * gain_errors, 3), "%")
        print("  exposures, sigma  ", np.round(100 * np.array(found["gains_sigma"]), 3))
        print(f"  largest errors {np.abs(angle_errors).max():.3f} deg, {100 * np.abs(gain_errors).max():.3f} %")
        plain = run(scene / "station.toml", args.output / f"{scene.name}_plain", args)
        print(f"  as it was: from images {plain['from_images']}, from surface {plain['from_surface']}; zero off by "
              f"{plain['zero_error_deg']:.3f} ± {plain['zero_error_sigma_deg']:.3f} deg, scene polarized by "
              f"{np.round(plain['scene_polarization'], 4)} ± {np.round(plain['scene_polarization_sigma'], 4)}, "
              f"phases fit the surface to {plain['coherence']:.2f}, counted the other way {plain['coherence_opposite']:.2f}")  # fmt: skip
        if args.until is None:
            mads = [detail_mad(scene, work) for work in (args.output / f"{scene.name}_plain", folder / "work")]
            print(f"  fused detail MAD {mads[0]:.4f} GSD as it was, {mads[1]:.4f} perturbed and calibrated")


if __name__ == "__main__":
    main()
