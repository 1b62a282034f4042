"""Attack on single file operations: one of them fails, as on a network disk or over a quota, or the run is killed at it.

strace counts a run's operations. At one of them, chosen at random, strace makes the system refuse it or kill the program.
This reaches far more kinds of failures, and far narrower places, than full disks and kills at random moments. After each
attack the run is repeated and must leave what an undisturbed run leaves, bit for bit. Where a process may not watch another
one, as in some containers, the attack prints so and does nothing.

    operations.py PROGRAM FOLDER --seconds N [--seed S]
"""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
import time
from collections import Counter

from programs import Attack, attacks_on_station, parser_of_attack

#: Operation → errors that the system may return. ESTALE, EBUSY: another machine moved or holds the file; EDQUOT: the quota
#: is used up, which a network disk reports at fsync and close only.
ERRORS = {
    "openat": ("EACCES", "EIO", "EMFILE", "ENOSPC", "ESTALE"),
    "write": ("EDQUOT", "EIO", "ENOSPC", "ESTALE"),
    "pwrite64": ("EDQUOT", "EIO", "ENOSPC"),
    "fallocate": ("EDQUOT", "ENOSPC", "EOPNOTSUPP"),
    "fsync": ("EDQUOT", "EIO", "ENOSPC"),
    "close": ("EDQUOT", "EIO"),
    "rename": ("EACCES", "EBUSY", "EIO", "ESTALE"),
    "unlink": ("EACCES", "EBUSY", "ESTALE"),
    "mkdir": ("EACCES", "EDQUOT", "EROFS"),
}
KILLED = "signal=SIGKILL"
#: Exit code of the loader if the program cannot begin.
NOT_LOADED = 127


class Operations:
    """The file operations of one attack's run."""

    def __init__(self, attack: Attack) -> None:
        self.attack = attack
        self.done: Counter[str] = Counter()
        self.count = self._counted()

    def disturb(self, operation: str, number: int, what: str) -> None:
        """The operation with this number fails (error=…), or ends the program (signal=SIGKILL)."""
        attack = self.attack
        work = attack.new_folder("work")
        inject = f"inject={operation}:{what}:when={number}"
        command = ["strace", "-f", "-qq", "-e", f"trace={operation}", "-e", inject, "-o", "/dev/null"]
        run = subprocess.run([*command, *attack.command(work)], capture_output=True, text=True, errors="replace")
        self.done["killed at" if what == KILLED else what.removeprefix("error=")] += 1
        code, said = run.returncode, f"{inject}: ends with {run.returncode}: {run.stderr}"
        attack.expect(code in ((-9, 0) if what == KILLED else (0, 2, 5, NOT_LOADED)), said)
        attack.expect("Traceback" not in run.stderr and "error of its own" not in run.stderr, said)
        attack.expect(code in (-9, 0) or bool(run.stderr.strip()), f"{inject}: ends with {code} and says nothing")
        attack.nothing_false(work, inject)
        attack.resume(work, inject)
        shutil.rmtree(work)

    def _counted(self) -> dict[str, int]:
        """How often the first thread of a run does each operation: strace counts for each thread separately."""
        work = self.attack.new_folder("work")
        log = self.attack.folder / "operations.txt"
        command = ["strace", "-f", "-qq", "-e", f"trace={','.join(ERRORS)}", "-o", str(log)]
        subprocess.run([*command, *self.attack.command(work)], check=True, capture_output=True)
        shutil.rmtree(work)
        lines = [line.split(maxsplit=1) for line in log.read_text(errors="replace").splitlines()]
        count = Counter(what.split("(")[0] for process, what in lines if process == lines[0][0])
        return {operation: count[operation] for operation in ERRORS if count[operation] > 0}


def may_watch() -> bool:
    """Whether strace works here."""
    return subprocess.run(["strace", "-o", "/dev/null", "true"], capture_output=True).returncode == 0


def main() -> int:
    """Attack for so many seconds; the exit code is 1 if there were findings."""
    arguments = parser_of_attack(__doc__).parse_args()
    if not may_watch():
        print("strace may not watch other processes here: left out")
        return 0
    end = time.monotonic() + arguments.seconds
    attacks = attacks_on_station(arguments.program.resolve(), arguments.folder.resolve())
    chance = random.Random(arguments.seed)
    all_operations = [Operations(attack) for attack in attacks.values()]
    while time.monotonic() < end:
        operations = chance.choice(all_operations)
        operation = chance.choice(list(operations.count))
        what = KILLED if chance.random() < 0.5 else f"error={chance.choice(ERRORS[operation])}"
        operations.disturb(operation, chance.randint(1, operations.count[operation]), what)
    for operations in all_operations:
        print(f"{operations.attack.name}: {dict(operations.done)} of {operations.count}")
    findings = sum(len(attack.findings) for attack in attacks.values())
    print(f"{findings} findings")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
