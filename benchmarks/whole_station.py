"""Whole stations of several sizes, from images to the assessed surface: time, processor time and memory of every step.

    .venv/bin/python benchmarks/whole_station.py [--megapixels 1 4 18] [--fusion grid] [--prior depth] [--threads 2] [--folder F]

Stations are synthetic reliefs (`malus.synthetic`), made once in the folder. Each run is a separate process of `malus-station`. On a busy
machine only processor seconds can be compared; seconds and processor seconds are printed, and the load of the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import tempfile
from pathlib import Path

from measuring import ROOT, Row, touch_memory

from malus import synthetic
from malus.workspace import STEPS

PROGRAM = ROOT / "build" / "malus-station"
FIGURES = ("seconds", "cpu_seconds", "peak_mb")


def station_of(folder: Path, megapixels: float, prior: str) -> Path:
    """Station file with 3:2 images, even numbers of pixels; made if it does not exist."""
    height = 2 * round((megapixels * 1e6 / 1.5) ** 0.5 / 2)
    width = 2 * round(0.75 * height)
    path = folder / f"{width}x{height}-{prior}"
    return (
        path / "station.toml"
        if (path / "meta.json").exists()
        else synthetic.write_station(path, width, height, prior=prior)
    )


def measure(station: Path, fusion: str, threads: int, until: str | None = None) -> dict[str, Row]:
    """Run the station; returns the times of its steps from manifest.json."""
    work = station.parent / "work"
    shutil.rmtree(work, ignore_errors=True)
    command = [PROGRAM, station, "-o", work, "--fusion", fusion, "--threads", str(threads), "--quiet"]
    command += ["--until", until] if until else []
    touch_memory(4)
    subprocess.run(command, check=True, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"})
    times = json.loads((work / "manifest.json").read_text())["times"]
    shutil.rmtree(work)
    return {step: {key: times[step][key] for key in FIGURES} for step in STEPS if step in times}


def step_medians(
    station: Path, fusion: str, threads: list[int], runs: int, until: str | None = None
) -> list[dict[str, Row]]:
    """Median times of every step for each number of threads, measured in turn."""
    taken = [[measure(station, fusion, count, until) for count in threads] for _ in range(runs)]
    return [
        {step: {key: statistics.median(run[i][step][key] for run in taken) for key in FIGURES} for step in taken[0][i]}
        for i in range(len(threads))
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--megapixels", type=float, nargs="+", default=[1, 4, 18])
    parser.add_argument("--fusion", choices=["grid", "refined"], default="grid")
    parser.add_argument("--prior", choices=["cloud", "depth"], default="depth")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="for the stations; default: a temporary one")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        print("| megapixels | step | seconds | processor seconds | a megapixel | peak MB |\n|---|---|---|---|---|---|")
        for megapixels in arguments.megapixels:
            times = measure(station_of(folder, megapixels, arguments.prior), arguments.fusion, arguments.threads)
            rows = list(times.items())
            total = {key: sum(time[key] for _, time in rows) for key in ("seconds", "cpu_seconds")}
            rows.append(("all", {**total, "peak_mb": max(time["peak_mb"] for _, time in rows)}))
            for step, time in rows:
                print(
                    f"| {megapixels:g} | {step} | {time['seconds']:.2f} | {time['cpu_seconds']:.2f} "
                    f"| {time['cpu_seconds'] / megapixels:.2f} | {time['peak_mb']:.0f} |"
                )
        print(f"\nLoad of the machine at the end: {os.getloadavg()[0]:.1f} processes.")


if __name__ == "__main__":
    main()
