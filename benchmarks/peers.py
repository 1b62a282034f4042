"""Measures Malus and its peers: one measurement per process, its result as a line of JSON.

benchmarks/.venv/bin/python benchmarks/peers.py sinusoid "numpy uint16" 4243 2
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from measuring import Row, peak_gb, timed

ANGLES = np.arange(6) * np.pi / 6


def pyamg_solve(path: str) -> Row:
    """Smoothed aggregation with conjugate gradients to 1e-8, as its manual recommends for symmetric systems."""
    import pyamg
    from scipy import sparse

    with open(path, "rb") as file:
        count, entries = np.fromfile(file, np.int64, 2)
        starts = np.fromfile(file, np.int32, count + 1)
        rows, values = np.fromfile(file, np.int32, entries), np.fromfile(file, np.float64, entries)
        right = np.fromfile(file, np.float64, count)
    lower = sparse.csc_matrix((values, rows, starts), shape=(count, count))
    matrix = sparse.csr_matrix(lower + sparse.tril(lower, -1).T)
    residuals: list[float] = []

    def work() -> None:
        solver = pyamg.smoothed_aggregation_solver(matrix, max_coarse=500)
        solver.solve(right, tol=1e-8, accel="cg", maxiter=200, residuals=residuals)

    seconds = timed(work)
    return {
        "seconds": seconds,
        "gb": peak_gb(),
        "iterations": len(residuals) - 1,
        "residual": residuals[-1] / residuals[0],
    }


def stack(side: int, dtype: str) -> list[np.ndarray]:
    random = np.random.default_rng(0)
    noise = 0.003 * random.standard_normal((side, side), dtype=np.float32)
    images = [
        (0.3 * (1 + 0.2 * np.cos(2 * (a - 0.7))) + np.roll(noise, k)).astype(np.float32) for k, a in enumerate(ANGLES)
    ]
    return [np.rint(65535 * image).astype(np.uint16) for image in images] if dtype == "uint16" else images


def sinusoid(kind: str, side: int, threads: int) -> Row:
    """Intensity, degree and phase of six images; Malus and numpy give the residual too. The first call warms up."""
    peer, dtype = kind.split()
    images = stack(side, dtype)
    design = np.stack([0.5 * np.ones(6), 0.5 * np.cos(2 * ANGLES), 0.5 * np.sin(2 * ANGLES)], 1).astype(np.float32)
    inverse = np.linalg.pinv(design)

    def in_float32() -> list[np.ndarray]:
        """The input of numpy and polanalyser, which would convert 16-bit images to float64 and be slower."""
        return [image.astype(np.float32) for image in images] if dtype == "uint16" else images

    def numpy_fit() -> Any:
        values = in_float32()
        s0, s1, s2 = (sum(inverse[j, k] * values[k] for k in range(6)) for j in range(3))
        squares = sum((values[k] - (design[k, 0] * s0 + design[k, 1] * s1 + design[k, 2] * s2)) ** 2 for k in range(6))
        return np.hypot(s1, s2) / s0, 0.5 * np.arctan2(s2, s1), np.sqrt(squares / 3)

    def malus_fit() -> Any:
        import malus

        return malus.polarization.decompose(images, ANGLES, threads=threads)

    def polanalyser_fit() -> Any:
        import polanalyser

        stokes = polanalyser.calcStokes(in_float32(), ANGLES)
        return polanalyser.cvtStokesToDoLP(stokes), polanalyser.cvtStokesToAoLP(stokes)

    def copy() -> Any:
        return [image.copy() for image in images]

    work = {"malus": malus_fit, "numpy": numpy_fit, "polanalyser": polanalyser_fit, "copy": copy}[peer]
    work()
    return {"seconds": timed(work), "gb": peak_gb()}


def known_warp(random: np.random.Generator, width: int, height: int) -> np.ndarray:
    """The motion due to a turning filter: up to 3 px, 0.05° and 2e-4 of scale and shear, about the middle of the image."""
    linear = np.eye(2) + random.uniform(-2e-4, 2e-4, (2, 2))
    angle = np.deg2rad(random.uniform(-0.05, 0.05))
    linear = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ linear
    middle = 0.5 * np.array([width - 1, height - 1])
    return np.column_stack([linear, middle - linear @ middle + random.uniform(-3, 3, 2)])


def warped_stack(width: int, height: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Six images of one texture with structure from 1.5 to 100 px, its polarization smooth, moved by known maps, with noise."""
    import cv2

    random = np.random.default_rng(0)
    margin = 32
    shape = (height + 2 * margin, width + 2 * margin)

    def field(sigma: float) -> np.ndarray:
        step = max(1, int(sigma / 2))
        small = random.standard_normal((shape[0] // step + 8, shape[1] // step + 8)).astype(np.float32)
        small = cv2.GaussianBlur(small, (0, 0), sigma / step)
        full = (
            cv2.resize(small, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
            if step > 1
            else small[: shape[0], : shape[1]]
        )
        return full / full.std()

    texture = 0.3 * np.exp(0.1 * sum(field(sigma) for sigma in (1.5, 6.0, 25.0, 100.0)))
    degree, phase = 0.1 * (1 + np.tanh(field(60.0))), field(80.0)
    images, maps = [], []
    for k, angle in enumerate(ANGLES):
        warp = known_warp(random, width, height) if k else np.eye(2, 3)
        shift = np.array([margin, margin])
        from_margin = np.column_stack([warp[:, :2], warp[:, 2] - warp[:, :2] @ shift])
        still = (texture * (1 + degree * np.cos(2 * (angle - phase)))).astype(np.float32)
        image = cv2.warpAffine(still, from_margin, (width, height), flags=cv2.INTER_LANCZOS4)
        image += np.sqrt(image / 20000 + (8 / 20000) ** 2) * random.standard_normal(image.shape, dtype=np.float32)
        images.append(image)
        maps.append(warp)
    return images, maps


def ecc_maps(images: list[np.ndarray], iterations: int, tolerance: float) -> list[np.ndarray]:
    """OpenCV's ECC, coarse to fine over a pyramid down to 100 pixels; affine."""
    import cv2

    def pyramid(image: np.ndarray) -> list[np.ndarray]:
        levels = [image]
        while min(levels[-1].shape) >= 200:
            levels.append(cv2.pyrDown(levels[-1]))
        return levels

    base = pyramid(images[0])
    maps = [np.eye(2, 3)]
    for image in images[1:]:
        warp = np.eye(2, 3, dtype=np.float32)
        for template, moved in zip(reversed(base), reversed(pyramid(image)), strict=True):
            warp[:, 2] *= 2
            criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, iterations, tolerance)
            _, warp = cv2.findTransformECC(template, moved, warp, cv2.MOTION_AFFINE, criteria, None, 5)
        maps.append(warp.astype(float))
    return maps


def write_stack(width: int, path: str) -> Row:
    """Write the stack that all registrations read."""
    images, truth = warped_stack(width, width * 2 // 3)
    np.savez(path, images=np.stack(images), truth=np.stack(truth))
    return {}


def registration(kind: str, path: str, threads: int) -> Row:
    """Error: RMS displacement from the known maps over the five images' corners and centers."""
    import cv2

    import malus

    cv2.setNumThreads(threads)
    with np.load(path) as stored:
        images, truth = list(stored["images"]), list(stored["truth"])
    height, width = images[0].shape
    found: list[np.ndarray] = []

    def work() -> None:
        if kind.startswith("ecc"):
            found[:] = ecc_maps(images, *((50, 1e-3) if kind == "ecc" else (200, 1e-7)))
        else:
            found[:] = [r.image_from_base for r in malus.capture.register(images, threads=threads)]

    # The first call warms up: fresh memory can take as long as the work, and differs from run to run.
    if kind != "ecc, converged":
        work()
    seconds = timed(work)
    points = np.array([[x, y, 1] for x in (0, width - 1) for y in (0, height - 1)] + [[width / 2, height / 2, 1]])
    errors = [points @ (a - b).T for a, b in zip(found[1:], truth[1:], strict=True)]
    return {
        "seconds": seconds,
        "gb": peak_gb(),
        "error_px": float(np.sqrt(np.mean(np.sum(np.square(errors), axis=-1)))),
    }


def main() -> None:
    kind, *rest = sys.argv[1:]
    if kind == "pyamg":
        row = pyamg_solve(rest[0])
    elif kind == "sinusoid":
        row = sinusoid(rest[0], int(rest[1]), int(rest[2]))
    elif kind == "stack":
        row = write_stack(int(rest[0]), rest[1])
    else:
        row = registration(rest[0], rest[1], int(rest[2]))
    print(json.dumps(row))


if __name__ == "__main__":
    main()
