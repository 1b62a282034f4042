"""Attack on whole runs: kills at random moments (in a campaign also of shards, workers and scheduler), limits of memory and
of file size at many levels, disks that are full, read-only or without permission after every step.

After each attack the run is repeated undisturbed and must leave what an undisturbed run leaves, bit for bit. Small disks and
control groups need root's rights; without these rights the program says so and leaves those attacks out.

    programs.py PROGRAM FOLDER --seconds N [--seed S]
"""

from __future__ import annotations

import argparse
import atexit
import hashlib
import json
import os
import random
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image

from malus import Options, _core, synthetic

MB = 1 << 20
#: Levels of address space and of file size, from the least with which the program starts to one that refuses nothing.
ADDRESS_SPACE_MB = [60, 80, 100, 128, 160, 200, 240, 256, 272, 288, 304, 320, 340, 360, 380, 400, 430, 460, 500, 600]
FILE_SIZE_KB = [0, 1, 4, 16, 32, 64, 96, 128, 256, 512, 1024]
#: Levels of memory in use; the system kills a process that takes more.
MEMORY_MB = [5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 90, 100, 120, 150]
#: Free space on a disk as a step begins.
FREE_KB = [0, 4, 40, 200]
#: Exit code of the loader if the program cannot begin.
NOT_LOADED = 127
#: A run that takes longer counts as hanging. A busy machine takes a hundred times as long as an idle one.
LONGEST_S = 900
NOBODY = 65534
#: Counts are printed after each so many kills, so that an attack that is stopped by hand has them, too.
KILLS_TOLD = 25
#: Files that say when or where something was done and so differ from run to run.
NOT_COMPARED = ("manifest.json", ".lock")
#: Time, memory and end of a step, in the report.
TIMES = re.compile(rb'(<td class="n">[^<]*</td>){2}<td>\d{4}-\d\d-\d\dT[^<]*Z</td>')


def state_of(work: Path) -> dict[str, str]:
    """SHA-256 of every file that a run leaves, without the times in it."""
    files = [path for path in work.rglob("*") if path.is_file() and path.name not in NOT_COMPARED]
    return {
        str(path.relative_to(work)): hashlib.sha256(_without_times(path)).hexdigest()
        for path in files
        if path.parent.name != "done"
    }


def _without_times(path: Path) -> bytes:
    return TIMES.sub(b"", path.read_bytes()) if path.name == "index.html" else path.read_bytes()


def tiny_station(folder: Path, *, seed: int = 0) -> Path:
    """The smallest possible station, with an object of 48 x 40 pixels: its run takes a fraction of a second."""
    station = synthetic.write_station(folder, 120, 120, seed=seed)
    mask = np.zeros((120, 120), np.uint8)
    mask[40:80, 36:84] = 255
    Image.fromarray(mask).save(folder / "mask.png")
    text = station.read_text(encoding="utf-8")
    station.write_text(text.replace("[polarized]", '[polarized]\nmask = "mask.png"', 1), encoding="utf-8")
    return station


@contextmanager
def small_disk(folder: Path, options: str) -> Iterator[Path]:
    """A disk in memory, mounted with these options."""
    folder.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)
        folder.rmdir()


def may_mount(folder: Path) -> bool:
    """Whether this process has all of root's rights, which root lacks in some containers."""
    try:
        with small_disk(folder, "size=1m"):
            return os.geteuid() == 0
    except (OSError, subprocess.CalledProcessError):
        return False


def control_group() -> Path | None:
    """A new control group whose memory can be limited, of version 2 or 1; None where none can be made."""
    for parent, file in (
        (Path("/sys/fs/cgroup"), "memory.max"),
        (Path("/sys/fs/cgroup/memory"), "memory.limit_in_bytes"),
    ):
        group = parent / f"malus-attack-{os.getpid()}"
        try:
            group.mkdir()
        except OSError:
            continue
        if (group / file).exists():
            atexit.register(group.rmdir)
            return group / file
        group.rmdir()
    return None


def group_ended(group: int) -> bool:
    """Whether all processes of a group end within a minute."""
    for _ in range(600):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


