"""Decoding of LAZ files in a process of its own: for some damaged files the decoder ends its process, or takes any memory.

    python _laz.py FILE FIELD…

writes these fields of all points to standard output, point after point, as float64. It imports nothing of malus.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

#: Points that are decoded at a time.
_AT_ONCE = 1_000_000
_NO_MEMORY = 5


def fields_of(path: Path, names: list[str]) -> NDArray[np.float64]:
    """Fields of all points of a LAZ file, N×len(names). ValueError for a damaged file, MemoryError if there is too little memory."""
    done = subprocess.run([sys.executable, "-P", __file__, str(path), *names], capture_output=True)
    if done.returncode == _NO_MEMORY:
        raise MemoryError
    if done.returncode != 0:
        said = done.stderr.decode(errors="replace").strip().splitlines()
        raise ValueError(
            said[-1] if done.returncode > 0 and said else f"it ends its decoder, signal {-done.returncode}"
        )
    return np.frombuffer(done.stdout).reshape(-1, len(names))


def _decode(path: str, names: list[str]) -> None:
    laspy = importlib.import_module("laspy")
    # Not the backend laszip, which laspy would try next: more damaged files end its process.
    backends = (laspy.LazBackend.LazrsParallel, laspy.LazBackend.Lazrs)
    with laspy.open(path, laz_backend=backends, read_evlrs=False) as reader:
        for points in reader.chunk_iterator(_AT_ONCE):
            table = np.stack([np.asarray(points[name], np.float64) for name in names], axis=1)
            sys.stdout.buffer.write(table.tobytes())


if __name__ == "__main__":
    try:
        _decode(sys.argv[1], sys.argv[2:])
    except (MemoryError, ImportError):  # the process that asks has the libraries: here was no room for them
        sys.exit(_NO_MEMORY)
    except Exception as error:  # whatever a damaged file causes
        sys.exit(str(error))
