"""Check before NumPy is loaded that there is enough memory to start."""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path

#: Address space for the loaded package and one small station.
LEAST_MB = 1024


def prepare() -> None:
    """Prepare for a limit of address space (`ulimit -v`, batch queues), if there is one.

    If the limit is too low to start, raise MemoryError; programs end with exit code 5. BLAS gets one thread only: each thread takes
    128 MB when BLAS is loaded, and BLAS waits forever if it does not get them.
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
