"""How often a fused surface is worse than its prior although its confidence is not lowered.

    python benchmarks/harm.py STATION… --executable malus-station -o OUT [--jobs 2] [--draws 1] [--seed 1]
    python benchmarks/harm.py --renders DIR… [--count 200] --executable malus-station -o OUT [--jobs 2] [--seed 1]
    python benchmarks/harm.py --from-photos STATION… --executable malus -o OUT [--jobs 2]

STATION: folders of rendered stations (`random_stations.py`, or of rendered/renderer/render.py). For each station a variant is drawn
(`station_variants.py`): half of the variants are correct, a quarter have a wrong prior, a quarter a wrong setting.

--renders: a station takes a minute to render but seconds to run, and noise, errors of the prior and wrong settings need no rendering.
So --count random stations are made from the renders below these folders. Objects are drawn in random order; no object is drawn again
before all were drawn once. Of an object in the round, one of its stations is drawn. Each station gets the noise of a random sensor and a
variant as above. Scene, light and material are those of the renders: "own" in the table of lights means the scene's own light.

--from-photos: correct stations whose coarse surface Malus makes from their photographs; the renders need enough of these, e.g. ten
(`random_stations.py --photos 10`).

Each station is run. Prior and fused surface are compared with the truth on the pixels where both have a depth, with the definitions of
rendered/score.py:

    harm           RMSE, detail's MAD or median normal error of the fused surface is more than 10 % above the prior's
    unmarked harm  … and quality.json says confidence "high", or nothing
    gain           one of the three is more than 10 % below the prior's, and no harm
    kept           none of the three differs from the prior's by 0.5 %
    refused        exit code 2 or 3, with a message: counts as marked

Bars: unmarked harm on at most 1 % of the stations whose prior lies where the object is; "low" or refused on at most 5 % of the correct
stations that are not metal. If the prior itself is shifted, turned, scaled or mirrored, a comparison with the prior means little: these
stations are listed apart. Prints tables and every unmarked harm, writes OUT/harm.json; the exit code is 1 if a bar is missed. A variant
that OUT already has from the same executable is not run again.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import shutil
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import station_variants
import tifffile
from numpy.typing import NDArray
from rendered_files import BORDER_PX, Array, Mask, lowpass
from scipy import ndimage
from station_variants import WRONG_PRIOR, Variant

from malus._robust import robust_spread

Result = dict[str, Any]

WORSE, BETTER, SAME = 1.1, 0.9, 0.005
UNMARKED_BAR, LOW_BAR = 0.01, 0.05
FIGURES = ("rmse", "detail_mad", "normal_median")
REFUSED = (2, 3)
TIME_LIMIT_S = 900


# --- scoring: definitions of rendered/score.py


def normals_of(depth: Array, K: Array) -> Array:
    """Unit normals towards the camera, from central differences of the points."""
    v, u = np.indices(depth.shape)
    points = np.stack([(u - K[0, 2]) / K[0, 0] * depth, (v - K[1, 2]) / K[1, 1] * depth, depth], -1)
    normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    with np.errstate(invalid="ignore"):  # where truth has no depth there is no normal
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def figures(depth: Array, truth: Array, mask: Mask, K: Array, gsd: float) -> dict[str, float]:
    """RMSE and detail's MAD [GSD], median normal error [degrees] on the pixels of the mask."""
    error = np.where(mask, (depth - truth) / gsd, 0.0)
    error = np.where(mask, error - np.median(error[mask]), 0.0)
    detail = (error - lowpass(error, mask))[mask]
    cosine = (normals_of(np.where(mask, depth, truth), K) * normals_of(truth, K)).sum(-1)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))[ndimage.binary_erosion(mask)]
    return dict(
        rmse=float(np.sqrt((error[mask] ** 2).mean())),
        detail_mad=robust_spread(detail),
        normal_median=float(np.nanmedian(angle)),
    )


