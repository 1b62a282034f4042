"""Decoding of LAZ files in a process of its own: for some damaged files the decoder ends its process, or takes any memory.

    python _laz.py FILE NAME=TYPE…

writes these fields of all points to standard output, point after point, in these types of numpy. It imports nothing of malus.
"""

from __future__ import annotations

import importlib
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any, BinaryIO

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
        refused = [line for line in said if line.startswith("memory allocation")]
        if done.returncode > 0 or refused:
            raise ValueError((refused or said or ["damaged"])[-1])
        raise ValueError(f"it ends its decoder, signal {-done.returncode}")
    return np.frombuffer(done.stdout, kind)


def answer(path: str, fields: list[str], out: BinaryIO) -> int | str:
    """Write the points to `out`; returns what the process ends with: 0, `_NO_MEMORY`, or what is wrong with the file."""
    try:
        _decode(path, fields, out)
    except (
        MemoryError,
        ImportError,
    ):  # ImportError: too little memory to load the libraries, which the caller has found
        return _NO_MEMORY
    except Exception as error:  # any error that a damaged file causes
        return str(error)
    return 0


def _decode(path: str, fields: list[str], out: BinaryIO) -> None:
    laspy = importlib.import_module("laspy")
    kind = np.dtype([(name, type_) for name, type_ in (field.split("=") for field in fields)])
    # Not the backend laszip, which laspy would try next: more damaged files end its process.
    backends = (laspy.LazBackend.LazrsParallel, laspy.LazBackend.Lazrs)
    with laspy.open(path, laz_backend=backends, read_evlrs=False) as reader:
        at_once = min(reader.header.point_count, _AT_ONCE) * (reader.header.point_format.size + kind.itemsize)
        _limit_memory(10 * Path(path).stat().st_size + 4 * at_once)
        for points in reader.chunk_iterator(_AT_ONCE):
            out.write(records_of(points, kind).tobytes())


def _limit_memory(more: int) -> None:
    """Limit this process to so many more bytes, plus 64 MB and what the decoder's threads take. For a damaged file the decoder would
    allocate whatever size the file states, and fill it with zeros.
    """
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    of_threads = 8_000_000 * (os.cpu_count() or 1)
    wanted = int(status["VmData"].split()[0]) * 1024 + 64_000_000 + of_threads + more
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    # A lower limit that the user set stays.
    resource.setrlimit(resource.RLIMIT_DATA, (wanted if soft == resource.RLIM_INFINITY else min(wanted, soft), hard))


if __name__ == "__main__":
    sys.exit(answer(sys.argv[1], sys.argv[2:], sys.stdout.buffer))
