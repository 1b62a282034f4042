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


def stack(side: int) -> list[np.ndarray]:
    random = np.random.default_rng(0)
    noise = 0.003 * random.standard_normal((side, side), dtype=np.float32)
    return [
        (0.3 * (1 + 0.2 * np.cos(2 * (a - 0.7))) + np.roll(noise, k)).astype(np.float32) for k, a in enumerate(ANGLES)
    ]


def sinusoid(kind: str, side: int, threads: int) -> Row:
    """Intensity, degree and phase of six images; Malus and numpy give the residual too. The first call warms up."""
    images = stack(side)
    design = np.stack([0.5 * np.ones(6), 0.5 * np.cos(2 * ANGLES), 0.5 * np.sin(2 * ANGLES)], 1).astype(np.float32)
    inverse = np.linalg.pinv(design)

    def numpy_fit() -> Any:
        s0, s1, s2 = (sum(inverse[j, k] * images[k] for k in range(6)) for j in range(3))
        squares = sum((images[k] - (design[k, 0] * s0 + design[k, 1] * s1 + design[k, 2] * s2)) ** 2 for k in range(6))
        return np.hypot(s1, s2) / s0, 0.5 * np.arctan2(s2, s1), np.sqrt(squares / 3)

    def malus_fit() -> Any:
        import malus

        return malus.polarization.decompose(images, ANGLES, threads=threads)

    def polanalyser_fit() -> Any:
        import polanalyser

        stokes = polanalyser.calcStokes(images, ANGLES)
        return polanalyser.cvtStokesToDoLP(stokes), polanalyser.cvtStokesToAoLP(stokes)

    def copy() -> Any:
        return [image.copy() for image in images]

    work = {"malus": malus_fit, "numpy": numpy_fit, "polanalyser": polanalyser_fit, "copy": copy}[kind]
    work()
    return {"seconds": timed(work), "gb": peak_gb()}


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
            cells.append(f"{row[extra]:.0f}" if row.get(extra) else "–")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--side", type=int, default=1000, help="of the height system, in pixels")
    parser.add_argument("--large-side", type=int, default=4000, help="of the large one, multigrid only")
    parser.add_argument("--fit-side", type=int, default=4243, help="of the images of the sinusoid fit (18 megapixels)")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "benchmarks.md")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        kind, *rest = json.loads(arguments.child)
        row = pyamg_solve(rest[0]) if kind == "pyamg" else sinusoid(kind, int(rest[0]), int(rest[1]))
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
                "Malus, CHOLMOD by position": lambda: program(side, 1, "cholmod-by-position"),
                "CHOLMOD (METIS)": lambda: program(side, 1, "cholmod"),
                "PyAMG, smoothed aggregation": lambda: child("pyamg", system),
            },
            arguments.runs,
        )
    large = medians({"Malus multigrid": lambda: program(arguments.large_side, threads, "multigrid")}, 1)
    fits = medians(
        {
            kind: (lambda kind=kind: child(kind, arguments.fit_side, threads))
            for kind in ("malus", "copy", "numpy", "polanalyser")
        },
        arguments.runs,
    )
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

## Sinusoid fit, six images of {arguments.fit_side} × {arguments.fit_side} pixels, float32

Intensity, degree and phase; Malus and numpy also the residual, Malus also the state of each pixel. `copy` copies the six images.

{table(fits, "malus")}
"""
    arguments.output.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
