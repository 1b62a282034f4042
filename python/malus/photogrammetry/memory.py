"""Memory of this machine and of processes, in MB, as Linux reports it."""

from __future__ import annotations

import os
import resource
from pathlib import Path

#: Limit of the control group that a container or a batch queue gives; "max" = none.
_GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")


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


def available_mb() -> float:
    """Memory that a child process can take: what the system reports as available, within the limits of the control group
    and of the address space.
    """
    left = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e6]
    free = _kilobytes(Path("/proc/meminfo"), "MemAvailable")
    if free is not None:
        left.append(1.024e-3 * free)
    try:
        left.append(float(_GROUP_LIMIT.read_text(encoding="ascii")) / 1e6 - resident_mb())
    except (OSError, ValueError):
        pass
    space, _ = resource.getrlimit(resource.RLIMIT_AS)
    if space != resource.RLIM_INFINITY:
        left.append(space / 1e6)
    return max(0.0, min(left))
