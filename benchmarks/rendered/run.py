"""Renders stations with exact truth (or takes rendered ones), runs them, scores them, and writes the tables of docs/method.md.

    python benchmarks/rendered/run.py -o OUT --data DIR [--scenes relief coin …]     # DIR/SCENE as the renderer leaves it
    python benchmarks/rendered/run.py -o OUT --data examples --scenes bust coin glass
    python benchmarks/rendered/run.py -o OUT --render relief coin --python RENDERER_VENV/bin/python [--seed 5] [--size 200x150]

`malus-station` runs each scene's station.toml (or the file of --station), once with default options and twice with the preset
"paper". --runs selects among these runs; --set and --threads apply to all. OUT/SCENE-RUN are the workspaces, OUT/figures.json
contains every score, and OUT/tables.md a table for each run: figures of prior → fused, and the processor seconds of all steps.
--ablation writes another table instead: default options with one part of the refinement left out at a time. Workspaces that are
finished with the same inputs are not computed again. Needs numpy, scipy, Pillow and tifffile; rendering needs renderer/requirements.txt.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
#: Runs of each scene: name in the tables, and additional arguments of the command line.
RUNS: dict[str, list[str]] = {
    "refined": [],
    "paper": ["--preset", "paper"],
    "paper, Eq 16": ["--preset", "paper", "--set", "optimize.enabled=false"],
}
#: Parts of the refinement, and the options that leave each one out.
PARTS = {
    "highlight": "refine.lobe=false",
    "mirrored surroundings": "refine.environment=false",
    "map of the surroundings": "refine.surroundings=false",
    "evidence": "refine.evidence=false",
    "regional weights": "refine.regional_weights=false",
    "albedo": "refine.albedo_weight=0",
    "robust Stokes residuals": "refine.robust_scale=100",
    "slope error of the model": "refine.slope_error=0",
    "prior": "refine.prior_weight=0.01 refine.good_prior_weight=0.01",
    "prior's weight by its sigma": "refine.good_prior_weight=5",
    "robust prior": "refine.prior_robust_gsd=1000",
    "second start": "refine.search=false",
    "coarse to fine": "refine.coarsest_px=100000",
    "graduated start": "refine.graduation=1",
    "second differences": "refine.smoothness=0",
}
FIGURES = {
    "rmse_gsd": "RMSE",
    "detail_rmse_gsd": "detail",
    "detail_mad_gsd": "MAD",
    "normal_median_deg": "normals [°]",
}


def render(scenes: list[str], python: str, output: Path, rest: list[str]) -> None:
    for scene in scenes:
        if (output / scene / "meta.json").exists():
            continue
        command = [python, str(HERE / "renderer" / "render.py"), "--scene", scene, "--out", str(output / scene), *rest]
        subprocess.run(command, check=True)


def score(scene: Path, work: Path) -> dict[str, float]:
    command = [sys.executable, str(HERE / "score.py"), str(scene), str(work), "--json"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    figures: dict[str, float] = json.loads(done.stdout)
    return figures


def run_scene(
    scene: Path, station: str, program: str, output: Path, runs: dict[str, list[str]], options: list[str]
) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, added in runs.items():
        work = output / f"{scene.name}-{name.replace(', ', '-').replace(' ', '')}"
        command = [program, str(scene / station), "-o", str(work), "--quiet", *added, *options]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            found[name] = {"exit code": done.returncode, "message": done.stderr.strip()}
            continue
        quality = json.loads((work / "quality.json").read_text(encoding="utf-8"))
        times = json.loads((work / "manifest.json").read_text(encoding="utf-8"))["times"]
        found[name] = {
            **score(scene, work),
            "confidence": quality["confidence"]["level"],
            "processor_seconds": sum(step["cpu_seconds"] for step in times.values()),
        }
    return found


def table(name: str, figures: dict[str, dict[str, Any]]) -> str:
    lines = [
        f"Run: {name} (prior → fused; GSD)\n",
        "| station | " + " | ".join(FIGURES.values()) + " | patch | 2 sigma | processor seconds |",
    ]
    lines.append("|---" * (len(FIGURES) + 4) + "|")
    for scene, runs in figures.items():
        row = runs[name]
        if "exit code" in row:
            lines.append(f"| {scene} | exit code {row['exit code']}: {row['message'][:120]} |")
            continue
        cells = [f"{row['prior_' + key]:.3g} → {row[key]:.3g}" for key in FIGURES]
        patches = [f"{value:.3g}" for key, value in row.items() if key.startswith("patch_")]
        cells += [", ".join(patches) or "–", f"{row['sigma_2']:.3f}", f"{row['processor_seconds']:.0f}"]
        lines.append(f"| {scene} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def ablation(figures: dict[str, dict[str, Any]]) -> str:
    """Table of detail / MAD / normals without each part; – if leaving the part out changes nothing on the scene."""
    lines = ["| without | " + " | ".join(figures) + " |", "|---" * (len(figures) + 1) + "|"]
    for name in ("nothing", *PARTS):
        cells = []
        for runs in figures.values():
            row, whole = runs[name], runs["nothing"]
            if "exit code" in row:
                cells.append(f"exit code {row['exit code']}")
            elif name != "nothing" and row | {"processor_seconds": 0} == whole | {"processor_seconds": 0}:
                cells.append("–")
            else:
                cells.append(
                    f"{row['detail_rmse_gsd']:.3f} / {row['detail_mad_gsd']:.3f} / {row['normal_median_deg']:.2f}"
                )
        lines.append(f"| {name}" + (f" (`{PARTS[name]}`)" if name in PARTS else "") + " | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--data", type=Path, help="folder of rendered scenes")
    where.add_argument("--render", nargs="+", metavar="SCENE", help="render these into OUT/scenes first")
    parser.add_argument("--python", default=sys.executable, help="interpreter that has the renderer's packages")
    parser.add_argument("--scenes", nargs="+", help="of --data; default: all that have the station file")
    parser.add_argument("--station", default="station.toml")
    parser.add_argument("--program", default=str(HERE.parents[1] / "build" / "malus-station"))
    parser.add_argument("--runs", nargs="+", choices=list(RUNS), default=list(RUNS), help="default: all of them")
    parser.add_argument("--ablation", action="store_true", help="what each part of the refinement buys, instead")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    parser.add_argument("--threads", type=int, help="of every run; default: all cores")
    args, for_renderer = parser.parse_known_args()
    if for_renderer and not args.render:
        parser.error(f"unknown arguments {' '.join(for_renderer)}; only --render passes others on, to render.py")
    args.output.mkdir(parents=True, exist_ok=True)
    data = args.data or args.output / "scenes"
    if args.render:
        render(args.render, args.python, data, for_renderer)
    names = args.render or args.scenes or sorted(p.parent.name for p in data.glob(f"*/{args.station}"))
    if not names:
        parser.error(f"--data {data}: no folder in it has a {args.station}")
    options = [word for assignment in args.set for word in ("--set", assignment)]
    options += ["--threads", str(args.threads)] if args.threads else []
    runs: dict[str, list[str]] = (
        {"nothing": []}
        | {
            part: [word for assignment in assignments.split() for word in ("--set", assignment)]
            for part, assignments in PARTS.items()
        }
        if args.ablation
        else {name: RUNS[name] for name in args.runs}
    )
    figures: dict[str, dict[str, Any]] = {}
    for name in names:
        figures[name] = run_scene(data / name, args.station, args.program, args.output, runs, options)
        print(name, json.dumps(figures[name]), flush=True)
    (args.output / "figures.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    text = ablation(figures) if args.ablation else "\n".join(table(run, figures) for run in runs)
    (args.output / "tables.md").write_text(text, encoding="utf-8")
    print(args.output / "tables.md")


if __name__ == "__main__":
    main()
