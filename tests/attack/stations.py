"""Attack on the pipeline: random stations with exact truth, correct and faulty ones.

For every station, a run must end or raise MalusError, and a result of high confidence must be within three of its own
standard deviations of the truth, except for the share of pixels below. Half of the stations are matte, well lit and without
mistakes, so that many have high confidence; in the other half anything may be odd or wrong.

    stations.py --seconds N [--seed S]
    stations.py --stations N [--seed S]
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

import malus
from malus import synthetic

#: A normal distribution has 0.3 % beyond three sigma; sigma is known to a third, and edges of the relief are steeper than sigma allows for.
LARGEST_SHARE_BEYOND = 0.05
#: Stations that hypothesis draws in a row. The first station of a row is always the same: in rows of three it was a third of all.
ROW = 100
#: A summary is printed after each so many stations, so that an attack that is stopped by hand has one, too.
STATIONS_TOLD = 12
#: Pixels at the border, which have neighbors on one side only.
BORDER = 8

ANGLES = st.one_of(
    st.sampled_from([(0, 45, 90, 135), (0, 60, 120), (0, 30, 60, 90, 120, 150)]),
    st.lists(st.integers(0, 359), min_size=3, max_size=8, unique=True).map(tuple),
)
SENSORS = st.builds(
    synthetic.Sensor,
    angles_deg=ANGLES,
    full_well_e=st.sampled_from([2000.0, 20000.0]),
    frames_averaged=st.sampled_from([1, 16]),
)
#: Light from the front and from the side, sharp highlights and none, with and without surroundings.
REFLECTANCES = st.builds(
    synthetic.Reflectance,
    refractive_index=st.floats(1.4, 1.8),
    roughness=st.sampled_from([0.1, 0.25, 0.5, 5.0]),
    light=st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.just(-1.0)),
    sky=st.floats(0.0, 0.5),
)
#: Text of the station file and its replacement, which is wrong or unusual.
CHANGES = st.sampled_from(
    [
        ("", ""),
        ("", ""),
        ('unit = "mm"', 'unit = "m"'),
        ("angles_deg = [", 'angle_direction = "cw"\nangles_deg = ['),
        ("angles_deg = [", "angle_zero_deg = 40.0\nangles_deg = ["),
        ("[polarized]", '[polarized]\nmask = "gt/hole.png"'),
        ("refractive_index = 1.5", "refractive_index = 1.9"),
        ("refractive_index = 1.5", 'metal = "bronze"'),
        ("tvec = [0.0, 0.0, 0.0]", "tvec = [0.6, -0.3, 0.0]"),
        ("tvec = [0.0, 0.0, 0.0]", "tvec = [0.0, 0.0, 2.0]"),
    ]
)
OPTIONS = st.fixed_dictionaries(
    {"fusion": st.sampled_from(["grid", "refined"])},
    optional={
        "refine.evidence": st.booleans(),
        "evidence.refuse": st.booleans(),
        "refine.surroundings": st.booleans(),
    },
)


@dataclass(frozen=True)
class Drawn:
    """A random station and the options of its run."""

    width: int
    height: int
    prior: str
    sensor: synthetic.Sensor
    reflectance: synthetic.Reflectance
    seed: int
    change: tuple[str, str]
    options: dict[str, Any]


ANYTHING = st.builds(
    Drawn,
    width=st.integers(120, 180),
    height=st.integers(120, 160),
    prior=st.sampled_from(["cloud", "depth"]),
    sensor=SENSORS,
    reflectance=REFLECTANCES,
    seed=st.integers(0, 10**6),
    change=CHANGES,
    options=OPTIONS,
)
WELL_MADE = st.builds(
    Drawn,
    width=st.integers(120, 160),
    height=st.integers(120, 160),
    prior=st.just("cloud"),
    sensor=st.builds(
        synthetic.Sensor,
        angles_deg=st.sampled_from([(0, 45, 90, 135), (0, 30, 60, 90, 120, 150)]),
        full_well_e=st.just(200000.0),
        frames_averaged=st.just(64),
    ),
    reflectance=st.builds(
        synthetic.Reflectance,
        roughness=st.just(5.0),
        light=st.tuples(st.floats(-0.12, 0.12), st.floats(-0.12, 0.12), st.just(-1.0)),
        sky=st.floats(0.0, 0.01),
    ),
    seed=st.integers(0, 10**6),
    change=st.sampled_from([("", ""), ("", ""), ("[polarized]", '[polarized]\nmask = "gt/hole.png"')]),
    options=st.just({"fusion": "refined", "refine.surroundings": False}),
)

#: Stations drawn so far: running one again would show nothing new.
seen: set[str] = set()
found: Counter[str] = Counter()
#: Level of confidence → the largest share of pixels farther than three sigma from the truth.
worst: defaultdict[str, float] = defaultdict(float)


def write(folder: Path, drawn: Drawn) -> Path:
    """Write a synthetic station with the sensor, reflectance and change that were drawn."""
    width, height, number = drawn.width, drawn.height, drawn.seed
    station = synthetic.write_station(
        folder, width, height, prior=drawn.prior, sensor=drawn.sensor, reflectance=drawn.reflectance, seed=number
    )
    hole = np.full((height, width), 255, np.uint8)
    hole[height // 4 : height // 2, width // 4 : width // 2] = 0
    synthetic._save(folder / "gt/hole.png", hole)
    text = station.read_text(encoding="utf-8")
    assert drawn.change[0] in text, drawn.change
    station.write_text(text.replace(*drawn.change, 1) if drawn.change[0] else text, encoding="utf-8")
    return station


def share_beyond(result: malus.Result, station: Path) -> float:
    """Share of pixels farther from the truth than three standard deviations."""
    truth = np.load(station.parent / "gt/depth_normal_mask.npz")["depth"].astype(float)
    inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    assert result.depth is not None and result.sigma is not None
    error, sigma = np.abs(result.depth - truth)[inner], result.sigma[inner]
    known = np.isfinite(error) & np.isfinite(sigma)
    return float(np.mean(error[known] > 3 * sigma[known])) if known.any() else 0.0


def one_station(drawn: Drawn) -> None:
    """Run one station and check its result against the truth."""
    with tempfile.TemporaryDirectory(prefix="malus-attack-") as folder:
        chosen = malus.Options(fusion=drawn.options["fusion"])
        for name, value in drawn.options.items():
            if name != "fusion":
                chosen.set(f"{name}={str(value).lower()}")
        station = write(Path(folder) / "station", drawn)
        try:
            result = malus.reconstruct(malus.Station.load(station), chosen, threads=2)
        except malus.MalusError as error:
            found[f"exit code {error.exit_code}"] += 1
            return
        assert result.quality is not None
        level = result.quality["confidence"]["level"]
        found[f"confidence {level}"] += 1
        share = share_beyond(result, station)
        worst[level] = max(worst[level], share)
        if level == "high":
            assert share <= LARGEST_SHARE_BEYOND, f"high confidence, {share:.1%} of the pixels beyond 3 sigma"


def summary() -> str:
    """How many stations ran, how they ended, and how far they were from the truth."""
    shares = ", ".join(f"{level} {share:.1%}" for level, share in worst.items())
    return f"{len(seen)} stations: {dict(found)}; largest share of pixels beyond 3 sigma: {shares}"


def attack_by(random_seed: int, more: Callable[[], bool]) -> int:
    """Run the stations of one row while `more()` holds. Hypothesis knows no time limit: stations that it draws later are skipped.

    Returns the number of findings. They are hidden from hypothesis, which would otherwise run each again and end the row.
    """
    findings = 0

    def one_more(drawn: Drawn) -> None:
        nonlocal findings
        if not more() or repr(drawn) in seen:
            return
        seen.add(repr(drawn))
        try:
            one_station(drawn)
        except Exception as error:
            findings += 1
            print(f"FINDING: {type(error).__name__}: {error}\n  {drawn}", flush=True)
        if len(seen) % STATIONS_TOLD == 0:
            print(summary(), file=sys.stderr, flush=True)

    settings(max_examples=ROW, deadline=None, database=None, phases=[Phase.generate],
             suppress_health_check=list(HealthCheck))(
        seed(random_seed)(given(st.one_of(ANYTHING, WELL_MADE))(one_more))
    )()  # fmt: skip
    return findings


def main() -> int:
    """Attack for so many seconds; the exit code is 1 if there were findings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--stations", type=int, help="so many in all, however long they take")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    end = time.monotonic() + (math.inf if arguments.stations else arguments.seconds)

    def more() -> bool:
        return len(seen) < arguments.stations if arguments.stations else time.monotonic() < end

    findings = rows = 0
    while more():
        findings += attack_by(arguments.seed + rows, more)
        rows += 1
    print(f"{summary()}; {findings} findings")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