class Attack:
    """A command on a station, and the files that it leaves if nothing disturbs it."""

    def __init__(
        self,
        name: str,
        folder: Path,
        command: Callable[[Path], list[str]],
        start: Path | None = None,
        *,
        repeatable: bool = True,
        longest_s: float = LONGEST_S,
    ) -> None:
        """`command`: of a workspace; `start`: folder with its initial files. If not `repeatable`, only the files' names are compared."""
        self.name, self.folder, self.command, self.start = name, folder, command, start
        self.repeatable, self.longest_s = repeatable, longest_s
        self.findings: list[str] = []
        self.runs: Counter[str] = Counter()
        work = self.new_folder("undisturbed")
        started = time.monotonic()
        done = self.run(work)
        assert done.returncode == 0, done.stderr
        self.seconds = time.monotonic() - started
        self.expected = self.state_of(work)

    def state_of(self, work: Path) -> dict[str, str]:
        """The files that a run leaves, with their hashes if the run is repeatable."""
        state = state_of(work)
        return state if self.repeatable else dict.fromkeys(state, "there")

    def kills(self) -> int:
        """How many runs were killed before they had ended."""
        return sum(count for what, count in self.runs.items() if what.startswith("kills"))

    def expect(self, holds: bool, what: str) -> None:
        """Record a finding unless `holds`."""
        if not holds:
            self.findings.append(what)
            print(f"FINDING: {self.name}: {what}", flush=True)

    def new_folder(self, name: str) -> Path:
        """A new workspace with the initial files."""
        work = self.folder / name
        if self.start is not None:
            shutil.copytree(self.start, work)
        return work

    def run(self, work: Path, *more: str, before: Callable[[], None] | None = None) -> subprocess.CompletedProcess[str]:
        """Run to the end; `before` is called in the run's process."""
        return subprocess.run(
            [*self.command(work), *more], capture_output=True, text=True, errors="replace", timeout=self.longest_s,
            preexec_fn=before,
        )  # fmt: skip

    def begin(self, work: Path, step: str) -> None:
        """Run until this step is done, undisturbed."""
        done = self.run(work, "--until", step)
        self.expect(done.returncode == 0, f"until {step}: ends with {done.returncode}: {done.stderr}")

    def resume(self, work: Path, after: str) -> None:
        """Run to the end: the result must be that of the undisturbed run, and nothing else may lie about."""
        done = self.run(work)
        self.expect(done.returncode == 0, f"{after}: the next run ends with {done.returncode}: {done.stderr}")
        now = self.state_of(work)
        wrong = sorted(name for name in now.keys() | self.expected.keys() if now.get(name) != self.expected.get(name))
        self.expect(not wrong, f"{after}, then resumed: {', '.join(wrong)} differ")

    def nothing_false(self, work: Path, after: str) -> None:
        """Every file of a step that a manifest calls done is there, as the undisturbed run makes it."""
        now = self.state_of(work)
        for manifest in work.rglob("manifest.json"):
            folder = manifest.parent.relative_to(work)
            steps = json.loads(manifest.read_text(encoding="utf-8"))["steps"]
            done = [
                str(folder / name) for step in steps.values() if step["status"] == "done" for name in step["outputs"]
            ]
            wrong = sorted(name for name in done if now.get(name) != self.expected.get(name))
            self.expect(not wrong, f"{after}: {', '.join(wrong)} are not what {manifest} says is done")
        quality = work / "object" / "quality.json"
        if quality.exists():
            files = json.loads(quality.read_text(encoding="utf-8"))["files"]
            wrong = sorted(name for name in files if now.get(f"object/{name}") != self.expected.get(f"object/{name}"))
            self.expect(not wrong, f"{after}: {', '.join(wrong)} are not what {quality} says is done")

    def refused(self, work: Path, what: str, codes: tuple[int, ...], before: Callable[[], None] | None = None) -> None:
        """Run: it must end with one of these codes or 0. A result that looks finished must be that of the undisturbed run."""
        try:
            done = self.run(work, before=before)
        except subprocess.TimeoutExpired:
            self.expect(False, f"{what}: did not end")
            return
        self.expect(done.returncode in (0, *codes), f"{what}: ends with {done.returncode}: {done.stderr}")
        self.expect("Traceback" not in done.stderr, f"{what}: {done.stderr}")
        # quality.json can be complete although the disk had no room to record that the last step is done.
        quality = work / "quality.json"
        self.expect(
            not quality.exists() or hashlib.sha256(quality.read_bytes()).hexdigest() == self.expected["quality.json"],
            f"{what}: looks finished after {done.stderr}",
        )

    def killed(self, moments_s: list[float]) -> None:
        """Kill runs in one workspace at these moments, one after the other."""
        work = self.new_folder("work")
        for moment in moments_s:
            run = subprocess.Popen(
                self.command(work), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
            )
            time.sleep(moment)
            self.runs["kills" if run.poll() is None else "ended before the kill"] += 1
            run.send_signal(signal.SIGKILL)
            run.wait()
            self.expect(group_ended(run.pid), f"killed after {moment} s: processes that it started go on")
            self.nothing_false(work, f"killed after {moment} s")
        self.resume(work, f"killed after {moments_s} s")
        shutil.rmtree(work)

    def killed_together(self, commands: dict[str, list[str]], victim: str, moment_s: float) -> None:
        """Kill one of several programs that work together in one workspace at this moment. The other programs end by themselves,
        or are ended when the last one, for which they all work, has ended.
        """
        work = self.new_folder("work")
        runs = {
            name: subprocess.Popen(
                [word.replace("WORK", str(work)) for word in command], cwd=self.folder, stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE, text=True, errors="replace", start_new_session=True,
            )
            for name, command in commands.items()
        }  # fmt: skip
        what = f"{victim} killed after {moment_s} s"
        time.sleep(moment_s)
        self.runs[f"kills of a {victim.split()[0]}" if runs[victim].poll() is None else "ended before the kill"] += 1
        runs[victim].send_signal(signal.SIGKILL)
        last = next(reversed(runs.values()))
        try:
            _, error = last.communicate(timeout=LONGEST_S)
            self.expect(last.returncode in (0, 4, 5, -signal.SIGKILL), f"{what}: ends with {last.returncode}: {error}")
            self.expect("Traceback" not in error, f"{what}: {error}")
        except subprocess.TimeoutExpired:
            self.expect(False, f"{what}: did not end")
        for run in runs.values():
            run.terminate()
            try:
                run.communicate(timeout=60)
            except subprocess.TimeoutExpired:  # a Dask worker does not react if its scheduler has ended first
                run.kill()
                run.communicate()
            self.expect(group_ended(run.pid), f"{what}: processes that it started go on")
        self.nothing_false(work, what)
        self.resume(work, what)
        shutil.rmtree(work)

    def limited(self, name: str, level: int, before: Callable[[], None], codes: tuple[int, ...]) -> None:
        """Run with a limit of the process, which `before` sets."""
        self.runs[name] += 1
        work = self.new_folder("work")
        self.refused(work, f"{name} {level}", codes, before)
        self.resume(work, f"{name} {level}")
        shutil.rmtree(work, ignore_errors=True)

    def on_full_disk(self, step: str, free_kb: int) -> None:
        """Run on a disk that is full except for `free_kb` once this step is done."""
        self.runs["full disks"] += 1
        what = f"{free_kb} KB left after {step}"
        with small_disk(self.folder / "disk", "size=64m") as disk:
            work = disk / "work"
            self.begin(work, step)
            room = os.statvfs(disk)
            (disk / "filler").write_bytes(bytes(max(room.f_bavail * room.f_frsize - free_kb * 1024, 0)))
            self.refused(work, what, (5,))
            (disk / "filler").unlink()
            self.resume(work, what)

    def on_read_only_disk(self, step: str) -> None:
        """Run on a disk that is read-only once this step is done."""
        self.runs["read-only disks"] += 1
        what = f"read-only after {step}"
        with small_disk(self.folder / "disk", "size=64m") as disk:
            work = disk / "work"
            self.begin(work, step)
            subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
            self.refused(work, what, (2, 5))
            subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True)
            self.resume(work, what)

    def without_permission(self, step: str) -> None:
        """Run as another user, who does not own the workspace, once this step is done."""
        self.runs["no permission"] += 1
        what = f"no permission after {step}"
        work = self.new_folder("work")
        self.begin(work, step)
        self.refused(work, what, (2,), lambda: os.setuid(NOBODY))
        self.resume(work, what)
        shutil.rmtree(work)


