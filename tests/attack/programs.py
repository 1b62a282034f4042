"""Attack on a whole run of malus-station: kills at random moments, and limits of memory and of file size at many levels.

After each the run is repeated without the attack, and must leave what an undisturbed run leaves, bit for bit.

    programs.py PROGRAM FOLDER --seconds N [--seed S]
"""

from __future__ import annotations

import argparse
import hashlib
import random
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from malus import synthetic

MB = 1 << 20
#: Levels of address space and of the size of one file, from where the program just starts to where nothing is refused.
ADDRESS_SPACE_MB = [60, 80, 100, 128, 160, 200, 240, 256, 272, 288, 304, 320, 340, 360, 380, 400, 430, 460, 500, 600]
FILE_SIZE_KB = [0, 1, 4, 16, 32, 64, 96, 128, 256, 512, 1024]
#: The loader's own, before a program begins.
NOT_LOADED = 127
#: A run that takes longer has not ended by itself.
LONGEST_S = 300


class Findings(list[str]):
    """What was not as promised; `expect` adds to it."""

    def expect(self, holds: bool, what: str) -> None:
        if not holds:
            self.append(what)
            print("FINDING:", what, flush=True)


def state_of(work: Path) -> dict[str, str]:
    """SHA-256 of everything that a run leaves, but the manifest, which says when."""
    files = [path for path in work.rglob("*") if path.is_file() and path.name not in ("manifest.json", ".lock")]
    return {str(path.relative_to(work)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


class Attack:
    """One station, the program, and what an undisturbed run of it leaves."""

    def __init__(self, program: Path, folder: Path) -> None:
        self.station = synthetic.write_station(folder / "station", 160, 120)
        self.program, self.folder = program, folder
        self.findings = Findings()
        self.runs: Counter[str] = Counter()
        started = time.monotonic()
        done = subprocess.run(self.command(folder / "undisturbed"), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        self.seconds = time.monotonic() - started
        self.expected = state_of(folder / "undisturbed")

    def command(self, work: Path) -> list[str]:
        return [str(self.program), str(self.station), "-o", str(work), "--quiet", "--threads", "2"]

    def resume(self, work: Path, after: str) -> None:
        """Run to the end: the result must be that of the undisturbed run, and nothing else may lie about."""
        done = subprocess.run(self.command(work), capture_output=True, text=True, timeout=LONGEST_S)
        self.findings.expect(done.returncode == 0, f"{after}: the next run ends with {done.returncode}: {done.stderr}")
        now = state_of(work)
        wrong = sorted(name for name in now.keys() | self.expected.keys() if now.get(name) != self.expected.get(name))
        self.findings.expect(not wrong, f"{after}, then resumed: {', '.join(wrong)} differ")

    def kill(self, work: Path, moment_s: float) -> None:
        run = subprocess.Popen(self.command(work), stderr=subprocess.DEVNULL)
        time.sleep(moment_s)
        run.send_signal(signal.SIGKILL)
        run.wait()
        self.runs["kills"] += 1

    def limit(self, work: Path, kind: int, value: int, name: str) -> None:
        self.runs[name] += 1
        what = f"{name} {value}"
        try:
            done = subprocess.run(
                self.command(work), capture_output=True, text=True, errors="replace", timeout=LONGEST_S,
                preexec_fn=lambda: resource.setrlimit(kind, (value, value)),
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            self.findings.expect(False, f"{what}: did not end")
            return
        allowed = (0, 5, NOT_LOADED) if kind == resource.RLIMIT_AS else (0, 5)
        self.findings.expect(done.returncode in allowed, f"{what}: ends with {done.returncode}: {done.stderr}")
        self.findings.expect(
            done.returncode == 0 or not (work / "quality.json").exists(), f"{what}: looks finished after {done.stderr}"
        )

    def in_new_folder(self, name: str, disturb: Callable[[Path], None]) -> None:
        work = self.folder / f"work{sum(self.runs.values())}"
        disturb(work)
        self.resume(work, name)
        subprocess.run(["rm", "-rf", str(work)], check=True)


def main() -> int:
    """Attack for so many seconds; the exit code is 1 if there were findings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("program", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    attack = Attack(arguments.program.resolve(), arguments.folder.resolve())
    chance = random.Random(arguments.seed)
    levels = [(resource.RLIMIT_AS, level * MB, "address space") for level in ADDRESS_SPACE_MB]
    levels += [(resource.RLIMIT_FSIZE, level << 10, "file size") for level in FILE_SIZE_KB]
    chance.shuffle(levels)
    end = time.monotonic() + arguments.seconds
    while time.monotonic() < end:
        if levels:
            kind, value, name = levels.pop()
            attack.in_new_folder(f"{name} {value}", lambda work: attack.limit(work, kind, value, name))  # noqa: B023
        moments = [chance.uniform(0, attack.seconds) for _ in range(chance.randint(1, 3))]
        attack.in_new_folder(
            f"killed after {moments} s",
            lambda work: [attack.kill(work, moment) for moment in moments],  # noqa: B023
        )
    print(f"{dict(attack.runs)}; undisturbed {attack.seconds:.1f} s; {len(attack.findings)} findings")
    return 1 if attack.findings else 0


if __name__ == "__main__":
    sys.exit(main())
