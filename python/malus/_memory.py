"""What must be known before NumPy is loaded: whether there is memory to start at all."""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path

#: Address space that the package takes once it is loaded, and room for one small station.
LEAST_MB = 1024


def prepare() -> None:
    """Under a limit of address space (`ulimit -v`, batch queues): MemoryError if it is too low to start, exit code 5 in the
    programs; and one thread for BLAS, each of which takes 128 MB when it is loaded and waits forever if it gets none.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if limit >= LEAST_MB << 20:
        return
    message = f"out of memory: the limit of address space (ulimit -v) is {limit >> 20} MB, expected at least {LEAST_MB} MB to start"
    if Path(sys.argv[0]).name in ("malus", "-m"):
        print(f"malus: {message}", file=sys.stderr)
        sys.exit(5)
    raise MemoryError(message)