def scored_pixels(label: NDArray[np.uint8]) -> Mask:
    """Object pixels away from its border and the image's."""
    inner = np.zeros(label.shape, bool)
    inner[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    eroded = ndimage.binary_erosion(label == 1, np.ones((3, 3)), iterations=BORDER_PX, border_value=1)
    return np.asarray(eroded & inner)


def score(station: Path, work: Path) -> dict[str, Any]:
    """Figures of prior and fused surface, and their ratios; {} if the two share too few pixels."""
    meta = json.loads((station / "meta.json").read_text())
    truth = np.load(station / "gt/depth_normal_mask.npz")
    prior, fused = (tifffile.imread(work / name / "depth.tif").astype(float) for name in ("prior", "fused"))
    mask = scored_pixels(truth["label"]) & (prior > 0) & (fused > 0)
    if mask.sum() < 100:
        return {}
    depth, K = truth["depth"].astype(float), np.array(meta["station"]["K"])
    before, after = (figures(surface, depth, mask, K, meta["gsd_mm"]) for surface in (prior, fused))
    ratios = {name: after[name] / max(before[name], 1e-12) for name in FIGURES}
    return dict(prior=before, fused=after, ratios=ratios)


# --- running


def quality_figures(work: Path) -> dict[str, Any]:
    """The program's own figures of its result: status, confidence, warnings and shares."""
    quality = json.loads((work / "quality.json").read_text())
    confidence, refinement = quality.get("confidence", {}), quality.get("refinement", {})
    return dict(
        status=quality["status"], level=confidence.get("level"), reasons=confidence.get("reasons", []), warnings=quality["warnings"],
        explained_share=refinement.get("explained_share"), trusted_share=refinement.get("trusted_share"),
    )  # fmt: skip


def description(station: Path) -> dict[str, Any]:
    """Scene, light and material of a rendered station."""
    meta = json.loads((station / "meta.json").read_text())
    drawn = station / "random.json"
    out = dict(scene=meta["scene"], light="own", metal=meta["material"]["bsdf"] == "roughconductor")
    return out | (json.loads(drawn.read_text()) if drawn.exists() else {})


@dataclass(frozen=True)
class Task:
    """A variant of a rendered station; name and draw identify it."""

    station: Path
    name: str
    draw: int
    variant: Variant


def name_of(station: Path) -> str:
    """Name of the station's folder. The folder of a station in the round is inside its object's folder; then both names are needed."""
    station = station.resolve()
    return f"{station.parent.name}_{station.name}" if (station.parent / "object.toml").exists() else station.name


def tasks_of_stations(stations: list[Path], draws: int, seed: int) -> list[Task]:
    """`draws` variants of each station."""
    return [
        Task(station, name, draw, station_variants.draw(np.random.default_rng([seed, zlib.crc32(name.encode()), draw])))
        for station, name in ((station, name_of(station)) for station in stations)
        for draw in range(draws)
    ]


def tasks_of_renders(folders: list[Path], count: int, seed: int) -> list[Task]:
    """Random stations from a pool of renders; station number n depends on the seed, n and the pool alone."""
    objects: dict[Path, list[Path]] = {}
    for file in sorted(path for folder in folders for path in folder.glob("**/station.toml")):
        station = file.parent.resolve()
        if (station / "gt/depth_normal_mask.npz").exists() and (station / "meta.json").exists():
            objects.setdefault(station.parent if (station.parent / "object.toml").exists() else station, []).append(
                station
            )
    order: list[Path] = []
    random = np.random.default_rng(seed)
    while objects and len(order) < count:
        order += [list(objects)[k] for k in random.permutation(len(objects))]
    tasks = []
    for number, chosen in enumerate(order[:count]):
        random = np.random.default_rng([seed, number])
        station = objects[chosen][random.integers(len(objects[chosen]))]
        variant = replace(station_variants.draw(random), sensor=station_variants.draw_sensor(random))
        tasks.append(Task(station, name_of(station), number, variant))
    return tasks


def tasks_from_photos(stations: list[Path]) -> list[Task]:
    """The stations with photographs in place of their clouds."""
    variant = Variant("correct", station_variants.FROM_PHOTOS)
    return [Task(station, name_of(station), 0, variant) for station in stations]


def run(task: Task, args: argparse.Namespace) -> Result:
    """Write, run and score a variant of a station."""
    station, name, draw, variant = task.station, task.name, task.draw, task.variant
    folder = args.output / f"{name}_{draw}"
    identity = dict(name=name, draw=draw, variant=asdict(variant), executable=args.hash)
    result_file = folder / "result.json"
    if result_file.exists():
        old: Result = json.loads(result_file.read_text())
        if {key: old.get(key) for key in identity} == identity:
            return old
    shutil.rmtree(folder, ignore_errors=True)
    work = folder / "work"
    if variant.name == station_variants.FROM_PHOTOS:
        folder.mkdir(parents=True)
        what = ["run", str(station / "station_photos.toml")]  # of `malus`; `malus-station` does not read photographs
    else:
        what = [str(station_variants.write(station, variant, folder)), "--until", "assess"]
    command = [str(args.executable), *what, "-o", str(work), "--threads", "1", "--quiet"]
    try:
        process = subprocess.run(command, capture_output=True, text=True, timeout=TIME_LIMIT_S)
        code, message = process.returncode, process.stderr.strip()
    except subprocess.TimeoutExpired:
        code, message = -1, f"stopped after {TIME_LIMIT_S} s"
    result: Result = identity | dict(station=str(station), exit_code=code, message=message, **description(station))
    if code == 0:
        result |= quality_figures(work) | score(station, work)
    result_file.write_text(json.dumps(result, indent=1) + "\n")
    return result


# --- judging


def is_harm(result: Result) -> bool:
    return any(not ratio <= WORSE for ratio in result.get("ratios", {}).values())


def is_unmarked(result: Result) -> bool:
    return is_harm(result) and result["level"] not in ("partial", "low")


def is_gain(result: Result) -> bool:
    ratios = result.get("ratios", {}).values()
    return any(ratio < BETTER for ratio in ratios) and not is_harm(result)


def is_kept(result: Result) -> bool:
    """The fused surface is the prior's."""
    return "ratios" in result and all(abs(ratio - 1) < SAME for ratio in result["ratios"].values())


def is_refused(result: Result) -> bool:
    return result["exit_code"] in REFUSED and bool(result["message"])


def is_failure(result: Result) -> bool:
    return result["exit_code"] != 0 and not is_refused(result)


def row_name(result: Result) -> str:
    """Row of the table: what is wrong; for correct stations, metal or whether the file has the true refractive index."""
    variant = result["variant"]
    if variant["name"] != "correct":
        return f"{variant['kind']}: {variant['name']}"
    if result["metal"]:
        return "correct: metal"
    true = result.get("refractive_index")
    known = true is None or abs(true - result["index_said"]) < 0.001
    return "correct: index known" if known else "correct: index taken as 1.5"


TESTS: dict[str, Callable[[Result], bool]] = {
    "gain": is_gain,
    "kept": is_kept,
    "harm": is_harm,
    "unmarked": is_unmarked,
    "high": lambda r: r.get("level") == "high",
    "partial": lambda r: r.get("level") == "partial",
    "low": lambda r: r.get("level") == "low",
    "refused": is_refused,
    "failed": is_failure,
}


def counts(results: Iterable[Result]) -> dict[str, Any]:
    """How many stations pass each test; medians of the ratios of the fused surface's figures to the prior's."""
    listed = list(results)
    ratios = [result["ratios"] for result in listed if "ratios" in result]
    medians = {name: float(np.median([r[name] for r in ratios])) if ratios else None for name in FIGURES}
    tested = {name: sum(map(test, listed)) for name, test in TESTS.items()}
    return dict(stations=len(listed)) | tested | dict(median_ratios=medians)


def table(results: list[Result], key: Callable[[Result], str]) -> dict[str, dict[str, Any]]:
    rows = sorted({key(result) for result in results})
    return {row: counts(r for r in results if key(r) == row) for row in rows} | {"all": counts(results)}


def share(part: int, whole: int) -> float:
    return part / whole if whole else math.nan


def bars(results: list[Result]) -> dict[str, dict[str, Any]]:
    """The shares with a bar, and further shares without one."""
    placed = counts(r for r in results if r["variant"]["name"] not in WRONG_PRIOR)
    misplaced = counts(r for r in results if r["variant"]["name"] in WRONG_PRIOR)
    right = counts(r for r in results if r["variant"]["kind"] == "correct" and not r["metal"])
    figures = {
        "unmarked harm": (placed["unmarked"], placed["stations"], UNMARKED_BAR),
        "unmarked harm, prior itself wrong": (misplaced["unmarked"], misplaced["stations"], None),
        "low or refused of correct": (right["low"] + right["refused"], right["stations"], LOW_BAR),
        "gain of correct": (right["gain"], right["stations"], None),
        "failed": (placed["failed"] + misplaced["failed"], len(results), 0.0),
    }
    return {
        name: dict(count=part, of=whole, share=share(part, whole), bar=bar, held=bar is None or part <= bar * whole)
        for name, (part, whole, bar) in figures.items()
    }


def print_table(title: str, rows: dict[str, dict[str, Any]]) -> None:
    print(f"\n{title:30s} stations " + " ".join(f"{name:>8s}" for name in TESTS) + "   median × rmse, detail, normals")
    for row, found in rows.items():
        cells = " ".join(f"{found[name]:8d}" for name in TESTS)
        ratios = ", ".join("–" if value is None else f"{value:.2f}" for value in found["median_ratios"].values())
        print(f"{row:30s} {found['stations']:8d} {cells}   {ratios}")


def print_case(result: Result) -> None:
    """One line for a station that did harm or failed."""
    variant, ratios = result["variant"], result.get("ratios", {})
    shown = ", ".join(f"{name} × {value:.2f}" for name, value in ratios.items())
    says = ", ".join(
        f"{key} {result[key]:.2f}" for key in ("explained_share", "trusted_share") if result.get(key) is not None
    )
    what = f"{variant['name']} {json.dumps(variant['amount']) if variant['amount'] else ''}".strip()
    images = ("noisy" if variant["noisy"] else "low noise") + (", good cloud" if variant["good_cloud"] else "")
    print(f"  {result['name']} ({result['draw']}): {what}, {images}; {shown or result['message']}; {says}")


def report(results: list[Result], output: Path) -> bool:
    """Print and write all results; returns whether all bars are held."""
    tables = {
        "variant": table(results, row_name),
        "scene": table(results, lambda r: str(r["scene"])),
        "light": table(results, lambda r: str(r["light"])),
    }
    for title, rows in tables.items():
        print_table(title, rows)
    for title, test in (("unmarked harm", is_unmarked), ("failed", is_failure)):
        print(f"\n{title}:")
        for result in filter(test, results):
            print_case(result)
    judged = bars(results)
    print()
    for name, bar in judged.items():
        limit = "" if bar["bar"] is None else f", at most {bar['bar']:.0%}: {'held' if bar['held'] else 'MISSED'}"
        print(f"{name}: {bar['count']} of {bar['of']} ({bar['share']:.1%}){limit}")
    (output / "harm.json").write_text(json.dumps(dict(bars=judged, tables=tables, stations=results), indent=1) + "\n")
    return all(bar["held"] for bar in judged.values())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stations", nargs="*", type=Path)
    parser.add_argument("--from-photos", action="store_true", help="the stations' coarse surfaces are made from photos")
    parser.add_argument(
        "--renders", nargs="+", type=Path, default=[], metavar="DIR", help="folders of rendered stations"
    )
    parser.add_argument("--count", type=int, default=200, help="random stations upon the renders")
    parser.add_argument("--executable", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--draws", type=int, default=1, help="variants of each station")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    args.executable, args.output = args.executable.resolve(), args.output.resolve()
    args.hash = hashlib.sha256(args.executable.read_bytes()).hexdigest()
    needed = ["station_photos.toml"] if args.from_photos else ["station.toml", "station_noisy.toml"]
    for station in args.stations:
        if not all((station / name).exists() for name in needed):
            parser.error(f"{station}: expected a rendered station with {' and '.join(needed)}")
    if args.from_photos:
        tasks = tasks_from_photos(args.stations)
    else:
        tasks = tasks_of_stations(args.stations, args.draws, args.seed)
        tasks += tasks_of_renders(args.renders, args.count, args.seed)
    if not tasks:
        parser.error("no station: expected STATION… or --renders with folders of rendered stations")
    args.output.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(args.jobs) as pool:
        results = []
        for number, result in enumerate(pool.map(lambda task: run(task, args), tasks), 1):
            results.append(result)
            print(f"{number} of {len(tasks)}", end="\r", file=sys.stderr, flush=True)
    return 0 if report(results, args.output) else 1


if __name__ == "__main__":
    sys.exit(main())
