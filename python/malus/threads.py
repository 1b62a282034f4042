"""How many threads a computation uses."""

import os

#: The processors that this process may use: the default of every function.
ALL_CORES: int = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
