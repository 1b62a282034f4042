"""Effect of ± 50 % in each constant of prior, sweep and fusion on the fused surface of rendered stations.

    python benchmarks/constants.py -o OUT [STATION.toml…] [--map STATION.toml…] [--index STATION.toml…]
                                   [--swept STATION.toml…] [--stages prior…] [--jobs 1] [--only PATTERN]
                                   [--no-build] [--table]

STATION: a station file of a rendered station (`random_stations.py`, or rendered/renderer/render.py).

varied_source.py makes OUT/tree, a copy of the C++ sources whose constants an environment variable multiplies, and builds it. Each
constant is then multiplied by 0.5 and 1.5, one at a time (whole numbers are rounded and at least 1; switches are inverted). The run starts
at the step that the constant belongs to. If a station does not reach the constant's code, the constant is not run on this station. Recorded
are the ratios of the fused depth's detail MAD and of its median normal error (harm.py) to those of a run with nothing varied, and whether
depth, standard deviation and all other results are the same to the bit.

A map of the surroundings and the search for the refractive index take ten times as long as all other steps of a small station. They are
therefore switched off (refine.surroundings and refine.correct_index), except on the stations of --map and --index. On these stations only
their own constants are varied, and with --map also those of the fusion that changed no other station's depth. With --map, a quarter of the
pixels fits the map, and the map is taken sooner. If an object is larger than 128 x 96 px, only its middle is used. --swept: the coarse
surface comes from a sweep of the station's photographs at their true poses instead of from the cloud. These stations are for the constants
of the sweep, and for those of the prior whose code a cloud does not reach.

OUT/results.jsonl has a line for each run; runs with a line are not repeated. --table prints these results; --docs FILE writes them into the
last column of the tables of docs/constants.md, by the names in the column "where".
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import harm
import numpy as np
import sweep
import tifffile
import varied_source
from measuring import ROOT
from rendered_files import read_cloud, vectors

Row = dict[str, Any]
FACTORS = (0.5, 1.5)
TIME_LIMIT_S = 300
MIDDLE = (96, 128)  # rows and columns
HEAD = "± 50 % [%]"
# Last step before each stage; the results up to this step are the same for all constants of the stage.
BEFORE = {"prior": "polarization", "fuse": "evidence", "grid": "evidence", "map": "evidence", "index": "evidence"}
NO_MAP, NO_INDEX = "refine.surroundings=false", "refine.correct_index=false"
SETTINGS = {"map": [NO_INDEX], "index": [NO_MAP]}  # all other stages: both
# A quarter of the pixels fits a map, and a quarter of the usual gain suffices for the map to be taken.
MAP_IS_TAKEN = "surroundings_course.cpp:enough_samples=0.25,model_choice.cpp:clearly=0.25"
GRID = ["--fusion", "grid", "--set", "optimize.enabled=true"]
OF_KIND = {
    "map": ("surroundings", "finishes", "same_normals", "self_mirroring", "refine.surroundings"),
    "index": ("index_search", "refine.correct_index", "index_fit"),
}  # fmt: skip
OF_SWEPT = (
    "swept_prior.cpp:stride",
    "raster_prior.cpp:surroundings_px",
    "raster_prior_internal.h:independent_px",
    "prior.hole_slope",
)
NOT_PLAIN = ("_map", "_index", "_swept")
# Files whose constants are used after the depth is known: two stations are enough for them.
AFTER_THE_DEPTH = ("surface_sigma", "refinement_verdict")
SECTIONS = {"prior": ("prior", "Prior"), "sweep": ("prior", "Sweep"), "refine": ("fusion", "Refine")}


@dataclass(frozen=True)
class Change:
    """One constant times one factor: of the code (`varied`), or an option (`option`)."""

    key: str
    factor: float
    stage: str
    varied: str = ""
    option: str = ""


def changes_of_code(constants: Iterable[varied_source.Constant], rooms: dict[str, str]) -> list[Change]:
    found = []
    for constant in constants:
        if constant.left:
            continue
        file = constant.key.split(":")[0]
        stage = {"prior": "prior", "stereo": "sweep"}.get(rooms[file], "grid" if file.startswith("grid_") else "fuse")
        found += [Change(constant.key, by, stage, varied=f"{constant.key}={by}") for by in FACTORS]
    return found


def changes_of_options() -> list[Change]:
    """Changes of the numbers and switches in the structures of options."""
    found = []
    for section, (file, structure) in SECTIONS.items():
        text = (ROOT / "cpp/malus/options" / f"{file}_options.h").read_text()
        body = re.search(rf"struct {structure}Options {{(.*?)template", text, re.S)
        assert body is not None
        stage = "fuse" if section == "refine" else section
        for kind, name, value in re.findall(r"(double|int|bool) (\w+) = ([^;]+);", body[1]):
            key = f"{section}.{name}"
            if kind == "bool":
                switched = "false" if value == "true" else "true"
                found.append(Change(key, 0, stage, option=f"{key}={switched}"))
                continue
            for by in FACTORS:
                varied = by * float(value)
                text_of = str(max(1, math.floor(varied + 0.5))) if kind == "int" else repr(varied)
                found.append(Change(key, by, stage, option=f"{key}={text_of}"))
    return found


# --- stations


def write_photos(station: Path, folder: Path) -> None:
    """Views, mask and points for sweep_of_files. Every 20th point of the coarse cloud replaces the points that the photos' matches give."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = sweep.load(station)
    views = {"station": (scene.intensity, scene.camera)} | {f"view{i}": view for i, view in enumerate(scene.views)}
    lines = []
    for name, (image, camera) in views.items():
        np.float32(image).tofile(folder / f"{name}.f32")
        rotation, translation = camera.pose()
        numbers = [*camera.params, *np.ravel(rotation), *np.ravel(translation)]
        lines.append(f"{name} {camera.width} {camera.height} " + " ".join(f"{number:.17g}" for number in numbers))
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n")
    np.uint8(255 * scene.mask).tofile(folder / "mask.u8")
    vectors(read_cloud(station / "dense/mvs_cloud.ply"), ("x", "y", "z"))[::20].tofile(folder / "points.f64")