def disturbances(attack: Attack) -> list[Callable[[], None]]:
    """All attacks on malus-station that are made once: limits at all levels, disks at all steps."""
    tasks: list[Callable[[], None]] = []

    def limit(name: str, kind: int, level: int, value: int, codes: tuple[int, ...]) -> None:
        tasks.append(lambda: attack.limited(name, level, lambda: resource.setrlimit(kind, (value, value)), codes))

    for level in ADDRESS_SPACE_MB:
        limit("address space, MB", resource.RLIMIT_AS, level, level * MB, (5, NOT_LOADED))
    for level in FILE_SIZE_KB:
        limit("file size, KB", resource.RLIMIT_FSIZE, level, level << 10, (5,))
    if not may_mount(attack.folder / "disk"):
        print("disks, permissions and control groups take root's rights: left out")
        return tasks
    for step, _, _, _ in _core.describe_run(Options(fusion="grid").to_json(), None):
        tasks.append(lambda step=step: attack.on_read_only_disk(step))  # type: ignore[misc]
        tasks.append(lambda step=step: attack.without_permission(step))  # type: ignore[misc]
        for free_kb in FREE_KB:
            tasks.append(lambda step=step, free_kb=free_kb: attack.on_full_disk(step, free_kb))  # type: ignore[misc]
    group = control_group()
    if group is None:
        print("no control group can be made: its limits of memory are left out")
        return tasks

    def in_group(level: int) -> None:
        def enter() -> None:
            (group.parent / "cgroup.procs").write_text(str(os.getpid()))

        group.write_text(str(level * MB))
        attack.limited("control group, MB", level, enter, (5, -signal.SIGKILL))

    return tasks + [lambda level=level: in_group(level) for level in MEMORY_MB]


