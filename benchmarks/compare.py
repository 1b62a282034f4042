"""Compares Malus with its peers in one run: called by benchmarks/run, writes docs/benchmarks.md.

Every solver, fit or station runs several times, in turn with the others, each time in a process of its own and in memory that was touched
just before (measuring.py). The tables have medians, the peak memory of the process, and ratios. On another machine, or on a busy one, only
the ratios are meaningful.
"""

from __future__ import annotations

import argparse
import platform
import tempfile
from collections.abc import Callable
from pathlib import Path

import whole_station
from measuring import ROOT, Row, comparison, medians, peer, program, table


def height_system(arguments: argparse.Namespace, folder: Path) -> str:
    side, threads = arguments.side, arguments.threads
    system = folder / "system.bin"
    program("height_system", side, 1, "export", system)

    def solver(kind: str, count: int) -> Callable[[], Row]:
        return lambda: program("height_system", side, count, kind)

    rows = medians(
        {
            "Malus, CHOLMOD by position": solver("malus", threads),
            "CHOLMOD (METIS)": solver("cholmod", 1),
            "PyAMG, smoothed aggregation": lambda: peer("pyamg", system),
        },
        arguments.runs,
    )
    return f"""## Height system, {side} × {side} pixels

Central differences, anisotropic in every direction somewhere (`tests/cpp/linalg/height_like_system.h`). Seconds are those
from the assembled system to the solution, factorizations included; peak memory includes the system. `CHOLMOD (METIS)` is
the same code in its default ordering, `by position` in ours (decision 20), both on one thread.

{comparison(rows, "Malus, CHOLMOD by position")}

PyAMG reaches {rows["PyAMG, smoothed aggregation"]["residual"]:.1e} of the first residual in at most 200 iterations.
"""


def sinusoid_fit(arguments: argparse.Namespace, folder: Path) -> str:
    def fit(kind: str, count: int) -> Callable[[], Row]:
        return lambda: peer("sinusoid", kind, arguments.fit_side, count)

    def fits(dtype: str) -> str:
        rows = medians(
            {
                "malus": fit(f"malus {dtype}", arguments.threads),
                "malus, 1 thread": fit(f"malus {dtype}", 1),
                "copy": fit(f"copy {dtype}", arguments.threads),
                "numpy": fit(f"numpy {dtype}", arguments.threads),
                "polanalyser": fit(f"polanalyser {dtype}", arguments.threads),
            },
            arguments.runs,
        )
        return comparison(rows, "malus")

    return f"""## Sinusoid fit, six images of {arguments.fit_side} × {arguments.fit_side} pixels

All compute intensity, degree and phase; Malus and numpy also the residual, Malus also the state of each pixel. `copy`
only copies the six images.

16-bit images, which numpy and polanalyser get in float32 (their own float64 is slower):

{fits("uint16")}

float32 images:

{fits("float32")}
"""


def registration(arguments: argparse.Namespace, folder: Path) -> str:
    images = folder / "stack.npz"
    width = arguments.registration_width
    peer("stack", width, images)

    def register(kind: str, count: int) -> Callable[[], Row]:
        return lambda: peer("registration", kind, images, count)

    rows = medians(
        {
            "Malus": register("malus", arguments.threads),
            "Malus, 1 thread": register("malus", 1),
            "OpenCV, ECC": register("ecc", arguments.threads),
        },
        arguments.runs,
    )
    rows |= medians({"OpenCV, ECC to 1e-7": register("ecc, converged", arguments.threads)}, 1)
    return f"""## Registration, six images of {width} × {width * 2 // 3} pixels

Affine maps to the first image are found. The images show one texture whose polarization varies, moved by up to 3 px,
0.05° and 2e-4 of scale and shear, with noise. Error: RMS displacement from the true maps over corners and center, in
pixels. ECC runs over a pyramid down to 100 pixels with OpenCV's default criteria, 50 iterations and 1e-3, and once with
200 and 1e-7.

{comparison(rows, "Malus", "error_px")}
"""


def clouds_and_meshes(arguments: argparse.Namespace, folder: Path) -> str:
    def visible(count: int) -> Callable[[], Row]:
        return lambda: program("visible_points", arguments.million_points, 5184, 3456, count)

    clouds = medians(
        {f"{arguments.threads} threads": visible(arguments.threads), "1 thread": visible(1)}, arguments.runs
    )
    meshes = medians(
        {"meshes": lambda: program("mesh_files", arguments.fit_side, folder, arguments.threads)}, arguments.runs
    )["meshes"]
    lines = [
        [name, *(f"{meshes[f'{name}_{kind}_mb_s']:.0f}" for kind in ("written", "copied"))] for name in ("ply", "glb")
    ]
    return f"""## Dense clouds and large meshes

Finding which of {arguments.million_points:g} million points in random order a view of 5184 × 3456 pixels sees. Memory includes the cloud;
fitting the spline comes on top:

{comparison(clouds, f"{arguments.threads} threads")}

Writing and syncing a mesh of {arguments.fit_side} × {arguments.fit_side} vertices, beside `cp` and `sync` of the same file, in MB/s:

{table(["file", "written", "copied"], lines)}
"""