def only_middle(toml: Path, out: Path) -> Path:
    """The station file; if the object is large, the file of a copy whose object is only the middle."""
    station, folder = toml.resolve().parent, out / "middle" / toml.resolve().parent.name
    truth = dict(np.load(station / "gt/depth_normal_mask.npz"))
    middle = np.zeros(truth["label"].shape, bool)
    top, left = (max((side - limit) // 2, 0) for side, limit in zip(middle.shape, MIDDLE, strict=True))
    middle[top : top + MIDDLE[0], left : left + MIDDLE[1]] = True
    if ((truth["label"] == 1) & middle).sum() > 0.6 * (truth["label"] == 1).sum():
        return toml
    (folder / "gt").mkdir(parents=True, exist_ok=True)
    truth["label"] = np.where(middle, truth["label"], 0)
    np.savez(folder / "gt/depth_normal_mask.npz", **truth)
    cv2.imwrite(str(folder / "mask.png"), np.uint8(255 * (truth["label"] == 1)))
    shutil.copyfile(station / "meta.json", folder / "meta.json")
    for name in ("pol", "dense", "gt_sparse", "views"):
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(station / name)
    text = re.sub(r"(?ms)^\[\[.*", "", re.sub("(?m)^mask = .*\n", "", toml.read_text()))
    (folder / toml.name).write_text(text.replace("[polarized]\n", '[polarized]\nmask = "mask.png"\n'))
    return folder / toml.name


class Station:
    """A rendered station: its prepared results, and its runs with a change. kind: "plain", "map", "index" or "swept"."""

    def __init__(self, toml: Path, kind: str, out: Path) -> None:
        self.toml, self.kind, self.swept, self.out = only_middle(toml, out).absolute(), kind, kind == "swept", out
        self.folder = self.toml.parent
        self.name = (
            self.folder.name + ("_noisy" if "noisy" in toml.stem else "") + ("" if kind == "plain" else f"_{kind}")
        )
        self.base = out / "base" / self.name
        self.truth = np.load(self.folder / "gt/depth_normal_mask.npz")
        self.meta = json.loads((self.folder / "meta.json").read_text())
        self.plain: dict[str, Row] = {}
        self.reached: dict[str, set[str]] = {}

    def stages(self) -> tuple[str, ...]:
        return {"swept": ("sweep",), "map": ("map",), "index": ("index",), "plain": ("prior", "fuse", "grid")}[
            self.kind
        ]

    def command(self, stage: str, work: Path, more: list[str]) -> list[str]:
        build = self.out / "build"
        if self.swept:
            program = map(str, (build / "sweep-of-files", self.toml, self.base / "photos", work))
            return [*program, NO_MAP, NO_INDEX, *more]
        options = [word for option in (*SETTINGS.get(stage, [NO_MAP, NO_INDEX]), *more) for word in ("--set", option)]
        program = map(str, (build / "malus-station", self.toml, "-o", work))
        return [*program, "--threads", "1", "--quiet", *options, *(GRID if stage == "grid" else [])]

    def prepare(self) -> None:
        """Make the results before each stage, the results with nothing varied, and the list of constants that are reached."""
        for stage in self.stages():
            before = self.base / stage
            if not self.swept and not before.exists():
                part = before.with_suffix(".part")
                shutil.rmtree(part, ignore_errors=True)
                subprocess.run([*self.command(stage, part, []), "--until", BEFORE[stage]], check=True)
                part.rename(before)
            if self.swept and not (self.base / "photos").exists():
                write_photos(self.folder, self.base / "photos")
            reached = self.base / f"{stage}.reached"
            reached.unlink(missing_ok=True)
            self.plain[stage] = self.run(stage, [], {"MALUS_REACHED": str(reached)})
            self.reached[stage] = set(reached.read_text().split())

    def run(self, stage: str, options: list[str], environment: dict[str, str]) -> Row:
        if stage == "map":
            varied = ",".join(filter(None, [environment.get("MALUS_VARIED"), MAP_IS_TAKEN]))
            environment = environment | {"MALUS_VARIED": varied}
        with tempfile.TemporaryDirectory(dir=self.base) as folder:
            work = Path(folder) / "work"
            if not self.swept:
                shutil.copytree(self.base / stage, work, copy_function=os.link)
            command = self.command(stage, work, options) + ([] if self.swept else ["--until", "fuse"])
            start = time.perf_counter()
            try:
                done = subprocess.run(
                    command, env=os.environ | environment, capture_output=True, text=True, timeout=TIME_LIMIT_S
                )
                code, message = done.returncode, done.stderr.strip()[-300:]
            except subprocess.TimeoutExpired:
                code, message = -1, "too slow"
            row: Row = dict(code=code, seconds=round(time.perf_counter() - start, 2))
            return row | (self.outcome(work) if code == 0 else dict(message=message))

    def outcome(self, work: Path) -> Row:
        """Figures of the fused depth, and the contents of the rasters for comparison (keys `_…`, not recorded)."""
        fused, prior = (tifffile.imread(work / name / "depth.tif").astype(float) for name in ("fused", "prior"))
        mask = harm.scored_pixels(self.truth["label"]) & (fused > 0) & (prior > 0)
        if mask.sum() < 100:
            return dict(code=3, message="too few pixels")
        K = np.array(self.meta["station"]["K"])
        figures = harm.figures(fused, self.truth["depth"].astype(float), mask, K, self.meta["gsd_mm"])
        files = {path.name: path.read_bytes() for path in sorted((work / "fused").iterdir())}
        if "refinement.json" in files:
            files["refinement.json"] = re.sub(rb'"[a-z_]*(seconds|share)": [^,}\\n]*', b"", files["refinement.json"])
        rest = {
            name: content for name, content in files.items() if name not in ("depth.tif", "normals.tif", "sigma.tif")
        }
        return dict(figures=figures, _depth=files["depth.tif"], _sigma=files["sigma.tif"], _rest=rest)


def measured(station: Station, change: Change) -> Row:
    """A line of results.jsonl."""
    row: Row = dict(key=change.key, factor=change.factor, stage=change.stage, station=station.name)
    stage = change.stage if station.kind == "plain" else station.stages()[0]
    if change.varied and change.varied.split("=")[0] not in station.reached[stage]:
        return row | dict(reached=False)
    environment = {"MALUS_VARIED": change.varied} if change.varied else {}
    options = [change.option] if change.option else []
    found, plain = station.run(stage, options, environment), station.plain[stage]
    row |= {name: value for name, value in found.items() if name[0] != "_"}
    if found["code"] == 0:
        row["ratios"] = {name: found["figures"][name] / plain["figures"][name] for name in harm.FIGURES}
        row["same"] = {name: found[f"_{name}"] == plain[f"_{name}"] for name in ("depth", "sigma", "rest")}
    return row


def wanted(station: Station, change: Change, number: int, reached: set[str]) -> bool:
    """Whether a change is run on a station. number: of the plain stations before it; reached: constants that changed a plain station's depth."""
    if station.kind == "swept":
        return change.stage == "sweep" or change.key in OF_SWEPT
    kind = next((kind for kind, keys in OF_KIND.items() if change.key.startswith(keys)), "plain")
    if station.kind != "plain":
        return kind == station.kind or (
            station.kind == "map" and kind == "plain" and change.stage == "fuse" and change.key not in reached
        )
    if change.stage == "sweep" or kind != "plain":
        return False
    return number < 2 or not (change.key.startswith(AFTER_THE_DEPTH) or change.stage in ("prior", "grid"))


# --- results


def percent(ratio: float) -> str:
    value = 100 * (ratio - 1)
    text = f"{value:+.1f}" if abs(value) < 9.95 else f"{value:+.0f}"
    return "0" if float(text) == 0 else text.replace("-", "−")


def summary(rows: list[Row]) -> Row:
    """Summary of the lines of one constant: geometric means over the stations, the station that changes most, and unchanged results."""
    out: Row = dict(
        stations=len({row["station"] for row in rows}),
        reached=len({row["station"] for row in rows if row.get("reached", True)}),
    )
    ran = [row for row in rows if "ratios" in row]
    out["refused"] = sorted({f"{row['station']} x{row['factor']}" for row in rows if row.get("code", 0) != 0})
    out["same"] = {name: all(row["same"][name] for row in ran) for name in ("depth", "sigma", "rest")} if ran else {}
    out["mean"], out["normals"], out["factors"] = {}, {}, sorted({row["factor"] for row in rows})
    for factor in sorted({row["factor"] for row in rows}):
        of_factor = [row for row in ran if row["factor"] == factor]
        missed = len(
            [row for row in rows if row["factor"] == factor and not row.get("reached", True)]
        )  # nothing changes on these stations
        for name, figure in (("mean", "detail_mad"), ("normals", "normal_median")):
            logs = [math.log(row["ratios"][figure]) for row in of_factor]
            if logs:
                out[name][str(factor)] = math.exp(sum(logs) / (len(logs) + missed))
    if ran:
        most = max(ran, key=lambda row: abs(math.log(row["ratios"]["detail_mad"])))
        out["most"] = dict(station=most["station"], factor=most["factor"], ratio=most["ratios"]["detail_mad"])
        by_station: dict[str, float] = {}
        for row in ran:
            size = abs(math.log(row["ratios"]["detail_mad"]))
            by_station[row["station"]] = max(by_station.get(row["station"], 0), size)
        out["by_station"] = by_station
    return out


def cell(found: Row) -> str:
    """Cell of a table in docs/constants.md."""
    if not found["mean"]:
        return "refused" if found["refused"] else "not reached"
    same = found["same"]
    if same["depth"]:
        return "nothing" if same["sigma"] and same["rest"] else "report only" if same["sigma"] else "σ only"
    means, normals = ([percent(ratio) for ratio in found[name].values()] for name in ("mean", "normals"))
    if len(means) == 1 and len(found["factors"]) > 1:
        refused = [by for by in found["factors"] if str(by) not in found["mean"]]
        means.insert(0 if refused == [FACTORS[0]] else 1, "refused")
    text = ", ".join(means) if any(part != "0" for part in means) else "< .05"
    if any(part != "0" for part in normals):
        text += f" ({', '.join(normals)})"
    most = found["most"]
    if found["reached"] > 1 and abs(most["ratio"] - 1) >= 0.01:
        text += f"; {scene_of(most['station'])} {percent(most['ratio'])}"
    return text


def scene_of(station: str) -> str:
    return re.sub(r"^\d+_|_(map|index|swept|noisy|views).*", "", station).replace("_", " ")


def keys_of(where: str, option: str, options: set[str]) -> list[str]:
    """Names of constants in a row of docs/constants.md: in its column "where", or the options in its first column."""
    if where:
        files = re.findall(r"`([\w.]+\.(?:cpp|h))`: ((?:`[\w.]+`(?:, )?)+)", where)
        return [f"{file}:{name}" for file, names in files for name in re.findall(r"`([\w.]+)`", names)]
    names = re.findall(r"`(\w+)`", option)
    return [key for name in names for key in sorted(options) if key.split(".")[1] == name]


def cell_of_row(keys: list[str], found: dict[str, Row], left: dict[str, str]) -> str:
    cells = [cell(found[key]) if key in found else "not varied" if key in left else "not measured" for key in keys]
    return cells[0] if len(set(cells)) == 1 else " / ".join(cells)


def fill_docs(docs: Path, found: dict[str, Row], left: dict[str, str]) -> None:
    """Write the last column of the tables of constants."""
    lines, section = [], ""
    options = {change.key for change in changes_of_options()}
    for line in docs.read_text().splitlines():
        if line.startswith("## "):
            section = (re.findall(r"`(\w+)\.", line) or [""])[0]
        cells = [part.strip() for part in line.strip("|").split("|")]
        if line.startswith(("| constant", "| option")):
            columns = len(cells) - ("± 50 %" in cells[-1])
            line = "| " + " | ".join([*cells[:columns], HEAD]) + " |"
        elif line.startswith("|---"):
            line = "|" + "---|" * (columns + 1)
        elif line.startswith("|"):
            of_section = {key for key in options if key.startswith(f"{section}.")}
            keys = keys_of(cells[3] if not section else "", cells[0], of_section)
            text = cell_of_row(keys, found, left) if keys else "not varied"
            line = "| " + " | ".join([*cells[:columns], text]) + " |"
        lines.append(line)
    docs.write_text("\n".join(lines) + "\n")


def summaries(lines: list[Row]) -> dict[str, Row]:
    by_key: dict[str, list[Row]] = {}
    for line in lines:
        by_key.setdefault(line["key"], []).append(line)
    return {key: summary(rows) for key, rows in by_key.items()}


def read_lines(path: Path) -> list[Row]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def measure(stations: list[Station], changes: list[Change], results: Path) -> None:
    for station in stations:
        lines = read_lines(results)
        known = {(line["key"], line["factor"], line["station"]) for line in lines}
        others = {line["station"] for line in lines if not line["station"].endswith(NOT_PLAIN)} - {station.name}
        reached = {
            line["key"]
            for line in lines
            if line.get("ratios") and not line["same"]["depth"] and not line["station"].endswith(NOT_PLAIN)
        }
        todo = [
            c
            for c in changes
            if wanted(station, c, len(others), reached) and (c.key, c.factor, station.name) not in known
        ]
        if not todo:
            continue
        station.prepare()
        print(
            station.name,
            {stage: (row["seconds"], row.get("figures")) for stage, row in station.plain.items()},
            flush=True,
        )
        start = time.perf_counter()
        for done, change in enumerate(todo, 1):
            row = measured(station, change)
            with results.open("a") as file:
                file.write(json.dumps(row) + "\n")
            if done % 20 == 0 or done == len(todo):
                print(f"{station.name}: {done} of {len(todo)}, {time.perf_counter() - start:.0f} s", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stations", nargs="*", type=Path)
    parser.add_argument("--map", nargs="+", type=Path, default=[], metavar="STATION")
    parser.add_argument("--index", nargs="+", type=Path, default=[], metavar="STATION")
    parser.add_argument("--swept", nargs="+", type=Path, default=[], metavar="STATION")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=1, help="of the build")
    parser.add_argument(
        "--only",
        nargs="+",
        default=["*"],
        metavar="PATTERN",
        help="constants whose name matches, such as 'refine.cpp:*'",
    )
    parser.add_argument("--stages", nargs="+", default=["prior", "sweep", "fuse", "grid"], help="of these alone")
    parser.add_argument("--no-build", dest="build", action="store_false", help="OUT/build is up to date")
    parser.add_argument("--table", action="store_true", help="print what OUT has, and run nothing")
    parser.add_argument(
        "--docs", type=Path, metavar="FILE", help="write the last column of its tables: docs/constants.md"
    )
    parser.add_argument("--json", type=Path, help="write what OUT has to this file")
    args = parser.parse_args()
    out = args.output.resolve()
    results, listed = out / "results.jsonl", out / "constants.json"
    if args.build and not args.table:
        constants = varied_source.build(out, args.jobs)
        listed.write_text(json.dumps([constant.__dict__ for constant in constants], indent=1) + "\n")
    constants = [varied_source.Constant(**entry) for entry in json.loads(listed.read_text())]
    if not args.table:
        rooms = {path.name: room for room in varied_source.ROOMS for path in (ROOT / "cpp/malus" / room).iterdir()}
        changes = [
            c
            for c in changes_of_code(constants, rooms) + changes_of_options()
            if any(fnmatch.fnmatch(c.key, only) for only in args.only) and c.stage in args.stages
        ]
        kinds = dict(plain=args.stations, map=args.map, index=args.index, swept=args.swept)
        stations = [Station(path, kind, out) for kind, paths in kinds.items() for path in paths]
        measure(stations, changes, results)
    report(summaries(read_lines(results)), constants, args)
    return 0


def report(found: dict[str, Row], constants: list[varied_source.Constant], args: argparse.Namespace) -> None:
    for key, row in sorted(found.items()):
        refused = f"  refused: {row['refused']}" if row["refused"] else ""
        print(f"{key:48s} {row['reached']} of {row['stations']}  {cell(row)}{refused}")
    left = {constant.key: constant.left for constant in constants if constant.left}
    for key, why in left.items():
        print(f"{key:48s} not varied: {why}")
    if args.docs:
        fill_docs(args.docs, found, left)
    if args.json:
        args.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