QUIET = ["--quiet", "--threads", "2"]


def attacks_on_station(program: Path, folder: Path) -> dict[str, Attack]:
    """malus-station with both fusions."""
    # Another user must be able to read program and station, too.
    folder.chmod(0o755)
    program = Path(shutil.copy(program, folder))
    station = tiny_station(folder / "station")
    attacks = {}
    for fusion in ("grid", "refined"):
        (folder / fusion).mkdir()
        attacks[fusion] = Attack(
            fusion, folder / fusion,
            lambda work, fusion=fusion: [str(program), str(station), "-o", str(work), "--fusion", fusion, *QUIET],  # type: ignore[misc]
        )  # fmt: skip
    return attacks


def attacks_on(program: Path, folder: Path) -> dict[str, Attack]:
    """malus-station with both fusions, the report, and a campaign in two processes."""
    attacks = attacks_on_station(program, folder)
    python = [sys.executable, "-m", "malus.cli"]
    (folder / "report").mkdir()
    attacks["report"] = Attack(
        "report", folder / "report", lambda work: [*python, "report", str(work)], folder / "grid" / "undisturbed"
    )
    attacks["batch"] = attack_on_campaign(folder / "batch", 3, '[options]\nfusion = "grid"\n')
    return attacks


def attack_on_campaign(folder: Path, stations: int, more: str = "") -> Attack:
    """A campaign of this many stations in two processes, without reports; `more` lines end its file."""
    for k in range(stations):
        tiny_station(folder / "stations" / f"o{k}", seed=k)
    file = folder / "campaign.toml"
    file.write_text(f'[campaign]\nstations = ["stations/o*/station.toml"]\nreport = false\n{more}')
    batch = [sys.executable, "-m", "malus.cli", "batch", str(file), "--jobs", "2", *QUIET]
    return Attack("campaign", folder, lambda work: [*batch, "-o", str(work)], longest_s=max(LONGEST_S, 60 * stations))


def attack_on_photos(folder: Path) -> Attack:
    """A run from photographs: COLMAP, the sweep, the surface and the report. COLMAP's model differs each time."""
    sys.path.append(str(Path(__file__).resolve().parents[1] / "python"))
    from conftest import demo_with_photos

    folder.mkdir()
    station, _ = demo_with_photos(folder / "station")
    run = [sys.executable, "-m", "malus.cli", "run", str(station), "--fusion", "grid", *QUIET]
    return Attack("photos", folder, lambda work: [*run, "-o", str(work)], repeatable=False)


def attack_on_object(folder: Path) -> Attack:
    """Two stations and the surface of both. Its record must be that of its files, whenever it is there."""
    for k in range(2):
        tiny_station(folder / "parts" / f"o{k}", seed=k)
    file = folder / "object.toml"
    file.write_text('[object]\nstations = ["parts/o*/station.toml"]\nreport = false\n[options]\nfusion = "grid"\n')
    run = [sys.executable, "-m", "malus.cli", "object", str(file), *QUIET]
    return Attack("object", folder, lambda work: [*run, "-o", str(work)])


