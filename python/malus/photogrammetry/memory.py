"""Memory of this machine and of processes, in MB, as Linux reports it."""

from __future__ import annotations

import os
import resource
from contextlib import suppress
from pathlib import Path


def _kilobytes(file: Path, field: str) -> float | None:
    """N of a line `field: N kB`; None if there is no such file or line."""
    try:
        for line in file.read_text(encoding="utf-8").splitlines():
            name, _, value = line.partition(":")
            if name == field:
                return float(value.split()[0])
    except OSError:
        pass
    return None


def peak_mb(process: int) -> float:
    """Most memory that a process has had; 0 if it has ended."""
    return 1.024e-3 * (_kilobytes(Path(f"/proc/{process}/status"), "VmHWM") or 0.0)


def resident_mb() -> float:
    """Memory that this process has now."""
    return 1.024e-3 * (_kilobytes(Path("/proc/self/status"), "VmRSS") or 0.0)


def group_limits_mb(root: Path = Path("/")) -> list[float]:
    """Limits of the control groups that this process is in, as containers and batch queues give them; empty without any.

    A group's own limit may be larger than that of a group around it. root: folder that has proc and sys.
    """
    try:
        groups = (root / "proc/self/cgroup").read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return []
    limits = []
    for controllers, path in (line.split(":", 2)[1:] for line in groups):
        if controllers == "":
            mount, file = root / "sys/fs/cgroup", "memory.max"
        elif "memory" in controllers.split(","):  # version 1
            mount, file = root / "sys/fs/cgroup/memory", "memory.limit_in_bytes"
        else:
            continue
        # In a container the path may be that of the host, of which only the mount point itself exists.
        own = mount / path.lstrip("/")
        for group in (own, *own.parents):
            with suppress(OSError, ValueError):  # ValueError: "max", no limit
                limits.append(float((group / file).read_text(encoding="ascii")) / 1e6)
            if group == mount:
                break
    return limits


def _machine_mb() -> float:
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e6


def limit_mb() -> float:
    """Memory that this process may have: the machine's, within the limits of control groups."""
    return min([_machine_mb(), *group_limits_mb()])


def available_mb() -> float:
    """Memory that a child process can take: what the system reports as available, within the limits of control groups
    and of the address space.
    """
    left = [_machine_mb(), *(limit - resident_mb() for limit in group_limits_mb())]
    free = _kilobytes(Path("/proc/meminfo"), "MemAvailable")
    if free is not None:
        left.append(1.024e-3 * free)
    space, _ = resource.getrlimit(resource.RLIMIT_AS)
    if space != resource.RLIM_INFINITY:
        left.append(space / 1e6)
    return max(0.0, min(left))
