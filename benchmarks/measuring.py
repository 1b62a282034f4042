"""Measurements in processes of their own, and tables of their medians."""

from __future__ import annotations

import json
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
Row = dict[str, Any]


def peak_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def timed(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def touch_memory(gigabytes: float = 3.0) -> None:
    """Write to this much memory and free it. The host of a virtual machine may take back free memory; the next process then gets memory at
    the speed of a disk, slower the longer the machine was idle. In a process of its own: a child's peak memory starts at its parent's."""
    subprocess.run([sys.executable, "-c", f"import numpy; numpy.ones({int(gigabytes * 1e9 / 8)})"], check=True)


def peer(*arguments: object) -> Row:
    """A measurement of peers.py in a process of its own."""
    return _json_of(sys.executable, ROOT / "benchmarks" / "peers.py", *arguments)


def program(name: str, *arguments: object) -> Row:
    """One of the programs of benchmarks/CMakeLists.txt."""
    return _json_of(ROOT / "build" / "benchmarks" / name, *arguments)


def _json_of(*command: object) -> Row:
    touch_memory()
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=True)
    row: Row = json.loads(done.stdout.splitlines()[-1])
    return row


def medians(measurements: dict[str, Callable[[], Row]], runs: int) -> dict[str, Row]:
    """Medians of all measurements, made in turn, `runs` times, so that a busy minute affects all of them."""
    rows: dict[str, list[Row]] = {name: [] for name in measurements}
    for _ in range(runs):
        for name, measure in measurements.items():
            rows[name].append(measure())
            print(name, rows[name][-1], file=sys.stderr, flush=True)
    return {
        name: {key: statistics.median(row[key] for row in taken) for key in taken[0]} for name, taken in rows.items()
    }


def table(head: list[str], lines: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(line) + " |" for line in [head, ["---"] * len(head), *lines])


def comparison(rows: dict[str, Row], base: str, extra: str | None = None) -> str:
    """Table of seconds, their ratio to those of `base`, and peak memory."""
    lines = []
    for name, row in rows.items():
        cells = [name, f"{row['seconds']:.3g}", f"{row['seconds'] / rows[base]['seconds']:.2f}", f"{row['gb']:.2f}"]
        if extra:
            cells.append(f"{row[extra]:.3g}" if row.get(extra) else "–")
        lines.append(cells)
    return table(["", "seconds", f"× {base}", "peak GB"] + ([extra] if extra else []), lines)
