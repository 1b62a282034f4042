"""Counts the instructions of the kernels whose speed is promised and compares them with instructions.json.

A kernel that takes more than recorded, beyond the tolerance, is a failure. Counts depend on the compiler and the
libraries, not on the machine or what else it does; docs/decisions/0035-instruction-counts.md.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
RECORDED = HERE / "instructions.json"
TOLERANCE = 0.05
# BLAS takes the same path on every machine, and no symbols are looked up while instructions are counted. No variables of
# the caller: the environment lies on the stack, so that its size shifts the addresses of everything there.
ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "OPENBLAS_CORETYPE": "Haswell",
    "OMP_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
    "LD_BIND_NOW": "1",
    "LC_ALL": "C",
}


def why_not() -> str | None:
    """Why this machine cannot count instructions; None if it can."""
    if shutil.which("valgrind") is None:
        return "valgrind is not installed"
    cpu = Path("/proc/cpuinfo")
    if not cpu.exists() or " avx2 " not in cpu.read_text():
        return "the processor has no AVX2, so that other versions of the inner loops run"
    return None


def count(build: Path) -> dict[str, int]:
    """Instructions of each kernel. The profiles of the kernels stay in `build`/performance."""
    subprocess.run(["cmake", "--build", build, "--target", "performance_kernels"], check=True)
    profiles = build / "performance"
    shutil.rmtree(profiles, ignore_errors=True)
    profiles.mkdir()
    program = build / "tests" / "performance" / "performance_kernels"
    valgrind = ["valgrind", "-q", "--tool=callgrind", "--instr-atstart=no", "--callgrind-out-file=profile"]
    environment = ENVIRONMENT | {"PATH": os.environ["PATH"]}
    if subprocess.run([*valgrind, str(program), "."], cwd=profiles, env=environment).returncode != 0:
        sys.exit("the kernels did not run to their end")
    counts = {}
    for profile in sorted(profiles.glob("profile.*"), key=lambda path: int(path.suffix[1:])):
        text = profile.read_text()
        kernel = re.search("^desc: Trigger: Client Request: (.*)$", text, re.MULTILINE)
        total = re.search("^totals: ([0-9]+)$", text, re.MULTILINE)
        if kernel and total:
            counts[kernel[1]] = int(total[1])
            profile.rename(profiles / (kernel[1].replace(", ", "-").replace(" ", "-") + ".callgrind"))
    return counts


def compare(counts: dict[str, int], recorded: dict[str, int]) -> tuple[list[str], list[str]]:
    """Prints the table. Returns what is wrong, and the kernels that take much less than recorded."""
    wrong, faster = [f"{kernel}: recorded, but not run" for kernel in recorded if kernel not in counts], []
    print(f"{'kernel':28}{'million instructions':>22}{'recorded':>12}{'change':>10}")
    for kernel, now in counts.items():
        before = recorded.get(kernel)
        if before is None:
            print(f"{kernel:28}{now / 1e6:22.2f}")
            wrong.append(f"{kernel}: not recorded")
            continue
        change = now / before - 1
        print(f"{kernel:28}{now / 1e6:22.2f}{before / 1e6:12.2f}{100 * change:+8.2f} %")
        if change > TOLERANCE:
            wrong.append(
                f"{kernel}: {now / 1e6:.2f} million instructions, {100 * change:.1f} % more than the"
                f" {before / 1e6:.2f} recorded"
            )
        elif change < -TOLERANCE:
            faster.append(kernel)
    return wrong, faster


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=Path, help="CMake's build tree, Release, with MALUS_BUILD_TESTS")
    parser.add_argument("--update", action="store_true", help="record what the kernels take now")
    arguments = parser.parse_args()
    if reason := why_not():
        print(f"skipped: {reason}")
        return 0
    build = arguments.build.resolve()
    counts = count(build)
    recorded = json.loads(RECORDED.read_text()) if RECORDED.exists() else {}
    wrong, faster = compare(counts, recorded)
    update = "tests/performance/run --update"
    if arguments.update:
        RECORDED.write_text(json.dumps(counts, indent=2) + "\n")
        print(f"recorded in {RECORDED.name}")
        return 0
    if faster:
        print(f"much less than recorded: {'; '.join(faster)}. Record it, so that it stays: {update}")
    if wrong:
        print("not as recorded:", file=sys.stderr)
        for line in wrong:
            print(f"  {line}", file=sys.stderr)
        print(
            f"The tolerance is {100 * TOLERANCE:.0f} %. Where they go: callgrind_annotate {build}/performance/KERNEL.callgrind\n"
            f"If it is meant: {update}",
            file=sys.stderr,
        )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