def killed_beside_others(batch: Attack, chance: random.Random) -> None:
    """Kill one of two shards of a campaign, or one program of a Dask cluster, while the other programs go on."""
    whole = batch.command(Path("WORK"))
    commands = {f"shard {k}": [*whole, "--shard", f"{k}/2"] for k in (1, 2)}
    if find_spec("distributed") is not None and chance.random() < 0.5:
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = str(free.getsockname()[1])
        address = f"tcp://127.0.0.1:{port}"
        dask = [sys.executable, "-m", "distributed.cli.dask_"]
        worker = [*dask[:-1], dask[-1] + "worker", address, "--nthreads", "1", "--no-dashboard"]
        commands = {
            "scheduler": [*dask[:-1], dask[-1] + "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"],
            "worker 1": worker,
            "worker 2": worker,
            "client": [*whole, "--scheduler", address],
        }
    batch.killed_together(commands, chance.choice(list(commands)), chance.uniform(0, 2 * batch.seconds))


def kill(attacks: dict[str, Attack], chance: random.Random) -> None:
    """Kill runs of one attack, chosen at random, one to three times. Quicker attacks are chosen more often."""
    if "batch" in attacks and chance.random() < 0.1:
        killed_beside_others(attacks["batch"], chance)
    [attack] = chance.choices(list(attacks.values()), [1 / attack.seconds**0.5 for attack in attacks.values()])
    attack.killed([chance.uniform(0, attack.seconds) for _ in range(chance.randint(1, 3))])


def counts(attacks: dict[str, Attack]) -> str:
    """The number of runs of each kind so far, for each attack."""
    return "; ".join(f"{name}: {dict(attack.runs)}" for name, attack in attacks.items())


def parser_of_attack(description: str | None) -> argparse.ArgumentParser:
    """Which program is attacked, in which folder, for how long, and with which random seed."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("program", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--seed", type=int, default=1)
    return parser


def main() -> int:
    """Attack for so many seconds; the exit code is 1 if there were findings."""
    parser = parser_of_attack(__doc__)
    parser.add_argument("--kills", type=int, help="only kills, so many in all, however long they take")
    parser.add_argument("--photos", action="store_true", help="only runs from photographs, which take minutes each")
    parser.add_argument("--object", action="store_true", help="only runs of an object of two stations")
    parser.add_argument(
        "--campaign", type=int, help="only a campaign of so many stations, with all --kills (20) before it is done"
    )
    arguments = parser.parse_args()
    end = time.monotonic() + arguments.seconds
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    if arguments.photos:
        attacks = {"photos": attack_on_photos(folder / "photos")}
    elif arguments.object:
        attacks = {"object": attack_on_object(folder / "object")}
    elif arguments.campaign:
        attacks = {"campaign": attack_on_campaign(folder / "campaign", arguments.campaign)}
    else:
        attacks = attacks_on(arguments.program.resolve(), folder)
    chance = random.Random(arguments.seed)
    once = disturbances(attacks["grid"]) if "grid" in attacks and not arguments.kills else []
    chance.shuffle(once)
    kills = told = 0
    with suppress(KeyboardInterrupt):  # an attack that is ended by hand gives its counts, too
        while kills < arguments.kills if arguments.kills else time.monotonic() < end:
            if once:
                once.pop()()
            if arguments.campaign:
                every_s = attacks["campaign"].seconds / (arguments.kills or 20)
                attacks["campaign"].killed([chance.uniform(0, 2 * every_s) for _ in range(arguments.kills or 20)])
                break
            kill(attacks, chance)
            kills = sum(map(Attack.kills, attacks.values()))
            if kills // KILLS_TOLD > told:
                told = kills // KILLS_TOLD
                print(f"{kills} kills: {counts(attacks)}", file=sys.stderr, flush=True)
    for name, attack in attacks.items():
        print(f"{name}: {dict(attack.runs)}; undisturbed {attack.seconds:.1f} s")
    findings = sum(len(attack.findings) for attack in attacks.values())
    print(f"{len(once)} limits and disks not reached; {findings} findings")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
