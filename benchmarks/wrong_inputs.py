"""How the program responds to wrong inputs: each mistake is made on a copy of a station's files, and the program runs on the copy.

    python benchmarks/wrong_inputs.py STATION.toml… --executable malus-station [--capture] [--only MISTAKE…]
                                      [--jobs 2] [--table OUT.md]

STATION.toml: with 16- or 8-bit images at stated angles, an undistorted camera and a binary PLY cloud; with gt/ and
meta.json beside it, figures against the truth are printed. Prints for each mistake how the run ends (an exit code, or
status and confidence), the ratios of the fused surface's RMSE, detail MAD and median normal error to the prior's, and
the text of every warning, error and reason. After the last station, prints for each mistake how often each end occurred,
and how often there was no message. The unchanged station comes first: each message about it is a false alarm, unless the
station is known to be wrong. "images of another object" are those of the next station of another name whose images have
the same size. `--capture` makes the mistakes of `capture_mistakes.py` (at the camera) instead. With `--until evidence`
nothing is fused, and the end follows from the findings of the checks: "low" or "goes on".
"""

from __future__ import annotations

import argparse
import collections
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

import harm
import numpy as np
from capture_mistakes import CAPTURE_MISTAKES
from mistakes import MISTAKES, OTHER_OBJECT, Inputs, read, write, write_images

#: Options of each run: one thread, since several runs are side by side, and without results that no figure needs.
WITHOUT = ["--set", "assess.polarization_height=false", "--threads", "1", "--quiet"]


@dataclass(frozen=True)
class Said:
    """How a run ended, as one line; its messages; ratios of the fused figures to the prior's if there is a truth."""

    end: str
    words: list[str]
    ratios: dict[str, float] = field(default_factory=dict)

    def is_silent(self) -> bool:
        return not self.words

    def figures(self) -> str:
        return " ".join(f"{value:.2f}" for value in self.ratios.values())


def run(inputs: Inputs, station: Path, executable: Path, until: str) -> Said:
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder) / "work"
        command = [executable, write(inputs, Path(folder) / "station"), "-o", work, "--until", until, *WITHOUT]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        said = done.stderr.strip().splitlines()
        if done.returncode != 0:
            return Said(f"exit code {done.returncode}", said)
        if until == "evidence":
            found = json.loads((work / "evidence/findings.json").read_text())
            severe = any(finding["severity"] in ("warning", "error") for finding in found)
            return Said("low" if severe else "goes on", said)
        quality = json.loads((work / "quality.json").read_text())
        confidence = quality["confidence"]
        words = [*quality["warnings"], *(f"because: {reason}" for reason in confidence["reasons"])]
        scored = harm.score(station, work) if (station / "gt").is_dir() else {}
        return Said(f"{quality['status']}, {confidence['level']}", words, scored.get("ratios", {}))


def import_of_numbers(inputs: Inputs, folder: Path) -> Said:
    """Images with names from a camera, whose numbers are not angles."""
    for name in write_images(inputs, folder):
        (folder / name).rename(folder / f"IMG_0{123 + int(Path(name).stem)}.tif")
    return imported(folder)


def import_of_short_table(inputs: Inputs, folder: Path) -> Said:
    """A table with semicolons and decimal commas, one of whose rows is missing."""
    angles = [f"{angle:.1f}".replace(".", ",") for angle in np.rad2deg(inputs.angles)]
    rows = [f"{name};{angle}" for name, angle in zip(write_images(inputs, folder), angles, strict=True)]
    (folder / "angles.csv").write_text("\n".join(["image;angle_deg", *rows[:-1]]))
    return imported(folder)


def imported(folder: Path) -> Said:
    command = [sys.executable, "-m", "malus", "import", folder, "-o", folder / "station.toml"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return Said(f"exit code {done.returncode}", done.stderr.strip().splitlines())


IMPORTS = {
    "import: numbers of files for angles": import_of_numbers,
    "import: semicolons, a row missing": import_of_short_table,
}


def mistakes_on(inputs: Inputs, others: Sequence[Inputs]) -> dict[str, Inputs]:
    """All mistakes in files that can be made on these inputs."""
    made = {name: mistake(inputs) for name, mistake in MISTAKES.items()}
    other = next(filter(inputs.is_comparable, others), None)
    if other is not None:
        made[OTHER_OBJECT] = replace(inputs, images=other.images, angles=other.angles, mask=other.mask)
    return made


def table(said: dict[str, dict[str, Said]]) -> str:
    """Markdown with a row per mistake and a column per station: the end, and the ratios of RMSE, MAD and normals to the prior's."""
    names = list(said)
    lines = ["| mistake | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for mistake in dict.fromkeys(mistake for found in said.values() for mistake in found):
        cells = []
        for found in said.values():
            one = found.get(mistake)
            cells.append("–" if one is None else "; ".join(filter(None, [one.end, one.figures()])))
        lines.append(f"| {mistake} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def all_of(
    inputs: Inputs, path: Path, others: Sequence[Inputs], args: argparse.Namespace
) -> Iterator[tuple[str, Said]]:
    """The result of every mistake that was asked for, in order."""
    if args.capture:
        made = {name: mistake(inputs) for name, mistake in CAPTURE_MISTAKES.items()}
    else:
        made = mistakes_on(inputs, others)
    chosen = {name: wrong for name, wrong in made.items() if not args.only or name in args.only}
    with ThreadPoolExecutor(args.jobs) as pool:
        runs = pool.map(lambda wrong: run(wrong, path.parent, args.executable, args.until), chosen.values())
        yield from zip(chosen, runs, strict=True)
    for name, tried in IMPORTS.items():
        if not args.capture and (not args.only or name in args.only):
            with tempfile.TemporaryDirectory() as folder:
                yield name, tried(inputs, Path(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stations", nargs="+", type=Path)
    parser.add_argument("--executable", type=Path, required=True)
    parser.add_argument("--until", choices=["evidence", "assess"], default="assess")
    parser.add_argument("--capture", action="store_true", help="the mistakes of a person at the camera")
    names = [*MISTAKES, OTHER_OBJECT, *IMPORTS, *CAPTURE_MISTAKES]
    parser.add_argument("--only", nargs="+", metavar="MISTAKE", choices=names)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--table", type=Path, help="write the ends as Markdown, too")
    args = parser.parse_args()
    args.executable = args.executable.resolve()
    stations = {path: read(path) for path in args.stations}
    ends: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    all_said: dict[str, dict[str, Said]] = {}
    for number, (path, inputs) in enumerate(stations.items()):
        print(path)
        others = [*list(stations.values())[number + 1 :], *list(stations.values())[:number]]
        column = all_said.setdefault(inputs.name, {})
        for name, said in all_of(inputs, path, others, args):
            column[name] = said
            ends[name][f"{said.end}, silent" if said.is_silent() else said.end] += 1
            print(f"  {name}: {said.end} {said.figures()}", flush=True)
            for words in said.words:
                print(f"    {words}", flush=True)
        if args.table:
            args.table.write_text(table(all_said), encoding="utf-8")
    print(f"{len(stations)} stations")
    for name, counts in ends.items():
        print(f"  {name}: " + ", ".join(f"{end}: {count}" for end, count in counts.items()))


if __name__ == "__main__":
    main()
