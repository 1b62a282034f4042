"""Resources that a stage takes: time, processor time and memory of this process and of COLMAP."""

from __future__ import annotations

import json
import resource

from malus import _core
from malus.photogrammetry.program import Colmap


def _children_seconds() -> float:
    """Processor seconds of the child processes that have ended."""
    use = resource.getrusage(resource.RUSAGE_CHILDREN)
    return use.ru_utime + use.ru_stime


class Meter:
    """Measures from its construction on."""

    def __init__(self, colmap: Colmap | None) -> None:
        """Processes of `colmap` that run meanwhile are included."""
        self._colmap = colmap
        if colmap is not None:
            colmap.peak_mb = 0.0
        self._children = _children_seconds()
        self._watch = _core.StepWatch()

    def stop(self) -> dict[str, float]:
        """To be called once. `seconds`, `cpu_seconds`, and `peak_mb`, the most memory that this process and COLMAP had together."""
        times: dict[str, float | None] = json.loads(self._watch.stop())
        peaks = (times["peak_mb"] or 0.0, self._colmap.peak_mb if self._colmap is not None else 0.0)
        return {
            "seconds": round(times["seconds"] or 0.0, 2),
            "cpu_seconds": round((times["cpu_seconds"] or 0.0) + _children_seconds() - self._children, 2),
            "peak_mb": round(max(peaks)),
        }