def whole_stations(arguments: argparse.Namespace, folder: Path) -> str:
    threads, runs = arguments.threads, arguments.station_runs
    sums, steps = [], []

    def sum_line(megapixels: float, fusion: str, several: dict[str, Row], one: dict[str, Row] | None) -> list[str]:
        def seconds(rows: dict[str, Row]) -> float:
            return sum(row["seconds"] for row in rows.values())

        processor = sum(row["cpu_seconds"] for row in several.values()) / megapixels
        peak = max(row["peak_mb"] for row in several.values()) / 1000
        alone = f"{seconds(one):.1f}" if one else "–"
        return [f"{megapixels:g}", fusion, f"{seconds(several):.1f}", alone, f"{processor:.1f}", f"{peak:.2f}"]

    def step_lines(name: str, several: dict[str, Row], one: dict[str, Row]) -> list[list[str]]:
        return [
            [name, step, *(f"{row['seconds']:.2f}" for row in (one[step], several[step]))]
            + [f"{one[step]['seconds'] / several[step]['seconds']:.2f}"]
            for step in several
        ]

    for megapixels in arguments.megapixels:
        station = whole_station.station_of(folder, megapixels, "depth")
        several, one = whole_station.step_medians(station, "grid", [threads, 1], runs)
        sums.append(sum_line(megapixels, "grid", several, one))
        if megapixels == max(arguments.megapixels):
            steps += step_lines(f"{megapixels:g} Mpx", several, one)
    for megapixels in sorted({min(arguments.megapixels), max(arguments.megapixels)}):
        station = whole_station.station_of(folder, megapixels, "cloud")
        several, one = whole_station.step_medians(station, "grid", [threads, 1], 1)
        sums.append(sum_line(megapixels, "grid, cloud", several, one))
        steps += step_lines(f"{megapixels:g} Mpx, cloud", {"prior": several["prior"]}, {"prior": one["prior"]})
    for megapixels in arguments.refined_megapixels:
        station = whole_station.station_of(folder, megapixels, "depth")
        counts = [threads, 1] if megapixels == min(arguments.refined_megapixels) else [threads]
        several, *alone = whole_station.step_medians(station, "refined", counts, 1)
        sums.append(sum_line(megapixels, "refined", several, alone[0] if alone else None))
        if alone:
            steps += step_lines(f"{megapixels:g} Mpx, refined", {"fuse": several["fuse"]}, {"fuse": alone[0]["fuse"]})
    return f"""## Whole stations

Synthetic reliefs (`malus.synthetic`) that fill the image, from the images to the assessed surface. The prior is a depth
map, or, in rows with "cloud", a cloud of 170 000 points a megapixel. Seconds are sums over the steps, on {threads} threads and
on one: of medians of {runs} runs with grid fusion and a depth map, of one run otherwise. `benchmarks/whole_station.py`
prints every step.

{table(["megapixels", "fusion", "seconds", "on one thread", "processor seconds a megapixel", "peak GB"], sums)}

{table(["station", "step", "1 thread", f"{threads} threads", "times as fast"], steps)}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    sections = [height_system, sinusoid_fit, registration, clouds_and_meshes, whole_stations]
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--station-runs", type=int, default=3, help="of whole stations with --fusion grid")
    parser.add_argument("--side", type=int, default=1000, help="of the height system, in pixels")
    parser.add_argument("--fit-side", type=int, default=4243, help="of images and meshes (18 megapixels)")
    parser.add_argument("--registration-width", type=int, default=5196, help="of images 3:2 (18 megapixels)")
    parser.add_argument("--million-points", type=float, default=50, help="of the dense cloud")
    parser.add_argument("--megapixels", type=float, nargs="+", default=[1, 4, 18], help="of whole stations, grid")
    parser.add_argument("--refined-megapixels", type=float, nargs="*", default=[1, 18], help="of refined ones")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="for stations and files (5 GB); default: a temporary one")
    parser.add_argument("--only", nargs="+", choices=[section.__name__ for section in sections], help="print these")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "benchmarks.md")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        wanted = [section for section in sections if not arguments.only or section.__name__ in arguments.only]
        text = "\n".join(section(arguments, folder) for section in wanted)
    if arguments.only:
        print(text)
        return
    page = f"""# Benchmarks

Written by `benchmarks/run` on {platform.processor() or platform.machine()} with {arguments.threads} threads. Figures are medians of {arguments.runs} runs, which alternate
with those of the other rows, each in a process of its own. Memory is written to and freed just before each run, because
the host of a virtual machine may have taken back what was free: getting it again was seen at 0.45 GB/s, 6 GB/s after
that. Only ratios within a table can be compared with other machines.

Elsewhere: instructions of the kernels (`tests/performance/run`, decision 35), the surface sweep (`benchmarks/sweep.py`,
[method](method.md), section 6), what ± 50 % of each constant does (`benchmarks/constants.py`,
[constants](constants.md)), 100 megapixels ([decision 3](decisions/0003-cost-model.md)), and photographs of a camera's
full size ([reliability](reliability.md#at-camera-scale)).

{text}"""
    arguments.output.write_text(page)
    print(page)


if __name__ == "__main__":
    main()
