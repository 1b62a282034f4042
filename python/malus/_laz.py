"""Decoding of LAZ files in a process of its own: for some damaged files the decoder ends its process, or takes any memory.

    python _laz.py FILE NAME=TYPE…

writes these fields of all points to standard output, point after point, in these types of numpy. It imports nothing of malus.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Points that are decoded at a time.
_AT_ONCE = 1_000_000
_NO_MEMORY = 5


def records_of(points: Any, kind: np.dtype[np.void]) -> NDArray[np.void]:
    """The fields of this type of points that laspy has read."""
    records = np.empty(len(points), kind)
    for name in kind.names or ():
        records[name] = np.asarray(points[name])
    return records


def decoded(path: Path, kind: np.dtype[np.void]) -> NDArray[np.void]:
    """As `records_of`, of all points of a LAZ file. ValueError for a damaged file, MemoryError if there is too little memory."""
    fields = [f"{name}={kind[name].str}" for name in kind.names or ()]
    done = subprocess.run([sys.executable, "-P", __file__, str(path), *fields], capture_output=True)
    if done.returncode == _NO_MEMORY:
        raise MemoryError
    if done.returncode != 0:
        said = done.stderr.decode(errors="replace").strip().splitlines()
        raise ValueError(
            said[-1] if done.returncode > 0 and said else f"it ends its decoder, signal {-done.returncode}"
        )
    return np.frombuffer(done.stdout, kind)


def _decode(path: str, fields: list[str]) -> None:
    laspy = importlib.import_module("laspy")
    kind = np.dtype([(name, type_) for name, type_ in (field.split("=") for field in fields)])
    # Not the backend laszip, which laspy would try next: more damaged files end its process.
    backends = (laspy.LazBackend.LazrsParallel, laspy.LazBackend.Lazrs)
    with laspy.open(path, laz_backend=backends, read_evlrs=False) as reader:
        for points in reader.chunk_iterator(_AT_ONCE):
            sys.stdout.buffer.write(records_of(points, kind).tobytes())


if __name__ == "__main__":
    try:
        _decode(sys.argv[1], sys.argv[2:])
    except (MemoryError, ImportError):  # the process that asks has the libraries: here was no room for them
        sys.exit(_NO_MEMORY)
    except Exception as error:  # whatever a damaged file causes
        sys.exit(str(error))
