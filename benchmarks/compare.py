"""Malus beside its peers, all in one run: called by benchmarks/run, writes docs/benchmarks.md.

Every solver or fit runs in a process of its own, in turn, several times; the table has medians, the peak memory of the
process, and ratios. Only the ratios mean anything on another machine, and on a busy one only these.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = ROOT / "build" / "benchmarks" / "height_system"
ANGLES = np.arange(6) * np.pi / 6
Row = dict[str, Any]


def peak_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def timed(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


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
        """What numpy and polanalyser work on; given 16-bit images they would compute in float64, slower."""
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
    """What a turning filter does: up to 3 px, 0.05° and 2e-4 of scale and shear, about the middle of the image."""
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
    """The stack that all registrations read."""
    images, truth = warped_stack(width, width * 2 // 3)
    np.savez(path, images=np.stack(images), truth=np.stack(truth))
    return {}


def registration(kind: str, path: str, threads: int) -> Row:
    """Error: RMS displacement from the known maps over the five images' corners and centres."""
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
            options = malus.Options(capture={"interpolation": kind})
            found[:] = [r.image_from_base for r in malus.capture.register(images, options=options, threads=threads)]

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


def child(*arguments: object) -> Row:
    """A measurement in a process of its own."""
    command = [sys.executable, __file__, "--child", json.dumps([str(argument) for argument in arguments])]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def program(*arguments: object) -> Row:
    done = subprocess.run([str(PROGRAM), *map(str, arguments)], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def medians(measurements: dict[str, Callable[[], Row]], runs: int) -> dict[str, Row]:
    """All of them in turn, `runs` times, so that a busy minute falls on every one."""
    rows: dict[str, list[Row]] = {name: [] for name in measurements}
    for _ in range(runs):
        for name, measure in measurements.items():
            rows[name].append(measure())
            print(name, rows[name][-1], file=sys.stderr, flush=True)
    return {
        name: {key: statistics.median(row[key] for row in taken) for key in taken[0]} for name, taken in rows.items()
    }


def table(rows: dict[str, Row], base: str, extra: str | None = None) -> str:
    head = ["", "seconds", f"× {base}", "peak GB"] + ([extra] if extra else [])
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name, row in rows.items():
        cells = [name, f"{row['seconds']:.3g}", f"{row['seconds'] / rows[base]['seconds']:.2f}", f"{row['gb']:.2f}"]
        if extra:
            cells.append(f"{row[extra]:.3g}" if row.get(extra) else "–")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--side", type=int, default=1000, help="of the height system, in pixels")
    parser.add_argument("--large-side", type=int, default=4000, help="of the large one, multigrid only")
    parser.add_argument("--fit-side", type=int, default=4243, help="of the images of the sinusoid fit (18 megapixels)")
    parser.add_argument("--registration-width", type=int, default=5196, help="of images 3:2 (18 megapixels)")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "benchmarks.md")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        kind, *rest = json.loads(arguments.child)
        if kind == "pyamg":
            row = pyamg_solve(rest[0])
        elif kind == "sinusoid":
            row = sinusoid(rest[0], int(rest[1]), int(rest[2]))
        elif kind == "stack":
            row = write_stack(int(rest[0]), rest[1])
        else:
            row = registration(rest[0], rest[1], int(rest[2]))
        print(json.dumps(row))
        return

    side, threads = arguments.side, arguments.threads
    with tempfile.TemporaryDirectory() as folder:
        system = Path(folder) / "system.bin"
        subprocess.run([str(PROGRAM), str(side), "1", "export", str(system)], check=True)
        solvers = medians(
            {
                "Malus multigrid": lambda: program(side, threads, "multigrid"),
                "Malus multigrid, 1 thread": lambda: program(side, 1, "multigrid"),
                "Malus, CHOLMOD by position": lambda: program(side, threads, "cholmod-by-position"),
                "Malus, CHOLMOD by position, 1 thread": lambda: program(side, 1, "cholmod-by-position"),
                "CHOLMOD (METIS)": lambda: program(side, 1, "cholmod"),
                "PyAMG, smoothed aggregation": lambda: child("pyamg", system),
            },
            arguments.runs,
        )
    large = medians({"Malus multigrid": lambda: program(arguments.large_side, threads, "multigrid")}, 1)
    fits = {
        dtype: medians(
            {
                name: lambda peer=peer, dtype=dtype, count=count: child(
                    "sinusoid", f"{peer} {dtype}", arguments.fit_side, count
                )
                for name, peer, count in (
                    ("malus", "malus", threads),
                    ("malus, 1 thread", "malus", 1),
                    ("copy", "copy", threads),
                    ("numpy", "numpy", threads),
                    ("polanalyser", "polanalyser", threads),
                )
            },
            arguments.runs,
        )
        for dtype in ("uint16", "float32")
    }
    with tempfile.TemporaryDirectory() as folder:
        images = str(Path(folder) / "stack.npz")
        child("stack", arguments.registration_width, images)
        registrations = medians(
            {
                name: lambda kind=kind, count=count: child("registration", kind, images, count)
                for name, kind, count in (
                    ("Malus", "bicubic", threads),
                    ("Malus, 1 thread", "bicubic", 1),
                    ("Malus, Keys' interpolation", "keys", threads),
                    ("OpenCV, ECC", "ecc", threads),
                )
            },
            arguments.runs,
        )
        converged = {"OpenCV, ECC to 1e-7": lambda: child("registration", "ecc, converged", images, threads)}
        registrations |= medians(converged, 1)
    growth = (large["Malus multigrid"]["seconds"] / arguments.large_side**2) / (
        solvers["Malus multigrid"]["seconds"] / side**2
    )
    text = f"""# Benchmarks

Written by `benchmarks/run` on {platform.processor() or platform.machine()}, {threads} threads; medians of {arguments.runs}, each in a process of its own, in turn.
Only ratios within a table can be compared with other machines.

## Height system, {side} × {side} pixels, to 1e-8

Central differences, anisotropic in every direction somewhere (`tests/cpp/linalg/height_like_system.h`); seconds from the assembled system
to the solution, factorizations and hierarchies included; peak memory with the system.

{table(solvers, "Malus multigrid", "iterations")}

PyAMG reaches {solvers["PyAMG, smoothed aggregation"]["residual"]:.1e} of the first residual in at most 200 iterations. At {arguments.large_side} × {arguments.large_side} pixels multigrid takes
{large["Malus multigrid"]["seconds"]:.0f} s, {large["Malus multigrid"]["gb"]:.1f} GB and {large["Malus multigrid"]["iterations"]:.0f} iterations: {growth:.2f} times as long a pixel.

## Sinusoid fit, six images of {arguments.fit_side} × {arguments.fit_side} pixels

Intensity, degree and phase; Malus and numpy also the residual, Malus also the state of each pixel. `copy` copies the six images. First 16-bit
images, which numpy and polanalyser get in float32 (their own float64 is slower), then float32 ones.

{table(fits["uint16"], "malus")}

{table(fits["float32"], "malus")}

## Registration, six images of {arguments.registration_width} × {arguments.registration_width * 2 // 3} pixels

Affine maps to the first image, of one texture whose polarization varies, moved by up to 3 px, 0.05° and 2e-4 of scale and shear, with
noise. Error: RMS displacement from the true maps over corners and centre, in pixels. ECC runs over a pyramid down to 100 pixels with
OpenCV's default criteria, 50 iterations and 1e-3, and, once, with 200 and 1e-7. The default interpolation, OpenCV's bicubic one, moves what it
interpolates by up to 0.05 px, and registration makes up for that in the maps; Keys' does not.

{table(registrations, "Malus", "error_px")}
"""
    # What programs of their own measured stays.
    before = arguments.output.read_text() if arguments.output.exists() else ""
    own = before.find("## Dense clouds")
    text += "\n" + before[own:] if own >= 0 else ""
    arguments.output.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
